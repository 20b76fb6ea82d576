import contextlib
import zipfile

import cv2
import numpy as np
import pandas as pd
import pytest
from pyproj import CRS

from roadsight.base.errors import InputError
from roadsight.base.sections.poles import Videolog
from roadsight.geometry.cameras import wrap_deg
from roadsight.geometry.frames import Frame
from roadsight.geometry.north import SiteNorth
from roadsight.io.cloud.tile_writer import TileWriter
from roadsight.io.images.exif import image_facts
from roadsight.io.images.videologs import ImageSource, natural_key, read_videolog_table
from roadsight.io.raster.rasters import write_raster
from roadsight.io.raster.top_rasters import TopRasterWriter
from roadsight.io.records.atomic import write_json
from roadsight.io.records.tables import read_table
from roadsight.poles.drive.videolog import split_drives
from roadsight.scene.voxel_classes import Columns, VoxelGrid
from roadsight.stages.poles import read_videolog
from tests.helpers.tagged_images import gps_jpeg, jpeg

UNIT = 1200 / 3937
"""US survey feet, as in EPSG:6543, North Carolina."""


def frame_of(wkt):
    return Frame((2_200_000.0, 640_000.0, 300.0), UNIT, UNIT, wkt)


@pytest.fixture(scope="module")
def wkt():
    return CRS.from_epsg(6543).to_wkt()


@pytest.fixture
def site(tmp_path, wkt):
    """A cloud of 400 m x 40 m, terrain at 7 m, images every 8 m to the east."""
    frame = frame_of(wkt)
    write_json(tmp_path / "frame.json", frame.to_dict())
    x, y = (a.ravel() for a in np.meshgrid(np.arange(0.5, 400), np.arange(0.5, 40)))
    ones = np.ones(len(x), np.uint8)
    with TileWriter(tmp_path / "cloud.parquet", 50.0, coloured=False) as writer:
        names = ("classification", "intensity", "return_number", "number_of_returns")
        writer.append({"x": x, "y": y, "z": 0 * x + 7} | dict.fromkeys(names, ones))
        writer.finish()
    write_raster(tmp_path / "dem.tif", np.full((40, 400), 7.0), frame, 0.0, 40.0, 1.0)
    images = tmp_path / "images"
    images.mkdir()
    lat, lon = SiteNorth(frame).to_geographic([[20.0 + 8 * i, 20.0] for i in range(40)])
    rows = [(f"{i:03d}.jpg", a, o, "r1", i) for i, (a, o) in enumerate(zip(lat, lon, strict=True))]
    for name, *_rest in rows:
        (images / name).write_bytes(jpeg())
    table = pd.DataFrame(rows, columns=["image", "latitude", "longitude", "route", "sequence"])
    return tmp_path, table


def run(folder, table, *extra, images="images", code=0):
    if table is not None:
        table.to_csv(folder / "videolog.csv", index=False)
    names = {"cloud": "cloud.parquet", "frame": "frame.json", "dem": "dem.tif"}
    names["out"] = "frames.parquet"
    paths = [f"--{name}={folder / file}" for name, file in names.items()]
    videolog = folder / ("images" if table is None else "videolog.csv")
    given = ["--videolog", str(videolog), "--images", str(folder / images)]
    assert read_videolog.main([*given, *paths, *extra]) == code
    return read_table(folder / "frames.parquet") if code == 0 else None


def test_a_clean_route(site):
    folder, table = site
    frames = run(folder, table)
    assert (frames["status"] == "ok").all() and len(frames) == 40
    assert frames["path"].tolist() == table["image"].tolist()
    np.testing.assert_allclose(frames["x"], 20 + 8 * np.arange(40), atol=1e-3)
    np.testing.assert_allclose(frames["y"], 20, atol=1e-3)
    np.testing.assert_allclose(frames["heading_deg"], 90, atol=0.01)
    np.testing.assert_allclose(frames["step_m"][:-1], 8, atol=1e-3)
    np.testing.assert_allclose(frames["z_road"], 7, atol=1e-3)
    assert (frames[["left_path", "right_path"]] == "").all(axis=None)
    assert frames["sequence"].dtype == np.int64 and set(frames["width_px"]) == {48}


def test_order_of_rows_and_names_of_columns_do_not_matter(site, rng):
    folder, table = site
    plain = run(folder, table)
    mixed = table.iloc[rng.permutation(len(table))].copy()
    mixed["image"] = mixed["image"].str.replace(".jpg", "").radd("some/folder/")
    mixed.columns = [" Image", "LAT", "Long", "route_id", "Mile_Post"]
    mixed["Mile_Post"] = mixed["Mile_Post"] * 0.005 + 1.25
    found = run(folder, mixed)
    assert found["path"].tolist() == plain["path"].tolist()
    assert found["sequence"].tolist() == list(range(40))
    columns = ["x", "y", "z_road", "heading_deg", "step_m"]
    np.testing.assert_allclose(found[columns], plain[columns], atol=1e-6)


def test_bad_rows_cost_only_themselves(site, capsys, caplog):
    folder, table = site
    images = folder / "images"
    (images / "001.jpg").unlink()
    (images / "002.jpg").write_bytes((images / "002.jpg").read_bytes()[:-4])
    (images / "003.jpg").write_bytes(b"no image at all")
    (images / "004.jpg").write_bytes(jpeg(size=(64, 32)))
    (images / "extra.jpg").write_bytes(jpeg())
    table.loc[5, ["latitude", "longitude"]] = [0.0, 0.0]
    table.loc[6, "latitude"] = np.nan
    table.loc[7, "latitude"] += 0.1
    table.loc[8, ["latitude", "longitude"]] = (
        table.loc[8, ["longitude", "latitude"]].to_numpy().copy()
    )
    table.loc[10, ["latitude", "longitude"]] = (
        table.loc[9, ["latitude", "longitude"]].to_numpy().copy()
    )
    jump = table.loc[35, ["latitude", "longitude"]]
    table.loc[14, ["latitude", "longitude"]] = jump.to_numpy()
    table.loc[20, "image"] = "../../secret.jpg"
    table = pd.concat([table, table.loc[[25, 26]]], ignore_index=True)
    table.loc[41, "latitude"] += 0.0001
    table["sequence"] = table["sequence"].astype(float)
    table.loc[28, "sequence"] = 27
    table.loc[29, "sequence"] = np.nan
    frames = run(folder, table)
    status = frames.set_index("image")["status"]
    expected = {
        "001.jpg": "image missing", "002.jpg": "image truncated", "003.jpg": "image unreadable",
        "004.jpg": "64 x 32 px", "005.jpg": "no position", "006.jpg": "no position",
        "007.jpg": "outside the cloud", "008.jpg": "latitude and longitude look swapped",
        "010.jpg": "same position", "014.jpg": "GPS jump of 176 m",
        "../../secret.jpg": "image unreadable", "026.jpg": "listed at two places",
        "028.jpg": "sequence number used before", "029.jpg": "no sequence number",
    }  # fmt: skip
    for name, reason in expected.items():
        assert status[name].startswith(reason), (name, status[name])
    good = status.drop(list(expected))
    assert (good == "ok").all() and len(good) == 26
    ok = frames[frames["status"] == "ok"]
    np.testing.assert_allclose(ok["heading_deg"], 90, atol=0.05)
    assert frames["image"].is_unique
    assert frames["sequence"].is_monotonic_increasing
    text = caplog.text
    assert "not used: image missing (001.jpg)" in text
    assert "extra.jpg" in text and "2 rows repeat an image" in text


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda t: t.rename(columns={"latitude": "longitude", "longitude": "latitude"}), "swapped"),
        (lambda t: t.assign(latitude=t["latitude"] + 3), "no image was taken near"),
        (lambda t: t.assign(latitude=0.0, longitude=0.0), "no image can be used.*40 x no position"),
        (lambda t: t.drop(columns="longitude"), "no column longitude.*lng"),
        (lambda t: t.iloc[:0], "lists no images"),
        (lambda t: t.iloc[:1], "no image can be used.*the only image of its route"),
        (
            lambda t: t.assign(latitude=t["latitude"].iloc[0], longitude=t["longitude"].iloc[0]),
            "never moved|same position",
        ),
        (lambda t: t.assign(image="x" + t["image"]), "40 x image missing"),
    ],
)
def test_a_table_that_is_wrong_throughout_is_one_message(site, capsys, change, message):
    folder, table = site
    run(folder, change(table), code=2)
    error = capsys.readouterr().err.strip().splitlines()[-1]
    assert error.startswith("roadsight: ")
    assert pd.Series([error]).str.contains(message)[0], error
    assert not (folder / "frames.parquet").exists()


def test_images_in_zip_files_are_the_same(site):
    folder, table = site
    plain = run(folder, table)
    zips = folder / "zips"
    zips.mkdir()
    for number in range(2):
        with zipfile.ZipFile(zips / f"{number}.zip", "w") as archive:
            for path in sorted((folder / "images").iterdir())[number::2]:
                archive.write(path, path.name)
            archive.writestr("__MACOSX/._x.jpg", b"rubbish")
    pd.testing.assert_frame_equal(run(folder, table, images="zips"), plain)
    source = ImageSource(zips)
    assert len(source.names()) == 40 and source.size("007.jpg") == (48, 32)
    assert source.read("007.jpg").shape == (32, 48, 3) and source.read("007.jpg").dtype == np.uint8
    assert len(ImageSource(zips / "0.zip").names()) == 20
    with zipfile.ZipFile(zips / "2.zip", "w") as archive:
        archive.writestr("007.jpg", b"again")
    with pytest.raises(InputError, match="twice"):
        ImageSource(zips)


def test_names_stay_inside(tmp_path):
    (tmp_path / "in").mkdir()
    (tmp_path / "secret.png").write_bytes(b"x")
    source = ImageSource(tmp_path / "in")
    up = ("../secret.png", "a/../../secret.png", "..\\secret.png")
    for name in (*up, "/etc/passwd", "C:\\x", ""):
        recorded = name in ("/etc/passwd", "C:\\x")  # the last part is looked up
        assert not recorded or source.find(name) == ""
        for call in (source.read, source.size, *([] if recorded else [source.find])):
            with pytest.raises(InputError, match="leads out"):
                call(name)
    with pytest.raises(InputError, match="no such image"):
        source.read("none.jpg")
    with zipfile.ZipFile(tmp_path / "in" / "bad.zip", "w") as archive:
        archive.writestr("../up.jpg", b"x")
    with pytest.raises(InputError, match="leads out"):
        ImageSource(tmp_path / "in")
    (tmp_path / "in" / "bad.zip").write_bytes(b"PK")
    with pytest.raises(InputError, match="no ZIP"):
        ImageSource(tmp_path / "in")
    with pytest.raises(InputError, match="neither a folder"):
        ImageSource(tmp_path / "none")


def test_side_views_and_ambiguous_names(site):
    folder, table = site
    for side in ("left", "right"):
        (folder / "images" / side).mkdir()
        for name in table["image"]:
            (folder / "images" / side / name).write_bytes(jpeg())
    (folder / "images" / "right" / "003.jpg").unlink()
    table["left_image"] = "left/" + table["image"]
    table["right_image"] = "right/" + table["image"]
    frames = run(folder, table)
    assert frames["path"].tolist() == table["image"].tolist()
    assert frames["left_path"].tolist() == table["left_image"].tolist()
    assert frames["right_path"][3] == "" and frames["right_path"][4] == "right/004.jpg"
    assert (frames["status"] == "ok").all()
    assert ImageSource(folder / "images").find("x/003.jpg") == ""  # left or front?


@pytest.mark.parametrize("order", ["<", ">"])
def test_a_folder_of_geotagged_images(site, order):
    folder, table = site
    plain = run(folder, table)
    for name in table["image"]:
        (folder / "images" / name).unlink()
    for row in table.itertuples():
        content = gps_jpeg(row.latitude, row.longitude, order)
        (folder / "images" / f"IMG_{row.sequence}.jpg").write_bytes(content)
    (folder / "images" / "IMG_400.jpg").write_bytes(jpeg())
    frames = run(folder, None)
    assert frames["path"].tolist() == [f"IMG_{i}.jpg" for i in range(40)] + ["IMG_400.jpg"]
    assert frames["status"].tolist() == ["ok"] * 40 + ["no position"]
    np.testing.assert_allclose(frames[["x", "y"]][:40], plain[["x", "y"]], atol=0.01)


def test_image_facts():
    facts = image_facts(gps_jpeg(-33.5, 151.25, orientation=6))
    assert (facts.width_px, facts.height_px, facts.complete) == (32, 48, True)
    assert (facts.latitude, facts.longitude) == pytest.approx((-33.5, 151.25))
    png = cv2.imencode(".png", np.zeros((5, 9, 3), np.uint8))[1].tobytes()
    assert image_facts(png) == type(facts)(9, 5)
    assert not image_facts(png[:-8]).complete
    assert not image_facts(jpeg()[:-2]).complete
    whole = gps_jpeg(1.0, 2.0)
    for cut in range(0, len(whole), 7):
        with contextlib.suppress(ValueError):
            assert not image_facts(whole[:cut]).complete
    garbled = bytearray(whole)
    garbled[30:60] = b"\xff" * 30
    assert image_facts(bytes(garbled)).latitude is None


def test_natural_order():
    names = ["a10.jpg", "a2.jpg", "2/b.jpg", "10/b.jpg", "a1.jpg"]
    assert sorted(names, key=natural_key) == ["2/b.jpg", "10/b.jpg", "a1.jpg", "a2.jpg", "a10.jpg"]


def test_drives_and_strays():
    xy = np.column_stack([np.arange(30) * 8.0, np.zeros(30)])
    drives, stray = split_drives(xy)
    assert [len(d) for d in drives] == [30] and not stray.any()
    far = xy.copy()
    far[15:, 1] += 500.0  # the vehicle went on elsewhere
    drives, stray = split_drives(far)
    assert [len(d) for d in drives] == [15, 15] and not stray.any()
    far = xy.copy()
    far[[0, 7, 8, 29], 1] += 300.0
    drives, stray = split_drives(far)
    assert np.flatnonzero(stray).tolist() == [0, 7, 8, 29]
    assert [len(d) for d in drives] == [26]
    assert split_drives(np.empty((0, 2)))[0] == []


def test_road_height_comes_from_the_deck_of_a_bridge(site, wkt):
    folder, table = site
    frame = frame_of(wkt)
    grid = VoxelGrid.over(frame, 0.5, [0, 0, 0, 400, 40, 20])
    with TopRasterWriter(folder / "top.tif", frame, grid) as writer:
        for row in range(30, 50):
            column = np.arange(360, 440)  # 180 m to 220 m
            same = np.ones(80)
            place = (np.full(80, row), column)
            writer.add(Columns(*place, np.full(80, 17, np.uint8), 13.5 * same, same))
    frames = run(folder, table, "--top", str(folder / "top.tif"))
    on_deck = (frames["x"] > 182) & (frames["x"] < 218)
    np.testing.assert_allclose(frames["z_road"][on_deck], 13.5, atol=0.01)
    away = (frames["x"] < 176) | (frames["x"] > 224)
    np.testing.assert_allclose(frames["z_road"][away], 7.0, atol=0.01)


@pytest.mark.real
def test_a_real_track_in_north_carolina(data, wkt):
    from roadsight.poles.drive.videolog import Site, build_frames

    folder = data / "videolog"
    source = ImageSource(folder / "kitti_0009" / "images")
    table = read_videolog_table(folder / "nc_route_track.csv", source)
    size = {"path": "x", "left_path": "", "right_path": "", "width_px": 1, "height_px": 1}
    north = SiteNorth(Frame((2_200_000.0, 640_000.0, 0.0), UNIT, UNIT, wkt))
    everywhere = Site(
        north.to_local, lambda xy: np.ones(len(xy), bool), lambda xy: np.zeros(len(xy))
    )
    frames = build_frames(table.assign(**size, status="ok"), everywhere, Videolog())
    ok = frames[frames["status"] == "ok"]
    assert len(table) == 627 and len(ok) > 600
    assert ok["step_m"].median() == pytest.approx(8.0, abs=0.2)
    wobble, rough = (
        np.abs(np.diff(wrap_deg(np.diff(ok[name])))) for name in ("heading_deg", "heading_raw_deg")
    )
    assert np.percentile(wobble, 90) < 0.8 * np.percentile(rough, 90)


def test_a_local_system_has_x_and_y_instead_of_degrees(site):
    folder, table = site
    plain = run(folder, table)
    frame = frame_of(None)
    write_json(folder / "frame.json", frame.to_dict())
    write_raster(folder / "dem.tif", np.full((40, 400), 7.0), frame, 0.0, 40.0, 1.0)
    native = frame.to_native(plain[["x", "y"]].to_numpy(float))
    local = table.drop(columns=["latitude", "longitude"])
    local = local.assign(x=native[:, 0], y=native[:, 1], z=0.0)
    found = run(folder, local)
    columns = ["x", "y", "z_road", "heading_deg", "step_m"]
    np.testing.assert_allclose(found[columns], plain[columns], atol=1e-4)
    assert (found["status"] == "ok").all()
    assert found[["latitude", "longitude"]].isna().all(axis=None)


def test_places_outside_a_local_cloud_are_one_message(site, capsys):
    folder, table = site
    frame = frame_of(None)
    write_json(folder / "frame.json", frame.to_dict())
    write_raster(folder / "dem.tif", np.full((40, 400), 7.0), frame, 0.0, 40.0, 1.0)
    away = table.drop(columns=["latitude", "longitude"]).assign(x=5.0, y=6.0)
    run(folder, away, code=2)
    told = capsys.readouterr().err
    assert "no image was taken near the cloud" in told and "those of the cloud" in told
    assert "x 5.0" in told and "latitude" not in told
