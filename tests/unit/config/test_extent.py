import json
import re

import numpy as np
import pytest
from pydantic import ValidationError

from roadsight.base.errors import InputError
from roadsight.config.sites import Extent
from roadsight.geometry.frames import Frame
from roadsight.io.vector.site_bounds import read_extent
from roadsight.stages.scene.ingest_cloud import main
from tests.helpers.las_files import random_points, write_las
from tests.unit.scene.test_ingest import UTM, run

EAST, NORTH = 458000.0, 5428000.0


def polygon(path, ring, crs="urn:ogc:def:crs:EPSG::25832"):
    feature = {"type": "Feature", "properties": {}, "geometry": {"type": "Polygon"}}
    feature["geometry"]["coordinates"] = [[*ring, ring[0]]]
    content = {"type": "FeatureCollection", "features": [feature]}
    content["crs"] = {"type": "name", "properties": {"name": crs}}
    path.write_text(json.dumps(content))
    return path


def kept(tmp_path, cloud, extent):
    kind, _, value = extent.partition("=")
    _, about = run(tmp_path, [cloud], extent=lambda frame: read_extent(kind, value, frame))
    return about


@pytest.fixture
def cloud(tmp_path):
    xyz = random_points(5000)
    return xyz, write_las(tmp_path / "a.laz", xyz, UTM)


def test_a_box_keeps_what_lies_in_it(tmp_path, cloud):
    xyz, path = cloud
    about = kept(tmp_path, path, f"box={EAST + 20},{NORTH + 10},{EAST + 60},{NORTH + 40}")
    x, y = xyz[:, 0] - EAST, xyz[:, 1] - NORTH
    expected = int(((x > 20) & (x < 60) & (y > 10) & (y < 40)).sum())
    assert abs(about["points"] - expected) <= 2
    assert about["dropped"]["outside"] == 5000 - about["points"]
    low, high = np.array(about["bounds_m"]).reshape(2, 3)
    assert (high - low)[:2] == pytest.approx([40, 30], abs=1.5)


def test_a_polygon_in_any_crs_keeps_what_lies_in_it(tmp_path, cloud):
    _, path = cloud
    ring = [(EAST, NORTH), (EAST + 60, NORTH), (EAST + 60, NORTH + 80), (EAST, NORTH + 80)]
    about = kept(tmp_path, path, f"polygon={polygon(tmp_path / 'area.geojson', ring)}")
    assert about["points"] == pytest.approx(2500, abs=150)


def test_distances_from_edges_and_from_a_track(tmp_path):
    frame = Frame((EAST, NORTH, 0.0), crs_wkt=UTM)
    edges = tmp_path / "edges.csv"
    edges.write_text(f"edge,x,y\na,{EAST},{NORTH}\na,{EAST + 100},{NORTH}\n")
    within = read_extent("edges_m", "10", frame, [edges])
    assert within(np.array([[50.0, 9.0], [50.0, 11.0], [-20.0, 0.0]])).tolist() == [1, 0, 0]
    track = tmp_path / "videolog.csv"
    track.write_text("image,latitude,longitude\na.jpg,49.0,8.4\nb.jpg,49.0001,8.4\n")
    within = read_extent("track_m", "15", frame, [track])
    assert not within(np.array([[0.0, 1e5]])).any()
    with pytest.raises(InputError, match=r"extent\.track_m: needs poles\.videolog"):
        read_extent("track_m", "15", frame)


@pytest.mark.parametrize(
    ("extent", "told"),
    [
        ("box=0,0,10,10", "extent: holds no point of the clouds"),
        ("box=10,0,0,10", r"extent\.box: is empty"),
    ],
)
def test_an_extent_that_misses_the_cloud_is_refused(tmp_path, cloud, capsys, extent, told):
    _, path = cloud
    out = [str(tmp_path / name) for name in ("cloud.parquet", "frame.json")]
    arguments = ["--site", "s", "--extent", extent, "--cloud", out[0], "--frame", out[1]]
    assert main([*arguments, "--clouds", str(path)]) == 2
    assert re.search(told, capsys.readouterr().err)
    assert not (tmp_path / "cloud.parquet").exists()


def test_one_kind_of_extent_is_stated():
    assert Extent(box=[0, 1, 2, 3]).stated == "box=0.0,1.0,2.0,3.0"
    assert Extent(edges_m=60).stated == "edges_m=60.0"
    for wrong in ({}, {"edges_m": 5, "track_m": 5}, {"box": [1, 2]}):
        with pytest.raises(ValidationError):
            Extent(**wrong)
