"""What the sensors of a plan share along the road, and the data that they make."""

from __future__ import annotations

import logging
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import geopandas as gpd
import numpy as np
import pandas as pd
import shapely
from numpy.typing import NDArray

from roadsight.base.arrays import Bools, Floats
from roadsight.base.sections.sensing import Lidar, Targets
from roadsight.geometry.areas import inside
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
    Curve,
    Curves,
    found_by_plan,
)
from roadsight.stages.command import Command
from roadsight.stages.placement.shared.chosen_points import MeasuringFiles, points_by_height
from roadsight.stages.placement.shared.detection_inputs import (
    read_shaped_targets,
    sight_of,
)

log = logging.getLogger("measure_data")


@dataclass(frozen=True, kw_only=True)
class PlanDataFiles(MeasuringFiles):
    """A plan and what its sensors measure."""

    solution: Path
    edges: Path
    pavement: Path
    frame: Path
    scans: Path
    detections: Sequence[Path]
    frames_hz: Annotated[float, Lidar]
    lidar_curve: Annotated[Sequence[float], Targets]
    camera_curve: Annotated[Sequence[float], Targets]


def measure_data(given: PlanDataFiles, *, out: Path, layers: Path) -> None:
    """Write figures of the plan and of each sensor, and these as a layer."""
    frame = Frame.from_dict(read_json(given.frame))
    chosen = pd.DataFrame(
        read_json(given.solution)["sensors"], columns=["candidate", "sensor", "x", "y", "z"]
    )
    targets, feet_m, shape = read_shaped_targets(given)
    on_targets = points_by_height(given, chosen, feet_m, shape)
    hits = _hits(given.detections, chosen, targets["target"])
    seen = hits > 0
    times_seen = seen.sum(axis=0, dtype=np.int64)
    lost, if_dark, if_shorter = _margins(given, chosen, seen, feet_m, shape.height_m)
    edges = list(read_layer(given.edges, "edges", frame).geometry)
    along = stations_m(edges, targets[["x", "y"]].to_numpy(np.float64))
    at = stations_m(edges, chosen[["x", "y"]].to_numpy(np.float64))
    cell_m = float(read_about(given.targets)["cell_size_m"])
    pairs = overlaps(seen, along, at, cell_m)
    table = chosen.assign(along_road_m=at, **_rates(given, frame, chosen))
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
        "probability": _probability(given, chosen, hits),
        "heights": heights_of_plan(on_targets, times_seen > 0, shape.height_m),
        "mean_overlap_m": shared,
        "overlaps": [_named(pair, chosen) for pair in pairs],
        **totals,
        "sensors": table.drop(columns=["x", "y", "z"])
        .astype(object)
        .where(table.drop(columns=["x", "y", "z"]).notna(), None)
        .to_dict("records"),
    }
    write_json(out, content)
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
    write_layers(layers, {"sensors": layer, "targets": feet}, frame)
    log.info(
        "%.0f points a second, %.0f on the road",
        totals["points_per_s"],
        totals["road_points_per_s"],
    )


def _margins(
    given: PlanDataFiles,
    chosen: pd.DataFrame,
    seen: Bools,
    feet_m: Floats,
    height_m: float,
) -> tuple[dict[str, Any], Bools, Bools]:
    """What dark targets and a third less range would lose, from the plan's own detections."""
    sensors = load_sensors(given.sensors)
    kinds = [sensors[name] for name in chosen["sensor"]]
    names = zip(chosen["sensor"], kinds, strict=True)
    reach_m = [sight_of(given, name, kind).max_range_m for name, kind in names]
    places = chosen[["x", "y", "z"]].to_numpy(np.float64).reshape(-1, 3)
    return margins(seen, distances_m(places, feet_m, height_m), *ranges_m(kinds, reach_m))


def _hits(paths: Sequence[Path], chosen: pd.DataFrame, targets: pd.Series) -> NDArray[np.uint16]:
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
    given: PlanDataFiles, chosen: pd.DataFrame, hits: NDArray[np.uint16]
) -> dict[str, Any] | None:
    """How likely the targets are found by what their sensors measure, and by which curves."""
    curves = Curves(Curve(*given.lidar_curve), Curve(*given.camera_curve))
    sensors = load_sensors(given.sensors)
    found = found_by_plan(hits, [curves.of(sensors[name]) for name in chosen["sensor"]])
    said = {"lidar": given.lidar_curve, "camera": given.camera_curve}
    return None if found is None else found | {"curves": said}


def _rates(given: PlanDataFiles, frame: Frame, chosen: pd.DataFrame) -> dict[str, Floats]:
    """Points and pixels a second of each sensor, and its points on the road."""
    sensors = load_sensors(given.sensors)
    kinds = [sensors[name] for name in chosen["sensor"]]
    rates = [data_rates(kind, given.frames_hz) for kind in kinds]
    scans = np.array([frames_per_s(kind, given.frames_hz) for kind in kinds])
    return {
        "points_per_s": np.array([rate.get("points_per_s", 0.0) for rate in rates]),
        "pixels_per_s": np.array([rate.get("pixels_per_s", 0.0) for rate in rates]),
        "road_points_per_s": scans * _on_road(given, frame, len(chosen)),
    }


def _on_road(given: PlanDataFiles, frame: Frame, count: int) -> Floats:
    """Returns of one simulated scan of each sensor within the pavement's outline."""
    if not count:
        return np.zeros(0)
    parts = read_layer(given.pavement, "pavement", frame).geometry.to_numpy()
    outline = shapely.multipolygons(shapely.get_parts(parts))
    scan = read_laz(given.scans)
    xyz_m = frame.to_local(scan.xyz)
    number = scan.dims["point_source_id"].astype(np.int64) - 1
    on_road = inside(outline, xyz_m[:, 0], xyz_m[:, 1])
    return np.bincount(number[on_road], minlength=count).astype(np.float64)


def _named(pair: dict[str, Any], chosen: pd.DataFrame) -> dict[str, Any]:
    names = chosen["candidate"]
    return pair | {"sensor": str(names[pair["sensor"]]), "next": str(names[pair["next"]])}


main = Command(measure_data)


if __name__ == "__main__":
    sys.exit(main())
