"""Registration in a real browser: look, turn, click pairs, solve, save."""

import shutil

import numpy as np
import pandas as pd
import pytest

from roadsight.geometry.cameras import Intrinsics, cam_from_world, project
from roadsight.geometry.frames import Frame
from roadsight.io.images.camera_tables import read_baselines, read_cameras
from roadsight.io.records.atomic import read_json
from tests.e2e.studio_page import (
    check_look,
    click_at,
    drag,
    hold_back,
    key,
    noted,
    open_studio,
    press,
)
from tests.e2e.studio_project import Studio, make_project

pytestmark = pytest.mark.xdist_group("studio")
READY = "window.studio?.page?.content && studio.page.error && !studio.page.measuring"


@pytest.fixture(scope="module")
def studio(tmp_path_factory):
    folder = tmp_path_factory.mktemp("studio")
    with Studio(make_project(folder / "project"), folder / "log") as started:
        yield started


@pytest.fixture
def files(studio):
    """The site's own folder, with nothing in it yet."""
    file = studio.folder / "config/sites/drive.yaml"
    before = file.read_bytes()
    yield file.with_suffix("")
    file.write_bytes(before)
    shutil.rmtree(file.with_suffix(""), ignore_errors=True)


@pytest.fixture
def page(browser, studio, files):
    return open_studio(browser, studio, "registration/drive", READY)


def pose(page):
    return page.run("studio.page.pose")


def projected(page, places):
    """Pixels by the workflow's own projection with the page's pose."""
    now, (width, height) = pose(page), page.run("studio.page.content.size")
    camera = Intrinsics.centred(width, height, now["focal_px"])
    rotation = cam_from_world(now["heading_deg"], now["pitch_deg"], now["roll_deg"])
    return project(camera, rotation, [now[k] for k in "xyz"], places)[0]


def test_the_page_projects_as_the_workflow_does(page):
    page.run("studio.page.turn({ heading: 3.2, pitch: -1.4, roll: 2.5, ahead: 0.7, up: 0.4 })")
    rng = np.random.default_rng(4)
    now = pose(page)
    ahead = np.radians(now["heading_deg"] + rng.uniform(-20, 20, 30))
    away = rng.uniform(4, 60, 30)
    places = np.column_stack(
        [now["x"] + away * np.sin(ahead), now["y"] + away * np.cos(ahead), rng.uniform(0, 6, 30)]
    )
    shown = page.run(f"""import('/assets/js/registration/camera.js').then(({{ projector }}) => {{
        const project = projector(studio.page.pose, studio.page.content.centre);
        return {places.tolist()}.map((place) => project(...place).slice(0, 2));
    }})""")
    np.testing.assert_allclose(shown, projected(page, places), atol=1e-6)
    assert page.complaints == []


def test_knobs_turn_back_into_the_pose(page):
    page.run("studio.page.turn({ right: 1.5, ahead: -0.5, heading: 4, roll: -1, focal: 1.1 })")
    turned = pose(page)
    page.run("studio.page.turn({ right: -1.5, ahead: 0.5, heading: -4, roll: 1, focal: 1 / 1.1 })")
    back, base = pose(page), page.run("studio.page.base")
    assert back == pytest.approx(base, abs=1e-9)
    assert turned["heading_deg"] == pytest.approx((base["heading_deg"] + 4) % 360)


def test_sliders_and_mouse_move_the_camera_and_the_error_follows(page):
    before, typical = (page.run(f"studio.page.error.{name}_px") for name in ("rms", "median"))
    page.run("""(() => {
        const slider = document.querySelector('[data-knob=heading]');
        slider.value = 2; slider.dispatchEvent(new Event('input'));
    })()""")
    page.until("!studio.page.measuring")
    assert page.run("studio.page.error.rms_px") > before + 1
    assert page.run("studio.page.error.median_px") > typical + 1
    told = page.run("document.querySelector('[data-told=median]').textContent")
    assert float(told.split()[0]) == pytest.approx(
        page.run("studio.page.error.median_px"), abs=0.006
    )
    told = page.run("document.querySelector('[data-told=rms]').textContent")
    assert float(told.split()[0]) == pytest.approx(page.run("studio.page.error.rms_px"), abs=0.006)
    start = pose(page)
    key(page, "r")
    drag(page, (700, 400), (760, 400))
    assert pose(page)["heading_deg"] != pytest.approx(start["heading_deg"], abs=0.1)
    key(page, "m")
    drag(page, (700, 400), (700, 460))
    assert pose(page)["z"] > start["z"] + 0.3
    key(page, "l")
    drag(page, (700, 460), (700, 400))
    assert pose(page)["focal_px"] > 1.05 * start["focal_px"]
    drag(page, (700, 400), (700, 300))
    for _ in range(5):
        key(page, "z", modifiers=2)
    assert pose(page) == pytest.approx(page.run("studio.page.base"))


def test_keys_step_and_turn(page):
    key(page, "]")
    page.until("studio.page.number === 1 && " + READY)
    start = pose(page)
    key(page, "ArrowRight")
    key(page, "ArrowUp", modifiers=8)
    assert pose(page)["heading_deg"] == pytest.approx(start["heading_deg"] + 0.05)
    assert pose(page)["pitch_deg"] == pytest.approx(start["pitch_deg"] + 0.5)
    key(page, "}")
    page.until("studio.page.images[studio.page.number].state === 'rejected'")
    page.until("document.querySelector('[data-state=rejected]')")
    assert "no <edges> in the image" in page.run("document.querySelector('.panel').textContent")


def test_pairs_are_clicked_and_solved(page, files, studio):
    """Pairs of the present pose lead back to it from a start that is off."""
    base = page.run("studio.page.base")
    key(page, "c")
    page.until("studio.page.picture.picked?.length > 4000")
    box = page.run(
        "(({ left, top }) => [left, top])(studio.page.picture.canvas.getBoundingClientRect())"
    )
    chosen = page.run("""(() => {
        const { picked, points } = studio.page.picture;
        const all = [];
        for (let k = 0; k < picked.length; k += 4) {
            const [i, u, v, depth] = picked.slice(k, k + 4);
            if (depth > 6 && depth < 45 && u > 40 && v > 60) all.push([u, v, points[i + 3], depth]);
        }
        all.sort((a, b) => a[2] - b[2]);
        return Array.from({ length: 9 }, (_, n) => all[Math.floor((n + 0.5) / 9 * all.length)]);
    })()""")
    for u, v, *_ in chosen:
        click_at(page, box[0] + u, box[1] + v)
        place = page.run("[studio.page.half.x, studio.page.half.y, studio.page.half.z]")
        (a, b), fit = projected(page, [place])[0], page.run("studio.page.picture.fit")
        goal = fit["left"] + (a + 0.5) * fit["scale"], fit["top"] + (b + 0.5) * fit["scale"]
        click_at(page, box[0] + goal[0], box[1] + goal[1])
        page.run("studio.page.picture.paint()")
    assert page.run("studio.page.pairs.length") == 9
    page.run("studio.page.turn({ heading: 3, right: 0.8, focal: 1.2 })")
    page.run("studio.page.picture.canvas.focus()")
    key(page, "Enter")
    noted(page, "Solved:")
    solved = pose(page)
    assert abs(solved["heading_deg"] - base["heading_deg"]) < 0.7
    assert np.hypot(solved["x"] - base["x"], solved["y"] - base["y"]) < 0.7
    page.run("document.querySelector('[data-do=use]').click()")
    press(page, "Save baseline (1 image)")
    noted(page, "Baseline of 800x400")
    found = read_baselines(files / "baseline.json")["800x400"]
    assert found["pairs"] == 9
    assert found["focal_px"] == pytest.approx(solved["focal_px"], rel=1e-6)
    pairs = pd.read_csv(files / "pairs.csv")
    assert list(pairs.columns) == ["image", "pixel_x", "pixel_y", "x", "y", "z"] and len(pairs) == 9
    assert "baseline: drive/baseline.json" in files.with_suffix(".yaml").read_text()


def test_a_pose_lands_on_the_image_that_was_asked_for(page):
    base = page.run("studio.page.base")
    places = page.run("""(() => {
        const { points } = studio.page.picture;
        const step = 4 * Math.floor(points.length / 4 / 60);
        const place = (at) => Array.from(points.slice(at, at + 3));
        return Array.from({ length: 60 }, (_, n) => place(step * n));
    })()""")
    seen = zip(places, projected(page, places).tolist(), strict=True)
    pairs = [
        {"x": x, "y": y, "z": z, "u": u, "v": v}
        for (x, y, z), (u, v) in seen
        if 0 < u < 800 and 0 < v < 400
    ]
    assert len(pairs) >= 6
    page.run(f"studio.page.edit((own) => {{ own.pairs = {pairs}; own.pose.heading_deg += 3; }})")
    hold_back(page, "POST", "/solve")
    page.run("document.querySelector('[data-do=solve]').click()")
    page.until("window.held")
    name = page.run("studio.page.name")
    key(page, "]")
    page.until("studio.page.number === 1 && " + READY)
    page.run("release()")
    noted(page, f"Solved {name}")
    assert page.run("studio.page.own ?? null") is None
    solved = page.run(f"studio.page.history.now.images[{name!r}].pose")
    assert solved["heading_deg"] == pytest.approx(base["heading_deg"], abs=0.5)


def test_images_without_a_place_are_stepped_over(page):
    page.run("studio.page.images[1].state = 'unusable'")
    states = page.run("studio.page.images.map(({ state }) => state)")
    then = next(n for n, state in enumerate(states) if n > 1 and state != "unusable")
    key(page, "]")
    page.until(f"studio.page.number === {then} && {READY}")
    key(page, "[")
    page.until("studio.page.number === 0 && " + READY)
    assert page.complaints == []


def test_a_first_image_that_cannot_be_shown_is_told(page):
    told = page.run("""(() => {
        const { fetch } = window;
        const refuse = async () => new Response('{"error": "is damaged"}', { status: 422 });
        const asked = (url) => /images[/]\\d+$/.test(url);
        window.fetch = (url, options) => (asked(url) ? refuse() : fetch(url, options));
        return import('/assets/js/registration/page.js')
            .then(({ open }) => open(studio.page.site))
            .then(() => 'opened', (error) => error.message);
    })()""")
    assert told == "is damaged"


def test_a_correction_is_not_saved_over_another_one(page, files, studio):
    page.run("studio.page.turn({ heading: 1 })")
    press(page, "Save correction")
    page.until("document.querySelector('[data-state=corrected]')")
    theirs = (files / "corrections.csv").read_text().replace(".", ".0", 1)
    (files / "corrections.csv").write_text(theirs)
    press(page, "Save correction")
    noted(page, "changed meanwhile")
    assert (files / "corrections.csv").read_text() == theirs


def test_a_correction_by_hand_is_kept_and_forgotten(page, files, studio):
    page.run("studio.page.turn({ heading: 1, right: 0.25 })")
    wanted = pose(page)
    press(page, "Save correction")
    page.until("document.querySelector('[data-state=corrected]')")
    frame = Frame.from_dict(read_json(studio.folder / "results/drive/scene/frame.json"))
    table = read_cameras(files / "corrections.csv", frame)
    row = table.iloc[0]
    assert len(table) == 1
    for name in ("x", "y", "z", "heading_deg", "pitch_deg", "roll_deg"):
        assert row[name] == pytest.approx(wanted[name], abs=2e-4)
    press(page, "Forget correction")
    page.until("!document.querySelector('[data-state=corrected]')")
    assert "corrections" not in files.with_suffix(".yaml").read_text()


def test_unsaved_work_survives_a_reload(page):
    page.run("studio.page.turn({ heading: 1 })")
    turned = pose(page)
    page.reload()
    page.until(READY)
    assert pose(page) == pytest.approx(turned)


def test_too_few_pairs_are_told(page):
    page.run("""studio.page.edit((own) => {
        own.pairs = [1, 2, 3, 4].map((n) => ({ u: n, v: n, x: n, y: n, z: n }));
    })""")
    press(page, "Solve")
    noted(page, "lie on one line")


def test_pairs_by_keys(page):
    page.until("studio.page.picture.picked?.length > 4000")
    u, v = page.run("studio.page.picture.picked.slice(4 * 500 + 1, 4 * 500 + 3)")
    key(page, "c")
    page.run(f"""(() => {{
        const {{ picture }} = studio.page;
        picture.cross = [{u} - 12, {v} + 9];
        picture.canvas.focus();
    }})()""")
    key(page, "ArrowRight")
    key(page, "ArrowUp")
    key(page, "ArrowRight", modifiers=8)
    key(page, " ")
    assert page.run("studio.page.half !== null")
    key(page, "ArrowDown")
    key(page, " ")
    pair = page.run("studio.page.pairs[0]")
    shown = projected(page, [[pair[name] for name in "xyz"]])[0]
    assert abs(shown[0] - pair["u"]) < 25 and abs(shown[1] - pair["v"]) < 25
    key(page, "Delete")
    assert page.run("studio.page.pairs.length") == 0


def test_looks(page):
    for dark in (False, True):
        for size in ((1280, 720), (1920, 1080)):
            check_look(page, *size, dark)
