"""Turns of a scanner that do not close: a step along the ray where each turn begins and ends.

A turn takes a tenth of a second, in which the vehicle moves, pitches and heaves. What is left of
that grows with the time since the turn began, so that its last rays meet the first ones at another
height. All turns of a drive show that step along the same ray, usually straight behind the vehicle:
down the middle of the street, as high as a kerb.
"""

from __future__ import annotations

import numpy as np

from roadsight.base.arrays import Bools, Floats, Ints

_NEAREST_M, _FARTHEST_M = 3.0, 25.0
"""Part of a ray that is looked at: from beyond the blind disc to where rings are 2 m apart."""
_RING_M = 1.0
"""Length of the parts of a ray; each tells a step of its own."""
_RINGS = round((_FARTHEST_M - _NEAREST_M) / _RING_M)
_FEWEST_RINGS = 6
"""Parts that tell a turn's step by their median: a kerb crosses a ray in one or two."""
_OFF_M = 0.8
"""A scanner's place is known to 0.7 m, so that the ray may run so far beside it."""
_STRIP_M = 0.1
"""Width of strips along the ray, in which points are summed."""
_STRIPS = 3
"""Strips of each of two groups on either side, which tell the slope there too: two groups are
narrower than a gutter is away from where a vehicle drives."""
_FEWEST_POINTS = 3
"""In each group."""
_HALF_WIDTH_M = _OFF_M + 2 * _STRIPS * _STRIP_M
_ACROSS = round(2 * _HALF_WIDTH_M / _STRIP_M)
_COARSE_DEG = 2.0
"""Between rays that are tried first: of a seam between two of them a group of strips holds 17 m."""
_AROUND_DEG = 5.0
"""Directions of travel are known so well: places 0.3 m off, on a way of 5 m."""
_FINE_DEG = 0.5
"""Between rays that each turn tries around the common one: a strip's width at half the way."""
_ASKED_TURNS = 40
"""Turns, at even steps, that are asked for the common ray; 0.1 CPU s each."""
_ALMOST = 0.9
"""Rays and offsets that show so much of the highest step are averaged."""
_LEAST_STEP_M = 0.04
"""Lower steps are left, twice what counts as a step. Of five streets with ten turns each, the turns
of one share a step of 16 cm, straight behind the vehicle; those of the others at most 1.7 cm, along
any ray."""
_ALIKE_SHARE = 0.7
"""Share of the turns whose step has the median's sign and at least half of its height."""
_MOVED_M = 5.0
"""A way that tells a direction: places are up to 0.7 m off."""


def close_turns(xyz_m: Floats, scan: Ints, places_m: Floats, sure: Bools) -> tuple[Floats, float]:
    """Heights with the steps taken out that all turns show along one ray, each over its whole turn.

    A step that the opposite ray shows too is of the street, and stays.

    Parameters
    ----------
    xyz_m : (n, 3) points near the ground, local metres. scan : (n,) number of each point's turn.
    places_m : (scans, 2) where scanners stood, in the order of ``np.unique(scan)``. sure : (scans,)
    whether that is known.

    Returns
    -------
    heights : (n,) metres. step_m : median of the asked turns' steps; 0 where turns close.
    """
    heights = np.array(xyz_m[:, 2], np.float64)
    if sure.sum() < 2:
        return heights, 0.0
    places_m = places_m[sure]
    members = [np.flatnonzero(scan == one) for one in np.unique(scan)[sure]]
    headings = _headings(places_m)

    def turn(k: int) -> _Turn:
        return _Turn(xyz_m[members[k]], places_m[k], float(headings[k]))

    asked = [turn(k) for k in range(0, len(members), -(-len(members) // _ASKED_TURNS))]
    rays = np.radians(np.arange(0.0, 360.0, _COARSE_DEG))
    common = _common(np.array([[_highest(one.steps_m(ray)) for ray in rays] for one in asked]))
    best = int(np.argmax(np.abs(common)))
    step_m, opposite_m = common[best], common[best - len(rays) // 2]
    if abs(step_m) < max(_LEAST_STEP_M, 2.0 * abs(opposite_m)):
        return heights, 0.0
    for k, own in enumerate(members):
        heights[own] -= _ramp_m(xyz_m[own], turn(k), float(rays[best]), float(step_m))
    return heights, abs(float(step_m))


def _headings(places_m: Floats) -> Floats:
    """Direction of travel (k,) at places in order, radians; 0 throughout where none moved."""
    apart = np.hypot(*(places_m[:, None] - places_m[None]).transpose(2, 0, 1))
    found = np.zeros(len(places_m))
    if apart.max() < _MOVED_M:
        return found
    for k, far in enumerate(apart >= _MOVED_M):
        before, after = np.flatnonzero(far[:k]), np.flatnonzero(far[k:])
        first = before[-1] if len(before) else 0
        last = k + after[0] if len(after) else len(places_m) - 1
        way = places_m[last] - places_m[first]
        found[k] = np.arctan2(way[1], way[0])
    return found


class _Turn:
    """Points of one turn around their scanner, rays counted from its direction of travel."""

    def __init__(self, xyz_m: Floats, place_m: Floats, heading: float) -> None:
        self.place_m, self.heading = place_m, heading
        off = xyz_m[:, :2] - place_m
        away = np.hypot(*off.T)
        near = np.flatnonzero((away >= _NEAREST_M) & (away < _FARTHEST_M + _HALF_WIDTH_M))
        azimuth = np.mod(np.arctan2(off[near, 1], off[near, 0]) - heading, 2 * np.pi)
        order = np.argsort(azimuth, kind="stable")
        near = near[order]
        self._azimuth, self._away_m, self._z_m = azimuth[order], away[near], xyz_m[near, 2]

    def steps_m(self, ray: float) -> Floats:
        """Steps across lines along a ray, by their offset from it; positive: higher on the left.

        Of offsets from ``-_OFF_M`` to ``_OFF_M``, NaN where too few parts tell a step.
        """
        half = np.arctan2(_HALF_WIDTH_M, _NEAREST_M)
        middle = np.mod(ray, 2 * np.pi) + 2 * np.pi * np.array([-1.0, 0.0, 1.0])
        first, end = (np.searchsorted(self._azimuth, middle + side) for side in (-half, half))
        own = np.concatenate([np.arange(i, j) for i, j in zip(first, end, strict=True)])
        turned = self._azimuth[own] - ray
        along, across = self._away_m[own] * (np.cos(turned), np.sin(turned))
        ring = np.floor((along - _NEAREST_M) / _RING_M).astype(np.int64)
        strip = np.floor((across + _HALF_WIDTH_M) / _STRIP_M).astype(np.int64)
        inside = (ring >= 0) & (ring < _RINGS) & (strip >= 0) & (strip < _ACROSS)
        cell = (ring * _ACROSS + strip)[inside]
        count = _grouped(np.bincount(cell, minlength=_RINGS * _ACROSS))
        total = _grouped(np.bincount(cell, self._z_m[own][inside], _RINGS * _ACROSS))
        mean = np.where(count >= _FEWEST_POINTS, total / np.maximum(count, 1), np.nan)
        last = mean.shape[1] - 3 * _STRIPS
        right, own_right, own_left, left = (
            mean[:, i * _STRIPS : i * _STRIPS + last] for i in range(4)
        )
        # The slope on either side is none of the step.
        steps = own_left - own_right - 0.5 * (own_right - right + left - own_left)
        number = np.isfinite(steps).sum(axis=0)
        middle_row = np.maximum(number - 1, 0) // 2
        median = np.take_along_axis(np.sort(steps, axis=0), middle_row[None], axis=0)[0]
        return np.where(number >= _FEWEST_RINGS, median, np.nan)


def _grouped(cells: Floats | Ints) -> Floats:
    """Sums of neighbouring strips in each ring."""
    sums = np.pad(np.cumsum(cells.reshape(_RINGS, _ACROSS), axis=1), ((0, 0), (1, 0)))
    return np.asarray(sums[:, _STRIPS:] - sums[:, :-_STRIPS], np.float64)


def _highest(steps_m: Floats) -> float:
    """The step farthest from 0, NaN of none."""
    known = np.abs(np.nan_to_num(steps_m))
    return float(steps_m[np.argmax(known)]) if known.any() else np.nan


def _common(steps_m: Floats) -> Floats:
    """Step (k,) that most turns show along each ray, of (turns, k); else 0."""
    median = np.nanmedian(np.where(np.isfinite(steps_m).any(axis=0), steps_m, 0.0), axis=0)
    with np.errstate(invalid="ignore"):
        alike = (steps_m * np.sign(median) >= 0.5 * np.abs(median)).sum(axis=0)
    return np.where(alike >= _ALIKE_SHARE * len(steps_m), median, 0.0)


def _ramp_m(xyz_m: Floats, turn: _Turn, ray: float, step_m: float) -> Floats:
    """Error (n,) of a turn's heights, from half a step on the left of its ray to minus half.

    Places and headings are known to decimetres and degrees, so that each turn tells its own ray.
    """
    rays = ray + np.radians(np.arange(-_AROUND_DEG, _AROUND_DEG + _FINE_DEG / 2, _FINE_DEG))
    steps = np.sign(step_m) * np.array([turn.steps_m(one) for one in rays])
    steps = np.where(steps >= 0.5 * abs(step_m), steps, 0.0)
    if steps.any():
        step_m = float(np.sign(step_m) * steps.max())
    i, j = np.nonzero(steps >= _ALMOST * max(steps.max(), 1e-9))
    ray = float(rays[i].mean()) if len(i) else ray
    off_m = float(j.mean()) * _STRIP_M - _OFF_M if len(j) else 0.0
    azimuth = turn.heading + ray
    beside = off_m * np.array([-np.sin(azimuth), np.cos(azimuth)])
    off = xyz_m[:, :2] - (turn.place_m + beside)
    share = np.mod(np.arctan2(off[:, 1], off[:, 0]) - azimuth, 2 * np.pi) / (2 * np.pi)
    return np.asarray(step_m * (0.5 - share), np.float64)
