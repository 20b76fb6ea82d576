"""Reference line of a winding hilly road: clothoid-like in plan, smooth waves in profile.

``station_m`` runs along the line, ``offset_m`` is positive to its left. The line is a table every
0.25 m; between its rows everything is linear, so that both ways of the conversion agree to 0.1 mm.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.ndimage import uniform_filter1d
from scipy.spatial import cKDTree

from roadsight.base.arrays import Floats

_STEP_M = 0.25  # Spacing of the stored stations.
_TRANSITION_M = 45.0  # Length over which curvature goes from a tangent to an arc.
_RADII_M = (190.0, 380.0)  # Least and greatest radius of bends.
# The line turns to either side by half of this at most, so that it never doubles back.
_MOST_TURN_RAD = 1.1


@dataclass(frozen=True)
class RuralLine:
    """Table of the reference line and the waves of its profile.

    Parameters
    ----------
    station_m, x_m, y_m, heading_rad : (n,) rows; headings anticlockwise from x.
    wave_m, wave_rad_m, wave_phase : (k,) amplitude, angle per metre, phase of the profile's waves.
    """

    station_m: Floats
    x_m: Floats
    y_m: Floats
    heading_rad: Floats
    wave_m: Floats
    wave_rad_m: Floats
    wave_phase: Floats

    def heading(self, station_m: ArrayLike) -> Floats:
        """Direction of rising stations, radians anticlockwise from x."""
        return np.interp(np.asarray(station_m, float), self.station_m, self.heading_rad)

    def plan(self, station_m: ArrayLike, offset_m: ArrayLike) -> Floats:
        """Local plan points (..., 2) of stations and offsets, broadcast together."""
        station, offset = np.broadcast_arrays(
            *(np.asarray(a, float) for a in (station_m, offset_m))
        )
        heading = self.heading(station)
        x = np.interp(station, self.station_m, self.x_m) - offset * np.sin(heading)
        y = np.interp(station, self.station_m, self.y_m) + offset * np.cos(heading)
        return np.stack([x, y], axis=-1)

    def road(self, xy_m: ArrayLike) -> Floats:
        """Station and offset (n, 2) of plan points (n, 2) nearer to the line than its radii.

        Newton's method from the nearest row; beyond the ends the end's direction holds.
        """
        xy = np.asarray(xy_m, float).reshape(-1, 2)
        tree = cKDTree(np.column_stack([self.x_m, self.y_m]))
        station = self.station_m[tree.query(xy)[1]]
        curvature = np.gradient(self.heading_rad, self.station_m)
        for _ in range(4):
            heading = self.heading(station)
            east, north = (xy - self.plan(station, 0.0)).T
            along = east * np.cos(heading) + north * np.sin(heading)
            offset = north * np.cos(heading) - east * np.sin(heading)
            bend = np.interp(station, self.station_m, curvature)
            station = station + along / np.maximum(1.0 - bend * offset, 0.2)
        heading = self.heading(station)
        east, north = (xy - self.plan(station, 0.0)).T
        return np.column_stack([station, north * np.cos(heading) - east * np.sin(heading)])

    def height(self, station_m: ArrayLike) -> Floats:
        """Height of the middle of the road, local metres."""
        angle = np.multiply.outer(np.asarray(station_m, float), self.wave_rad_m) + self.wave_phase
        return np.sin(angle) @ self.wave_m

    def grade(self, station_m: ArrayLike) -> Floats:
        """Rise over run of the middle of the road."""
        angle = np.multiply.outer(np.asarray(station_m, float), self.wave_rad_m) + self.wave_phase
        return np.cos(angle) @ (self.wave_m * self.wave_rad_m)


def random_line(start_m: float, end_m: float, rng: np.random.Generator) -> RuralLine:
    """Line between two stations (station 0 at the local origin) with bends both ways and a crest.

    Grades stay below 11 %, radii above 190 m, and the line never doubles back on itself.
    """
    station = np.arange(start_m, end_m + _STEP_M, _STEP_M)
    curvature = _bends(station, rng)
    turned = np.concatenate([[0.0], np.cumsum(0.5 * (curvature[1:] + curvature[:-1]) * _STEP_M)])
    heading = rng.uniform(0.0, 2.0 * np.pi) + turned - turned[np.searchsorted(station, 0.0)]
    middle = 0.5 * (heading[1:] + heading[:-1])
    x = np.concatenate([[0.0], np.cumsum(_STEP_M * np.cos(middle))])
    y = np.concatenate([[0.0], np.cumsum(_STEP_M * np.sin(middle))])
    at_zero = np.searchsorted(station, 0.0)
    lengths = np.array([rng.uniform(320.0, 400.0), rng.uniform(150.0, 190.0)])
    heights = np.array([rng.uniform(3.6, 4.4), rng.uniform(0.4, 0.7)])
    phases = rng.uniform(0.0, 2.0 * np.pi, 2)
    place = x - x[at_zero], y - y[at_zero]
    return RuralLine(station, *place, heading, heights, 2.0 * np.pi / lengths, phases)


def _bends(station: Floats, rng: np.random.Generator) -> Floats:
    """Curvature: arcs and tangents in turn, joined by linear transitions of 45 m."""
    curvature, at, heading, turn = np.zeros_like(station), station[0], 0.0, rng.choice([-1.0, 1.0])
    while at < station[-1]:
        at += rng.uniform(25.0, 70.0)
        length, k = rng.uniform(90.0, 170.0), turn / rng.uniform(*_RADII_M)
        if abs(heading + k * length) > 0.5 * _MOST_TURN_RAD:
            k = np.sign(k) * (0.5 * _MOST_TURN_RAD - abs(heading) * np.sign(heading * k)) / length
        curvature[(station >= at) & (station < at + length)] = k
        at, heading, turn = at + length, heading + k * length, -turn
    return uniform_filter1d(curvature, round(_TRANSITION_M / _STEP_M), mode="nearest")
