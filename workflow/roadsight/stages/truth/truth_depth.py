"""Depth maps on real data, one data set at a time."""

from __future__ import annotations

import sys
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from roadsight.base.arrays import Bools, Floats, Floats32
from roadsight.evidence.labelled_clouds import NEAREST_M, Street, first_per_cell, read_street
from roadsight.evidence.truth_catalogue import Figure
from roadsight.placement.depth.surfel_lidar import lidar_of_points
from roadsight.placement.sensors.sensors import Sensor
from roadsight.stages.truth.truth_stage import measuring

# Depth maps beside real scans: one frame is left out and predicted from the others.
#
# Everything is in the frame of the scanner of the frame that is left out: its centre is the
# origin. The peer is the median range of the map's points in a narrow cone about each beam.

LEFT_OUT = 5
"""Frame that is predicted."""

RIGHT_M = 0.5
"""A beam is right when its range is off by no more than this."""

CONE_DEG = 0.15
"""Half angle of the cone whose points make the peer."""

BANDS_M = {"to_20m": (0.0, 20.0), "20_to_40m": (20.0, 40.0), "40_to_90m": (40.0, 90.0)}
"""Real ranges that get a figure of their own."""

SCANNER = Sensor.model_validate(
    {
        "azimuth_step_deg": 0.2,
        "elevation_min_deg": -25.0,
        "elevation_max_deg": 3.0,
        "channels": 1121,
        "range_m": 90.0,
        "divergence_mrad": (2.0, 2.0),
    }
)
"""The virtual scanner that is looked up at the real beams."""

_FARTHEST_M = 90.0
"""Farther returns are too few to compare."""

_CELL_M = 0.02
"""Other scans are thinned to one point in a cube of this width."""

_BLOCK = 4_000
"""Beams whose cones are looked up at one time: it bounds memory."""


def measure_depth(dataset: str, files: Sequence[Path]) -> list[Figure]:
    """Shares of right beams, over all and by range, and how errors are balanced."""
    map_m, beams_m = leave_out(read_street(files[0].parent), LEFT_OUT)
    real_m = np.linalg.norm(beams_m, axis=1)
    started = time.process_time()
    depth = lidar_of_points(map_m).depth_map(SCANNER, np.zeros(3), 0.0)
    used_s = time.process_time() - started
    ours = looked_up(depth, beams_m)
    peer = median_in_cone(map_m, beams_m)
    rows = {"within_0.5m": np.ones(len(real_m), bool)} | {
        f"within_0.5m_{name}": (real_m >= low) & (real_m < high)
        for name, (low, high) in BANDS_M.items()
    }
    figures = [
        Figure(name, _right(ours, real_m, band), _right(peer, real_m, band), used_s)
        for name, band in rows.items()
        if band.any()
    ]
    balance = [_balance(found, real_m) for found in (ours, peer)]
    return [*figures, Figure("too_near_over_too_far", balance[0], balance[1], used_s)]


def leave_out(street: Street, frame: int) -> tuple[Floats, Floats]:
    """Points (n, 3) of the other frames and returns (m, 3) of one frame, seen from its scanner."""
    local = (street.xyz_m - street.scanner_m[frame]) @ street.world_from_scanner[frame]
    range_m = np.linalg.norm(local, axis=1)
    within = (range_m >= NEAREST_M) & (range_m <= _FARTHEST_M)
    others = local[street.still & (street.scan != frame) & within]
    return others[first_per_cell(others, _CELL_M)], local[street.still & (street.scan == frame)]


def looked_up(range_m: Floats32, beams_m: Floats) -> Floats:
    """Ranges (m,) of the depth map's cells nearest to beams (m, 3); 0 for no return."""
    azimuth = np.degrees(np.arctan2(beams_m[:, 1], beams_m[:, 0]))
    elevation = np.degrees(np.arctan2(beams_m[:, 2], np.hypot(beams_m[:, 0], beams_m[:, 1])))
    columns = len(SCANNER.azimuth_deg)
    step = 360.0 / columns
    column = np.rint((azimuth - SCANNER.azimuth_deg[0]) / step).astype(np.int64) % columns
    borders = (SCANNER.elevation_deg[1:] + SCANNER.elevation_deg[:-1]) / 2
    cells = np.asarray(range_m, np.float64)[np.searchsorted(borders, elevation), column]
    return np.asarray(cells)


def median_in_cone(map_m: Floats, beams_m: Floats) -> Floats:
    """Median range (m,) of the map's points within `CONE_DEG` of each beam; 0 where none is."""
    range_m = np.linalg.norm(map_m, axis=1)
    tree = cKDTree(map_m / range_m[:, None])
    towards = beams_m / np.linalg.norm(beams_m, axis=1, keepdims=True)
    chord = 2 * np.sin(np.radians(CONE_DEG) / 2)
    out = np.zeros(len(beams_m))
    for start in range(0, len(beams_m), _BLOCK):
        found = tree.query_ball_point(towards[start : start + _BLOCK], chord)
        for number, rows in enumerate(found):
            if rows:
                out[start + number] = np.median(range_m[rows])
    return out


def _right(found_m: Floats, real_m: Floats, band: Bools) -> float:
    right = (found_m > 0) & (np.abs(found_m - real_m) <= RIGHT_M)
    return 100 * float(right[band].mean())


def _balance(found_m: Floats, real_m: Floats) -> float:
    """The more frequent of too near and too far over the other."""
    known = found_m > 0
    near = int((known & (found_m < real_m - RIGHT_M)).sum())
    far = int((known & (found_m > real_m + RIGHT_M)).sum())
    return max(near, far) / max(min(near, far), 1)


main = measuring(measure_depth, __doc__)


if __name__ == "__main__":
    sys.exit(main())
