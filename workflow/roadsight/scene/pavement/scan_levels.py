"""Scans that share a ground surface: levelled on each other, and where each was taken from.

A registered cloud holds each scan with an error of its own, a few centimetres up or down and a few
millirad of tilt. Seen as one cloud that is a thick layer, and the thickness hides kerbs. Where
scans are told apart (``point_source_id``) the error is measured on the cells that they share and
removed.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable

import numpy as np
from scipy import ndimage

from roadsight.base.arrays import Bools, Floats, Ints
from roadsight.scene.grids import Grid

_CELL_M = 0.4  # Shared cells: wide enough to be hit by several scans, narrower than a kerb's strip.
_ROUNDS = 4  # Means and planes in turn; the planes change by less than 0.1 mm after the third.
_FLAT_M = 0.08  # A scan's points in one cell that spread more are not on flat ground.
_FEWEST = 100  # Shared cells below which a scan keeps its heights.


def level_scans(xyz_m: Floats, scan: Ints) -> tuple[Floats, Floats]:
    """Heights with the scans' offsets and tilts removed.

    Parameters
    ----------
    xyz_m : (n, 3) points near the ground, local metres. scan : (n,) number of each point's scan.

    Returns
    -------
    heights : (n,) metres. shifts : (scans, 3) offset at the middle of the cloud, and rise towards
    east and north per metre, of each scan in the order of ``np.unique(scan)``; zero for a single
    scan and for one that shares too few cells.
    """
    ids, number = np.unique(scan, return_inverse=True)
    if len(ids) < 2 or len(xyz_m) == 0:
        return xyz_m[:, 2].copy(), np.zeros((len(ids), 3))
    middle = xyz_m.mean(axis=0)
    grid = Grid.around(xyz_m[:, 0], xyz_m[:, 1], _CELL_M)
    cell = grid.flat(xyz_m[:, 0], xyz_m[:, 1])
    pair, means, spread, count = _cell_means(cell * len(ids) + number, xyz_m - middle)
    cell, owner = pair // len(ids), pair % len(ids)
    flat = (count >= 2) & (spread < _FLAT_M)
    design = np.column_stack([np.ones(len(means)), means[:, :2]])
    shifts = np.zeros((len(ids), 3))
    for _ in range(_ROUNDS):
        level = means[:, 2] - (design * shifts[owner]).sum(axis=1)
        shared = np.bincount(cell, flat, minlength=grid.rows * grid.columns)
        total = np.bincount(cell, flat * level, minlength=len(shared))
        off = level - (total / np.maximum(shared, 1))[cell]
        used = flat & (shared[cell] >= 2)
        for one in range(len(ids)):
            rows = used & (owner == one)
            if rows.sum() >= _FEWEST:
                shifts[one] += robust_plane(design[rows], off[rows])
        shifts -= shifts.mean(axis=0)
    points = np.column_stack([np.ones(len(xyz_m)), xyz_m[:, :2] - middle[:2]])
    return xyz_m[:, 2] - (points * shifts[number]).sum(axis=1), shifts


def _cell_means(key: Ints, xyz_m: Floats) -> tuple[Ints, Floats, Floats, Ints]:
    """Distinct keys, mean position, standard deviation of height and number of points of each."""
    order = np.argsort(key, kind="stable")
    distinct, start = np.unique(key[order], return_index=True)
    count = np.diff(np.append(start, len(key)))
    means = np.add.reduceat(xyz_m[order], start) / count[:, None]
    square = np.add.reduceat(xyz_m[order, 2] ** 2, start) / count
    return distinct, means, np.sqrt(np.maximum(square - means[:, 2] ** 2, 0.0)), count


def robust_plane(design: Floats, height_m: Floats) -> Floats:
    """Plane (3,) by reweighted least squares with Cauchy weights at twice the spread."""
    weight: Floats = np.ones(len(height_m))
    plane: Floats = np.zeros(3)
    for _ in range(5):
        plane = np.asarray(
            np.linalg.lstsq(design * weight[:, None], height_m * weight, rcond=None)[0], np.float64
        )
        off = height_m - design @ plane
        spread = 1.4826 * float(np.median(np.abs(off))) + 1e-4
        weight = 1.0 / np.sqrt(1.0 + (off / (2.0 * spread)) ** 2)
    return plane


# Scans, at even steps, that are asked for their blind disc: it tells vehicles from strips.
_ASKED_SCANS = 40
# Points up to this above the lowest of their cell of 1 m: ground, with registration errors of some
# centimetres, a kerb and a slope of 30 % across the cell.
_LOW_M = 0.5


def count_scans(parts: Callable[[], Iterable[tuple[Floats, Ints]]]) -> dict[str, float]:
    """Scans of a cloud, and how many of them tell where their scanner stood.

    Parameters
    ----------
    parts : gives positions (n, 3) and scan numbers (n,) of parts of the cloud made of whole cells
        of 1 m; asked twice, so that only points of the scans that count are held.

    Returns
    -------
    number : of scans. blind_share : of the scans asked, those with a blind disc below the scanner.
    """
    numbers = np.unique(np.concatenate([np.unique(scan) for _, scan in parts()]))
    if len(numbers) < 2:
        return {"number": len(numbers), "blind_share": 0.0}
    steps = np.linspace(0, len(numbers) - 1, min(_ASKED_SCANS, len(numbers)))
    asked = numbers[np.unique(steps.round().astype(np.int64))]
    held_xyz, held_scan = [], []
    for xyz_m, scan in parts():
        grid = Grid.around(xyz_m[:, 0], xyz_m[:, 1], 1.0)
        cell = grid.flat(xyz_m[:, 0], xyz_m[:, 1])
        lowest = np.full(grid.rows * grid.columns, np.inf)
        np.minimum.at(lowest, cell, xyz_m[:, 2])
        wanted = np.isin(scan, asked) & (xyz_m[:, 2] - lowest[cell] < _LOW_M)
        held_xyz.append(xyz_m[wanted])
        held_scan.append(scan[wanted])
    _, sure = scanner_positions(np.concatenate(held_xyz), np.concatenate(held_scan))
    # A scan without a point near the ground is none that tells.
    return {"number": len(numbers), "blind_share": float(sure.sum() / len(asked))}


_BLIND_M = 4.0  # Widest blind disc below a turning scanner on a vehicle that is told from a shadow.
_LEAST_BLIND_M = 1.5  # Narrowest: a scanner at 1.7 m whose lowest beam falls by 49 degrees.
_NEXT_M = 10.0  # A vehicle is so near when it takes another scan: a third of a second at 30 m/s.
# Points around a blind disc against the scan's median: 1.14 to 15 below vehicles (five streets, a
# drive, generated streets of 50 m), up to 1.0 in gaps of airborne strips.
_DENSER = 1.1
# The same against the scan's densest tenth: 0.60 to 1.15 below vehicles, up to 0.52 in gaps of
# strips and of whole drives that are one scan.
_DENSEST = 0.55
# Cells of a scan's box beyond which it is a drive or a strip, not a turn of a scanner.
_WIDEST_CELLS = 4_000_000


def scanner_positions(xyz_m: Floats, scan: Ints, cell_m: float = 0.25) -> tuple[Floats, Bools]:
    """Where the scanner of each scan stood, from the blind disc below it.

    A turning scanner sees nothing just below itself, and its points thin out with distance: the
    disc without a point that has most points around it is where the vehicle was. Against known
    positions of 50 scans: 0.1 to 0.7 m off (see the report); an airborne strip has no such disc.

    Parameters
    ----------
    xyz_m : (n, 3) points near the ground. scan : (n,) their scans. cell_m : side of a cell.

    Returns
    -------
    xy : (scans, 2) positions. sure : (scans,) whether there is a blind disc of at least 1.5 m with
    as many points around it as where the scan is dense, or beside that of a scan where it is so.
    """
    found, sure, wide = [], [], []
    for one in np.unique(scan):
        points = xyz_m[scan == one]
        grid = Grid.around(points[:, 0], points[:, 1], cell_m)
        size = grid.rows * grid.columns
        if size > _WIDEST_CELLS or len(points) < 1000:
            found.append((np.nan, np.nan))
            sure.append(False)
            wide.append(False)
            continue
        count = np.bincount(grid.flat(points[:, 0], points[:, 1]), minlength=size)
        count = count.reshape(grid.shape).astype(np.float64)
        density = ndimage.gaussian_filter(count, 3.0 / cell_m, mode="constant")
        empty = ndimage.distance_transform_edt(count == 0) * cell_m
        score = density * np.minimum(empty, _BLIND_M) ** 2
        best = np.unravel_index(int(np.argmax(score)), score.shape)
        x, y = grid.centres(best[1], best[0])
        typical, dense = np.percentile(density[count > 0], [50, 90])
        least = max(_DENSER * typical, _DENSEST * dense)
        found.append((float(x), float(y)))
        wide.append(bool(empty[best] >= _LEAST_BLIND_M))
        sure.append(bool(wide[-1] and density[best] > least))
    xy, is_sure = np.array(found).reshape(-1, 2), np.array(sure, dtype=bool)
    # Of a map that keeps one point a cell only the first scans are dense around their discs: others
    # are sure if their disc is wide and a sure one is near. Of two sure ones neither is chance.
    if is_sure.sum() >= 2:
        off = np.hypot(*(xy[:, None] - xy[None, is_sure]).transpose(2, 0, 1))
        is_sure = is_sure | (np.array(wide, dtype=bool) & (off <= _NEXT_M).any(axis=1))
    return xy, is_sure


# Turns of a scanner that do not close: a step along the ray where each turn begins and ends.
#
# A turn takes a tenth of a second, in which the vehicle moves, pitches and heaves. What is left
# of that grows with the time since the turn began, so that its last rays meet the first ones at
# another height. All turns of a drive show that step along the same ray, usually straight behind
# the vehicle: down the middle of the street, as high as a kerb.

# Part of a ray that is looked at: from beyond the blind disc to where rings are 2 m apart.
_NEAREST_M, _FARTHEST_M = 3.0, 25.0
_RING_M = 1.0  # Length of the parts of a ray; each tells a step of its own.
_RINGS = round((_FARTHEST_M - _NEAREST_M) / _RING_M)
# Parts that tell a turn's step by their median: a kerb crosses a ray in one or two.
_FEWEST_RINGS = 6
_OFF_M = 0.8  # A scanner's place is known to 0.7 m, so that the ray may run so far beside it.
_STRIP_M = 0.1  # Width of strips along the ray, in which points are summed.
# Strips of each of two groups on either side, which tell the slope there too: two groups are
# narrower than a gutter is away from where a vehicle drives.
_STRIPS = 3
_FEWEST_POINTS = 3  # In each group.
_HALF_WIDTH_M = _OFF_M + 2 * _STRIPS * _STRIP_M
_ACROSS = round(2 * _HALF_WIDTH_M / _STRIP_M)
# Between rays that are tried first: of a seam between two of them a group of strips holds 17 m.
_COARSE_DEG = 2.0
_AROUND_DEG = 5.0  # Directions of travel are known so well: places 0.3 m off, on a way of 5 m.
# Between rays that each turn tries around the common one: a strip's width at half the way.
_FINE_DEG = 0.5
_ASKED_TURNS = 40  # Turns, at even steps, that are asked for the common ray; 0.1 CPU s each.
_ALMOST = 0.9  # Rays and offsets that show so much of the highest step are averaged.
# Lower steps are left, twice what counts as a step. Of five streets with ten turns each, the turns
# of one share a step of 16 cm, straight behind the vehicle; those of the others at most 1.7 cm,
# along any ray.
_LEAST_STEP_M = 0.04
# Share of the turns whose step has the median's sign and at least half of its height.
_ALIKE_SHARE = 0.7
_MOVED_M = 5.0  # A way that tells a direction: places are up to 0.7 m off.


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
    steps_m = np.array([[_highest(one.steps_m(ray)) for ray in rays] for one in asked])
    # The step that most turns show along each ray, else 0.
    median = np.nanmedian(np.where(np.isfinite(steps_m).any(axis=0), steps_m, 0.0), axis=0)
    with np.errstate(invalid="ignore"):
        alike = (steps_m * np.sign(median) >= 0.5 * np.abs(median)).sum(axis=0)
    common = np.where(alike >= _ALIKE_SHARE * len(steps_m), median, 0.0)
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
