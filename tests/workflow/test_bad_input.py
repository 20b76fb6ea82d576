"""Bad input ends in one clear message before anything is overwritten.

What the covering alone can refuse (targets that nothing sees, a time limit) is tested beside its
stage, in tests/unit/test_solve_cover_stage.py.
"""

import json
import re

import cv2
import geopandas as gpd
import numpy as np
import pytest
import shapely
import yaml

from roadsight.base.errors import InputError
from roadsight.base.texts import read_yaml
from roadsight.config.load import load_config, load_site
from roadsight.geometry.frames import Frame
from roadsight.io.records.atomic import write_json
from roadsight.io.vector.vectors import write_layers
from roadsight.stages.scene import (
    build_dem,
    build_edges,
    cluster_fpfh,
    extract_pavement,
    ingest_cloud,
    profile_scene,
)
from tests.helpers.las_files import DATA, needs_data, random_points, wkt_of, write_las
from tests.workflow.conftest import TINY_SITE, Checkout

UTM = wkt_of("EPSG:25832")
PLANS = "config/plans.yaml"


@pytest.fixture(scope="module")
def checkout(tmp_path_factory):
    """A checkout in which nothing has run."""
    return Checkout.copy_to(tmp_path_factory.mktemp("bad") / "checkout")


def clouds_site(*clouds, crs="auto"):
    return yaml.safe_dump({"site": "tiny", "clouds": [str(c) for c in clouds], "crs": crs})


# Through Snakemake itself: the message stands alone, and no job runs.


def refused_by_snakemake(checkout, *arguments):
    """The one message with which Snakemake ends before any job."""
    result = checkout.snakemake("--cores", "1", *arguments)
    output = result.stdout + result.stderr
    assert result.returncode != 0, output
    messages = [line for line in output.splitlines() if line.startswith("roadsight: ")]
    assert len(messages) == 1, output
    assert "Traceback" not in output
    assert "rule " not in output
    assert not (checkout.folder / "results").exists()
    return messages[0]


def test_misspelt_key_of_the_configuration(checkout):
    message = refused_by_snakemake(checkout, "--config", "sites=[tiny]", "sead=3")
    assert "config/config.yaml: unknown key 'sead'" in message
    assert "did you mean 'seed'" in message


def test_key_that_is_twice_in_the_configuration(checkout):
    path = checkout.folder / "config/config.yaml"
    before = path.read_text()
    path.write_text(before + "seed: 3\n")
    try:
        message = refused_by_snakemake(checkout)
    finally:
        path.write_text(before)
    assert re.search(r"config/config.yaml, line \d+: .* key 'seed' is there twice", message)


def test_misspelt_setting_of_a_site(checkout):
    site = checkout.folder / "config/sites/tiny.yaml"
    site.write_text(TINY_SITE.replace("height_step_m", "hieght_step_m"))
    try:
        message = refused_by_snakemake(checkout)
    finally:
        site.write_text(TINY_SITE)
    assert "config/sites/tiny.yaml: settings: unknown key 'candidates.hieght_step_m'" in message
    assert "did you mean 'height_step_m'" in message


def test_no_such_cloud(checkout):
    site = checkout.folder / "config/sites/tiny.yaml"
    site.write_text(clouds_site("none.laz"))
    try:
        message = refused_by_snakemake(checkout)
    finally:
        site.write_text(TINY_SITE)
    assert "config/sites/tiny.yaml: clouds: no such cloud; found config/sites/none.laz" in message


def test_unset_variable(checkout):
    message = refused_by_snakemake(checkout, "--config", "sites=[autzen_arterial]")
    assert "config/sites/autzen_arterial.yaml" in message
    assert "environment variable ROADSIGHT_DATA is not set" in message
    assert "export ROADSIGHT_DATA=" in message


def test_published_alignment_without_a_registered_camera(checkout):
    folder = checkout.folder / "config/sites"
    write_las(folder / "lane.laz", random_points(1000), UTM)
    (folder / "photos").mkdir()
    cv2.imwrite(str(folder / "photos/a.png"), np.zeros((48, 64, 3), np.uint8))
    (folder / "drive.csv").write_text("image,latitude,longitude\na.png,48.0,9.0\n")
    content = {"site": "lane", "clouds": ["lane.laz"], "jobs": ["poles"]}
    shown = {
        "masks": [{"labels": "photos", "map": "../../resources/manifests/labels_project.yaml"}],
        "depth": {"images": "photos"},
    }
    content |= {"poles": {"images": "photos", "videolog": "drive.csv", **shown}}
    (folder / "lane.yaml").write_text(yaml.safe_dump(content))
    named = ("--configfile", "config/published.yaml", "--config", "sites=[lane]")
    message = refused_by_snakemake(checkout, *named)
    assert "config/sites/lane.yaml: poles.baseline" in message
    assert "registered camera of each image size" in message
    assert "roadsight register" in message


def test_message_of_a_failed_stage_reaches_the_terminal(checkout, tmp_path):
    cloud = write_las(tmp_path / "cut.laz", random_points(3000), UTM)
    cloud.write_bytes(cloud.read_bytes()[:-5000])
    site = checkout.folder / "config/sites/tiny.yaml"
    site.write_text(clouds_site(cloud))
    try:
        result = checkout.snakemake("--cores", "1", "results/tiny/scene/frame.json")
    finally:
        site.write_text(TINY_SITE)
    output = result.stdout + result.stderr
    assert result.returncode != 0
    lines = [line for line in output.splitlines() if "roadsight: " in line]
    assert len({line.strip() for line in lines}) == 1, output
    assert f"site tiny: {cloud}" in lines[0]
    assert "Traceback" not in output
    assert not list((checkout.folder / "results/tiny").rglob("*.parquet"))


# What the rule files call before any rule is known.


@pytest.fixture
def resolve(checkout, tmp_path, monkeypatch):
    """Resolve the small site as the rule files do, with changes; gives the message."""
    monkeypatch.chdir(checkout.folder)
    monkeypatch.delenv("ROADSIGHT_DATA", raising=False)

    def run(site=TINY_SITE, config=None, plans=None):
        content = read_yaml("config/config.yaml") | (config or {})
        if plans is not None:
            (tmp_path / "plans.yaml").write_text(plans)
            content["plans_file"] = str(tmp_path / "plans.yaml")
        (tmp_path / "site.yaml").write_text(site)
        with pytest.raises(InputError) as error:
            load_site(str(tmp_path / "site.yaml"), load_config(content))
        message = str(error.value)
        assert "\n" not in message
        return message

    return run


def settings(**sections):
    return yaml.safe_dump(yaml.safe_load(TINY_SITE) | {"settings": sections})


@pytest.mark.parametrize(
    ("heights", "found"),
    [
        ({"height_min_m": 10, "height_max_m": 4}, r"height_min_m \(10\).*height_max_m \(4\)"),
        ({"height_min_m": 10}, r"height_min_m \(10\).*height_max_m \(10\)"),
    ],
)
def test_lowest_height_above_the_highest(resolve, heights, found):
    message = resolve(settings(candidates=heights))
    assert re.search(f"site.yaml: settings: candidates: {found}", message)


@pytest.mark.parametrize(
    ("section", "key", "value"),
    [
        ("ground", "slope", 3.0),
        ("candidates", "spacing_m", 0),
        ("candidates", "spacing_m", float("nan")),
        ("targets", "min_points", 2.5),
        ("cover", "time_limit_s", -1),
        ("coverage", "uncoverable", "ignore"),
    ],
)
def test_value_outside_its_range(resolve, section, key, value):
    message = resolve(settings(**{section: {key: value}}))
    assert f"site.yaml: settings: {section}.{key}: " in message
    assert f"found {value!r}" in message


def test_unknown_sensor_of_a_plan(resolve):
    message = resolve(plans="plans: {os-64: {title: A, sensors: [OS-46]}}")
    assert "plans.yaml: plan 'os-64' names the unknown sensor 'OS-46'" in message
    assert "did you mean 'OS-64'" in message
    assert "config/sensors.yaml" in message


def test_plan_without_sensor(resolve):
    message = resolve(plans="plans: {os-64: {title: A, sensors: []}}")
    assert "plans.yaml: plans.os-64.sensors: " in message
    assert "at least 1" in message


def test_site_asks_for_an_unknown_plan_or_none(resolve):
    message = resolve(TINY_SITE.replace("[os-32, os-64]", "[os-99]"))
    assert "unknown plan 'os-99'" in message
    assert "allowed: vlp-16, puck-32c" in message
    assert "placement.plans: names no plan" in resolve(TINY_SITE.replace("[os-32, os-64]", "[]"))


def test_site_with_neither_or_both_sources(resolve):
    assert "either clouds" in resolve("site: tiny")
    assert "either clouds" in resolve(TINY_SITE + "clouds: [a.laz]\n")


@pytest.mark.parametrize("text", ["", "- a\n- b\n", "site: [\n", "site: Ä b\nsample: {}\n"])
def test_site_file_that_is_no_site(resolve, text):
    assert "site.yaml" in resolve(text)


# Clouds, through the stage that reads them.


def ingest(folder, *clouds, crs="auto", options=()):
    """Exit code of the stage; its outputs exist already and must stay as they were."""
    outputs = {"--cloud": folder / "cloud.parquet", "--frame": folder / "frame.json"}
    for path in outputs.values():
        path.write_text("old")
    paths = [part for name, path in outputs.items() for part in (name, str(path))]
    code = ingest_cloud.main(
        ["--site", "s", "--crs", crs, *options, *paths, "--clouds", *map(str, clouds)]
    )
    if code:
        assert [path.read_text() for path in outputs.values()] == ["old", "old"]
        assert not list(folder.glob("*.tmp*")) + list(folder.glob(".*tmp*"))
    return code


def ingest_message(folder, capsys, *clouds, **options):
    assert ingest(folder, *clouds, **options) == 2
    lines = capsys.readouterr().err.splitlines()
    messages = [line for line in lines if line.startswith("roadsight: ")]
    assert lines[-1:] == messages
    assert messages[0].startswith("roadsight: site s: ")
    return messages[0]


def test_truncated_cloud(tmp_path, capsys):
    cloud = write_las(tmp_path / "cut.laz", random_points(3000), UTM)
    cloud.write_bytes(cloud.read_bytes()[:-5000])
    assert str(cloud) in ingest_message(tmp_path, capsys, cloud)


def test_cloud_without_points(tmp_path, capsys):
    cloud = write_las(tmp_path / "none.laz", np.empty((0, 3)), UTM, offset=(0, 0, 0))
    message = ingest_message(tmp_path, capsys, cloud)
    assert f"{cloud}: " in message
    assert "no points" in message


def test_no_crs_anywhere(tmp_path, capsys):
    cloud = write_las(tmp_path / "bare.laz", random_points(50))
    message = ingest_message(tmp_path, capsys, cloud)
    assert str(cloud) in message
    assert "CRS" in message
    assert "local" in message
    assert ingest(tmp_path, cloud, crs="local", options=["--units", "metre"]) == 0


def test_two_clouds_in_different_crs(tmp_path, capsys):
    one = write_las(tmp_path / "one.laz", random_points(50), UTM)
    two = write_las(tmp_path / "two.laz", random_points(50), wkt_of("EPSG:25833"))
    message = ingest_message(tmp_path, capsys, one, two)
    assert "differ in CRS" in message
    assert str(two) in message


def test_longitude_and_latitude_read_as_metres(tmp_path, capsys):
    degrees = random_points(50, extent=(0.002, 0.002, 9), corner=(9.0, 50.0, 100.0))
    bare = write_las(tmp_path / "bare.laz", degrees, scale=1e-8)
    assert "degrees" in ingest_message(tmp_path, capsys, bare, crs="EPSG:25832")
    local = ["--units", "metre"]
    assert "degrees" in ingest_message(tmp_path, capsys, bare, crs="local", options=local)
    stated = write_las(tmp_path / "stated.laz", degrees, wkt_of("EPSG:4979"), scale=1e-8)
    message = ingest_message(tmp_path, capsys, stated)
    assert "target_crs" in message
    assert "EPSG:32632" in message


@pytest.mark.real
@needs_data
def test_feet_read_as_metres_elsewhere(tmp_path, capsys):
    cloud = DATA / "clouds/nc_unit_trap.laz"
    message = ingest_message(tmp_path, capsys, cloud, crs="EPSG:2264")
    assert str(cloud) in message
    assert "both in feet and in metres" in message
    assert "state `units: us-survey-foot`" in message
    assert "set `crs: EPSG:32119`" in message


@pytest.mark.real
@needs_data
def test_cloud_without_pavement(tmp_path, capsys):
    assert ingest(tmp_path, DATA / "clouds/autzen_trim.laz") == 0
    files = {name: str(tmp_path / file) for name, file in SCENE.items()}
    cloud, frame, profile = (("--" + n, files[n]) for n in ("cloud", "frame", "profile"))
    assert profile_scene.main([*cloud, *frame, "--out", files["profile"]]) == 0
    outputs = ["--dem", files["dem"], "--ground", files["ground"]]
    assert build_dem.main(["--site", "s", *cloud, *frame, *profile, *outputs]) == 0
    ground = ("--ground", files["ground"])
    assert cluster_fpfh.main([*cloud, *ground, *profile, "--out", files["clusters"]]) == 0
    capsys.readouterr()
    outputs = ["--pavement", files["pavement"], "--points", files["points"]]
    found = ["--clusters", files["clusters"], *profile, "--tma"]
    code = extract_pavement.main(["--site", "s", *cloud, *frame, *ground, *found, *outputs])
    assert code == 2
    message = capsys.readouterr().err.splitlines()[-1]
    assert message.startswith("roadsight: site s: ")
    assert "no pavement found" in message
    assert "placement.tma" in message
    assert not (tmp_path / "pavement.gpkg").exists()


SCENE = {
    "cloud": "cloud.parquet", "frame": "frame.json", "profile": "profile.json", "dem": "dem.tif",
    "ground": "ground.parquet", "clusters": "clusters.parquet", "pavement": "pavement.gpkg",
    "points": "points.parquet",
}  # fmt: skip


# Digitised edges.

FRAME = Frame((458_000.0, 5_428_000.0, 100.0), crs_wkt=UTM)


@pytest.fixture
def edges_message(tmp_path, capsys):
    """Message on digitised edges, given as coordinates (name, vertices) in the site's CRS."""
    write_json(tmp_path / "frame.json", FRAME.to_dict())
    pavement = gpd.GeoDataFrame({"area_m2": [800.0]}, geometry=[shapely.box(0, 0, 100, 8)])
    write_layers(tmp_path / "pavement.gpkg", {"pavement": pavement}, FRAME)
    (tmp_path / "edges.gpkg").write_text("old")

    def run(*lines, name="digitised.geojson", text=None):
        features = [
            {
                "type": "Feature",
                "properties": {"edge": edge},
                "geometry": {"type": "LineString", "coordinates": vertices},
            }
            for edge, vertices in lines
        ]
        content = json.dumps({"type": "FeatureCollection", "features": features})
        (tmp_path / name).write_text(content if text is None else text)
        options = {"frame": "frame.json", "pavement": "pavement.gpkg", "dem": "none.tif"}
        options |= {"digitised": name, "out": "edges.gpkg"}
        paths = [part for n, file in options.items() for part in (f"--{n}", str(tmp_path / file))]
        assert build_edges.main(["--site", "s", "--digitised-crs", "EPSG:25832", *paths]) == 2
        assert (tmp_path / "edges.gpkg").read_text() == "old"
        lines = capsys.readouterr().err.splitlines()
        assert lines[-1].startswith("roadsight: ")
        assert str(tmp_path / name) in lines[-1]
        return lines[-1]

    return run


def native(*xy):
    return FRAME.to_native(np.array(xy, float)).tolist()


def test_edges_outside_the_cloud(edges_message):
    message = edges_message(("left", native((0, 8), (100, 8))), ("far", native((0, 90), (90, 90))))
    assert "edge 'far' lies outside the cloud's road" in message
    assert "found 82 m from the pavement" in message
    assert "allowed: at most 50 m" in message
    assert "placement.edges_crs" in message


def test_edge_of_fewer_than_two_points(edges_message):
    message = edges_message(("left", native((5, 8), (5, 8))))
    assert "left: has fewer than two different vertices" in message
    (x, y), header = native((5, 8))[0], "edge,x,y"
    message = edges_message(name="digitised.csv", text=f"{header}\nleft,{x},{y}\n")
    assert "left" in message
    assert "two" in message


def test_edge_that_crosses_itself(edges_message):
    message = edges_message(("left", native((0, 8), (50, 8), (50, 12), (20, 2))))
    assert "left: crosses itself" in message


def test_edges_that_are_not_there(edges_message):
    assert "holds no features" in edges_message()
    assert "digitised.geojson" in edges_message(text="no JSON")
