"""Runs of the levels of the pole job and of generated samples, on a finished lane with poles."""

import json
from collections.abc import Callable
from pathlib import Path

import cv2
import geopandas as gpd
import laspy
import numpy as np
import pandas as pd
from shapely import Polygon

from roadsight.config.schema import Settings
from roadsight.geometry.frames import Frame
from roadsight.io.images.image_shards import ImageShard
from roadsight.io.images.videologs import ImageSource
from roadsight.io.records.atomic import read_json, write_json
from roadsight.io.records.tables import read_table
from roadsight.io.vector.vectors import write_layers
from roadsight.stages.evidence.compare_components import PoleSettings
from tests.options.registry import Finished, Run, run_of
from tests.properties.poles_job import BASELINE, HALF_M, LENS, aside, place
from tests.unit.io.test_road_files import with_measures


@run_of("poles.road", "classes", "pavement")
def road_source(sites: Finished, level: str) -> None:
    """Road cells are those of the class, or those of a polygon."""
    job = sites.poles
    pavement = {}
    if level == "pavement":
        pavement = {"pavement": "pavement.gpkg"}
        _write_pavement(sites)
    source = {"classes": "class", "pavement": "pavement"}[level]
    outputs = {"voxels": f"voxels-{level}", "top": f"top-{level}.tif"}
    job.again("rasterise_lidar", "--road-source", source, **pavement, **outputs)
    _edges(sites, f"road-{level}", top=outputs["top"])


def _write_pavement(sites: Finished) -> None:

    from roadsight.geometry.frames import Frame
    from tests.properties.poles_job import HALF_M

    frame = Frame.from_dict(read_json(sites.poles.path("frame")))
    origin = sites.lane.xyz[:, :2].min(axis=0)
    y = np.arange(-39.0, 239.0, 2.0)
    ring = np.concatenate([place(y, -HALF_M), place(y, HALF_M)[::-1]]) - origin
    table = gpd.GeoDataFrame({"area_m2": [1.0]}, geometry=[Polygon(ring)])
    write_layers(sites.poles.path("pavement.gpkg"), {"pavement": table}, frame,
                 {"pavement": "MultiPolygon"})  # fmt: skip


@run_of("road_edges.method", "contours", "pixels", "curbs")
def road_edges_method(sites: Finished, level: str) -> None:
    files = {"cloud": "cloud", "frames": "frames"} if level == "curbs" else {}
    # The lane has no curb: then nothing may be taken for one.
    code = 2 if level == "curbs" else 0
    _edges(sites, level, "--method", level, code=code, **files)


def _edges(sites: Finished, name: str, *options: str, code: int = 0, **files: str) -> None:
    """Edges lie 3.6 m beside the middle of the lane."""
    outputs = {"edges": f"edges-{name}", "lines": f"lines-{name}.gpkg"}
    sites.poles.again("extract_road_edges", *options, code=code, **files, **outputs)
    if code == 0:
        xy = read_table(sites.poles.path(outputs["edges"]))[["x", "y"]].to_numpy()
        off = np.abs(np.abs(aside(*(xy + sites.lane.xyz[:, :2].min(axis=0)).T)) - HALF_M)
        assert len(xy) > 200 and np.median(off) < 0.3  # a voxel


@run_of("image_edges.borders", "all", "nearest")
def borders(sites: Finished, level: str) -> None:
    sites.poles.again("trace_image_edges", "--borders", level, out=f"borders-{level}")
    found = read_table(sites.poles.path(f"borders-{level}"))
    assert found["image"].nunique() == len(sites.lane.gps)


@run_of("poles.depth.kind", "inverse_depth", "depth")
def depth_kind(sites: Finished, level: str) -> None:
    """Images of depth are the reciprocal of what images of inverse depth hold."""
    job = sites.poles
    folder = Path(job.path(f"depth-images-{level}"))
    folder.mkdir(exist_ok=True)
    for file in sorted(Path(job.path("depth")).glob("*.png")):
        image = cv2.imread(str(file), cv2.IMREAD_UNCHANGED).astype(float)
        if level == "depth":
            image = np.where(image > 0, 2e5 / np.maximum(image, 1.0) + 1, 65535)
        cv2.imwrite(str(folder / file.name), np.clip(image, 0, 65535).astype(np.uint16))
    named = ("--source", str(folder), "--folder-kind", level)
    job.again("estimate_depth", *named, out=f"depth-{level}")
    made = ImageShard(job.path(f"depth-{level}"))
    name = made.names[0]
    low, high = (made.read(name)[rows].astype(float).mean() for rows in (-40, 260))
    assert low > high  # the road near the camera is nearer


@run_of("calibration.start", "edges", "landmarks")
def calibration_start(sites: Finished, level: str) -> None:
    _calibrated(sites, f"start-{level}", "--start", level)


@run_of("alignment.landmarks", "use", "skip")
def landmarks(sites: Finished, level: str) -> None:
    given = () if level == "use" else ("--pole-axes", "--columns")
    _calibrated(sites, f"landmarks-{level}", *given)


@run_of("alignment.ties", "use", "skip")
def ties(sites: Finished, level: str) -> None:
    _calibrated(sites, f"ties-{level}", *(() if level == "use" else ("--matches",)))


def _calibrated(sites: Finished, name: str, *options: str) -> None:
    sites.poles.again("calibrate_drive", *options, out=f"calibration-{name}")
    (drive,) = read_json(sites.poles.path(f"calibration-{name}"))["drives"]
    assert not drive["problem"]


@run_of("alignment.method", "auto", "road", "dense", "published", "none")
def alignment_method(sites: Finished, level: str) -> None:
    """Every image gets a pose or a reason; on this lane the road fixes the heading."""
    job = sites.poles
    dense: tuple[str, ...] = ()
    files: dict[str, str] = {}
    if level == "dense":
        lens = {"fx_px": LENS.focal_px, "cx_px": LENS.cx_px, "cy_px": LENS.cy_px}
        dense = ("--intrinsics", json.dumps(lens))
        files = {"cloud": "cloud", "photographs": "images", "masks": "masks0"}
    if level == "published":
        Path(job.path("baseline.json")).write_text(json.dumps(BASELINE))
        dense = ("--baseline", job.path("baseline.json"))
    calibration = f"calibration-{level}"
    job.again("calibrate_drive", "--method", level, *dense, **files, out=calibration)
    dense = () if level == "published" else dense
    job.again("align_cameras", "--method", level, *dense, **files, calibration=calibration,
              out=f"cameras-{level}")  # fmt: skip
    found = read_table(job.path(f"cameras-{level}"))
    assert len(found) == len(sites.lane.gps)
    assert (found["accepted"] == (found["reason"] == "")).all()
    if level in ("auto", "road", "published"):
        assert found["accepted"].mean() >= 0.5
        gap = (found["heading_deg"] - job.cameras["heading_deg"])[found["accepted"]]
        assert gap.abs().max() < 2.0


@run_of("sightings.kinds", "pole", "sign", "tree", "guardrail", "building", "headwall")
def kinds(sites: Finished, level: str) -> None:
    job = sites.poles
    objects: dict[str, str] = {}
    if level not in ("pole", "sign"):
        job._stage("find_roadside_objects", "--kinds", level, cloud="cloud", frame="frame",
                   dem="dem.tif", out="objects")  # fmt: skip
        objects = {"objects": "objects", "seen": "seen"}
    found = _measured(sites, f"kind-{level}", "--kinds", level, **objects)
    assert len(found) > 0 if level == "pole" else set(found["kind"]) <= {level}


@run_of("sightings.bearing", "fused", "image", "lidar")
def bearing(sites: Finished, level: str) -> None:
    voxels = {"voxels": "voxels"} if level == "lidar" else {}
    found = _measured(sites, f"bearing-{level}", "--bearing", level, **voxels)
    usual = read_table(sites.poles.path("sightings0"))
    both = usual.merge(found, on=["image", "u_foot", "v_foot"])
    turned = (both["bearing_deg_x"] - both["bearing_deg_y"] + 180) % 360 - 180
    assert len(both) == len(usual) and turned.abs().median() < 1.0


@run_of("sightings.height_rule", "metric", "published", "none")
def height_rule(sites: Finished, level: str) -> None:
    assert len(_measured(sites, f"rule-{level}", "--height-rule", level)) > 0


@run_of("sightings.mask_rule", "axes", "published")
def mask_rule(sites: Finished, level: str) -> None:
    assert len(_measured(sites, f"masks-{level}", "--mask-rule", level)) > 0


@run_of("sightings.distance", "fused", "published")
def distance(sites: Finished, level: str) -> None:
    assert len(_measured(sites, f"distance-{level}", "--distance", level)) > 0


@run_of("sightings.side_views", "found", "given", "stitched")
def side_views(sites: Finished, level: str) -> None:
    assert len(_measured(sites, f"side-{level}", "--side-views", level)) > 0


def _measured(sites: Finished, name: str, *options: str, **files: str) -> pd.DataFrame:
    """Sightings, with depths and bearings wherever they are kept."""
    sites.poles.again("measure_poles", *options, **files, out=f"sightings-{name}")
    found = read_table(sites.poles.path(f"sightings-{name}"))
    kept = found[found["kept"].astype(bool)]
    assert kept["depth_m"].between(1, 100).all()
    assert kept["bearing_deg"].between(0, 360).all()
    return found


@run_of("triangulation.method", "packing", "sweep")
def triangulation_method(sites: Finished, level: str) -> None:
    outputs = {
        "poles": f"poles-{level}", "layers": f"poles-{level}.gpkg",
        "csv": f"poles-{level}.csv", "geojson": f"poles-{level}.geojson",
    }  # fmt: skip
    job = sites.poles
    # Each pole of the lane is in sight of two images within 60 m, few within the published 25.
    job.again("triangulate_poles", "--method", level, "--sweep-distance-m", "60", **outputs)
    table = read_table(job.path(outputs["poles"]))
    xy = table[table["kept"].astype(bool)][["x", "y"]].to_numpy()
    true = sites.lane.poles - sites.lane.xyz[:, :2].min(axis=0)
    gaps = np.hypot(*(xy[:, None] - true).transpose(2, 0, 1)).min(axis=1)
    assert len(xy) >= 2 and np.median(gaps) < 1.0, gaps


@run_of("validation.components", "skip", "compare")
def components(sites: Finished, level: str) -> None:
    """`skip` has no stage; `compare` says what each component is worth."""
    if level == "skip":
        return
    job = sites.poles
    table = pd.DataFrame(
        np.add(sites.lane.poles, [sites.lane.east_m, 4_000_000.0]), columns=["x", "y"]
    )
    table.assign(id=range(len(table))).to_csv(job.path("truth.csv"), index=False)
    parts = Settings().model_dump(include=set(PoleSettings.model_fields))
    settings = PoleSettings.model_validate(parts)
    job._stage("compare_components", "--settings", settings.model_dump_json(),
               "--truth-crs", "EPSG:32617", frames="frames", image_edges="edges0", masks="masks0",
               depth="depth0", road_edges="road_edges", columns="columns", voxels="voxels",
               dem="dem.tif", frame="frame", truth="truth.csv", pole_axes="axes0",
               matches="matches0", terrain="terrain.npz", out="components")  # fmt: skip
    assert len(read_json(job.path("components"))) > 0


def _rated(sites: Finished, name: str, *options: str, **files: str) -> pd.DataFrame:
    outputs = {"out": f"hazard-{name}", "csv": f"hazard-{name}.csv"}
    sites.poles._stage("rate_hazard", *options, poles="poles", frame="frame", frames="frames",
                       edges="road_edges", dem="dem.tif", cloud="cloud", ground="ground",
                       **files, **outputs)  # fmt: skip
    found = read_table(sites.poles.path(outputs["out"]))
    kept = read_table(sites.poles.path("poles"))["kept"].astype(bool).sum()
    assert len(found) == kept
    return found


@run_of("roads.traffic", "right", "left")
def traffic(sites: Finished, level: str) -> None:
    _rated(sites, f"traffic-{level}", "--traffic", level)


@run_of("roads.carriageway", "two-way", "divided", "one-way")
def carriageway(sites: Finished, level: str) -> None:
    _rated(sites, f"carriageway-{level}", "--carriageway", level)


@run_of("roads.measure_unit", "m", "km", "ft", "usft", "mi", "usmi")
def measure_unit(sites: Finished, level: str) -> None:
    """The inventory's speed reaches the poles, whatever its measures are counted in."""
    unit_m = {"m": 1.0, "km": 1000.0, "ft": 0.3048, "usft": 1200 / 3937, "mi": 1609.344}
    whole = 500.0 / unit_m.get(level, 5280 * 1200 / 3937)
    job = sites.poles
    east = sites.lane.east_m
    line = np.array([[east, 3_999_900.0, 0.0], [east, 4_000_400.0, whole]])
    frame = Frame((0.0, 0.0, 0.0))
    with_measures(job.path(f"routes-{level}.gpkg"), line, many=False, frame=frame, epsg=32617)
    row = {"route": "SR 7", "from_m": 0.0, "to_m": 500.0, "aadt": 4321}
    pd.DataFrame([row]).to_csv(job.path(f"inventory-{level}.csv"), index=False)
    named = ("--measure-unit", level)
    found = _rated(sites, f"unit-{level}", *named, routes=f"routes-{level}.gpkg",
                   inventory=f"inventory-{level}.csv")  # fmt: skip
    assert (found["aadt_least"] == 4321).all()
    measured = found["station_m" if level == "m" else f"measure_{level}"]
    north = found["y"] + sites.lane.xyz[:, 1].min() + 100.0
    assert np.abs(measured * 500.0 / whole - north).max() < 1.0


@run_of("pictures.blur", "True", "False")
def blur(sites: Finished, level: str) -> None:
    job = sites.poles
    write_json(job.path("summary"), {"site": "lane", "poles": {}, "warnings": []})
    shown = ("--site", "lane", "--images", job.path("images"), "--blur", level)
    job._stage("write_poles_page", *shown, summary="summary", frame="frame", top="top.tif",
               road_edges="road_edges",
               frames="frames", poles="poles", cameras="cameras0", image_edges="edges0",
               sightings="sightings0", masks="masks0", depth="depth0", dem="dem.tif",
               out=f"page-{level}", pictures=f"pictures-{level}")  # fmt: skip
    assert read_json(job.path(f"page-{level}"))["counts"]["images"] == len(sites.lane.gps)


@run_of("sample.scene", "highway", "rural")
def scene(sites: Finished, level: str) -> None:
    _highway(sites, "scene") if level == "highway" else _rural(sites, "scene")


@run_of("sample.class_scheme", "usual", "none", "unclassified", "lines", "plants")
def class_scheme(sites: Finished, level: str) -> None:
    """Plants are those of the highway; the others are classes of a rural survey."""
    if level == "plants":
        _highway(sites, level, "--class-scheme", level)
        cloud = sites.street.path(f"{level}.laz")
    else:
        _rural(sites, level, "--class-scheme", level)
        cloud = sites.poles.path(f"{level}.laz")
    classes = np.unique(np.asarray(laspy.read(cloud).classification))
    assert (len(classes) == 1) == (level in ("none", "unclassified"))


def _highway(sites: Finished, name: str, *options: str) -> None:
    """Cloud and edges of a generated highway."""
    job = sites.street
    small = ("--points", "60000", "--length-m", "40")
    job._stage("generate_sample", *small, *options, cloud=f"{name}.laz", truth=f"{name}.gpkg",
               edges=f"{name}.geojson")  # fmt: skip
    cloud = laspy.read(job.path(f"{name}.laz"))
    assert 40_000 < len(cloud.points) < 90_000
    assert len(gpd.read_file(job.path(f"{name}.geojson"))) >= 2


@run_of("sample.car_parks", "True", "False")
def car_parks(sites: Finished, level: str) -> None:
    _rural(sites, f"parks-{level}", "--car-parks", level)
    truth = gpd.read_file(sites.poles.path(f"parks-{level}.gpkg"), layer="driveways")
    assert ("car park" in set(truth["kind"])) == (level == "True")


@run_of("sample.side_views", "True", "False")
def sample_side_views(sites: Finished, level: str) -> None:
    """Shots have side views or none; rendered for the first place."""
    table = _rural(sites, f"views-{level}", "--side-views", level)
    assert table["left_image"].notna().any() == (level == "True")
    job = sites.poles
    job._stage("render_videolog", "--length-m", "120", "--side-views", level, "--shard", "0",
               "--shards", "60", images=f"views-{level}.zip")  # fmt: skip
    names = ImageSource(job.path(f"views-{level}.zip")).names()
    assert len(names) % (3 if level == "True" else 1) == 0


def _rural(sites: Finished, name: str, *options: str) -> pd.DataFrame:
    """Videolog of a generated road."""
    job = sites.poles
    small = ("--length-m", "120", "--pulses-per-m2", "4")
    job._stage("generate_rural", *small, *options, cloud=f"{name}.laz", truth=f"{name}.gpkg",
               poles=f"{name}-poles.csv", videolog=f"{name}-log.csv",
               cameras=f"{name}-cameras.csv", baseline=f"{name}-baseline.json")  # fmt: skip
    assert len(laspy.read(job.path(f"{name}.laz")).points) > 5000
    table = pd.read_csv(job.path(f"{name}-log.csv"))
    assert len(table) >= 10
    return table


def _with_option(make: Callable[..., object], option: str) -> Run:
    """Run that generates a scene at a level of one option."""

    def run(sites: Finished, level: str) -> None:
        make(sites, f"{option}-{level}", f"--{option.replace('_', '-')}", level)

    return run


for _option in ("tunnel", "overhead"):
    run_of(f"sample.{_option}", "True", "False")(_with_option(_highway, _option))
for _option in ("flush_verges", "pole_returns"):
    run_of(f"sample.{_option}", "True", "False")(_with_option(_rural, _option))
run_of("sample.scanned_from", "vehicle", "air")(_with_option(_highway, "scanned_from"))
