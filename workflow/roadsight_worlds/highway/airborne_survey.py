"""The sample highway surveyed from the air: two flight lines, so that walls get few points."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from roadsight_worlds.casting.alignment import heading_at, to_plan
from roadsight_worlds.highway.highway import Highway
from roadsight_worlds.highway.highway_ground import HALF_WIDTH_M
from roadsight_worlds.highway.mobile_scanner import PointChunk
from roadsight_worlds.highway.returns import LaserModel, measure

FLIGHT_HEIGHT_M = 1000.0  # Of the aircraft above the road, as of the rural road's survey.
LINES_M = (150.0, -150.0)  # Offsets of the flight lines: pulses lean by up to 11 degrees.
# Pulses start so far from the road: above all that stands, within the laser model's range.
_START_M = 80.0
_LASER = LaserModel(
    range_sigma_m=0.02, mixed_edge_share=0.0, multipath_share=0.0, clutter_share=0.0
)
_PULSES_S = 500_000.0  # Pulses a second; each has a time of its own.


def survey(highway: Highway, points: int, rng: np.random.Generator) -> Iterator[PointChunk]:
    """Survey the site with about ``points`` pulses on jittered grids, one chunk a flight line."""
    cell_m = math.sqrt(len(LINES_M) * 2 * HALF_WIDTH_M * highway.length_m / points)
    station = np.arange(0.0, highway.length_m, cell_m)
    offset = np.arange(-HALF_WIDTH_M, HALF_WIDTH_M, cell_m)
    grid = np.stack(np.meshgrid(station, offset, indexing="ij"), axis=-1).reshape(-1, 2)
    for number, line_m in enumerate(LINES_M, start=1):
        road = grid + rng.uniform(0.0, cell_m, grid.shape)
        heading = heading_at(highway.alignment, road[:, 0])
        lean = (road[:, 1] - line_m) / FLIGHT_HEIGHT_M
        ray = np.column_stack(
            [-lean * np.sin(heading), lean * np.cos(heading), -np.ones(len(road))]
        )
        ray /= np.linalg.norm(ray, axis=1, keepdims=True)
        height_m = highway.terrain.height_m + highway.terrain.grade * road[:, 0]
        start = np.column_stack([to_plan(highway.alignment, road), height_m]) - _START_M * ray
        echoes = measure(highway, start, ray, _LASER, rng)
        hit = echoes.pulse
        xyz = start[hit] + echoes.range_m[:, None] * ray[hit]
        time_s = ((number - 1) * len(grid) + hit) / _PULSES_S
        numbers = np.full(len(hit), number, np.uint16)
        yield PointChunk(xyz, echoes.intensity, time_s, echoes.truth_class, numbers)
