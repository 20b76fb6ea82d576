"""Error and cost of coordinates in single precision, of the world and near a local origin."""

from __future__ import annotations

import sys
import time
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from numpy.typing import ArrayLike

from roadsight.base.arrays import Floats
from roadsight.base.sections.scene import GroundClasses
from roadsight.geometry.frames import Frame
from roadsight.io.cloud.clouds import read_laz
from roadsight.io.records.atomic import read_json, write_json
from roadsight.io.records.run_records import own_usage
from roadsight.scene.pavement.fpfh import nearest_neighbours, upward_normals
from roadsight.stages.command import Command

LEVELS = {
    "float32, world": (False, True),
    "float32, local": (True, True),
    "float64, local": (True, False),
}
"""Ways to store coordinates: whether a local origin is subtracted, whether as float32."""

DEFAULT = "float32, local"

_POINTS = 100_000
"""The first points of the cloud; more would only take more time."""

_NEIGHBOURS = GroundClasses().neighbours
"""Of the plane whose normal is measured."""

_REPEATS = 3
"""Timings of each way, of which the shortest counts."""


def measure_precision(
    cloud: Annotated[Path, "LAZ file, whose coordinates are exact"], frame_path: Path, *, out: Path
) -> None:
    """Write the errors of each way to store coordinates and the time that normals take."""
    frame = Frame.from_dict(read_json(frame_path))
    native = read_laz(cloud).xyz[:_POINTS]
    exact = normals_of(native - native.mean(axis=0), _NEIGHBOURS)
    levels = {name: _level(native, frame, exact, *way) for name, way in LEVELS.items()}
    write_json(out, {"default": DEFAULT, "repeats": _REPEATS, "levels": levels})


def _level(
    native: Floats, frame: Frame, exact: Floats, local: bool, single: bool
) -> dict[str, Any]:
    """Errors and cost of one way."""
    origin = np.asarray(frame.origin) if local else np.zeros(3)
    points = stored(native, origin, single)
    timings = []
    for _ in range(_REPEATS):
        cpu, wall = time.process_time(), time.perf_counter()
        found = normals_of(points, _NEIGHBOURS)
        timings.append((time.process_time() - cpu, time.perf_counter() - wall))
    return {
        "coordinate_error_m": largest_error_m(native, origin, single),
        "normal_error_deg": normal_error_deg(found, exact),
        "cpu_s": min(timings)[0],
        "wall_s": min(timings)[1],
        "peak_mib": own_usage().peak_mib,
    }


# What single precision costs in accuracy at coordinates of the world and near a local origin.


def stored(native: Floats, origin: ArrayLike, single: bool) -> Floats:
    """Native coordinates (n, 3) as they come back from storage, less the local origin.

    Parameters
    ----------
    origin : subtracted before storage; zeros store coordinates of the world. single : as float32.
    """
    kept = native - np.asarray(origin, np.float64)
    return kept.astype(np.float32).astype(np.float64) if single else kept


def largest_error_m(native: Floats, origin: ArrayLike, single: bool) -> float:
    """Largest distance between a point and what is stored of it, in the unit of the points."""
    back = stored(native, origin, single) + np.asarray(origin, np.float64)
    return float(np.sqrt(((back - native) ** 2).sum(axis=1)).max())


def normals_of(xyz_m: Floats, neighbours: int) -> Floats:
    """Upward normals (n, 3) of points; NaN where a neighbourhood is no plane."""
    _, index = nearest_neighbours(xyz_m, neighbours)
    return upward_normals(xyz_m, index)[0]


def normal_error_deg(found: Floats, exact: Floats) -> float:
    """95th percentile of the angle between normals (n, 3); a lost normal is 90 degrees off."""
    cosine = np.clip(np.abs((exact * found).sum(axis=1)), 0.0, 1.0)
    return float(np.percentile(np.degrees(np.arccos(np.nan_to_num(cosine))), 95))


main = Command(measure_precision)


if __name__ == "__main__":
    sys.exit(main())
