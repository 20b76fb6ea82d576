"""Directions in which a sensor measures, as a grid in its own frame with a weight for each cell."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from roadsight.base.arrays import Floats
from roadsight.placement.sensors.aimed import Camera, Radar, Rosette
from roadsight.placement.sensors.sensors import Sensor

SPHERICAL, PINHOLE, EQUIDISTANT = 0, 1, 2
"""Numbers of the projections, by which kernels know them; see `Raster`."""
_ROSETTE_CELL_DEG = 0.1
"""Cells in which a rosette's expected points are gathered."""
_ROSETTE_PARTS = 4
"""Parts of a cell, either way, over which the density is averaged: it is not even at the rim and at
the axis."""
_RADAR_CELL_DEG = 0.02
"""Cells that tell which part of a target a radar's beam meets: far finer than its resolution."""
_MOST_FINE = 24
"""Pixels of a camera and cells of a rosette looked at along either axis of a target."""
_MOST_RADAR = 16
"""The same for radars, of which only the part of a target that is met counts."""
_ALL = 1 << 30
"""More than any sensor has: every beam of a spinning LiDAR is looked at."""


@dataclass(frozen=True)
class Raster:
    """A grid of directions.

    Parameters
    ----------
    projection : what u and v are. SPHERICAL: azimuth and elevation, degrees. PINHOLE: y / x and
        z / x. EQUIDISTANT: angle from the x axis, degrees, towards y and towards z.
    u, v : (columns,) and (rows,), increasing, of the cells' middles.
    weight : (rows, columns) what a cell counts for, or (0, 0) where each counts for 1.
    most : along either axis at most so many cells of a target are looked at; where it spans more,
        every n-th stands for its neighbours.
    """

    projection: int
    u: Floats
    v: Floats
    weight: Floats
    most: int


def spinning_raster(sensor: Sensor) -> Raster:
    """Beams of a spinning LiDAR, all of them."""
    return Raster(SPHERICAL, sensor.azimuth_deg, sensor.elevation_deg, np.zeros((0, 0)), _ALL)


def camera_raster(camera: Camera) -> Raster:
    """Middles of a camera's pixels; of near targets, whose pixels abound, some of them."""
    u, v = (
        np.asarray((np.arange(count) + 0.5 - count / 2) / camera.focal_px, np.float64)
        for count in (camera.columns_px, camera.rows_px)
    )
    return Raster(PINHOLE, u, v, np.zeros((0, 0)), _MOST_FINE)


def radar_raster(radar: Radar) -> Raster:
    """Fine directions at which the part of a target is judged that a radar's beam meets."""
    reach = min(radar.zones[-1].half_angle_deg, 180.0)
    u = _cells(-reach, reach, _RADAR_CELL_DEG)
    v = _cells(radar.elevation_min_deg, radar.elevation_max_deg, _RADAR_CELL_DEG)
    return Raster(SPHERICAL, u, v, np.zeros((0, 0)), _MOST_RADAR)


@lru_cache(maxsize=8)
def rosette_raster(rosette: Rosette) -> Raster:
    """Expected points of one frame in each cell of 0.1 degrees, whatever the phase of the prisms.

    The prisms' speeds have no common measure, so that over the phases both angles are independent
    and even. The angle between the arrows, each a quarter a of the field long, is then even on 0 to
    180 degrees, and the distance from the axis is below r with probability
    1 - arccos(r^2 / (2 a^2) - 1) / pi. The density is infinite at the rim and at the axis, but not
    its mean over rings as wide as a part of a cell.
    """
    across, upright = rosette.half_view_deg
    cell = _ROSETTE_CELL_DEG
    u = cell * (np.arange(2 * int(np.ceil(across / cell))) + 0.5 - np.ceil(across / cell))
    v = cell * (np.arange(2 * int(np.ceil(upright / cell))) + 0.5 - np.ceil(upright / cell))
    parts = (np.arange(_ROSETTE_PARTS) + 0.5) / _ROSETTE_PARTS - 0.5
    weight = np.zeros((len(v), len(u)))
    for offset_deg in rosette.laser_offsets_deg:
        for du in parts:
            for dv in parts:
                radius = np.hypot(u + cell * du, (v + cell * dv - offset_deg)[:, None])
                weight += _density(radius, rosette.field_deg / 4, cell / _ROSETTE_PARTS)
    return Raster(EQUIDISTANT, u, v, weight * (rosette.points / weight.sum()), _MOST_FINE)


def _density(radius_deg: Floats, arrow_deg: float, width_deg: float) -> Floats:
    """Mean share of points per square degree of the ring of a width about each radius."""
    inner, outer = np.maximum(radius_deg - width_deg / 2, 0), radius_deg + width_deg / 2
    share = _within(outer, arrow_deg) - _within(inner, arrow_deg)
    return np.asarray(share / (np.pi * (outer**2 - inner**2)))


def _within(radius_deg: Floats, arrow_deg: float) -> Floats:
    """Probability that the sum of two arrows of a length in even directions is so short."""
    cosine = np.clip(radius_deg**2 / (2 * arrow_deg**2) - 1, -1, 1)
    return np.asarray(1 - np.arccos(cosine) / np.pi)


def _cells(low: float, high: float, step: float) -> Floats:
    """Middles of cells of about a width that fill an interval."""
    count = max(round((high - low) / step), 1)
    return low + (np.arange(count) + 0.5) * (high - low) / count
