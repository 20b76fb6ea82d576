import subprocess
import sys

import geopandas as gpd
import laspy
import numpy as np
import pandas as pd
import pytest
import shapely

from roadsight.__main__ import COMMANDS, main
from roadsight.base.sections.scene import Edges
from roadsight.placement.sensors.rays import beam_directions
from roadsight.placement.sensors.sensors import load_sensor
from roadsight.stages.scene import generate_sample
from roadsight.stages.scene.generate_sample import TRUTH_DIMENSION
from roadsight_worlds.casting.alignment import to_plan
from roadsight_worlds.casting.materials import TruthClass
from roadsight_worlds.highway.highway import EPSG, ORIGIN_M, build_highway
from roadsight_worlds.highway.truth import truth_layers
from tests.helpers.las_files import random_points, wkt_of, write_las

LENGTH_M, SEED = 60.0, 1
DOWN = [[0.0, 0.0, -1.0]] * 2
SENSORS = """
sensors:
  small: {azimuth_step_deg: 1, elevation_min_deg: -40, elevation_max_deg: -2, channels: 20,
          range_m: 60}
  short: {azimuth_step_deg: 1, elevations_deg: [-10, 0], range_m: 30}
"""
SUFFIXES = {"edges": ".gpkg", "geometry": ".gpkg", "depthmap": ".npz", "init": ".yaml"}
CLOUD_VERBS = {
    "ground": [], "pavement": [], "edges": [], "geometry": ["--along", "line.gpkg"],
    "depthmap": ["--sensor", "VLP-16", "--at", "0", "0", "0"],
}  # fmt: skip


@pytest.fixture(scope="module")
def sample(tmp_path_factory):
    """Sixty metres of generated highway."""
    folder = tmp_path_factory.mktemp("sample")
    files = {"cloud": "cloud.laz", "truth": "truth.gpkg", "edges": "edges.geojson"}
    paths = [part for n, file in files.items() for part in (f"--{n}", str(folder / file))]
    size = ["--length-m", str(LENGTH_M), "--points", "150000", "--seed", str(SEED)]
    assert generate_sample.main([*paths, *size]) == 0
    (folder / "sensors.yaml").write_text(SENSORS)
    return folder


@pytest.fixture(scope="module")
def truth(sample):
    return laspy.read(sample / "cloud.laz")


@pytest.fixture(scope="module")
def highway():
    return build_highway(SEED, LENGTH_M)


@pytest.fixture(scope="module")
def place(highway):
    """Six metres above the left edge at the middle of the road, native coordinates."""
    line = truth_layers(highway)["edges"].geometry[0]
    x, y = shapely.get_coordinates(line.interpolate(0.5, normalized=True))[0]
    z = highway.scene.cast([[x, y, 50.0]], [[0.0, 0.0, -1.0]], 100.0)[0][0]
    return np.array([x, y, 50.0 - z + 6.0]) + ORIGIN_M


def depthmap(sample, place, out, *options, cloud="cloud.laz", sensor="small"):
    return main(
        [
            *("depthmap", str(sample / cloud), "--sensors", str(sample / "sensors.yaml")),
            *("--sensor", sensor, "--at", *map(str, place), "-o", str(out), *options),
        ]
    )


def unchanged_but_for_classes(before, after):
    assert after.header.parse_crs().to_epsg() == EPSG
    assert np.allclose(after.xyz, before.xyz, rtol=0, atol=1e-6)
    for name in ("intensity", "gps_time", "point_source_id", TRUTH_DIMENSION):
        assert np.array_equal(after[name], before[name]), name


def f1(found, true):
    return 2 * (found & true).sum() / (found.sum() + true.sum())


def test_ground_is_that_of_the_truth(sample, truth, tmp_path, capsys):
    out = tmp_path / "labelled.laz"
    assert main(["ground", str(sample / "cloud.laz"), "-o", str(out)]) == 0
    labelled = laspy.read(out)
    unchanged_but_for_classes(truth, labelled)
    found = np.asarray(labelled.classification) == 2
    assert set(np.unique(labelled.classification)) == {0, 2}
    true = np.isin(truth[TRUTH_DIMENSION], (TruthClass.GROUND, TruthClass.ROAD))
    assert f1(found, true) > 0.97
    things = np.isin(truth[TRUTH_DIMENSION], (TruthClass.HIGH_VEGETATION, TruthClass.VEHICLE))
    assert found[things].mean() < 0.1
    assert capsys.readouterr().out == f"{found.sum()} of {len(found)} points are ground: {out}\n"


def test_ground_by_the_published_rule_takes_what_hides_it(sample, truth, tmp_path):
    found = {}
    for method in ("robust", "pillars"):
        out = tmp_path / f"{method}.laz"
        arguments = ["ground", str(sample / "cloud.laz"), "--method", method, "-o", str(out)]
        assert main(arguments) == 0
        found[method] = np.asarray(laspy.read(out).classification) == 2
    true = np.isin(truth[TRUTH_DIMENSION], (TruthClass.GROUND, TruthClass.ROAD))
    assert f1(found["pillars"], true) > 0.9
    things = np.isin(truth[TRUTH_DIMENSION], (TruthClass.HIGH_VEGETATION, TruthClass.VEHICLE))
    assert found["pillars"][things].mean() > 2 * found["robust"][things].mean()


@pytest.fixture(scope="module")
def paved(sample):
    out = sample / "paved.laz"
    assert main(["pavement", str(sample / "cloud.laz"), "-o", str(out)]) == 0
    return laspy.read(out)


def test_pavement_is_that_of_the_truth(truth, paved):
    unchanged_but_for_classes(truth, paved)
    labels = np.asarray(paved.classification)
    assert set(np.unique(labels)) == {0, 2, 11}
    assert f1(labels == 11, truth[TRUTH_DIMENSION] == TruthClass.ROAD) > 0.9


def relabelled_pavement(sample, truth, folder, label):
    """Labels of `roadsight pavement` where the file gives all but vegetation one class."""
    relabelled = laspy.read(sample / "cloud.laz")
    relabelled.classification = np.where(truth[TRUTH_DIMENSION] == 5, 5, label).astype(np.uint8)
    relabelled.write(folder / "in.laz")
    assert main(["pavement", str(folder / "in.laz"), "-o", str(folder / "out.laz")]) == 0
    return np.asarray(laspy.read(folder / "out.laz").classification)


def test_labels_of_the_file_give_way(sample, truth, paved, tmp_path):
    labels = relabelled_pavement(sample, truth, tmp_path, 2)
    assert np.array_equal(labels == 11, np.asarray(paved.classification) == 11)
    assert set(np.unique(labels)) == {1, 2, 5, 11}


def test_a_road_class_that_is_everywhere_widens_no_road(sample, truth, paved, tmp_path):
    labels = relabelled_pavement(sample, truth, tmp_path, 11)
    found, alone = labels == 11, np.asarray(paved.classification) == 11
    assert 2 * (found & alone).sum() / (found.sum() + alone.sum()) > 0.98
    assert set(np.unique(labels)) == {1, 2, 5, 11}


def test_edges_lie_on_the_true_ones(sample, highway, tmp_path):
    out = tmp_path / "edges.gpkg"
    assert main(["edges", str(sample / "cloud.laz"), "-o", str(out)]) == 0
    edges = gpd.read_file(out, layer="edges")
    pavement = gpd.read_file(out, layer="pavement")
    assert edges.crs.to_epsg() == pavement.crs.to_epsg() == EPSG
    assert set(edges["source"]) == {"automatic"}
    true = shapely.unary_union(truth_layers(highway)["edges"].geometry.to_numpy())
    inner = truth_layers(highway)["pavement"].geometry
    outline = shapely.unary_union(inner.boundary.to_numpy())
    local = edges.geometry.translate(*(-np.array(ORIGIN_M)))
    points = shapely.points(np.concatenate([shapely.get_coordinates(line) for line in local]))
    off_m = np.median(shapely.distance(points, outline.union(true)))
    assert abs(off_m - Edges().offset_m) < 0.1
    assert edges["length_m"].sum() > 1.5 * LENGTH_M
    area_m2 = inner.area.sum()
    assert pavement["area_m2"].sum() == pytest.approx(area_m2, rel=0.15)


def line_beside(highway, path, offset_m):
    """A line along the highway, native coordinates."""
    stations = np.arange(2.0, LENGTH_M - 2.0, 8.0)
    plan = to_plan(highway.alignment, np.column_stack([stations, offset_m + 0 * stations]))
    line = shapely.LineString(plan + ORIGIN_M[:2])
    gpd.GeoDataFrame({"name": ["west"]}, geometry=[line], crs=f"EPSG:{EPSG}").to_file(path)
    return path


def test_the_geometry_of_a_road_without_a_drive(sample, highway, tmp_path, capsys):
    inner, outer = highway.section.pavement_m
    along = line_beside(highway, tmp_path / "along.gpkg", (inner + outer) / 2 + 1.0)
    known = gpd.GeoDataFrame(geometry=truth_layers(highway)["pavement"].translate(*ORIGIN_M[:2]))
    known.set_crs(EPSG).to_file(tmp_path / "known.gpkg")
    for name, options, within_m in (
        ("known", ["--edges", str(tmp_path / "known.gpkg")], 0.02),
        ("traced", [], 0.8),
    ):
        out = tmp_path / f"{name}_geometry.gpkg"
        argv = ["geometry", str(sample / "cloud.laz"), "--along", str(along), "-o", str(out)]
        assert main([*argv, *options]) == 0
        table = pd.read_csv(out.with_suffix(".csv"))
        assert set(table["road"]) == {"west"}
        assert table["paved_width_m"].median() == pytest.approx(outer - inner, abs=within_m)
        layer = gpd.read_file(out, layer="road_geometry")
        assert layer.crs.to_epsg() == EPSG
        assert layer["station_m"].tolist() == pytest.approx(table["station_m"].tolist())
        middle = to_plan(highway.alignment, [[s, (inner + outer) / 2] for s in (20.0, 40.0)])
        rise = -np.diff(highway.scene.cast([[*p, 50.0] for p in middle], DOWN, 100.0)[0])[0]
        grade = table["grade_percent"].median()
        assert grade == pytest.approx(100 * rise / np.hypot(*np.diff(middle, axis=0)[0]), abs=0.3)
    assert f"west: {len(table)} stations, paved width known at" in capsys.readouterr().out


def test_a_line_off_the_road_has_no_geometry(sample, highway, tmp_path, capsys):
    along = line_beside(highway, tmp_path / "along.gpkg", 80.0)
    out = tmp_path / "out.gpkg"
    argv = ["geometry", sample / "cloud.laz", "--along", along, "-o", out]
    told = refused(argv, tmp_path, capsys)
    assert "along.gpkg, west: has no pavement with an edge on both sides" in told


FIELD_M = (100.0, 40.0)
UPPER, LOWER = shapely.box(0, 25, 100, 34), shapely.box(0, 6, 100, 15)


@pytest.fixture(scope="module")
def field(tmp_path_factory):
    """Two carriageways of 9 m, 10 m apart, on level ground, and lines along them and between."""
    folder = tmp_path_factory.mktemp("field")
    x, y = np.random.default_rng(0).uniform(0, FIELD_M, (30_000, 2)).T
    paved, noise = np.abs(np.abs(y - 20) - 9.5) < 4.5, np.random.default_rng(1).normal(size=len(x))
    z = np.where(paved, 0.15 + 0.01 * noise, 0.12 * np.abs(noise))
    cloud = write_las(
        folder / "field.laz",
        np.column_stack([x, y, z]) + ORIGIN_M,
        wkt_of(f"EPSG:{EPSG}"),
        intensity=np.where(paved, 8000, 30000),
    )
    for name, y in (("lane", 30.5), ("median", 20.0), ("verge", 24.0)):
        drawn(folder / f"{name}.gpkg", shapely.LineString([(5, y), (95, y)]), name=name)
    return cloud


def drawn(path, *shapes, name="a"):
    """A file of shapes, of local coordinates."""
    placed = [shapely.transform(shape, lambda xy: xy + ORIGIN_M[:2]) for shape in shapes]
    gpd.GeoDataFrame({"name": [name] * len(placed)}, geometry=placed, crs=f"EPSG:{EPSG}").to_file(
        path
    )
    return str(path)


def along(field, line, out, *options):
    line = field.parent / f"{line}.gpkg"
    return ["geometry", str(field), "--along", str(line), "-o", str(out), *options]


@pytest.mark.parametrize("given", ["areas", "lines", "traced"])
def test_what_lies_between_two_carriageways_is_no_road(field, tmp_path, capsys, given):
    shapes = [UPPER, LOWER]
    if given == "lines":
        shapes = [shapely.LineString([(0, y), (100, y)]) for y in (6, 15, 25, 34)]
    known = drawn(tmp_path / "known.gpkg", *shapes)
    places = [f"{ORIGIN_M[0] + 50},{ORIGIN_M[1] + y}" for y in (10.5, 29.5)]
    options = [f"--seeds={';'.join(places)}"] if given == "traced" else ["--edges", known]
    out = tmp_path / "out.gpkg"
    told = refused(along(field, "median", out, *options), tmp_path, capsys)
    assert "median: has no pavement with an edge on both sides" in told
    assert "not between two carriageways" in told
    # A metre off the pavement a line moves to its middle, not to that of the strip it lies on.
    assert main(along(field, "verge", out, *options)) == 0
    table = pd.read_csv(out.with_suffix(".csv"))
    within_m = 0.3 if given == "traced" else 0.01
    assert table["paved_width_m"].to_numpy() == pytest.approx(9, abs=2 * within_m)
    assert table["y"].to_numpy() == pytest.approx(ORIGIN_M[1] + 29.5, abs=within_m)


def test_slivers_between_areas_are_no_edges(field, tmp_path):
    known = [shapely.box(0, 25, 50, 29.45), shapely.box(0, 29.55, 50, 34)]
    known.append(shapely.box(50.1, 25, 100, 34))
    edges = drawn(tmp_path / "known.gpkg", *known)
    out = tmp_path / "out.gpkg"
    assert main(along(field, "lane", out, "--edges", edges)) == 0
    assert pd.read_csv(out.with_suffix(".csv"))["paved_width_m"].to_numpy() == pytest.approx(9)
    assert gpd.read_file(out, layer="edges")["length_m"].tolist() == pytest.approx([218])


def test_edges_that_are_no_lines_or_areas_are_refused(field, tmp_path, capsys):
    bow = shapely.Polygon([(0, 25), (100, 34), (100, 25), (0, 34)])
    point = shapely.Point(5, 25)
    for shape, message in ((point, "Point"), (bow, "is no valid polygon")):
        edges = drawn(tmp_path / f"{shape.geom_type}.gpkg", UPPER, shape)
        argv = along(field, "lane", tmp_path / "out.gpkg", "--edges", edges)
        told = refused(argv, tmp_path, capsys)
        assert f"{edges}, feature 2" in told
        assert message in told


def test_lines_among_areas_are_refused(field, tmp_path, capsys):
    edges = drawn(tmp_path / "known.gpkg", UPPER, shapely.LineString([(0, 6), (100, 6)]))
    told = refused(along(field, "lane", tmp_path / "o.gpkg", "--edges", edges), tmp_path, capsys)
    assert "holds both lines and areas" in told


def test_options_that_areas_have_no_use_for_are_refused(field, tmp_path, capsys):
    edges = drawn(tmp_path / "known.gpkg", UPPER)
    options = ["--edges", edges, "--method", "surface", "--track", edges]
    told = refused(along(field, "lane", tmp_path / "out.gpkg", *options), tmp_path, capsys)
    assert "--method and --track: have no use with areas" in told


def test_what_a_verb_reads_is_never_overwritten(tmp_path, capsys):
    geometry = ["geometry", "no.laz", "--along"]
    for argv, out, told in [
        ([*geometry, tmp_path / "a.csv"], "a.gpkg", "a.csv"),
        ([*geometry, tmp_path / "a.gpkg"], "a.gpkg", "a.gpkg"),
        ([*geometry, "b.gpkg", "--edges", f"{tmp_path}/a.gpkg|layername=e"], "a.gpkg", "a.gpkg"),
        ([*geometry, "b.gpkg", "--track", tmp_path / "a.gpkg"], "a.gpkg", "a.gpkg"),
        (["edges", "no.laz", "--track", tmp_path / "a.gpkg"], "a.gpkg", "a.gpkg"),
    ]:
        message = refused([*argv, "-o", tmp_path / out], tmp_path, capsys)
        assert f"--out {tmp_path / told}: would replace a file" in message


@pytest.mark.parametrize(
    ("model", "within"), [("surfel", 0.9), ("hybrid", 0.7), ("unet", 0.7), ("unet_mask", 0.7)]
)
def test_depth_maps_agree_with_exact_ray_casting(sample, highway, place, tmp_path, model, within):
    out = tmp_path / "map.npz"
    assert depthmap(sample, place, out, "--model", model, "--azimuth-deg", "25") == 0
    sensor = load_sensor(sample / "sensors.yaml", "small")
    with np.load(out) as content:
        depth = dict(content)
    assert set(depth) == {"range_m", "azimuth_deg", "elevation_deg"}
    range_m = depth["range_m"]
    assert range_m.shape == (20, 360)
    assert np.array_equal(depth["azimuth_deg"], sensor.azimuth_deg)
    assert np.array_equal(depth["elevation_deg"], sensor.elevation_deg)
    assert range_m.max() <= sensor.range_m
    directions = beam_directions(sensor, 25.0).reshape(-1, 3).astype(float)
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    origins = np.tile(place - ORIGIN_M, (len(directions), 1))
    exact, _, _ = highway.scene.cast(origins, directions, sensor.range_m)
    returned = range_m.ravel() > 0
    both = returned & np.isfinite(exact) & (exact < 25)
    assert both.sum() > 2000
    error = np.abs(range_m.ravel()[both] - exact[both])
    assert np.mean(error < 0.3) > within
    assert np.median(error) < 0.1


def test_a_depth_map_is_turned_by_the_azimuth(sample, place, tmp_path):
    maps = []
    for azimuth_deg in (0, 90):
        out = tmp_path / f"{azimuth_deg}.npz"
        assert depthmap(sample, place, out, "--azimuth-deg", str(azimuth_deg)) == 0
        with np.load(out) as content:
            maps.append(content["range_m"])
    assert not np.array_equal(maps[0], maps[1])
    turned = np.roll(maps[1], 90, axis=1)
    assert np.mean(np.isclose(maps[0], turned, atol=1e-3)) > 0.99


@pytest.fixture(scope="module")
def bare(sample, truth):
    """The same cloud without a word on its CRS."""
    return write_las(sample / "bare.laz", truth.xyz, intensity=truth.intensity)


def test_a_cloud_without_crs_is_local(sample, bare, place, truth, tmp_path):
    out = tmp_path / "ground.laz"
    assert main(["ground", str(bare), "-o", str(out)]) == 0
    labelled = laspy.read(out)
    assert labelled.header.parse_crs() is None
    assert np.allclose(labelled.xyz, truth.xyz, rtol=0, atol=1e-6)
    for name, cloud in (("with", "cloud.laz"), ("without", bare)):
        assert depthmap(sample, place, tmp_path / f"{name}.npz", cloud=cloud) == 0
    with np.load(tmp_path / "with.npz") as one, np.load(tmp_path / "without.npz") as other:
        # The CRS moves the local origin by less than a nanometre, and single rays with it.
        same = np.isclose(one["range_m"], other["range_m"], rtol=0, atol=0.01)
        assert same.mean() > 0.995


def test_feet_are_read_as_feet(sample, bare, place, truth, tmp_path):
    foot_m = 0.3048
    feet = write_las(tmp_path / "feet.laz", truth.xyz / foot_m, intensity=truth.intensity)
    units = ["--units", "foot", "--vertical-units", "foot"]
    assert depthmap(sample, place, tmp_path / "metres.npz", cloud=bare) == 0
    assert depthmap(sample, place / foot_m, tmp_path / "feet.npz", *units, cloud=feet) == 0
    with np.load(tmp_path / "metres.npz") as one, np.load(tmp_path / "feet.npz") as other:
        assert np.median(np.abs(one["range_m"] - other["range_m"])) < 0.02


@pytest.mark.parametrize("point_format", [4, 10])
def test_waveforms_are_left_out_and_told_once(point_format, tmp_path, caplog, rng):
    xyz = np.column_stack([rng.uniform(0, 30, (4000, 2)), rng.normal(0, 0.01, 4000)])
    about = {"point_format": point_format, "wavepacket_index": 1, "wavepacket_size": 64}
    cloud = write_las(tmp_path / "a.las", xyz, **about, intensity=7)
    assert main(["ground", str(cloud), "-o", str(tmp_path / "b.laz")]) == 0
    assert caplog.text.count("waveforms are left out") == 1
    written = laspy.read(tmp_path / "b.laz")
    assert "wavepacket_index" not in written.point_format.dimension_names
    assert (written.intensity == 7).all()


@pytest.mark.parametrize("verb", COMMANDS)
def test_help(verb, capsys):
    with pytest.raises(SystemExit) as stop:
        main([verb, "--help"])
    assert stop.value.code == 0
    assert f"usage: roadsight {verb}" in capsys.readouterr().out


def test_help_lists_every_verb(capsys):
    with pytest.raises(SystemExit) as stop:
        main(["--help"])
    assert stop.value.code == 0
    output = capsys.readouterr().out
    assert all(f"\n  {verb}" in output or f"\n    {verb}" in output for verb in COMMANDS)


@pytest.mark.parametrize("argv", [[], ["grounds"], ["ground"], ["ground", "a.laz"]])
def test_wrong_usage_is_exit_code_2(argv, capsys):
    with pytest.raises(SystemExit) as stop:
        main(argv)
    assert stop.value.code == 2
    assert "usage: roadsight" in capsys.readouterr().err


def refused(argv, folder, capsys):
    """Message of a verb that must fail and write nothing into ``folder``."""
    before = {path: path.read_bytes() for path in folder.iterdir()}
    assert main([str(part) for part in argv]) == 2
    captured = capsys.readouterr()
    assert {path: path.read_bytes() for path in folder.iterdir()} == before
    assert captured.out == ""
    lines = captured.err.splitlines()
    assert len(lines) == 1, captured.err
    assert lines[0].startswith("roadsight: ")
    return lines[0]


def bad_cloud(kind, folder):
    path = folder / "cloud.laz"
    if kind == "no such file":
        return path
    if kind == "is a folder":
        path.mkdir(parents=True)
        return path
    if kind == "wrong extension":
        path = folder / "cloud.e57"
        path.write_bytes(b"ASTM-E57")
        return path
    if kind == "no points":
        return write_las(path, np.empty((0, 3)), wkt_of("EPSG:25832"), offset=(0, 0, 0))
    write_las(path, random_points(3000), wkt_of("EPSG:25832"))
    if kind == "truncated":
        path.write_bytes(path.read_bytes()[:-5000])
    elif kind == "no LAS":
        path.write_bytes(b"x" * 1000)
    return path


@pytest.mark.parametrize("verb", [*CLOUD_VERBS, "init"])
@pytest.mark.parametrize(
    "kind", ["no such file", "is a folder", "wrong extension", "no points", "truncated", "no LAS"]
)
def test_bad_clouds(verb, kind, tmp_path, capsys):
    (tmp_path / "in").mkdir()
    (tmp_path / "out").mkdir()
    cloud = bad_cloud(kind, tmp_path / "in")
    out = tmp_path / "out" / "result"
    argv = [
        verb, cloud, "-o", out.with_suffix(SUFFIXES.get(verb, ".laz")), *CLOUD_VERBS.get(verb, []),
    ]  # fmt: skip
    message = refused(argv, tmp_path / "out", capsys)
    assert str(cloud) in message


def test_unknown_sensor(sample, place, tmp_path, capsys):
    at = ["--at", *place]
    for sensors, name, hint in [
        (["--sensors", sample / "sensors.yaml"], "smal", "did you mean 'small'"),
        ([], "OS-46", "did you mean 'OS-64'"),
    ]:
        argv = ["depthmap", sample / "cloud.laz", *sensors, "--sensor", name, *at]
        assert hint in refused([*argv, "-o", tmp_path / "map.npz"], tmp_path, capsys)


def test_sensor_out_of_reach(sample, place, tmp_path, capsys):
    argv = ["depthmap", sample / "cloud.laz", "--sensors", sample / "sensors.yaml"]
    argv += ["--sensor", "short", "-o", tmp_path / "map.npz", "--at"]
    message = refused([*argv, *(place + np.array([0, 0, 200]))], tmp_path, capsys)
    assert "out of reach" in message
    assert "within 30 m" in message
    assert "--at" in refused([*argv, "nan", 0, 0], tmp_path, capsys)


def test_outputs_of_another_kind_are_refused(sample, place, tmp_path, capsys):
    at = ["--sensor", "VLP-16", "--at", *place]
    for verb, name, options in [
        ("ground", "out.txt", []),
        ("pavement", "out.gpkg", []),
        ("edges", "out.laz", []),
        ("geometry", "out.csv", ["--along", "line.gpkg"]),
        ("depthmap", "out.csv", at),
    ]:
        argv = [verb, sample / "cloud.laz", *options, "-o", tmp_path / name]
        assert name in refused(argv, tmp_path, capsys)


def test_the_cloud_itself_is_never_overwritten(tmp_path, capsys):
    cloud = write_las(tmp_path / "a.laz", random_points(300), wkt_of("EPSG:25832"))
    for verb in ("ground", "pavement"):
        assert "itself" in refused([verb, cloud, "-o", cloud], tmp_path, capsys)


def test_ground_without_a_road_has_no_pavement(tmp_path, capsys, rng):
    """A meadow as rough as grass."""
    xyz = rng.uniform([0, 0, 0], [30, 30, 0.4], (40_000, 3)) + ORIGIN_M
    cloud = write_las(tmp_path / "meadow.laz", xyz, wkt_of(f"EPSG:{EPSG}"), intensity=100)
    for verb in ("pavement", "edges"):
        argv = [verb, cloud, "-o", tmp_path / f"out{SUFFIXES.get(verb, '.laz')}"]
        assert str(cloud) in refused(argv, tmp_path, capsys)


def test_seeds_that_are_no_places_or_off_the_cloud_are_one_message(tmp_path, capsys, rng):
    xyz = rng.uniform([0, 0, 0], [30, 30, 0.01], (40_000, 3)) + ORIGIN_M
    cloud = write_las(tmp_path / "flat.laz", xyz, wkt_of(f"EPSG:{EPSG}"), intensity=100)
    argv = ["pavement", cloud, "-o", tmp_path / "out.laz"]
    assert "x,y;x,y" in refused([*argv, "--seeds=1,2;three"], tmp_path, capsys)
    assert "x,y;x,y" in refused([*argv, "--seeds=1,2,3,4,5"], tmp_path, capsys)
    assert "seed 1 of 1" in refused([*argv, "--seeds=0,0"], tmp_path, capsys)
    for wrong in ("nan,2", "3,inf"):
        told = refused([*argv, f"--seeds=1,2;{wrong};5,6"], tmp_path, capsys)
        assert "--seeds: seed 2 of 3" in told
        assert wrong in told


@pytest.mark.parametrize("verb", ["pavement", "edges"])
@pytest.mark.parametrize("places", [["--seeds=1,2"], ["--track", "drive.gpkg"]])
def test_places_with_a_method_that_ignores_them_are_refused_first(verb, places, tmp_path, capsys):
    argv = [verb, tmp_path / "no.laz", "-o", tmp_path / f"out{SUFFIXES.get(verb, '.laz')}"]
    told = refused([*argv, *places, "--method", "published"], tmp_path, capsys)
    assert places[0].partition("=")[0] in told
    assert "published" in told


def test_as_a_program(tmp_path):
    cloud = bad_cloud("truncated", tmp_path)
    command = [sys.executable, "-m", "roadsight", "ground", str(cloud), "-o"]
    result = subprocess.run(
        [*command, str(tmp_path / "out.laz")], capture_output=True, text=True, check=False
    )
    assert result.returncode == 2
    assert result.stderr.startswith("roadsight: ")
    assert result.stderr.count("\n") == 1
    assert not (tmp_path / "out.laz").exists()


def test_an_output_that_cannot_be_written_is_one_message(sample, tmp_path, capsys):
    (tmp_path / "out.laz").mkdir()
    assert main(["ground", str(sample / "cloud.laz"), "-o", str(tmp_path / "out.laz")]) == 2
    captured = capsys.readouterr()
    assert captured.err.count("\n") == 1
    assert captured.err.startswith("roadsight: ")
    assert [path.name for path in tmp_path.iterdir()] == ["out.laz"]
