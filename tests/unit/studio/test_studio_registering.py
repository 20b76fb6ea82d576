from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from roadsight.base.errors import InputError
from roadsight.geometry import cameras
from roadsight.io.images.camera_tables import read_baselines
from roadsight.io.records.atomic import read_json, write_json
from roadsight.poles.alignment.published import WINDOW_PX
from roadsight.studio.drive_views import SiteDrive
from roadsight.studio.project import Project
from roadsight.studio.registering import (
    Pair,
    PoseBody,
    Registered,
    alignment_error,
    before_camera,
    image_content,
    points_around,
    save_baseline,
    save_correction,
    solve_pairs,
)
from tests.e2e.studio_project import make_project


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return make_project(tmp_path_factory.mktemp("registering") / "project")


@pytest.fixture
def project(folder, monkeypatch):
    monkeypatch.chdir(folder)
    return Project(folder)


@pytest.fixture
def drive(project):
    return SiteDrive(project.site("drive"))


def test_before_a_camera_as_angle_by_angle(rng):
    offset = rng.uniform(-160, 160, (500, 2))
    for heading in (0.0, 90.0, 200.0, 359.0):
        ahead = np.array([np.sin(np.radians(heading)), np.cos(np.radians(heading))])
        away = np.linalg.norm(offset, axis=1)
        slowly = ((offset @ ahead) / away >= np.cos(np.radians(30))) & (away <= 150)
        slowly |= away <= 5
        np.testing.assert_array_equal(before_camera(offset, heading, 30.0), slowly)


def test_the_error_is_that_of_points_with_a_pixel_in_the_window(drive):
    place = drive.place(2)
    seen, there = drive.scene.edges_of(place)
    pixels = [
        np.concatenate([seen.uv_px[seen.groups[k] : seen.groups[k + 1]] for k in (side, side + 2)])
        for side in (0, 1)
    ]
    ours = alignment_error(drive, place, drive.expected(place))
    assert ours["points"] > 10
    gaps, squares = [], []
    for pixel, part in zip(pixels, (slice(there.left), slice(there.left, None)), strict=True):
        uv = _seen_at(place.start, drive.expected(place), there.xyz_m[part])
        nearest = np.linalg.norm(uv[:, None] - pixel[None], axis=2).min(axis=1)
        gaps.extend(nearest[nearest <= WINDOW_PX])
        off = uv[:, None] - pixel[None]
        partner = np.where((abs(off) < WINDOW_PX).all(axis=2), (off**2).sum(axis=2), np.inf)
        squares.extend(partner.min(axis=1)[np.isfinite(partner).any(axis=1)])
    assert ours["rms_px"] == pytest.approx(np.sqrt(np.mean(squares)))
    assert ours["median_px"] == pytest.approx(np.median(gaps))


def _seen_at(start, pose, xyz_m):
    """Pixels of the points that the camera contains."""
    size = (start.width_px, start.height_px)
    camera = cameras.Intrinsics(*size, pose["focal_px"], start.cx_px, start.cy_px)
    rotation = cameras.cam_from_world(pose["heading_deg"], pose["pitch_deg"], pose["roll_deg"])
    uv, _ = cameras.project(camera, rotation, [pose["x"], pose["y"], pose["z"]], xyz_m)
    return uv[camera.contains(uv)]


def test_states_of_images(drive):
    states = [image["state"] for image in drive.about()]
    assert {"accepted", "rejected", "unusable"} <= set(states)
    lost = states.index("unusable")
    with pytest.raises(InputError, match="no usable place"):
        image_content(drive, lost)
    with pytest.raises(InputError, match="no such image"):
        drive.place(10**6)


def test_points_come_with_their_heights(project, drive):
    content = np.frombuffer(points_around(project.site("drive"), drive, 2), np.float32)
    points = content.reshape(-1, 4)
    assert len(points) > 100 and np.isfinite(points).all()
    assert np.abs(points[:, 3]).max() < 40


def test_a_pose_set_by_eye_makes_a_baseline(project, drive, folder):
    pose = PoseBody.model_validate(drive.expected(drive.place(1)))
    found = save_baseline(project, drive, [Registered(number=1, pose=pose)])
    baselines = read_baselines(folder / "config/sites/drive/baseline.json")
    assert list(baselines) == ["800x400"] == list(found["baselines"])
    assert baselines["800x400"]["focal_px"] == pytest.approx(pose.focal_px)
    assert project.site("drive").resolved.site.poles.baseline == "drive/baseline.json"
    again = save_baseline(project, drive, [Registered(number=1, pose=pose)])
    assert again["changed"] == []


def test_a_baseline_is_about_the_middle(project, drive, folder, monkeypatch):
    """The principal point of a drive is found after its baseline."""
    pose = PoseBody.model_validate(drive.expected(drive.place(1)))
    one = [Registered(number=1, pose=pose)]
    yaw_deg = []
    for shift_px in (0.0, 15.0):
        monkeypatch.setattr(drive, "shift_px", lambda place, shift=shift_px: shift)
        save_baseline(project, drive, one)
        found = read_baselines(folder / "config/sites/drive/baseline.json")["800x400"]
        yaw_deg.append(found["yaw_deg"])
    turn_deg = np.degrees(np.arctan(15.0 / pose.focal_px))
    assert yaw_deg[0] - yaw_deg[1] == pytest.approx(turn_deg)


def test_baselines_of_other_sizes_stay(project, drive, folder):
    own = folder / "config/sites/drive"
    pose = PoseBody.model_validate(drive.expected(drive.place(1)))
    pairs = [Pair(u=10.0 * n, v=5, x=n, y=n * n, z=0) for n in range(3)]
    save_baseline(project, drive, [Registered(number=1, pose=pose, pairs=pairs)])
    known = read_json(own / "baseline.json")
    write_json(own / "baseline.json", known | {"640x480": {"hfov_deg": 70.0}})
    with (own / "pairs.csv").open("a") as stream:
        stream.write("of_another_size,1,2,3,4,5\n")
    save_baseline(project, drive, [Registered(number=2, pose=pose)])
    found = read_baselines(own / "baseline.json")
    assert set(found) == {"640x480", "800x400"} and found["640x480"]["hfov_deg"] == 70.0
    assert [row.split(",")[0] for row in (own / "pairs.csv").read_text().split()] == [
        "image",
        "of_another_size",
    ]


def test_corrections_by_two_at_once_are_both_kept(project, drive):
    numbers = [n for n, image in enumerate(drive.about()) if image["state"] != "unusable"][:4]
    with ThreadPoolExecutor(4) as pool:
        poses = {n: PoseBody.model_validate(drive.expected(drive.place(n))) for n in numbers}
        list(pool.map(lambda n: save_correction(project, drive, n, poses[n]), numbers))
    now = SiteDrive(project.site("drive"))
    assert set(now.corrections) == {drive.place(n).image for n in numbers}
    for number in numbers:
        save_correction(project, drive, number, None)
    assert not Path("config/sites/drive/corrections.csv").exists()


def test_corrections_of_images_that_are_gone_stay(project, drive):
    pose = PoseBody.model_validate(drive.expected(drive.place(1)))
    save_correction(project, drive, 1, pose)
    path = Path("config/sites/drive/corrections.csv")
    header, row = path.read_text().split()
    gone = row.replace(drive.place(1).image, "zz_gone")
    path.write_text("\n".join([header, row, gone]) + "\n")
    save_correction(project, drive, 2, pose)
    assert gone in path.read_text().split() and row in path.read_text().split()
    path.write_text("image,focal_px\nx,1\n")
    with pytest.raises(InputError, match="lacks a column"):
        save_correction(project, drive, 1, pose)
    assert path.read_text() == "image,focal_px\nx,1\n"
    path.write_text(f"{header}\n{row}\n")
    save_correction(project, drive, 1, None)
    assert not path.exists()


def test_corrections_are_kept_beside_each_other_and_forgotten_one_by_one(project, drive):
    for number in (1, 2):
        pose = PoseBody.model_validate(drive.expected(drive.place(number)))
        save_correction(project, drive, number, pose)
        drive = SiteDrive(project.site("drive"))
    names = {drive.place(1).image, drive.place(2).image}
    assert set(drive.corrections) == names
    save_correction(project, drive, 1, None)
    drive = SiteDrive(project.site("drive"))
    assert set(drive.corrections) == names - {drive.place(1).image}
    save_correction(project, drive, 2, None)
    assert project.site("drive").resolved.site.poles.corrections is None


def test_an_image_is_solved_about_the_principal_point_of_its_drive(drive, rng):
    """Poses, errors and overlays of an image share one principal point."""
    place = drive.place(1)
    start = replace(place.start, cx_px=place.start.cx_px + 15.0)
    drive.places[place.image] = replace(place, start=start)
    pose = drive.expected(place)
    camera = cameras.Intrinsics(
        start.width_px, start.height_px, pose["focal_px"], start.cx_px, start.cy_px
    )
    rotation = cameras.cam_from_world(pose["heading_deg"], pose["pitch_deg"], pose["roll_deg"])
    depth = rng.uniform(8, 60, 10)
    ahead = np.column_stack([rng.uniform(-0.4, 0.4, 10), rng.uniform(-0.2, 0.1, 10), np.ones(10)])
    eye = np.array([pose["x"], pose["y"], pose["z"]])
    xyz = eye + depth[:, None] * ahead @ rotation
    uv, _ = cameras.project(camera, rotation, eye, xyz)
    pairs = [Pair(u=u, v=v, x=x, y=y, z=z) for (u, v), (x, y, z) in zip(uv, xyz, strict=True)]
    found = solve_pairs(drive, 1, pairs)
    assert found["rms_px"] < 0.1
    assert abs(cameras.wrap_deg(found["pose"]["heading_deg"] - pose["heading_deg"])) < 0.02
    assert image_content(drive, 1)["centre"] == [start.cx_px, start.cy_px]


def test_too_few_pairs_are_told(drive):
    with pytest.raises(InputError, match="too few"):
        solve_pairs(drive, 1, [Pair(u=1, v=1, x=1, y=1, z=1)])


@pytest.mark.parametrize(
    "change", [{"focal_px": 0}, {"focal_px": float("nan")}, {"pitch_deg": 91}, {"x": 1e9}, {"w": 1}]
)
def test_impossible_poses_are_refused(drive, change):
    pose = drive.expected(drive.place(1)) | change
    with pytest.raises(ValueError, match="validation error"):
        PoseBody.model_validate(pose)


def test_pictures_are_straightened_where_the_workflow_does_so(project, drive, folder):
    import cv2

    from roadsight.studio.drive_views import lens_for, without_distortion

    site, key = project.site("drive"), ("40001", 800, 400)
    assert lens_for(site, key) is None
    lens = {
        "route": key[0], "width_px": 800, "height_px": 400, "k1": -0.2, "k2": 0.0,
        "scale_px": 400.0,
    }  # fmt: skip
    write_json(folder / "results/drive/poles/drive.json", {"lenses": [lens]})
    effects = folder / "results/drive/effects.json"
    before = effects.read_bytes() if effects.exists() else None
    try:
        for decision, distorts in (("skip", False), ("simulate", True)):
            write_json(effects, [{"effect": "lens_distortion", "decision": decision}])
            assert (lens_for(site, key) is not None) == distorts
        found = lens_for(site, key)
        # A point of the pinhole's image comes from where the lens showed it.
        wanted = np.array([[620.0, 300.0]])
        u, v = np.rint(found.distort(wanted)[0]).astype(int)
        image = np.zeros((400, 800, 3), np.uint8)
        cv2.circle(image, (int(u), int(v)), 4, (255, 255, 255), -1)
        content = without_distortion(cv2.imencode(".png", image)[1].tobytes(), found)
        turned = cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_GRAYSCALE)
        rows, columns = np.nonzero(turned > 128)
        assert [columns.mean(), rows.mean()] == pytest.approx([620, 300], abs=1.5)
        with pytest.raises(InputError, match="no image"):
            without_distortion(b"text", found)
    finally:
        effects.unlink() if before is None else effects.write_bytes(before)
        (folder / "results/drive/poles/drive.json").unlink()
