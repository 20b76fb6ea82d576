import json
from pathlib import Path

import geopandas as gpd
import laspy
import numpy as np
import pytest
import shapely
from shapely import MultiPolygon, box

from roadsight.stages.scene import build_dem, build_edges, extract_pavement, ingest_cloud
from roadsight.stages.scene import profile_scene as profiled
from tests.helpers.las_files import DATA, needs_data
from tests.unit.scene.pavement.test_road_surface import HALF_ROAD_M, street

ORIGIN = np.array([458_000.0, 5_428_000.0, 100.0])


class Scene:
    """Stages up to the ground, run on a cloud."""

    def __init__(self, folder: Path, cloud: Path, *options: str) -> None:
        self.folder = folder
        both = ("--cloud", self.path("cloud.parquet"), "--frame", self.path("frame.json"))
        self.both = ("--site", "s", *both)
        assert ingest_cloud.main([*self.both, *options, "--clouds", str(cloud)]) == 0
        assert profiled.main([*both, "--out", self.path("profile.json")]) == 0
        self.profile = ("--profile", self.path("profile.json"))
        self.ground = ("--ground", self.path("ground.parquet"))
        dem = ("--dem", self.path("dem.tif"))
        assert build_dem.main([*self.both, *self.profile, *self.ground, *dem]) == 0

    def path(self, name: str) -> str:
        return str(self.folder / name)

    def pavement(self, *options: str) -> int:
        out = ("--pavement", self.path("pavement.gpkg"), "--points", self.path("points.parquet"))
        doubts = ("--doubts", self.path("doubts.json"))
        return extract_pavement.main(
            [*self.both, *self.ground, *self.profile, *out, *doubts, *options]
        )

    def doubts(self) -> dict[str, dict]:
        return {
            doubt["code"]: doubt for doubt in json.loads(Path(self.path("doubts.json")).read_text())
        }


@pytest.fixture
def scene(rng, tmp_path):
    """A generated street whose scans are told apart."""
    xyz, tone, scan, _ = street(rng)
    header = laspy.LasHeader(point_format=6, version="1.4")
    header.scales, header.offsets = np.full(3, 0.001), ORIGIN
    las = laspy.LasData(header)
    las.x, las.y, las.z = (xyz + np.array([0.0, 20.0, 0.0]) + ORIGIN).T
    las.intensity, las.point_source_id = tone.astype(np.uint16), scan.astype(np.uint16)
    las.classification = np.ones(len(xyz), np.uint8)
    las.return_number = las.number_of_returns = np.ones(len(xyz), np.uint8)
    las.write(str(tmp_path / "street.laz"))
    return Scene(tmp_path, tmp_path / "street.laz", "--crs", "local", "--units", "metre")


def test_scans_that_tell_make_the_pavement_one_surface(scene):
    # The generated street is so short that few of its discs are sure; what counts is the profile.
    profile = json.loads(Path(scene.path("profile.json")).read_text())
    assert profile["scans"]["number"] == 6
    profile["scans"]["blind_share"] = 1.0
    Path(scene.path("profile.json")).write_text(json.dumps(profile))
    assert scene.pavement() == 0
    doubts = scene.doubts()
    assert "scans are told apart" in doubts["pavement_method"]["message"]
    assert doubts["pavement_method"]["measured"] >= 0.5
    assert "grown from" in doubts["pavement_seeds"]["message"]
    edges = ("--pavement", scene.path("pavement.gpkg"), "--dem", scene.path("dem.tif"))
    frame = ("--frame", scene.path("frame.json"))
    assert build_edges.main(["--site", "s", *frame, *edges, "--out", scene.path("edges.gpkg")]) == 0


@pytest.mark.parametrize("on_lawn", [False, True])
def test_smooth_ground_gets_the_edges_of_the_surface(scene, monkeypatch, on_lawn):
    middle = 20 + ORIGIN[1]
    south, north = (-HALF_ROAD_M - 0.9, HALF_ROAD_M + 0.9) if not on_lawn else (7.5, 12.0)
    smooth = box(ORIGIN[0], middle + south, ORIGIN[0] + 50, middle + north)
    shift = np.array(json.loads(Path(scene.path("frame.json")).read_text())["origin"][:2])
    local = shapely.transform(smooth, lambda xy: xy - shift)
    monkeypatch.setattr(extract_pavement, "_published", lambda _: (MultiPolygon([local]), 0.2))
    profile = json.loads(Path(scene.path("profile.json")).read_text())
    profile["scans"]["blind_share"] = 0.0
    Path(scene.path("profile.json")).write_text(json.dumps(profile))
    assert scene.pavement() == 0
    found = shapely.union_all(gpd.read_file(scene.path("pavement.gpkg")).geometry.to_numpy())
    if on_lawn:
        assert scene.doubts()["pavement_ways_differ"]["measured"] < 0.9
        assert found.symmetric_difference(smooth).area < 0.01 * smooth.area
        return
    assert scene.doubts()["pavement_sharpened"]["measured"] > 0.7
    road = box(ORIGIN[0], middle - HALF_ROAD_M, ORIGIN[0] + 50, middle + HALF_ROAD_M)
    assert found.difference(road).area < 0.02 * found.area


def test_what_is_known_is_used(scene, tmp_path):
    rows = [f"drive,{ORIGIN[0] + x},{ORIGIN[1] + 21.8}" for x in (2.0, 25.0, 48.0)]
    (tmp_path / "track.csv").write_text("\n".join(["edge,x,y", *rows]) + "\n")
    seed = f"--seeds={ORIGIN[0] + 25},{ORIGIN[1] + 20 + HALF_ROAD_M / 2}"
    assert scene.pavement("--track", str(tmp_path / "track.csv"), seed) == 0
    doubts = scene.doubts()
    assert "seeds, track" in doubts["pavement_seeds"]["message"]
    assert doubts["pavement_track"]["severity"] == "note"


def test_a_seed_off_the_cloud_is_one_message(scene, capsys):
    capsys.readouterr()
    assert scene.pavement("--seeds=5,5") == 2
    (message,) = [line for line in capsys.readouterr().err.splitlines() if "roadsight:" in line]
    assert "site s" in message and "seed 1 of 1 lies where no ground was measured" in message


@needs_data
def test_a_seed_off_a_real_cloud_is_said(tmp_path, capsys):
    bank = Scene(tmp_path, DATA / "clouds/autzen_trim.laz")
    capsys.readouterr()
    assert bank.pavement("--method", "surface", "--seeds=0,0") == 2
    assert "seed 1 of 1" in capsys.readouterr().err.splitlines()[-1]
