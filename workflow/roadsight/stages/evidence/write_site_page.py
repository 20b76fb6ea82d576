"""Everything that the report shows of one site, in one compact file."""

from __future__ import annotations

import logging
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from itertools import repeat
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import pandas as pd

from roadsight.base.arrays import Floats, Ints
from roadsight.base.errors import InputError
from roadsight.geometry.frames import Frame
from roadsight.io.cloud.clouds import read_laz
from roadsight.io.cloud.tiles import COLOUR, CloudTiles, stack_xyz
from roadsight.io.raster.orthophotos import read_orthophoto
from roadsight.io.raster.rasters import Raster, read_raster
from roadsight.io.records.atomic import read_json, write_json
from roadsight.io.records.placement_tables import read_detections
from roadsight.io.records.tables import read_table
from roadsight.io.vector.vectors import read_layer
from roadsight.placement.sensors.sensors import AimedSensor, AnySensor, load_sensors
from roadsight.report.packing import sample_mask, thin
from roadsight.report.site.backdrops import Backdrop, backdrops
from roadsight.report.site.layers import CloudSample, near_measured
from roadsight.report.site.page import Placement, PlanResult, Relief, Scene, build_page
from roadsight.stages.command import Command

log = logging.getLogger("write_site_page")

_CLOUD_POINTS = 150_000
"""Points of the cloud in the page; three numbers of 16 bits each, before compression."""
_RETURNS = 20_000
"""Returns of a plan's virtual scans in the page."""
_SAMPLED_POINTS = 2_000_000
"""Points in memory before they are thinned evenly in space."""
_PHOTO_PIXELS = 1500
"""Pixels along the longer side of an orthophoto: half a megabyte of the page."""


@dataclass(frozen=True)
class PlacementResults:
    """What the placement job wrote; one entry for each plan, sensor or round."""

    sensors: Annotated[Path | None, "definitions of the sensors; needed with --solutions"] = None
    plans: Annotated[Sequence[str], "NAME=TITLE"] = ()
    unexamined: Annotated[Path | None, "pavement that no target stands for"] = None
    targets: Sequence[Path] = ()
    candidates: Sequence[Path] = ()
    detections: Sequence[Path] = ()
    coverage: Sequence[Path] = ()
    solutions: Sequence[Path] = ()
    layers: Sequence[Path] = ()
    tolerances: Sequence[Path] = ()
    obstacles: Sequence[Path] = ()
    scans: Sequence[Path] = ()


def write_site_page(
    site: str,
    summary_path: Path,
    frame_path: Path,
    cloud_path: Path,
    dem_path: Path,
    pavement: Path,
    edges: Path,
    found: PlacementResults,
    title: Annotated[str, "name of the site for people"] = "",
    orthophoto: Annotated[Path | None, "picture below the map"] = None,
    *,
    out: Path,
) -> None:
    """Read a site's artifacts and write its page."""
    about, summary = read_json(frame_path), read_json(summary_path)
    frame = Frame.from_dict(about)
    dem = read_raster(dem_path, frame)
    cloud, below = sample_cloud(cloud_path, dem)
    if orthophoto and below:
        below = {"orthophoto": _orthophoto(orthophoto, frame, cloud.xyz_m), **below}
    heights_m = near_measured(dem.values, dem.measured, dem.cell_size_m)
    scene = Scene(
        about,
        cloud,
        Relief(heights_m, dem.west_m, dem.north_m, dem.cell_size_m),
        read_layer(pavement, "pavement", frame),
        read_layer(edges, "edges", frame),
        below,
    )
    placement = None
    if found.solutions and found.sensors:
        placement = _placement(found, found.sensors, frame)
    page = build_page(title or site, summary, scene, placement)
    log.info("%d points, %d plans", len(scene.cloud.xyz_m), len(page["plans"]))
    write_json(out, page)


def sample_cloud(path: Path, dem: Raster) -> tuple[CloudSample, dict[str, Backdrop]]:
    """About 150,000 points of a tiled cloud, even in space, and pictures of it from above.

    The points have their height above ground; the pictures are drawn from two million.
    """
    cloud = CloudTiles(path)
    share = _SAMPLED_POINTS / max(cloud.points, 1)
    colours = [name for name in COLOUR if name in cloud.columns]
    names = ["x", "y", "z", "intensity", *colours]
    parts, start = [], 0
    for number, tile in enumerate(cloud.tiles):
        points = cloud.read(names, [number])
        mask = sample_mask(start, tile.rows, share)
        parts.append({name: points[name][mask] for name in names})
        start += tile.rows
    sample = {name: np.concatenate([part[name] for part in parts]) for name in names}
    xyz_m, intensity = stack_xyz(sample), sample["intensity"]
    above_m = sample["z"] - dem.sample(sample["x"], sample["y"])
    colour = np.column_stack([sample[name] for name in colours]) if colours else None
    chosen = thin(xyz_m, _CLOUD_POINTS)
    thinned = CloudSample(
        cloud.points,
        xyz_m[chosen],
        above_m[chosen],
        intensity[chosen],
        None if colour is None else colour[chosen],
    )
    return thinned, backdrops(xyz_m, above_m, intensity, colour)


def _orthophoto(path: Path, frame: Frame, xyz_m: Floats) -> Backdrop:
    """What an orthophoto shows of the cloud's box, with at most 1,500 pixels a side."""
    (west, south), (east, north) = xyz_m[:, :2].min(axis=0), xyz_m[:, :2].max(axis=0)
    cell_m = max(float(east - west), float(north - south), 1e-3) / _PHOTO_PIXELS
    rows, columns = int((north - south) / cell_m) + 1, int((east - west) / cell_m) + 1
    place = float(west), float(north)
    return Backdrop(read_orthophoto(path, frame, *place, rows, columns, cell_m), *place, cell_m)


def _placement(found: PlacementResults, sensors: Path, frame: Frame) -> Placement:
    """Results of all plans."""
    titles = dict(entry.partition("=")[::2] for entry in found.plans)
    solutions = [read_json(path) for path in found.solutions]
    chosen = {place["candidate"] for solution in solutions for place in solution["sensors"]}
    detections = read_detections(found.detections)
    definitions = load_sensors(sensors)
    names = dict.fromkeys(path.parent.name for path in found.detections)
    coverage = read_json(found.coverage[0])["plans"]
    targets = read_table(found.targets[0])
    files = (found.obstacles, found.scans)
    shares = partial(_shares, targets=targets["target"], frame=frame)
    plans = [
        _plan(
            solution,
            titles,
            coverage[solution["plan"]]["uncovered"],
            frame,
            shares(layers if "availability" in solution else None, "availability"),
            shares(lost, "lost_share"),
            *of_plan,
        )
        for solution, layers, lost, *of_plan in zip(
            solutions,
            found.layers,
            found.tolerances or repeat(None, len(solutions)),
            *files,
            strict=True,
        )
    ]
    return Placement(
        targets,
        [read_table(path) for path in found.candidates],
        detections[detections["candidate"].isin(chosen)],
        {name: _shown(definitions[name]) for name in names},
        plans,
        read_layer(found.unexamined, "unexamined", frame) if found.unexamined else None,
    )


def _shown(sensor: AnySensor) -> dict[str, Any]:
    """Definition of a sensor, with half its field of view where that is limited."""
    if not isinstance(sensor, AimedSensor):
        return sensor.to_dict()
    return sensor.to_dict() | {"half_view_deg": sensor.half_view_deg}


def _plan(
    solution: dict[str, Any],
    titles: dict[str, str],
    uncovered: Sequence[str],
    frame: Frame,
    shares: Floats | None,
    lost: Floats | None,
    obstacles: Path,
    scans: Path,
) -> PlanResult:
    name = solution["plan"]
    if name not in titles:
        raise InputError(
            "a solution of an unknown plan",
            where="--solutions",
            found=name,
            allowed=", ".join(titles),
        )
    returns_xyz_m, returns_sensor = _returns(scans, frame) if solution["sensors"] else _NO_RETURNS
    return PlanResult(
        titles[name],
        solution,
        uncovered,
        read_layer(obstacles, "uncovered", frame),
        read_layer(obstacles, "obstacles", frame),
        returns_xyz_m,
        returns_sensor,
        shares,
        lost,
    )


def _shares(layers: Path | None, column: str, targets: pd.Series, frame: Frame) -> Floats | None:
    """What a column of a plan's targets says of each (n,); None where nobody looked.

    Parameters
    ----------
    targets : names, in order; 0 for those that the plan leaves out.
    """
    if layers is None:
        return None
    shares = read_layer(layers, "targets", frame).set_index("target")[column]
    if shares.isna().all():
        return None
    return np.asarray(shares.reindex(targets).fillna(0.0), np.float64)


_NO_RETURNS = np.empty((0, 3)), np.empty(0, np.int64)


def _returns(path: Path, frame: Frame) -> tuple[Floats, Ints]:
    """Sample of the simulated returns in local metres, and the number of their sensor, from 0."""
    scan = read_laz(path)
    xyz_m = frame.to_local(scan.xyz)
    sampled = np.flatnonzero(sample_mask(0, len(xyz_m), _SAMPLED_POINTS / max(len(xyz_m), 1)))
    chosen = sampled[thin(xyz_m[sampled], _RETURNS)]
    return xyz_m[chosen], scan.dims["point_source_id"][chosen].astype(np.int64) - 1


main = Command(write_site_page)


if __name__ == "__main__":
    sys.exit(main())
