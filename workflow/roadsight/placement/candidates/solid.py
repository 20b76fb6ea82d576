"""Solid matter that a scan shows only in part: no sensor inside it, behind it or above it.

A scanner on the road sees the faces of walls and ceilings and nothing behind them. What it shows as
free there is rock, fill or a building. Three signs tell: no measured ground at the foot of a mast,
a roof that is wider than the space searched for points, and walls all around.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from roadsight.base.arrays import Bools, Floats, Floats32

REACH_M = 2.0
"""Surroundings of a position that are looked at: more than the half of a wall between two bores or
two carriageways (0.4 to 1.5 m), less than the width of a lane, so that open road shows."""
_CELLS = 8
"""Cells along either side of the plan of the surroundings, 0.5 m wide."""
_ROOF_SHARE = 0.6
"""Of the cells of the surroundings, those that a roof covers at its height: more than a gantry (a
fifth) or wires; both halves of a ceiling beside a wall of 0.8 m cover four fifths, and two thirds
1 m behind a portal."""
_ROOF_SPREAD_M = 0.5
"""The height of a roof differs by less than this: ceilings on a grade of 12 % by 0.48 m over 4 m;
of a crown with a radius of 2.5 m, half of the cells do."""
_THIN_SHARE = 0.35
"""Of the cells, those in which a roof is nothing but thin: crowns of trees are metres thick."""
_ROOF_PERCENTILE = 5
"""Percentile of a roof's points at which it begins: stray points may hang lower."""
_SECTORS = 16
"""Directions in which walls are looked for."""
_WALL_SHARE = 0.8
"""Of the directions, those with walls around a place that is enclosed. Beside a straight wall half
of them have one, in a corner three quarters, between the faces of a wall nearly all."""
_BAND_M = 0.5
"""Points so far above and below a place count as walls at its height."""
FOOT_M = 1.5
"""A mast has measured ground so near: a foundation, and the shadow of a rail or of half a car."""
_FOOT_SPACINGS = 2.0
"""Spacings of the ground points within which one lies for certain, where that is more."""


@dataclass(frozen=True)
class Surroundings:
    """Points around one position.

    Parameters
    ----------
    offsets_m : (n, 2) plan offsets from the position. heights_m : (n,) above its ground.
    """

    offsets_m: Floats | Floats32
    heights_m: Floats | Floats32

    def roof_m(self, lowest_m: float) -> float:
        """Height of a roof above the position that begins above ``lowest_m``; infinite if none."""
        above = self.heights_m > lowest_m
        if not above.any():
            return np.inf
        cell = np.floor((self.offsets_m[above] + REACH_M) / (2 * REACH_M) * _CELLS).astype(int)
        cell = np.clip(cell, 0, _CELLS - 1)
        number = cell[:, 0] * _CELLS + cell[:, 1]
        # The tops of cells: in those that a wall stands in, the least height is the wall's.
        top, underside = np.full((2, _CELLS * _CELLS), [[-np.inf], [np.inf]])
        np.maximum.at(top, number, self.heights_m[above])
        np.minimum.at(underside, number, self.heights_m[above])
        known = np.isfinite(top)
        found, thick_m = top[known], (top - underside)[known]
        middle = float(np.median(found)) if len(found) else np.inf
        level = np.abs(found - middle) <= _ROOF_SPREAD_M / 2
        # Of the cells whose middles lie within the reach, which is a circle.
        whole = np.pi / 4 * _CELLS**2
        thin = level & (thick_m <= _ROOF_SPREAD_M)
        if level.sum() < _ROOF_SHARE * whole or thin.sum() < _THIN_SHARE * whole:
            return np.inf
        body = self.heights_m[above]
        return float(np.percentile(body[body >= middle - _ROOF_SPREAD_M], _ROOF_PERCENTILE))

    def walled(self, heights_m: Floats) -> tuple[Bools, Floats]:
        """Whether walls stand around each height, and how near the nearest points beside it are.

        Parameters
        ----------
        heights_m : (k,) above ground.

        Returns
        -------
        (k,) enclosed, and (k,) plan distance of the nearest point, at most `REACH_M`.
        """
        far = np.full(len(heights_m), REACH_M)
        if not len(self.heights_m) or not len(heights_m):
            return np.zeros(len(heights_m), bool), far
        away = np.hypot(self.offsets_m[:, 0], self.offsets_m[:, 1])
        turn = np.arctan2(self.offsets_m[:, 1], self.offsets_m[:, 0])
        sector = np.floor((turn + np.pi) / (2 * np.pi) * _SECTORS).astype(int) % _SECTORS
        enclosed = np.zeros(len(heights_m), bool)
        for k, height in enumerate(heights_m):
            beside = np.abs(self.heights_m - height) <= _BAND_M
            if beside.any():
                enclosed[k] = len(np.unique(sector[beside])) >= _WALL_SHARE * _SECTORS
                far[k] = min(float(away[beside].min()), REACH_M)
        return enclosed, far


def has_measured_ground(xy_m: Floats, ground_xy_m: Floats) -> Bools:
    """Whether ground was measured at the foot of each position (n, 2).

    A terrain model is filled over gaps of many metres: under buildings, in rock beside a tunnel,
    behind walls. Where the ground's points are sparse, two of their spacings are near enough.

    Parameters
    ----------
    ground_xy_m : (m, 2) points labelled ground, near the positions at least.
    """
    if not len(ground_xy_m) or not len(xy_m):
        return np.zeros(len(xy_m), bool)
    tree = cKDTree(ground_xy_m)
    counts = np.asarray(tree.query_ball_point(xy_m, REACH_M, return_length=True))
    near = counts[counts > 0]
    spacing_m = np.sqrt(np.pi * REACH_M**2 / np.median(near)) if len(near) else 0.0
    reach_m = max(FOOT_M, _FOOT_SPACINGS * spacing_m)
    distance_m, _ = tree.query(xy_m, distance_upper_bound=reach_m * (1 + 1e-9))
    return np.isfinite(distance_m)
