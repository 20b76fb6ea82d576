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

_CELL_M = 0.4
"""Shared cells: wide enough to be hit by several scans, narrower than a kerb's strip."""
_ROUNDS = 4
"""Means and planes in turn; the planes change by less than 0.1 mm after the third."""
_FLAT_M = 0.08
"""A scan's points in one cell that spread more are not on flat ground."""
_FEWEST = 100
"""Shared cells below which a scan keeps its heights."""
_BLIND_M = 4.0
"""Widest blind disc below a turning scanner on a vehicle that is told from a shadow."""
_LEAST_BLIND_M = 1.5
"""Narrowest: a scanner at 1.7 m whose lowest beam falls by 49 degrees."""
_NEXT_M = 10.0
"""A vehicle is so near when it takes another scan: a third of a second at 30 m/s."""


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
                shifts[one] += _robust_plane(design[rows], off[rows])
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


def _robust_plane(design: Floats, height_m: Floats) -> Floats:
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


_ASKED_SCANS = 40
"""Scans, at even steps, that are asked for their blind disc: it tells vehicles from strips."""
_LOW_M = 0.5
"""Points up to this above the lowest of their cell of 1 m: ground, with registration errors of some
centimetres, a kerb and a slope of 30 % across the cell."""
_DENSER = 1.1
"""Points around a blind disc against the scan's median: 1.14 to 15 below vehicles (five streets, a
drive, generated streets of 50 m), up to 1.0 in gaps of airborne strips."""
_DENSEST = 0.55
"""The same against the scan's densest tenth: 0.60 to 1.15 below vehicles, up to 0.52 in gaps of
strips and of whole drives that are one scan."""
_WIDEST_CELLS = 4_000_000
"""Cells of a scan's box beyond which it is a drive or a strip, not a turn of a scanner."""


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
        wanted = np.isin(scan, asked) & _is_low(xyz_m)
        held_xyz.append(xyz_m[wanted])
        held_scan.append(scan[wanted])
    _, sure = scanner_positions(np.concatenate(held_xyz), np.concatenate(held_scan))
    # A scan without a point near the ground is none that tells.
    return {"number": len(numbers), "blind_share": float(sure.sum() / len(asked))}


def _is_low(xyz_m: Floats) -> Bools:
    """Points (n,) that lie low in their cell of 1 m: ground where there is any, at little cost."""
    grid = Grid.around(xyz_m[:, 0], xyz_m[:, 1], 1.0)
    cell = grid.flat(xyz_m[:, 0], xyz_m[:, 1])
    lowest = np.full(grid.rows * grid.columns, np.inf)
    np.minimum.at(lowest, cell, xyz_m[:, 2])
    return np.asarray(xyz_m[:, 2] - lowest[cell] < _LOW_M, bool)


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
    xy = np.array(found).reshape(-1, 2)
    return xy, _with_neighbours(xy, np.array(sure, dtype=bool), np.array(wide, dtype=bool))


def _with_neighbours(xy: Floats, sure: Bools, wide: Bools) -> Bools:
    """Scans (n,) that are sure, or have a wide disc where a sure one near them has its own.

    Of a map that keeps one point a cell only the first scans are dense around their discs. Of two
    sure ones neither is chance.
    """
    if sure.sum() < 2:
        return sure
    off = np.hypot(*(xy[:, None] - xy[None, sure]).transpose(2, 0, 1))
    return np.asarray(sure | (wide & (off <= _NEXT_M).any(axis=1)), bool)
