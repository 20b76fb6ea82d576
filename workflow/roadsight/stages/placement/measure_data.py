"""What the sensors of a plan share along the road, and the data that they make."""

from __future__ import annotations

import argparse
import logging
import sys
from typing import Any

import geopandas as gpd
import numpy as np
import pandas as pd
import shapely
from numpy.typing import NDArray

from roadsight.base.arrays import Bools, Floats
from roadsight.base.options import add_settings
from roadsight.config.sections.sensing import Lidar
from roadsight.geometry.frames import Frame
from roadsight.io.cloud.clouds import read_laz
from roadsight.io.records.atomic import read_json, write_json
from roadsight.io.records.detections import read_detections
from roadsight.io.records.tables import read_about
from roadsight.io.vector.vectors import read_layer, write_layers
from roadsight.placement.plans.handover import (
    data_rates,
    frames_per_s,
    handover,
    overlaps,
    stations_m,
)
from roadsight.placement.plans.margins import distances_m, margins, ranges_m
from roadsight.placement.sensors.sensors import load_sensors
from roadsight.placement.sight.heights import height_columns, heights_of_plan
from roadsight.placement.sight.probability import (
    CAMERA_CURVE,
    LIDAR_CURVE,
    Curve,
    Curves,
    found_by_plan,
)
from roadsight.scene.pavement.outline import inside
from roadsight.stages.command import run_stage
from roadsight.stages.placement.shared.chosen_points import points_by_height
from roadsight.stages.placement.shared.detection_inputs import (
    add_sight_arguments,
    read_shaped_targets,
    sight_of,
)

log = logging.getLogger("measure_data")


def measure_data(arguments: argparse.Namespace) -> None:
    """Write figures of the plan and of each sensor, and these as a layer."""
    frame = Frame.from_dict(read_json(arguments.frame))
    chosen = pd.DataFrame(
        read_json(arguments.solution)["sensors"], columns=["candidate", "sensor", "x", "y", "z"]
    )
    targets, feet_m, shape = read_shaped_targets(arguments)
    on_targets = points_by_height(arguments, chosen, feet_m, shape)
    hits = _hits(arguments.detections, chosen, targets["target"])
    seen = hits > 0
    times_seen = seen.sum(axis=0, dtype=np.int64)
    lost, if_dark, if_shorter = _margins(arguments, chosen, seen, feet_m, shape.height_m)
    edges = list(read_layer(arguments.edges, "edges", frame).geometry)
    along = stations_m(edges, targets[["x", "y"]].to_numpy(np.float64))
    at = stations_m(edges, chosen[["x", "y"]].to_numpy(np.float64))
    cell_m = float(read_about(arguments.targets)["cell_size_m"])
    pairs = overlaps(seen, along, at, cell_m)
    table = chosen.assign(along_road_m=at, **_rates(arguments, frame, chosen))
    for pair in pairs:
        table.loc[pair["sensor"], "overlap_with_next_m"] = pair["length_m"]
    totals = {
        name: float(table[name].sum())
        for name in ("points_per_s", "pixels_per_s", "road_points_per_s")
    }
    shared = float(np.mean([pair["length_m"] for pair in pairs])) if pairs else None
    content = {
        **handover(times_seen),
        "margins": lost,
        "probability": _probability(arguments, chosen, hits),
        "heights": heights_of_plan(on_targets, times_seen > 0, shape.height_m),
        "mean_overlap_m": shared,
        "overlaps": [_named(pair, chosen) for pair in pairs],
        **totals,
        "sensors": table.drop(columns=["x", "y", "z"])
        .astype(object)
        .where(table.drop(columns=["x", "y", "z"]).notna(), None)
        .to_dict("records"),
    }
    write_json(arguments.out, content)
    points = gpd.points_from_xy(table["x"], table["y"], table["z"])
    layer = gpd.GeoDataFrame(table.drop(columns=["x", "y", "z"]), geometry=points)
    feet = gpd.GeoDataFrame(
        {
            "target": targets["target"].astype(str),
            "sensors": times_seen,
            "seen_dark": if_dark.astype(np.int32),
            "seen_shorter": if_shorter.astype(np.int32),
        }
        | dict(height_columns(on_targets)),
        geometry=gpd.points_from_xy(*feet_m[:, :3].T),
    )
    write_layers(arguments.layers, {"sensors": layer, "targets": feet}, frame)
    log.info(
        "%.0f points a second, %.0f on the road",
        totals["points_per_s"],
        totals["road_points_per_s"],
    )


def _margins(
    arguments: argparse.Namespace,
    chosen: pd.DataFrame,
    seen: Bools,
    feet_m: Floats,
    height_m: float,
) -> tuple[dict[str, Any], Bools, Bools]:
    """What dark targets and a third less range would lose, from the plan's own detections."""
    sensors = load_sensors(arguments.sensors)
    kinds = [sensors[name] for name in chosen["sensor"]]
    names = zip(chosen["sensor"], kinds, strict=True)
    reach_m = [sight_of(arguments, name, kind).max_range_m for name, kind in names]
    places = chosen[["x", "y", "z"]].to_numpy(np.float64).reshape(-1, 3)
    return margins(seen, distances_m(places, feet_m, height_m), *ranges_m(kinds, reach_m))


def _hits(paths: list[str], chosen: pd.DataFrame, targets: pd.Series) -> NDArray[np.uint16]:
    """What each chosen sensor measures of the targets that it sees, (sensors, targets); else 0."""
    detections = read_detections(paths)
    keys = pd.MultiIndex.from_frame(chosen[["sensor", "candidate"]].astype(str))
    rows = keys.get_indexer(
        pd.MultiIndex.from_frame(detections[["sensor", "candidate"]].astype(str))
    )
    used = rows >= 0
    columns = pd.Index(targets.astype(str)).get_indexer(
        pd.Index(detections["target"][used].astype(str))
    )
    hits = np.zeros((len(chosen), len(targets)), np.uint16)
    hits[rows[used], columns] = detections["hits"][used]
    return hits


def _probability(
    arguments: argparse.Namespace, chosen: pd.DataFrame, hits: NDArray[np.uint16]
) -> dict[str, Any] | None:
    """How likely the targets are found by what their sensors measure, and by which curves."""
    curves = Curves(Curve(*arguments.lidar_curve), Curve(*arguments.camera_curve))
    sensors = load_sensors(arguments.sensors)
    found = found_by_plan(hits, [curves.of(sensors[name]) for name in chosen["sensor"]])
    said = {"lidar": arguments.lidar_curve, "camera": arguments.camera_curve}
    return None if found is None else found | {"curves": said}


def _rates(arguments: argparse.Namespace, frame: Frame, chosen: pd.DataFrame) -> dict[str, Floats]:
    """Points and pixels a second of each sensor, and its points on the road."""
    sensors = load_sensors(arguments.sensors)
    kinds = [sensors[name] for name in chosen["sensor"]]
    rates = [data_rates(kind, arguments.frames_hz) for kind in kinds]
    scans = np.array([frames_per_s(kind, arguments.frames_hz) for kind in kinds])
    return {
        "points_per_s": np.array([rate.get("points_per_s", 0.0) for rate in rates]),
        "pixels_per_s": np.array([rate.get("pixels_per_s", 0.0) for rate in rates]),
        "road_points_per_s": scans * _on_road(arguments, frame, len(chosen)),
    }


def _on_road(arguments: argparse.Namespace, frame: Frame, count: int) -> Floats:
    """Returns of one simulated scan of each sensor within the pavement's outline."""
    if not count:
        return np.zeros(0)
    parts = read_layer(arguments.pavement, "pavement", frame).geometry.to_numpy()
    outline = shapely.multipolygons(shapely.get_parts(parts))
    scan = read_laz(arguments.scans)
    xyz_m = frame.to_local(scan.xyz)
    number = scan.dims["point_source_id"].astype(np.int64) - 1
    on_road = inside(outline, xyz_m[:, 0], xyz_m[:, 1])
    return np.bincount(number[on_road], minlength=count).astype(np.float64)


def _named(pair: dict[str, Any], chosen: pd.DataFrame) -> dict[str, Any]:
    names = chosen["candidate"]
    return pair | {"sensor": str(names[pair["sensor"]]), "next": str(names[pair["next"]])}


def main(argv: list[str] | None = None) -> int:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    names = ("solution", "targets", "edges", "pavement", "frame", "sensors", "scans")
    for name in (*names, "out", "layers"):
        parser.add_argument(f"--{name}", required=True)
    for name in ("detections", "depth", "candidates"):
        parser.add_argument(f"--{name}", nargs="+", required=True)
    add_settings(parser, Lidar, "azimuth_stride", "frames_hz")
    add_sight_arguments(parser)
    for name, curve in (("lidar", LIDAR_CURVE), ("camera", CAMERA_CURVE)):
        parser.add_argument(f"--{name}-curve", type=float, nargs=2, default=curve)
    return run_stage(parser, measure_data, argv)


if __name__ == "__main__":
    sys.exit(main())
