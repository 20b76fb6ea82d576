"""Bad input ends in one clear message before anything is overwritten.

What site files, clouds and the covering alone can refuse is tested beside what reads them, in
tests/unit.
"""

import re
from contextlib import contextmanager

import cv2
import geopandas as gpd
import numpy as np
import pytest
import shapely
import yaml

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


@contextmanager
def instead(path, text):
    """Another text in a file, for a while."""
    before = path.read_text()
    path.write_text(text)
    try:
        yield
    finally:
        path.write_text(before)


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
    with instead(path, path.read_text() + "seed: 3\n"):
        message = refused_by_snakemake(checkout)
    assert re.search(r"config/config.yaml, line \d+: .* key 'seed' is there twice", message)


def test_misspelt_setting_of_a_site(checkout):
    changed = TINY_SITE.replace("height_step_m", "hieght_step_m")
    with instead(checkout.folder / "config/sites/tiny.yaml", changed):
        message = refused_by_snakemake(checkout)
    assert "config/sites/tiny.yaml: settings: unknown key 'candidates.hieght_step_m'" in message
    assert "did you mean 'height_step_m'" in message


def test_no_such_cloud(checkout):
    with instead(checkout.folder / "config/sites/tiny.yaml", clouds_site("none.laz")):
        message = refused_by_snakemake(checkout)
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
    with instead(checkout.folder / "config/sites/tiny.yaml", clouds_site(cloud)):
        result = checkout.snakemake("--cores", "1", "results/tiny/scene/frame.json")
    output = result.stdout + result.stderr
    assert result.returncode != 0
    lines = [line for line in output.splitlines() if "roadsight: " in line]
    assert len({line.strip() for line in lines}) == 1, output
    assert f"site tiny: {cloud}" in lines[0]
    assert "Traceback" not in output
    assert not list((checkout.folder / "results/tiny").rglob("*.parquet"))


# Stages that know no better input.


@needs_data
def test_cloud_without_pavement(tmp_path, capsys):
    files = {name: str(tmp_path / file) for name, file in SCENE.items()}
    cloud, frame, profile = (("--" + n, files[n]) for n in ("cloud", "frame", "profile"))
    given = ["--site", "s", "--clouds", str(DATA / "clouds/autzen_trim.laz")]
    assert ingest_cloud.main([*given, *cloud, *frame]) == 0
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


def test_edges_outside_the_cloud(tmp_path, capsys):
    write_json(tmp_path / "frame.json", FRAME.to_dict())
    pavement = gpd.GeoDataFrame({"area_m2": [800.0]}, geometry=[shapely.box(0, 0, 100, 8)])
    write_layers(tmp_path / "pavement.gpkg", {"pavement": pavement}, FRAME)
    lines = [shapely.LineString(((0, 8), (100, 8))), shapely.LineString(((0, 90), (90, 90)))]
    table = gpd.GeoDataFrame({"edge": ["left", "far"]}, geometry=lines)
    write_layers(tmp_path / "digitised.gpkg", {"edges": table}, FRAME)
    (tmp_path / "edges.gpkg").write_text("old")
    files = {"frame": "frame.json", "pavement": "pavement.gpkg", "dem": "none.tif"}
    files |= {"digitised": "digitised.gpkg", "out": "edges.gpkg"}
    paths = [f"--{name}={tmp_path / file}" for name, file in files.items()]
    assert build_edges.main(["--site", "s", *paths]) == 2
    assert (tmp_path / "edges.gpkg").read_text() == "old"
    message = capsys.readouterr().err.splitlines()[-1]
    assert message.startswith("roadsight: ") and str(tmp_path / "digitised.gpkg") in message
    assert "edge 'far' lies outside the cloud's road" in message
    assert "found 82 m from the pavement" in message
    assert "allowed: at most 50 m" in message
    assert "placement.edges_crs" in message
