import geopandas as gpd
import numpy as np
import pandas as pd
import pytest
from shapely import LineString, box

from roadsight.geometry.frames import Frame
from roadsight.io.cloud.tile_writer import TileWriter
from roadsight.io.raster.rasters import write_raster
from roadsight.io.records.atomic import read_json, write_json
from roadsight.io.records.tables import read_table, write_table
from roadsight.io.vector.vectors import write_layers
from roadsight.stages.placement import densify_candidates, place_candidates

FRAME = Frame((458_000.0, 5_428_000.0, 100.0))
SETTINGS = [
    "--spacing-m", "4", "--height-min-m", "4", "--height-max-m", "6", "--height-step-m", "1",
]  # fmt: skip
GAP = (20.0, 3.0)


def draw(folder, **off_m):
    """Digitised edges along the road, at these distances across it."""
    edges = {"edge": list(off_m), "kind": "edge", "source": "digitised"}
    lines = [LineString([(0, y), (40, y)]) for y in off_m.values()]
    write_layers(folder / "edges.gpkg", {"edges": gpd.GeoDataFrame(edges, geometry=lines)}, FRAME)


@pytest.fixture
def road(tmp_path, rng):
    """A straight road of 40 m with one edge, and a target at its middle that nobody sees."""
    write_json(tmp_path / "frame.json", FRAME.to_dict())
    draw(tmp_path, e=0.0)
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


def given_in(folder):
    """What candidates are placed by."""
    files = ("edges.gpkg", "pavement.gpkg", "dem.tif", "cloud.parquet", "frame.json")
    given = [p for n in files for p in (f"--{n.partition('.')[0]}", str(folder / n))]
    return given + SETTINGS


def place(folder, path):
    """Exit code of the regular round."""
    first = ["--site", "s", "--doubts", str(folder / "doubts.json"), "--out", str(path)]
    return place_candidates.main([*given_in(folder), *first])


def rounds(folder, count, closest_m):
    """Candidates of each round, the regular ones first."""
    given = given_in(folder)
    paths = [folder / f"round-{number}.parquet" for number in range(count + 1)]
    assert place(folder, paths[0]) == 0
    assert read_json(folder / "doubts.json") == []
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


def test_edges_in_the_lanes_are_told_and_then_refused(road, capsys):
    """The road lies between 1 and 9 m: both edges lie 3 m too far across it, then one alone."""
    out = road / "candidates.parquet"
    draw(road, near=4.0, far=12.0, verge=-2.0)
    assert place(road, out) == 0
    (doubt,) = read_json(road / "doubts.json")
    assert (doubt["code"], doubt["severity"]) == ("edges_on_pavement", "doubt")
    assert doubt["measured"] == pytest.approx(1 / 3, abs=0.1) and doubt["limit"] == 0.05
    out.unlink()
    draw(road, near=4.0)
    assert place(road, out) == 2
    told = capsys.readouterr().err
    assert "site s: sensors along near would stand in the lanes" in told
    assert "moved 3.0 m to the south (dx +0.0, dy -3.0 m)" in told
    assert "found 0.818; allowed: 0.5" in told and "placement.edges" in told
    assert not out.exists()
