"""Error and cost of coordinates in single precision, of the world and near a local origin."""

from __future__ import annotations

import sys
import time
from pathlib import Path
from typing import Annotated, Any

import numpy as np

from roadsight.base.arrays import Floats
from roadsight.base.sections.scene import GroundClasses
from roadsight.evidence.precision import (
    largest_error_m,
    normal_error_deg,
    normals_of,
    stored,
)
from roadsight.geometry.frames import Frame
from roadsight.io.cloud.clouds import read_laz
from roadsight.io.records.atomic import read_json, write_json
from roadsight.io.records.usage import own_usage
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


main = Command(measure_precision)


if __name__ == "__main__":
    sys.exit(main())
