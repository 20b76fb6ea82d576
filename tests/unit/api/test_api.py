import doctest
import importlib
import inspect
import logging
import re
import subprocess
import sys
from dataclasses import fields
from pathlib import Path

import geopandas as gpd
import numpy as np
import pandas as pd
import pytest
from scipy import sparse

import roadsight
from roadsight.api.drive import Drive, DriveOptions
from roadsight.api.sight import in_company_of
from roadsight.base import engines
from roadsight.base.errors import InputError
from roadsight.setcover import CoverProblem, solve_cover_problem
from tests.helpers.las_files import wkt_of, write_las
from tests.unit.scene.pavement.test_road_surface import f1
from tests.unit.scene.pavement.test_road_surface import street as kerbed_street

ROOT = Path(__file__).resolve().parents[3]
MODULES = sorted(set(roadsight._HOMES.values()))
FUNCTIONS = sorted(name for name in roadsight.__all__ if name.islower())


@pytest.mark.parametrize("name", MODULES)
def test_examples_hold(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    module = importlib.import_module(f"roadsight.api.{name}")
    failed, attempted = doctest.testmod(module, optionflags=doctest.ELLIPSIS)
    assert failed == 0
    assert attempted > 1


@pytest.mark.parametrize("name", FUNCTIONS)
def test_every_function_has_its_contract_and_an_example(name):
    function = getattr(roadsight, name)
    text = function.__doc__
    for part in ("Parameters", "Returns", "Raises", "Examples", ">>> "):
        assert part in text, part
    assert "+SKIP" not in text
    said = text[text.index("Parameters") : text.index("Returns")]
    for parameter in inspect.signature(function).parameters:
        assert re.search(rf"\b{parameter}\b.* :", said), parameter
    assert re.search(r"paper [12]|docs/|LAS specification", text), "no source"


def test_options_of_a_drive_are_those_that_its_function_takes():
    files = {"cloud", "images"}
    assert {field.name for field in fields(Drive)} - files == set(DriveOptions.__annotations__)


def test_all_that_is_promised_is_there_and_nothing_else():
    assert set(roadsight.__all__) == set(roadsight._HOMES) <= set(dir(roadsight))
    assert all(hasattr(roadsight, name) for name in roadsight.__all__)
    typed = (ROOT / "workflow" / "roadsight" / "__init__.pyi").read_text()
    assert all(f" as {name}\n" in typed for name in roadsight.__all__)
    with pytest.raises(AttributeError, match="no attribute 'curbs'"):
        _ = roadsight.curbs


def test_covers_work_without_the_rest():
    code = (
        "import sys, roadsight.setcover;"
        "own = [name for name in sys.modules if name.startswith('roadsight.')];"
        "print(sorted({name.split('.')[1] for name in own}),"
        " [name for name in ('pandas', 'geopandas', 'rasterio', 'cv2') if name in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "['base', 'setcover'] []"


def street(seed=2):
    """A flat street of 60 m by 24 m between two walls, local metres near a UTM place."""
    rng = np.random.default_rng(seed)
    flat = np.column_stack([rng.uniform(0, 60, 20_000), rng.uniform(0, 24, 20_000)])
    flat = np.column_stack([flat, rng.normal(0, 0.005, 20_000)])
    walls = np.column_stack([rng.uniform(0, 60, 40_000), rng.choice([0.0, 24.0], 40_000)])
    walls = np.column_stack([walls, rng.uniform(0, 8, 40_000)])
    return np.vstack([flat, walls])


@pytest.fixture(scope="module")
def file(tmp_path_factory):
    path = tmp_path_factory.mktemp("street") / "street.laz"
    shift = [500_000.0, 5_400_000.0, 100.0]
    return write_las(path, street() + shift, wkt_of("EPSG:25832"))


def test_a_path_a_cloud_and_an_array_give_the_same_ground(file):
    cloud = roadsight.read_cloud(file)
    labels = roadsight.ground(file)
    assert np.array_equal(labels, roadsight.ground(cloud))
    assert np.array_equal(labels, roadsight.ground(cloud.xyz_m))
    assert labels[:20_000].mean() > 0.99
    assert labels[20_000:].mean() < 0.2


def test_a_table_is_taken_by_the_names_of_its_columns(file):
    xyz_m = roadsight.read_cloud(file).xyz_m
    table = pd.DataFrame(xyz_m[:, ::-1], columns=["z", "y", "x"]).assign(label=7)
    assert np.array_equal(roadsight.ground(table), roadsight.ground(xyz_m))
    with pytest.raises(InputError, match="points: has no such column; found z"):
        roadsight.ground(table.drop(columns="z"))


def test_an_engine_that_has_nothing_to_do_is_told(rng):
    xyz, _, _, _ = kerbed_street(rng)
    with pytest.raises(InputError, match="method: has no use for an engine"):
        roadsight.pavement(xyz, method="surface", engine="open3d")


def test_a_matrix_is_taken_from_its_file(tmp_path):
    matrix = sparse.csr_matrix([[1, 1, 0], [0, 1, 1]])
    sparse.save_npz(tmp_path / "matrix.npz", matrix)
    assert roadsight.cover(tmp_path / "matrix.npz").chosen.tolist() == [0, 1]


def test_edges_are_in_the_crs_of_a_file_and_local_for_an_array(file):
    cloud = roadsight.read_cloud(file)
    native = roadsight.edges(file)
    assert native.crs.to_epsg() == 25832
    local = roadsight.edges(roadsight.pavement(cloud))
    assert local.crs is None
    moved = cloud.frame.to_native(np.array(local.geometry[0].coords)[:, :2])
    assert np.allclose(np.array(native.geometry[0].coords)[:, :2], moved, atol=1e-6)


def test_places_on_the_road_choose_the_surface(rng):
    xyz, _, _, road = kerbed_street(rng)
    found = roadsight.pavement(xyz, seeds_xy=[[25.0, 0.0]])
    driven = roadsight.pavement(xyz, track_xy=[[5.0, 1.8], [45.0, 1.8]])
    for one in (found, driven):
        assert f1(one.points, road) > 0.9
    with pytest.raises(InputError, match="seed 1 of 1"):
        roadsight.pavement(xyz, seeds_xy=[[900.0, 0.0]])
    with pytest.raises(InputError, match=r"seeds_xy\[1\]: is no place"):
        roadsight.pavement(xyz, seeds_xy=[[25.0, 0.0], [np.nan, 0.0]])
    with pytest.raises(InputError, match="method: has no use for seeds_xy"):
        roadsight.pavement(xyz, method="published", seeds_xy=[[25.0, 0.0]])


def test_a_detection_matrix_is_that_of_its_depth_maps(file):
    xyz = street()
    places = np.array([[10, 1, 5.0], [50, 23, 5.0]])
    feet = pd.DataFrame({"x": [12.0, 30.0, 55.0], "y": 12.0, "z": 0.0})
    sees = roadsight.detection_matrix(xyz, "OS1-64", places, feet)
    assert sees.shape == (2, 3)
    assert sees.dtype == bool
    for row, place in enumerate(places):
        ranges = roadsight.depth_map(xyz, "OS1-64", place)
        alone = roadsight.detection_matrix(xyz, "OS1-64", [place], feet)
        assert (alone != sees[row]).nnz == 0
        assert ranges.shape == (64, 2048)
    behind = np.array([[30, 40, 1.0]])  # beyond the wall
    assert roadsight.detection_matrix(xyz, "OS1-64", behind, feet).nnz == 0


@pytest.mark.parametrize("kind", [np.asarray, sparse.csr_matrix, sparse.coo_array, pd.DataFrame])
def test_covers_take_any_matrix(kind):
    rng = np.random.default_rng(4)
    dense = (rng.random((30, 60)) < 0.15).astype(float)
    dense[rng.integers(0, 30, 60), np.arange(60)] = 1
    found = roadsight.cover(kind(dense))
    truth = solve_cover_problem(CoverProblem(sparse.csr_matrix(dense)))
    assert found.status == "optimal"
    assert found.objective == truth.objective
    assert (dense[found.chosen].sum(axis=0) >= 1).all()


def test_layers_of_sightings_come_back_in_their_crs():
    seen = pd.DataFrame(
        {
            "lat": [51.5, 51.5, 51.5],
            "lon": [-0.1, -0.1001, -0.1002],
            "bearing": [315.0, 0.0, 45.0],
            "depth": [9.8, 6.9, np.nan],
        }
    )
    table = roadsight.triangulate(seen)
    points = gpd.points_from_xy(seen["lon"], seen["lat"], crs="EPSG:4326")
    layer = gpd.GeoDataFrame(seen[["bearing", "depth"]], geometry=points).to_crs("EPSG:27700")
    placed = roadsight.triangulate(layer)
    assert placed.crs.to_epsg() == 27700
    apart = placed.to_crs("EPSG:32630").distance(table.to_crs("EPSG:32630"))
    assert len(placed) == 1
    assert float(apart.iloc[0]) < 0.01


def test_names_of_a_layer_may_be_written_in_any_way():
    points = gpd.points_from_xy([-0.1, -0.1001], [51.5, 51.5], crs="EPSG:4326")
    columns = {"Lat": [0, 0], "Lon": [0, 0], " Bearing ": [315.0, 0.0], "Depth": [9.8, 6.9]}
    found = roadsight.triangulate(gpd.GeoDataFrame(columns, geometry=points))
    plain = {"lat": [51.5, 51.5], "lon": [-0.1, -0.1001]}
    plain |= {"bearing": [315.0, 0.0], "depth": [9.8, 6.9]}
    expected = roadsight.triangulate(pd.DataFrame(plain))
    assert found.drop(columns="geometry").equals(expected.drop(columns="geometry"))


def test_one_job_may_be_named_without_a_list():
    assert roadsight.estimate(6.3, jobs="poles") == roadsight.estimate(6.3, jobs=["poles"])


def test_a_step_that_fails_leaves_the_callers_log_alone(monkeypatch):
    root = logging.getLogger()
    for handlers in ([], [logging.NullHandler()]):
        monkeypatch.setattr(root, "handlers", handlers)
        before, level = handlers[:], root.level
        with pytest.raises(InputError, match=r"no\.laz"):
            roadsight.align("no.csv", "no.laz", "no")
        assert (root.handlers, root.level) == (before, level)


@pytest.mark.parametrize(
    "call",
    [
        lambda: roadsight.depth_map(street(), "OS1-64", [30, 12, 4], engine="open3d"),
        lambda: roadsight.detection_matrix(
            street(), "OS1-64", [[30, 12, 4]], [[38, 12, 0]], engine="open3d"
        ),
        lambda: roadsight.pavement(street(), method="published", engine="open3d"),
        lambda: roadsight.edges(street(), method="published", engine="open3d"),
    ],
)
def test_an_engine_that_is_not_there_is_named(call, monkeypatch):
    monkeypatch.setattr(engines, "is_installed", lambda: False)
    with pytest.raises(InputError, match="engine open3d is not installed"):
        call()


def test_points_that_stand_alone_are_left_out_if_asked():
    alone = np.vstack([street(), [[30.0, 12.0, 4.0]] * 2])
    assert np.array_equal(in_company_of(alone, 1.0, "own"), street())
    assert in_company_of(alone, 0.0, "own") is alone
    with pytest.raises(InputError, match="outlier_radius_m"):
        roadsight.depth_map(street(), "OS1-64", [30, 12, 3], outlier_radius_m=-1.0)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: roadsight.ground([[1.0, 2.0]]), "allowed: \\(n, 3\\) finite local metres"),
        (lambda: roadsight.ground([[1.0, 2.0, np.nan]]), "1 values not finite"),
        (lambda: roadsight.ground("missing.laz"), "missing.laz"),
        (lambda: roadsight.depth_map(street(), "OS-63", [0, 0, 1]), "no sensor 'OS-63'"),
        (lambda: roadsight.depth_map(street(), "OS1-64", [0, 9e3, 1]), "out of reach of the cloud"),
        (
            lambda: roadsight.detection_matrix(
                street(), "OS1-64", [[0, 0, 1]], pd.DataFrame({"x": [1]})
            ),
            "targets: lacks a column; found y",
        ),
        (lambda: roadsight.triangulate(pd.DataFrame({"lat": [1.0]})), "lacks the column lon"),
        (lambda: roadsight.estimate(-1), "miles: is not positive; found -1"),
        (lambda: roadsight.estimate(1, trees=3), "trees: is no amount"),
        (lambda: roadsight.estimate(1, points_m=-5), "points_m: is not positive; found -5"),
        (lambda: roadsight.estimate(1, images=float("nan")), "images: is not positive"),
        (lambda: roadsight.estimate(1, jobs=["pole"]), "jobs: is no job; found pole"),
        (lambda: roadsight.estimate(1, jobs=[]), "jobs: is no job; found none"),
        (lambda: roadsight.align("no.csv", "no.laz", "no"), "no.laz"),
    ],
)
def test_bad_input_is_one_message(call, message):
    with pytest.raises(InputError, match=message):
        call()


def test_the_montpellier_street_from_python(data):
    cloud = roadsight.read_cloud(data / "clouds" / "montpellier_street.laz")
    labels = roadsight.ground(cloud)
    given = np.asarray(cloud.native.dims["classification"])[cloud.taken] == 2
    assert (labels == given).mean() > 0.97


@pytest.mark.parametrize(
    ("wrong", "told"),
    [
        ({"method": "dens"}, "unknown method; found 'dens'"),
        ({"units": "feet"}, "unknown units; found 'feet'"),
        ({"engine": "mine"}, "unknown engine; found 'mine'"),
        ({"hfov_deg": 200.0}, "hfov_deg"),
        ({"max_sigma_heading_deg": 0.0}, "max_sigma_heading_deg"),
    ],
)
def test_align_refuses_what_it_does_not_know_before_it_reads_anything(wrong, told):
    with pytest.raises(InputError, match=told):
        roadsight.align("no.csv", "no.laz", "none", **wrong)
