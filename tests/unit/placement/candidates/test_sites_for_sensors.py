import geopandas as gpd
import numpy as np
import pandas as pd
import pytest
import shapely
from shapely import MultiPolygon, box

from roadsight.base.errors import InputError
from roadsight.base.sections.placement import Candidates
from roadsight.geometry.frames import Frame
from roadsight.io.records.tables import read_table
from roadsight.io.vector.known import read_mounts
from roadsight.io.vector.vectors import write_geojson
from roadsight.placement.candidates.candidates import stack_candidates
from roadsight.placement.candidates.mounting import outside_zones, positions_on_poles
from roadsight.stages.placement import place_candidates
from tests.helpers.report_site import ReportSite

ROAD = MultiPolygon([box(0, -4, 100, 4)])
LOCAL = Frame((1000.0, 2000.0, 0.0), unit_m=0.3048, vertical_unit_m=0.3048)


def poles(*rows):
    return pd.DataFrame(rows, columns=["name", "x", "y", "top_m"])


def test_arms_reach_to_the_road():
    found = positions_on_poles(poles(("a", 10, 6, 8), ("b", 20, -7, np.nan)), ROAD, 0.75)
    np.testing.assert_allclose(found[["x", "y"]], [[10, 5.25], [20, -6.25]])
    np.testing.assert_allclose(found["yaw_deg"], [-90, 90])
    assert list(found["key"]) == ["pole-a", "pole-b"] and set(found["mount"]) == {"pole"}


def test_a_pole_on_the_road_or_without_one_faces_north():
    for pavement in (ROAD, MultiPolygon()):
        found = positions_on_poles(poles(("a", 10, 0, 8)), pavement, 1.0)
        np.testing.assert_allclose(found[["x", "y", "yaw_deg"]], [[10, 1, 90]])
    assert len(positions_on_poles(poles(), ROAD, 1.0)) == 0


def test_zones_as_point_by_point(rng):
    zones = [box(0, 0, 4, 4), box(3, 3, 9, 6), shapely.Polygon([(10, 0), (14, 0), (12, 5)])]
    xy = np.vstack([rng.random((300, 2)) * 15, [[4, 2], [0, 0]]])
    slowly = [not any(zone.intersects(shapely.Point(p)) for zone in zones) for p in xy]
    assert outside_zones(xy, zones).tolist() == slowly
    assert outside_zones(xy, []).all() and len(outside_zones(xy[:0], zones)) == 0


def test_no_sensor_above_the_top_of_its_pole():
    table = positions_on_poles(poles(("a", 10, 6, 6.0), ("b", 20, 6, np.nan)), ROAD, 0.75)
    stacked = stack_candidates(
        table.assign(ground_z_m=0.0), np.empty((0, 3)), np.empty(0), Candidates(height_step_m=1.0)
    )
    highest = stacked.groupby("key")["height_m"].max()
    assert highest["pole-a"] == 6.0 and highest["pole-b"] == 10.0


def test_mounts_are_read_in_metres_of_the_site(tmp_path):
    table = gpd.GeoDataFrame(
        {"name": ["p", "q"], "height_m": [7.5, np.nan]},
        geometry=shapely.points([[1.0, 2.0], [30.0, 4.0]]),
    )
    write_geojson(tmp_path / "mounts.geojson", table, LOCAL)
    read = read_mounts(tmp_path / "mounts.geojson", LOCAL)
    np.testing.assert_allclose(read[["x", "y"]], [[1, 2], [30, 4]], atol=1e-6)
    assert list(read["name"]) == ["p", "q"]
    assert read["top_m"][0] == 7.5 and np.isnan(read["top_m"][1])


@pytest.mark.parametrize(
    ("rows", "problem"),
    [
        ("p,1,2,7\np,3,4,7\n", "share a name"),
        ("p,1,2,-1\n", "impossible height"),
        ("p,1,2,high\n", "impossible height"),
        ("p,1,2,inf\n", "impossible height"),
        ("p,x,2,7\n", "no finite number"),
    ],
)
def test_wrong_mounts_are_told(tmp_path, rows, problem):
    (tmp_path / "m.csv").write_text("name,x,y,height_m\n" + rows)
    with pytest.raises(InputError, match=problem):
        read_mounts(tmp_path / "m.csv", LOCAL)


def test_the_stage_hangs_sensors_on_poles_and_keeps_zones_free(tmp_path):
    site = ReportSite(tmp_path, placed=False)
    zone = gpd.GeoDataFrame({"name": ["z"]}, geometry=[box(30, 0, 50, 60)])
    hung = gpd.GeoDataFrame(
        {"name": ["in", "out"], "height_m": [9.0, 6.0]},
        geometry=shapely.points([[40.0, 12.0], [60.0, 12.0]]),
    )
    write_geojson(tmp_path / "zones.geojson", zone, site.frame)
    write_geojson(tmp_path / "mounts.geojson", hung, site.frame)
    files = {
        "edges": "placement/edges.gpkg", "pavement": "scene/pavement.gpkg", "dem": "scene/dem.tif",
        "cloud": "scene/cloud.parquet", "frame": "scene/frame.json",
    }  # fmt: skip
    arguments = [part for name, file in files.items() for part in (f"--{name}", site.path(file))]
    found = {}
    for name, options in (
        ("plain", []),
        ("drawn", ["--zones", tmp_path / "zones.geojson", "--mounts", tmp_path / "mounts.geojson"]),
    ):
        out = ["--site", "tiny", "--doubts", tmp_path / "doubts.json"]
        out += ["--out", tmp_path / f"{name}.parquet"]
        assert place_candidates.main([str(part) for part in [*arguments, *options, *out]]) == 0
        found[name] = read_table(tmp_path / f"{name}.parquet")
    in_zone = found["plain"]["x"].between(30, 50)
    drawn = found["drawn"]
    on_edges = drawn["mount"] != "pole"
    assert in_zone.any()
    assert set(drawn["candidate"][on_edges]) == set(found["plain"]["candidate"][~in_zone])
    assert set(drawn["key"][~on_edges]) == {"pole-out"}
    assert drawn["height_m"][~on_edges].max() <= 6.0


def test_a_table_without_heights(tmp_path):
    (tmp_path / "m.csv").write_text("id,x,y\np,1000,2000\nq,1010,2000\n")
    read = read_mounts(tmp_path / "m.csv", LOCAL)
    assert read["x"].tolist() == pytest.approx([0, 3.048]) and read["top_m"].isna().all()
