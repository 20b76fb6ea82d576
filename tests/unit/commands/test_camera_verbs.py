import io
import json
from contextlib import redirect_stdout
from functools import partial
from zipfile import ZipFile

import numpy as np
import pandas as pd
import pytest

from roadsight.__main__ import main
from roadsight.geometry.cameras import Intrinsics, project
from roadsight.io.images.image_shards import LabelImages
from roadsight.stages.scene import generate_rural, render_videolog
from roadsight_worlds.rural.rural_road import build_rural
from roadsight_worlds.rural.videolog import random_drives
from tests.helpers.tagged_images import gps_jpeg, jpeg

LENGTH = ["--length-m", "160", "--seed", "2"]
FOOT_M = 1200 / 3937
NARROW_PX, WIDE_PX = (500, 300), (400, 280)


def stage(module, **files):
    named = [part for name, path in files.items() for part in (f"--{name}", str(path))]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module, "build_rural", partial(build_rural, detail=0.01))
        drives = partial(random_drives, narrow_px=NARROW_PX, wide_px=WIDE_PX)
        for name in ("generate_rural", "render_videolog"):
            part = {"generate_rural": generate_rural, "render_videolog": render_videolog}[name]
            if hasattr(part, "random_drives"):
                patch.setattr(part, "random_drives", drives)
        options = ["--pulses-per-m2", "15"] if module is generate_rural else []
        assert module.main([*LENGTH, *options, *named]) == 0


@pytest.fixture(scope="module")
def drive(tmp_path_factory):
    """Cloud, videolog and true cameras of a road of 160 m."""
    folder = tmp_path_factory.mktemp("drive")
    names = {"cloud": "c.laz", "truth": "t.gpkg", "poles": "p.csv", "videolog": "v.csv"}
    names |= {"cameras": "k.csv", "baseline": "b.json"}
    stage(generate_rural, **{k: folder / v for k, v in names.items()})
    return folder


def front(drive):
    cameras = pd.read_csv(drive / "k.csv")
    return cameras[cameras["view"] == "front"].reset_index(drop=True)


def clicked(drive, images, rng, pairs=9):
    """Rows of pairs that a careful person would click in images with true cameras."""
    rows = []
    for _, camera in front(drive)[lambda t: t["image"].isin(images)].iterrows():
        rotation = camera[[f"cam_from_world_r{i}{j}" for i in range(3) for j in range(3)]]
        rotation = rotation.to_numpy(float).reshape(3, 3)
        lens = Intrinsics(
            *(camera[[f"{n}_px" for n in ("width", "height")]].astype(int)),
            *camera[["focal_px", "cx_px", "cy_px"]].astype(float),
        )
        native = camera[["easting_usft", "northing_usft", "height_usft"]].to_numpy(float) * FOOT_M
        depth = rng.uniform(10, 60, pairs)
        uv = rng.uniform([20, 40], [lens.width_px - 20, lens.height_px - 20], (pairs, 2))
        ray = np.column_stack([uv[:, 0] - lens.cx_px, uv[:, 1] - lens.cy_px])
        seen = np.column_stack([ray / lens.focal_px, np.ones(pairs)]) * depth[:, None]
        xyz = seen @ rotation + native
        again, _ = project(lens, rotation, native, xyz)
        assert np.allclose(again, uv)
        for pixel, place in zip(uv + rng.normal(0, 0.5, uv.shape), xyz / FOOT_M, strict=True):
            rows.append((camera["image"], *pixel, *place))
    names = ["image", "pixel_x", "pixel_y", "x", "y", "z"]
    return pd.DataFrame(rows, columns=names)


@pytest.fixture(scope="module")
def tagged(drive, tmp_path_factory):
    """The same drive as a folder of geotagged images, which are blank."""
    folder = tmp_path_factory.mktemp("tagged")
    cameras = front(drive).set_index("image")
    for row in pd.read_csv(drive / "v.csv", keep_default_na=False).itertuples():
        size = tuple(cameras.loc[row.image, ["width_px", "height_px"]].astype(int))
        route = folder / row.route
        route.mkdir(exist_ok=True)
        content = gps_jpeg(row.latitude, row.longitude, size=size)
        (route / row.image).write_bytes(content)
    return folder


def register(drive, images, pairs, out, videolog=None):
    pairs.to_csv(out.with_name("pairs.csv"), index=False)
    argv = ["register", out.with_name("pairs.csv"), "--videolog", videolog or drive / "v.csv"]
    argv += ["--cloud", drive / "c.laz", "--images", images, "-o", out]
    return main([str(part) for part in argv])


def test_a_baseline_from_clicked_pairs_of_geotagged_images(drive, tagged, tmp_path, capsys, rng):
    """The videolog is the images' own EXIF; heights and lens are those of the truth."""
    truth = front(drive)
    route = truth["route"].iloc[0]
    own = truth[truth["route"] == route]
    images = own["image"].iloc[[3, 5, 7]].tolist()
    pairs = clicked(drive, images, rng)
    pairs["image"] = route + "/" + pairs["image"]
    out = tmp_path / "baseline.json"
    assert register(drive, tagged, pairs, out, videolog=tagged) == 0
    size = f"{own['width_px'].iloc[0]}x{own['height_px'].iloc[0]}"
    content = json.loads(out.read_text())
    assert list(content) == [size]
    found = content[size]
    assert found["focal_px"] == pytest.approx(own["focal_px"].iloc[0], rel=0.02)
    assert found["height_m"] == pytest.approx(own["height_above_road_m"].mean(), abs=0.3)
    assert (found["images"], found["pairs"]) == (3, 27)
    assert found["rms_px"] < 2.0
    printed = capsys.readouterr().out
    assert printed.count("off by") == 27 and f"{size}: focal length" in printed


@pytest.mark.parametrize(
    "fault",
    [
        "few",
        pytest.param("line", marks=pytest.mark.full),
        pytest.param("stranger", marks=pytest.mark.full),
    ],
)
def test_pairs_that_do_not_tell_are_refused(drive, tagged, tmp_path, capsys, rng, fault):
    route, image = front(drive)[["route", "image"]].iloc[3]
    pairs = clicked(drive, [image], rng)
    pairs["image"] = f"{route}/{image}"
    if fault == "few":
        pairs = pairs.iloc[:3]
    elif fault == "line":
        steps = np.linspace(0, 1, len(pairs))[:, None]
        ends = pairs[["x", "y", "z"]].to_numpy()[:2]
        pairs[["x", "y", "z"]] = ends[0] + steps * (ends[1] - ends[0])
    else:
        pairs["image"] = "no.jpg"
    out = tmp_path / "baseline.json"
    assert register(drive, tagged, pairs, out, videolog=tagged) == 2
    told = capsys.readouterr().err.strip().splitlines()[-1]
    words = {"few": "too few", "line": "one line", "stranger": "not in the videolog"}
    assert words[fault] in told
    assert not out.exists()


@pytest.fixture(scope="module")
def aligned(drive, tmp_path_factory):
    """Exit code of ``align`` by exact masks of all views, what it printed, and its cameras."""
    folder = tmp_path_factory.mktemp("aligned")
    files = {key: folder / f"{key}.zip" for key in ("images", "labels", "depth")}
    stage(render_videolog, **files, shards=1, shard=0)
    labels = folder / "masks"
    labels.mkdir()
    with ZipFile(files["labels"]) as archive:
        for name in archive.namelist():
            if name.endswith(".png"):
                stem, _, view = name.removesuffix(".png").partition(".")
                to = f"{stem}_{view}.png" if view else f"{stem}.png"
                (labels / to).write_bytes(archive.read(name))
    assert LabelImages(str(labels))
    out = folder / "cameras.csv"
    argv = ["align", drive / "v.csv", "--cloud", drive / "c.laz", "--images", files["images"]]
    printed = io.StringIO()
    with redirect_stdout(printed):
        code = main([str(p) for p in (*argv, "--masks", labels, "-o", out)])
    cameras = pd.read_csv(out).merge(front(drive), on="image", suffixes=("", "_true"))
    return code, printed.getvalue(), cameras


@pytest.mark.full
def test_align_finds_the_cameras(drive, aligned):
    """Each image has its row; what is not accepted has a reason."""
    code, printed, cameras = aligned
    assert code == 0 and len(cameras) == len(front(drive))
    good = cameras["accepted"].to_numpy(bool)
    assert good.mean() > 0.4
    assert (cameras.loc[~good, "reason"].str.len() > 0).all()
    assert (cameras[["unit", "vertical_unit"]] == "us-survey-foot").all(axis=None)
    assert f"{good.sum()} of {len(cameras)} cameras" in printed


@pytest.mark.full
def test_aligned_cameras_stand_where_they_stood(aligned):
    good = aligned[2].query("accepted")
    apart = np.hypot(good["x"] - good["easting_usft"], good["y"] - good["northing_usft"])
    assert np.median(apart) * FOOT_M < 1.0


@pytest.mark.full
def test_aligned_cameras_look_where_they_looked(aligned):
    """Most within a tenth of a degree."""
    good = aligned[2].query("accepted")
    off_deg = np.abs(good["heading_grid_deg"] - good["heading_grid_deg_true"])
    assert np.median(off_deg) < 0.1


def rendered(drive, folder):
    """Rendered images of the drive, and a folder of their exact labels."""
    files = {key: folder / f"{key}.zip" for key in ("images", "labels", "depth")}
    stage(render_videolog, **files, shards=1, shard=0)
    labels = folder / "masks"
    labels.mkdir()
    with ZipFile(files["labels"]) as archive:
        for name in archive.namelist():
            if name.endswith(".png") and "." not in name.removesuffix(".png"):
                (labels / name).write_bytes(archive.read(name))
    return files["images"], labels


@pytest.mark.full
def test_geotagged_images_give_the_cameras_that_their_table_gives(drive, tmp_path):
    """A folder for each route, places from EXIF, no table; side views are not told by EXIF."""
    images, labels = rendered(drive, tmp_path)
    table = pd.read_csv(drive / "v.csv", keep_default_na=False)
    sides = [name for name in table if "left" in name or "right" in name]
    table.drop(columns=sides).to_csv(tmp_path / "front.csv", index=False)
    tagged = tmp_path / "tagged"
    with ZipFile(images) as archive:
        for row in table.itertuples():
            (tagged / row.route).mkdir(parents=True, exist_ok=True)
            content = gps_jpeg(row.latitude, row.longitude, plain=archive.read(row.image))
            (tagged / row.route / row.image).write_bytes(content)
    found = []
    for videolog, source in ((tmp_path / "front.csv", images), (tagged, tagged)):
        argv = ["align", videolog, "--cloud", drive / "c.laz", "--images", source]
        argv += ["--masks", labels, "-o", tmp_path / "cameras.csv"]
        assert main([str(p) for p in argv]) == 0
        cameras = pd.read_csv(tmp_path / "cameras.csv", keep_default_na=False)
        found.append(cameras.assign(image=cameras["image"].str.split("/").str[-1]))
    one, other = (cameras.set_index("image").sort_index() for cameras in found)
    assert list(one.index) == list(other.index) and len(one) > 25
    assert (one["accepted"] == other["accepted"]).mean() > 0.9
    both = one["accepted"] & other["accepted"]
    apart = np.hypot(one["x"] - other["x"], one["y"] - other["y"])[both] * FOOT_M
    assert both.any() and np.median(apart) < 0.05


def test_blank_images_are_no_cameras(drive, tmp_path, capsys):
    """The message comes from the stage that cannot go on, and nothing is written."""
    images = tmp_path / "images"
    images.mkdir()
    for row in front(drive).itertuples():
        (images / row.image).write_bytes(jpeg(size=(row.width_px, row.height_px)))
    out = tmp_path / "cameras.txt"
    argv = ["align", drive / "v.csv", "--cloud", drive / "c.laz", "--images", images, "-o", out]
    assert main([str(part) for part in argv]) == 2
    assert ".csv" in capsys.readouterr().err
    assert not out.exists()
