"""Runs of the levels of the scene and the placement, on a finished street of 48 m."""

import json

import geopandas as gpd
import laspy
import numpy as np
import pytest

from roadsight.base.sections.sensing import Targets
from roadsight.config.load import ResolvedSite, load_config, resolve_site
from roadsight.io.cloud.tiles import CloudTiles
from roadsight.io.records.atomic import read_json
from roadsight.io.records.depth_maps import DepthMaps
from roadsight.io.records.placement_tables import read_detections
from roadsight.io.records.scene_tables import read_surfels
from roadsight.io.records.tables import read_about, read_table, write_table
from roadsight.placement.sensors.sensors import panorama_name
from roadsight.placement.sight.kinds import Box, shape_of
from tests.conftest import PROJECT
from tests.helpers.engines import needs_open3d
from tests.options.registry import Finished, run_of
from tests.properties.placement_job import SENSORS

NETWORK = str(PROJECT / "resources/models/depth_unet.onnx")
ROAD_M2 = 48.0 * 8.0


def with_engine(level: str) -> None:
    if level == "open3d":
        needs_open3d()


@run_of("scene.overlap", "use", "leave_out")
def overlap(sites: Finished, level: str) -> None:
    name = f"overlap-{level}"
    sites.street.again("ingest_cloud", "--overlap", level, cloud=name, frame=f"{name}-frame")
    whole = CloudTiles(sites.street.path("cloud")).points
    assert CloudTiles(sites.street.path(name)).points == whole  # none is of an overlap


@run_of("units", "auto", "metre", "foot", "us-survey-foot")
def units(sites: Finished, level: str) -> None:
    _ingested(sites, "units", level)


@run_of("vertical_units", "auto", "metre", "foot", "us-survey-foot")
def vertical_units(sites: Finished, level: str) -> None:
    _ingested(sites, "vertical-units", level)


def _ingested(sites: Finished, option: str, level: str) -> None:
    """The unit is the stated one; `auto` takes that of the CRS."""
    name = f"{option}-{level}"
    auto = level == "auto"
    options = ("--crs", "EPSG:32617+5703" if auto else "local", f"--{option}", level)
    job = sites.poles if auto else sites.street
    job.again("ingest_cloud", *options, cloud=name, frame=f"{name}-frame")
    unit_m = {"auto": 1.0, "metre": 1.0, "foot": 0.3048, "us-survey-foot": 1200 / 3937}[level]
    field = "unit_m" if option == "units" else "vertical_unit_m"
    assert read_json(job.path(f"{name}-frame"))[field] == pytest.approx(unit_m, rel=1e-12)


@run_of("ground.method", "robust", "pillars")
def ground_method(sites: Finished, level: str) -> None:
    """Both find the road; the van on it is off-ground."""
    name = f"ground-{level}"
    sites.street.again("build_dem", "--method", level, dem=f"{name}.tif", ground=name)
    usual, found = (read_table(sites.street.path(one))["ground"] for one in ("ground", name))
    assert (usual == found).mean() > 0.9


@run_of("pavement.thinning", "columns", "voxels")
def thinning(sites: Finished, level: str) -> None:
    clusters = f"clusters-{level}"
    sites.street.again("cluster_fpfh", "--thinning", level, out=clusters)
    _pavement(sites, f"thinning-{level}", "--method", "published", clusters=clusters)


@run_of("pavement.method", "auto", "surface", "published")
def pavement_method(sites: Finished, level: str) -> None:
    _pavement(sites, level, "--method", level)


@run_of("pavement.cluster_engine", "own", "open3d")
def cluster_engine(sites: Finished, level: str) -> None:
    with_engine(level)
    _pavement(sites, f"engine-{level}", "--method", "published", "--cluster-engine", level)


@run_of("pavement.fpfh_engine", "own", "open3d")
def fpfh_engine(sites: Finished, level: str) -> None:
    with_engine(level)
    clusters = f"clusters-{level}"
    sites.street.again("cluster_fpfh", "--fpfh-engine", level, out=clusters)
    _pavement(sites, f"fpfh-{level}", "--method", "published", clusters=clusters)


@run_of("pavement.intensity", "auto", "use", "ignore")
def intensity(sites: Finished, level: str) -> None:
    clusters = f"clusters-{level}"
    sites.street.again("cluster_fpfh", "--intensity", level, out=clusters)
    named = ("--method", "published", "--intensity", level)
    _pavement(sites, f"intensity-{level}", *named, clusters=clusters)


def _pavement(sites: Finished, name: str, *options: str, **files: str) -> None:
    """The road's area, to a seventh: verges are not road, and the road is not lost."""
    outputs = {"pavement": f"pavement-{name}.gpkg", "points": f"points-{name}"}
    sites.street.again("extract_pavement", *options, **files, **outputs)
    found = gpd.read_file(sites.street.path(outputs["pavement"])).area.sum()
    assert found == pytest.approx(ROAD_M2, rel=0.15)


@run_of("targets.min_points", "local")
def min_points(sites: Finished, level: str) -> None:
    _targets(sites, "--min-points", level)


@run_of("targets.inset_m", "local")
def inset(sites: Finished, level: str) -> None:
    _targets(sites, "--inset-m", level)


def _targets(sites: Finished, option: str, level: str) -> None:
    name = f"targets{option}"
    sites.street.again("place_targets", option, level, out=name)
    usual = read_table(sites.street.path("targets"))
    found = read_table(sites.street.path(name))
    assert 0.5 * len(usual) < len(found) < 1.5 * len(usual)
    assert found["z"].between(usual["z"].min() - 0.1, usual["z"].max() + 0.1).all()


@run_of("targets.kind", "cylinder", "pedestrian", "car", "truck", "deer", "box")
def target_kind(sites: Finished, level: str) -> None:
    size = {"length_m": 4.0, "width_m": 1.6} if level == "box" else {}
    shape = shape_of(Targets(kind=level, **size).model_dump())
    box = isinstance(shape, Box)
    size_m = (
        ("--box", *map(str, (shape.length_m, shape.width_m, shape.height_m)))
        if box
        else ("--radius-m", str(shape.radius_m), "--height-m", str(shape.height_m))
    )
    targets = {}
    if box:
        # A vehicle is a target that points along the road.
        targets = {"targets": f"targets-{level}"}
        sites.street.again("place_targets", *size_m, edges="edges.gpkg", out=targets["targets"])
    _seen(sites, f"kind-{level}", *size_m, **targets)


def _seen(sites: Finished, name: str, *options: str, **files: str) -> None:
    """Targets are seen from all candidates together, and none by more beams than there are."""
    sites.street.again("build_detection_shard", *options, **files, out=f"seen-{name}")
    found = read_detections([sites.street.path(f"seen-{name}")])
    assert found["target"].nunique() > 0.5 * len(read_table(sites.street.path("targets")))
    assert found["hits"].min() > 8


@run_of("lidar.model", "surfel", "hybrid", "preliminary", "unet", "unet_mask")
def lidar_model(sites: Finished, level: str) -> None:
    network = ("--network", NETWORK) if level.startswith("unet") else ()
    few = _few_candidates(sites)
    sites.street.again(
        "render_depth_maps", "--model", level, *network, candidates=few, out=f"depth-{level}"
    )
    maps, usual = (_maps(sites, name) for name in (f"depth-{level}", "depth0"))
    # A preliminary map returns the nearest point of each cell: 0.27 and 0.53 m off here, and short.
    most_m = 0.6 if level == "preliminary" else 0.5
    for name, range_m in maps.items():
        both = (range_m > 0) & (usual[name] > 0)
        assert both.sum() > 0.5 * (usual[name] > 0).sum()
        apart_m = (range_m - usual[name])[both]
        assert np.median(np.abs(apart_m)) < most_m
        nearer = (apart_m <= 0.1).mean()
        assert level != "preliminary" or nearer > 0.7, nearer


def _few_candidates(sites: Finished, count: int = 2) -> str:
    """A table of a few candidates: the usual maps take a third of the time of the whole test."""
    path = sites.street.path("candidates")
    write_table(sites.street.path("few"), read_table(path).iloc[:count], read_about(path))
    return "few"


def _maps(sites: Finished, name: str) -> dict[str, np.ndarray]:
    return dict(DepthMaps(sites.street.path(name)))


@run_of("lidar.engine", "own", "open3d")
def ray_engine(sites: Finished, level: str) -> None:
    with_engine(level)
    few = _few_candidates(sites)
    sites.street.again("render_depth_maps", "--engine", level, candidates=few, out=f"depth-{level}")
    for name, range_m in _maps(sites, f"depth-{level}").items():
        assert np.mean(np.abs(range_m - _maps(sites, "depth0")[name]) > 0.01) < 1e-3


@run_of("lidar.mounting", "levelled", "normal")
def mounting_of_lidar(sites: Finished, level: str) -> None:
    few = _few_candidates(sites)
    sites.street._stage("tilt_mounts", "--mounting", level, candidates=few, dem="dem.tif",
                        frame="frame", out="tilts")  # fmt: skip
    sites.street.again("render_depth_maps", candidates=few, tilts="tilts", out="depth-tilted")
    usual = _maps(sites, "depth0")
    for name, range_m in _maps(sites, "depth-tilted").items():
        assert (range_m > 0).sum() == pytest.approx((usual[name] > 0).sum(), rel=0.3)


@run_of("lidar.outlier_engine", "own", "open3d")
def outlier_engine(sites: Finished, level: str) -> None:
    with_engine(level)
    _surfels(sites, "--outlier-radius-m", "0.5", "--outlier-engine", level)


@run_of("lidar.vegetation", "keep", "leave_out")
def vegetation(sites: Finished, level: str) -> None:
    """Without the bushes there are fewer surfels."""
    job = sites.street
    cloud = laspy.read(job.path("cloud.laz"))
    cloud.classification = np.where(np.abs(cloud.y) > 9.0, 5, 1).astype(np.uint8)
    cloud.write(job.path("green.laz"))
    local = ("--site", "street", "--crs", "local", "--units", "metre", "--vertical-units", "metre")
    named = (*local, "--clouds", job.path("green.laz"))
    assert job._run("ingest_cloud", named, {"cloud": "green", "frame": "green-frame"}) == 0
    usual, found = _surfels(sites, "--vegetation", level, cloud="green")
    assert (found < 0.9 * usual) == (level == "leave_out")


def _surfels(sites: Finished, *options: str, **files: str) -> tuple[int, int]:
    """How many surfels there usually are, and are now: most of them, and none more."""
    sites.street.again("build_surfels", *options, **files, out="surfels-again")
    names = ("surfels", "surfels-again")
    usual, found = (len(read_surfels(sites.street.path(name))) for name in names)
    assert 0.5 * usual < found <= usual
    return usual, found


@run_of("mounting.unshielded", "cost", "forbid")
def unshielded(sites: Finished, level: str) -> None:
    _mounted(sites, "unshielded", level)


@run_of("mounting.median", "allow", "forbid")
def median(sites: Finished, level: str) -> None:
    _mounted(sites, "median", level)


def _mounted(sites: Finished, field: str, level: str) -> None:
    _solved(sites, "--mounting", json.dumps({field: level}))


def _solved(sites: Finished, *options: str, code: int = 0, **files: str) -> dict:
    outputs = {"solution": "again", "layers": "again.gpkg", "timing": "again-timing"}
    sites.street.again("solve_cover", *options, code=code, **outputs, **files)
    found = {} if code else read_json(sites.street.path("again"))
    if found:
        assert found["status"] == "optimal"
        assert found["covered_targets"] <= found["targets"]
        assert 1 <= len(found["sensors"]) <= sites.street.solution["objective"] + 3
    return found


@run_of("coverage.uncoverable", "error", "exclude")
def uncoverable(sites: Finished, level: str) -> None:
    lost = sites.street.solution["uncoverable_targets"]
    refused = level == "error" and bool(lost)
    _solved(sites, "--uncoverable", level, code=2 if refused else 0)


@run_of("cover.second_objective", "True", "False")
def second_objective(sites: Finished, level: str) -> None:
    found = _solved(sites, "--second-objective", level)
    assert found["objective"] == sites.street.solution["objective"]
    assert ("second" in found) == (level == "True")


@run_of("cover.solver", "own", "highs")
def solver(sites: Finished, level: str) -> None:
    found = _solved(sites, "--solver", level)
    assert found["objective"] == sites.street.solution["objective"]
    assert found["solver"] == level


@run_of("cover.verify", "none", "highs")
def verify(sites: Finished, level: str) -> None:
    found = _solved(sites, "--verify", level)
    assert ("verified" in found) == (level == "highs")


@run_of("obstacles.method", "sight_lines", "cells")
def obstacles_method(sites: Finished, level: str) -> None:
    """What hides targets stands where the scene has points."""
    job, name = sites.street, f"obstacles-{level}.gpkg"
    seen = ("--detections", job.path("seen0"), "--sensors", SENSORS, "--plan", "one")
    cells = ("--depth", job.path("depth0")) if level == "cells" else ()
    files = {"cloud": "cloud"} if level == "cells" else {}
    job._stage("find_obstacles", *seen, *cells, "--method", level, "--candidates",
               job.path("candidates"), solution="solution", coverage="coverage",
               targets="targets", surfels="surfels", dem="dem.tif", frame="frame", out=name,
               **files)  # fmt: skip
    found = gpd.read_file(job.path(name), layer="obstacles")
    assert len(found) > 0 and found["height_m"].between(-1.0, 12.0).all()


@run_of("plan.robust", "tolerance")
def robust(sites: Finished, level: str) -> None:
    options = json.dumps({"robust": level})
    named = ("--options", options, "--robust", "--sensors-file", SENSORS)
    found = _solved(sites, *named, surfels="surfels")
    assert found["objective"] >= sites.street.solution["objective"]


@run_of("plan.alternatives", "True", "False")
def alternatives(sites: Finished, level: str) -> None:
    options = json.dumps({"alternatives": True}) if level == "True" else ""
    found = _solved(sites, "--options", options)
    assert ("alternatives" in found.get("options", {})) == (level == "True")


@run_of("plan.on_request", "True", "False")
def on_request(sites: Finished, level: str) -> None:
    """What is solved only where it is asked for is not among a site's plans."""
    own = {"mine": {"title": "Mine", "sensors": ["OS-32"], "on_request": level == "True"}}
    found = _site({"placement": {"own_plans": own}})
    assert ("mine" in found.plans) == (level == "False")


@run_of("sensor", "spinning", "rosette", "camera", "radar")
def kind_of_sensor(sites: Finished, level: str) -> None:
    name = {"spinning": "OS-32", "rosette": "Avia", "camera": "camera-8mp", "radar": "radar-77ghz"}
    few = _few_candidates(sites)
    panorama = panorama_name(0.5, 100)
    sites.street.again("render_depth_maps", "--panorama", "--sensor", panorama, candidates=few,
                       out="panorama")  # fmt: skip
    angles = ("--yaw-deg", "-60", "0", "60", "--pitch-deg", "-20", "-5", "--roll-deg", "0")
    pixels = ("--min-pixels", "20") if level == "camera" else ()
    job = sites.street
    job._stage("detect_poses", "--sensor", name[level], "--sensors", SENSORS, *angles, *pixels,
               depth="panorama", candidates=few, targets="targets", out="poses")  # fmt: skip
    assert len(read_detections([job.path("poses")])) > 0


@run_of("jobs", "scene", "placement", "poles")
def jobs(sites: Finished, level: str) -> None:
    """A site may ask for each; what its rules then make is what tests/workflow runs."""
    masks = [{"labels": "m", "map": "labels.yaml"}]
    views = {"videolog": "v.csv", "images": "i", "masks": masks, "depth": {"images": "d"}}
    found = _site({"jobs": [level]} | ({"poles": views} if level == "poles" else {}))
    assert found.site.jobs == [level]


def _site(content: dict) -> ResolvedSite:
    named = {"site": "s", "title": "S", "clouds": ["c.laz"], "jobs": ["placement"]} | content
    file = PROJECT / "config/sites/s.yaml"
    return resolve_site(named, file, load_config({"sites": ["s"]}))
