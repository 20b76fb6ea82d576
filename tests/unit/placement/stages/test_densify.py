import geopandas as gpd
import numpy as np
import pandas as pd
import pytest
from shapely import LineString, box

from roadsight.geometry.frames import Frame
from roadsight.io.cloud.tile_writer import TileWriter
from roadsight.io.raster.rasters import write_raster
from roadsight.io.records.atomic import write_json
from roadsight.io.records.tables import read_table, write_table
from roadsight.io.vector.vectors import write_layers
from roadsight.stages.placement import densify_candidates, place_candidates

FRAME = Frame((458_000.0, 5_428_000.0, 100.0))
SETTINGS = [
    "--spacing-m", "4", "--height-min-m", "4", "--height-max-m", "6", "--height-step-m", "1",
]  # fmt: skip
GAP = (20.0, 3.0)


@pytest.fixture
def road(tmp_path, rng):
    """A straight road of 40 m with one edge, and a target at its middle that nobody sees."""
    write_json(tmp_path / "frame.json", FRAME.to_dict())
    edges = {"edge": ["e"], "kind": ["edge"], "source": ["digitised"]}
    line = gpd.GeoDataFrame(edges, geometry=[LineString([(0, 0), (40, 0)])])
    write_layers(tmp_path / "edges.gpkg", {"edges": line}, FRAME)
    paved = gpd.GeoDataFrame({"part": [0]}, geometry=[box(0, 1, 40, 9)])
    write_layers(tmp_path / "pavement.gpkg", {"pavement": paved}, FRAME)
    write_raster(tmp_path / "dem.tif", np.zeros((30, 60)), FRAME, -10.0, 20.0, 1.0)
    xyz = rng.uniform((-5, 2, 0), (45, 8, 0.01), (2000, 3))
    ones = np.ones(len(xyz), np.uint8)
    with TileWriter(tmp_path / "cloud.parquet", 50.0, coloured=False) as writer:
        counts = dict.fromkeys(("classification", "return_number", "number_of_returns"), ones)
        writer.append(dict(zip("xyz", xyz.T, strict=True)) | {"intensity": ones} | counts)
        writer.finish()
    target = pd.DataFrame({"target": ["t0"], "x": GAP[0], "y": GAP[1], "z": 0.0})
    write_table(tmp_path / "targets.parquet", target)
    write_json(tmp_path / "coverage.json", {"plans": {"p": {"uncovered": ["t0"]}}})
    return tmp_path


def rounds(folder, count, closest_m):
    """Candidates of each round, the regular ones first."""
    files = ("edges.gpkg", "pavement.gpkg", "dem.tif", "cloud.parquet", "frame.json")
    given = [p for n in files for p in (f"--{n.partition('.')[0]}", str(folder / n))]
    given += SETTINGS
    paths = [folder / f"round-{number}.parquet" for number in range(count + 1)]
    assert place_candidates.main([*given, "--site", "s", "--out", str(paths[0])]) == 0
    for number in range(1, count + 1):
        known = ["--candidates", *map(str, paths[:number])]
        gap = ["--targets", str(folder / "targets.parquet"), "--plans", "p=far"]
        gap += ["--coverage", str(folder / "coverage.json"), "--radius-m", "10"]
        bound = ["--closest-m", str(closest_m), "--round", str(number)]
        out = ["--out", str(paths[number])]
        assert densify_candidates.main([*given, *known, *gap, *bound, *out]) == 0
    return [read_table(path) for path in paths]


def test_each_round_halves_both_spacings_near_the_gap(road):
    regular, first, second = rounds(road, 2, 0)
    assert sorted(set(regular["station_m"])) == list(range(0, 41, 4))
    assert sorted(set(regular["height_m"])) == [4, 5, 6]
    near = np.sqrt(10**2 - GAP[1] ** 2)
    for number, table in ((1, first), (2, second)):
        assert (np.abs(table["x"] - GAP[0]) <= near).all()
        heights = sorted(set(table["height_m"]))
        np.testing.assert_allclose(np.diff(heights), 0.5**number)
        stations = np.unique(table["station_m"])
        np.testing.assert_allclose(np.diff(stations), 4 / 2**number)
    every = pd.concat([regular, first, second])
    assert every["candidate"].is_unique


def test_spacings_stop_at_their_bound(road):
    regular, first, second, third = rounds(road, 3, 1.0)
    every = pd.concat([regular, first, second, third])
    assert set(every["height_m"]) == {4, 5, 6}  # half of 1 m would be less than 1 m
    along = np.unique(every.loc[np.abs(every["x"] - GAP[0]) < 8, "station_m"])
    np.testing.assert_allclose(np.diff(along), 1.0)  # 4, 2 and 1 m
    assert len(first) and len(second) and third.empty
