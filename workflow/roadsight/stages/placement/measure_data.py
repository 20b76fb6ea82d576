"""What the sensors of a plan share along the road, and the data that they make."""

from __future__ import annotations

import logging
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import geopandas as gpd
import numpy as np
import pandas as pd
import shapely
from numpy.typing import NDArray

from roadsight.base.arrays import Bools, Floats
from roadsight.base.errors import InputError
from roadsight.base.sections.sensing import Lidar, Targets
from roadsight.geometry.areas import inside
from roadsight.geometry.frames import Frame
from roadsight.io.cloud.clouds import read_laz
from roadsight.io.records.atomic import read_json, write_json
from roadsight.io.records.depth_maps import DepthMaps
from roadsight.io.records.placement_tables import read_detections, read_poses, read_tilts
from roadsight.io.records.tables import read_about
from roadsight.io.vector.vectors import points, read_layer, write_layers
from roadsight.placement.plans.handover import (
    data_rates,
    distances_m,
    frames_per_s,
    handover,
    margins,
    overlaps,
    ranges_m,
    stations_m,
)
from roadsight.placement.sensors.poses import Turn, local_from_sensor, split_pose
from roadsight.placement.sensors.sensors import AnySensor, Camera, Radar, load_sensor, load_sensors
from roadsight.placement.sight.detectors import BandedDetector, Criteria, detector_of
from roadsight.placement.sight.kinds import Shape
from roadsight.placement.sight.posed import Panorama
from roadsight.placement.sight.probability import Curve, Curves, found_by_plan
from roadsight.placement.sight.sight import beams_by_height
from roadsight.stages.command import Command
from roadsight.stages.placement.shared.detection_inputs import (
    SightFiles,
    read_shaped_targets,
    sight_of,
)

log = logging.getLogger("measure_data")


# What the chosen sensors of a plan measure of each target by height, from their depth maps.


@dataclass(frozen=True, kw_only=True)
class MeasuringFiles(SightFiles):
    """What tells what the chosen sensors of a plan measure."""

    sensors: Path
    depth: Sequence[Path]
    candidates: Sequence[Path]
    azimuth_stride: Annotated[int, Lidar]


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
    cell_m = float(read_about(given.targets)["cell_size_m"])
    edges = list(read_layer(given.edges, "edges", frame).geometry)
    sensors = load_sensors(given.sensors)
    kinds = [sensors[name] for name in chosen["sensor"]]
    named = zip(chosen["sensor"], kinds, strict=True)
    reach_m = [sight_of(given, name, kind).max_range_m for name, kind in named]
    hits = _hits(given.detections, chosen, targets["target"])
    on_road = _on_road(given, frame, len(chosen))
    on_targets = points_by_height(given, chosen, feet_m, shape)
    seen = hits > 0
    times_seen = seen.sum(axis=0, dtype=np.int64)
    # What dark targets and a third less range would lose, from the plan's own detections.
    places = chosen[["x", "y", "z"]].to_numpy(np.float64).reshape(-1, 3)
    away_m = distances_m(places, feet_m, shape.height_m)
    lost, if_dark, if_shorter = margins(seen, away_m, *ranges_m(kinds, reach_m))
    along = stations_m(edges, targets[["x", "y"]].to_numpy(np.float64))
    at = stations_m(edges, chosen[["x", "y"]].to_numpy(np.float64))
    pairs = overlaps(seen, along, at, cell_m)
    curves = Curves(Curve(*given.lidar_curve), Curve(*given.camera_curve))
    probability = found_by_plan(hits, [curves.of(kind) for kind in kinds])
    if probability is not None:
        probability["curves"] = {"lidar": given.lidar_curve, "camera": given.camera_curve}
    rates = [data_rates(kind, given.frames_hz) for kind in kinds]
    scans_per_s = np.array([frames_per_s(kind, given.frames_hz) for kind in kinds])
    table = chosen.assign(
        along_road_m=at,
        points_per_s=np.array([rate.get("points_per_s", 0.0) for rate in rates]),
        pixels_per_s=np.array([rate.get("pixels_per_s", 0.0) for rate in rates]),
        road_points_per_s=scans_per_s * on_road,
    )
    for pair in pairs:
        table.loc[pair["sensor"], "overlap_with_next_m"] = pair["length_m"]
    totals = {
        name: float(table[name].sum())
        for name in ("points_per_s", "pixels_per_s", "road_points_per_s")
    }
    shared = float(np.mean([pair["length_m"] for pair in pairs])) if pairs else None
    names = chosen["candidate"].astype(str)
    told = table.drop(columns=["x", "y", "z"])
    content = {
        **handover(times_seen),
        "margins": lost,
        "probability": probability,
        "heights": heights_of_plan(on_targets, times_seen > 0, shape.height_m),
        "mean_overlap_m": shared,
        "overlaps": [
            pair | {end: names[pair[end]] for end in ("sensor", "next")} for pair in pairs
        ],
        **totals,
        "sensors": told.astype(object).where(told.notna(), None).to_dict("records"),
    }
    write_json(out, content)
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
    write_layers(layers, {"sensors": points(table), "targets": feet}, frame)
    log.info(
        "%.0f points a second, %.0f on the road",
        totals["points_per_s"],
        totals["road_points_per_s"],
    )


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


class _Place(NamedTuple):
    """A chosen sensor: its name, its candidate, how it is turned, and whether it has a pose."""

    sensor: str
    candidate: str
    turn: Turn
    posed: bool


def points_by_height(
    given: MeasuringFiles, chosen: pd.DataFrame, feet_m: Floats, shape: Shape
) -> dict[str, Floats]:
    """Points of LiDARs and pixels of cameras on each target, (targets, bands), by unit.

    Parameters
    ----------
    chosen : columns sensor and candidate, whose name says its pose where it has one.

    Raises
    ------
    InputError : a chosen sensor has no depth map.
    """
    sensors = load_sensors(given.sensors)
    pairs = zip(chosen["sensor"], chosen["candidate"].astype(str), strict=True)
    places = [_Place(name, *split_pose(told), "@" in told) for name, told in pairs]
    places = [place for place in places if not isinstance(sensors[place.sensor], Radar)]
    totals: dict[str, Floats] = {}
    found = 0
    for place, panorama, tilt in _views(given, places, sensors):
        sensor = sensors[place.sensor]
        part = _measured(given, place, sensor, panorama, tilt, feet_m, shape)
        unit = "pixels" if isinstance(sensor, Camera) else "points"
        totals[unit] = totals.get(unit, np.zeros(part.shape)) + part
        found += 1
    if found < len(places):
        raise InputError(
            "depth maps of chosen sensors are missing",
            where=", ".join(map(str, given.depth)),
            found=f"{found} of {len(places)}",
            hint="run the workflow again",
        )
    return dict(sorted(totals.items()))


def _views(
    given: MeasuringFiles, places: list[_Place], sensors: dict[str, AnySensor]
) -> Iterator[tuple[_Place, Panorama, Floats | None]]:
    """Each place with its depth map, or its candidate's panorama, and the tilt of its mount."""
    poses = {name: pose for path in given.candidates for name, pose in read_poses(path).items()}
    tilts = read_tilts(given.tilts)
    for path in given.depth:
        maps = DepthMaps(path)
        beams = load_sensor(given.sensors, maps.info.sensor)
        if maps.info.sensor in sensors:
            beams = beams.thinned(given.azimuth_stride)
            here = [p for p in places if not p.posed and p.sensor == maps.info.sensor]
        else:
            here = [p for p in places if p.posed]
        for candidate, depth in maps.only({place.candidate for place in here}):
            *position_m, yaw_deg = poses[candidate]
            panorama = Panorama(depth, beams, np.array(position_m), float(yaw_deg))
            for place in here:
                if place.candidate == candidate:
                    yield place, panorama, tilts.get(candidate)


def _measured(
    given: MeasuringFiles,
    place: _Place,
    sensor: AnySensor,
    view: Panorama,
    tilt: Floats | None,
    feet_m: Floats,
    shape: Shape,
) -> Floats:
    """What one sensor measures of each target by height, as detection counts it."""
    sight = sight_of(given, place.sensor, sensor)
    if not place.posed:
        pose = (view.position_m, view.yaw_deg)
        hits = beams_by_height(view.range_m, view.sensor, *pose, feet_m, shape, sight, BANDS, tilt)
        return np.asarray(given.azimuth_stride * hits)
    detector = detector_of(sensor, Criteria(0, 1.0))
    assert isinstance(detector, BandedDetector)
    rotation = local_from_sensor(view.yaw_deg, place.turn, tilt)
    return detector.by_height(view, rotation, feet_m, shape, sight, BANDS)


# How many points, or pixels, a plan's sensors together have of targets, by height.

BANDS = 4
"""Targets are cut into so many equal parts of their height."""


def heights_of_plan(
    on_targets: dict[str, Floats], seen: Bools, height_m: float
) -> list[dict[str, Any]]:
    """Bands of height, the lowest first, for what each kind of sensor measures.

    Parameters
    ----------
    on_targets : by unit, (targets, bands) of all sensors together. seen : (targets,) by the plan;
        only these count. height_m : of every target.

    Returns
    -------
    unit, and bands: from_m and to_m above the foot, mean and median of the targets, and share_none
    of them that have less than one point there
    """
    found = []
    for unit, part in on_targets.items() if seen.any() else ():
        bands = [
            {
                "from_m": height_m * number / part.shape[1],
                "to_m": height_m * (number + 1) / part.shape[1],
                "mean": float(here.mean()),
                "median": float(np.median(here)),
                "share_none": float((here < 1).mean()),
            }
            for number, here in enumerate(part[seen].T)
        ]
        found.append({"unit": unit, "bands": bands})
    return found


def height_columns(on_targets: dict[str, Floats]) -> pd.DataFrame:
    """Columns ``points_1`` (lowest) and so on of each target, rounded to a tenth."""
    return pd.DataFrame(
        {
            f"{unit}_{band + 1}": part[:, band].round(1)
            for unit, part in on_targets.items()
            for band in range(part.shape[1])
        }
    )


main = Command(measure_data)


if __name__ == "__main__":
    sys.exit(main())
