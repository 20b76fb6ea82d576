import json

import laspy
import numpy as np
import pyogrio
import pytest

from roadsight.geometry.frames import Frame
from roadsight.io.vector.vectors import read_layer, read_lines
from roadsight.stages.scene.generate_sample import TRUTH_DIMENSION, main
from roadsight_worlds.highway.highway import EPSG, ORIGIN_M, build_highway
from roadsight_worlds.highway.truth import truth_layers

FILES = {"cloud": "cloud.laz", "truth": "truth.gpkg", "edges": "edges.geojson"}


def generate(folder, *options):
    paths = {name: folder / file for name, file in FILES.items()}
    argv = [part for name, path in paths.items() for part in (f"--{name}", str(path))]
    return main([*argv, "--length-m", "60", "--points", "40000", *options]), paths


@pytest.fixture(scope="module")
def sample(tmp_path_factory):
    code, paths = generate(tmp_path_factory.mktemp("sample"))
    assert code == 0
    return paths


def test_the_same_call_gives_the_same_bytes(sample, tmp_path):
    _, again = generate(tmp_path)
    for name, path in sample.items():
        assert path.read_bytes() == again[name].read_bytes(), name


def test_another_seed_gives_another_sample(sample, tmp_path):
    _, other = generate(tmp_path, "--seed", "2")
    for name, path in sample.items():
        assert path.read_bytes() != other[name].read_bytes(), name


def test_plants_can_be_told(sample, tmp_path):
    _, told = generate(tmp_path, "--class-scheme", "plants")
    usual, cloud = laspy.read(sample["cloud"]), laspy.read(told["cloud"])
    truth = np.asarray(cloud[TRUTH_DIMENSION])
    plants = np.isin(truth, (3, 5))
    assert 0 < plants.sum() < len(truth)
    assert np.asarray(cloud.classification)[plants].tolist() == truth[plants].tolist()
    assert not np.asarray(cloud.classification)[~plants].any()
    np.testing.assert_array_equal(usual.xyz, cloud.xyz)


def test_the_cloud_is_unclassified_and_carries_its_truth(sample):
    cloud = laspy.read(sample["cloud"])
    assert (cloud.header.version.major, cloud.header.version.minor) == (1, 4)
    assert cloud.header.point_format.id == 6
    assert cloud.header.parse_crs().to_epsg() == EPSG
    assert list(cloud.header.scales) == [0.001] * 3
    assert len(cloud.points) == pytest.approx(40_000, rel=0.05)
    assert set(np.unique(cloud.classification)) == {0}
    assert {2, 5, 6, 11, 65} <= set(np.unique(cloud[TRUTH_DIMENSION]))
    assert np.all(np.asarray(cloud.return_number) == 1)
    assert np.asarray(cloud.intensity).max() > 10_000
    assert np.asarray(cloud.gps_time).min() > 0
    xyz = np.asarray(cloud.xyz) - ORIGIN_M
    assert np.abs(xyz[:, :2]).max() < 120.0


def test_the_truth_reads_back_in_the_local_frame(sample):
    frame = build_highway(1, 60.0).frame()
    expected = truth_layers(build_highway(1, 60.0))
    assert {name for name, _ in pyogrio.list_layers(sample["truth"])} == set(expected)
    assert pyogrio.read_info(sample["truth"], layer="pavement")["crs"] == f"EPSG:{EPSG}"
    for name, layer in expected.items():
        found = read_layer(sample["truth"], name, frame)
        assert list(found.columns.drop("geometry")) == list(layer.columns.drop("geometry"))
        assert found.geometry.hausdorff_distance(layer.geometry).max() < 1e-6


def test_the_edges_name_their_crs_and_read_as_lines(sample):
    content = json.loads(sample["edges"].read_text())
    assert content["crs"]["properties"]["name"] == f"urn:ogc:def:crs:EPSG::{EPSG}"
    x, y = content["features"][0]["geometry"]["coordinates"][0]
    assert 667_000 < x < 669_000
    assert 3_546_000 < y < 3_548_000
    frame = Frame(ORIGIN_M, crs_wkt=build_highway(1, 60.0).frame().crs_wkt)
    lines = read_lines(sample["edges"], frame).set_index("edge")
    assert list(lines["kind"]) == ["edge", "median", "edge"]
    assert lines.geometry["median"].length == pytest.approx(60.0, abs=0.3)


@pytest.mark.parametrize("options", [("--length-m", "10"), ("--points", "5"), ("--seed", "-3")])
def test_bad_requests_leave_nothing_behind(options, tmp_path, capsys):
    code, paths = generate(tmp_path, *options)
    assert code == 2
    assert capsys.readouterr().err.startswith("roadsight: ")
    assert not any(path.exists() for path in paths.values())
