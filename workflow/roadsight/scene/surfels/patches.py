"""Square patches of surface over the cells of a grid, and their merging.

A patch is a plane over one square cell of a grid that is normal to the patch's dominant axis (the
axis nearest to its normal). Neighbouring patches of one surface share their cells' borders, so that
they close it without overlapping, and four of them make one of twice the size where they agree.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from roadsight.base.arrays import Bools, Floats, Ints
from roadsight.base.kernels import compiled, compiled_part


class Patches(NamedTuple):
    """Patches of one size.

    Parameters
    ----------
    axis : (n,) dominant axis k: 0, 1, 2 for x, y, z; u and v are the next two, cyclically.
    cell : (n, 2) indices of the cell along u and v, in patch sizes from the local origin.
    height_m : (n,) coordinate along k of the plane at the cell's centre.
    slope : (n, 2) its change along u and v.
    """

    axis: Ints
    cell: Ints
    height_m: Floats
    slope: Floats


def patches_of_planes(
    cells: Ints, normal: NDArray[np.floating], offset: NDArray[np.floating], size_m: float
) -> Patches:
    """Patches of planes through voxels.

    Parameters
    ----------
    cells : (n, 3) voxel indices. normal : (n, 3) unit. offset : (n,) of the plane along its normal
        from the voxel's centre, in voxel edges.
    size_m : edge of a voxel.
    """
    rows = np.arange(len(cells))
    axis = np.abs(normal).argmax(axis=1)
    u, v = (axis + 1) % 3, (axis + 2) % 3
    across = normal[rows, axis].astype(np.float64)
    height_m = (cells[rows, axis] + 0.5 + offset / across) * size_m
    slope = -np.stack([normal[rows, u], normal[rows, v]], axis=1) / across[:, None]
    return Patches(axis, np.stack([cells[rows, u], cells[rows, v]], axis=1), height_m, slope)


def centres_and_normals(patches: Patches, size_m: float) -> tuple[Floats, Floats]:
    """Centre (n, 3), local metres, and unit normal (n, 3) of each patch."""
    n = len(patches.axis)
    rows, axes = np.arange(n), (patches.axis, (patches.axis + 1) % 3, (patches.axis + 2) % 3)
    centre, normal = np.empty((n, 3)), np.empty((n, 3))
    middle_m = (patches.cell + 0.5) * size_m
    for part, axis in zip((patches.height_m, *middle_m.T), axes, strict=True):
        centre[rows, axis] = part
    for part, axis in zip((np.ones(n), *-patches.slope.T), axes, strict=True):
        normal[rows, axis] = part
    return centre, normal / np.linalg.norm(normal, axis=1, keepdims=True)


def no_patches() -> Patches:
    """No patch at all."""
    ints, floats = np.empty(0, np.int64), np.empty(0)
    return Patches(ints, np.empty((0, 2), np.int64), floats, np.empty((0, 2)))


def join(parts: list[Patches]) -> Patches:
    """Patches of one size from several sources."""
    axis, cell, height_m, slope = (np.concatenate(column) for column in zip(*parts, strict=True))
    return Patches(axis, cell, height_m, slope)


def _take(patches: Patches, chosen: NDArray) -> Patches:
    axis, cell, height_m, slope = (column[chosen] for column in patches)
    return Patches(axis, cell, height_m, slope)


def merge_coplanar(patches: Patches, size_m: float, tolerance_m: float) -> tuple[Patches, Patches]:
    """Replace patches that agree by patches of twice the size.

    Patches over the four cells of a larger cell become one if all four are there and none of them
    departs from the mean plane by more than ``tolerance_m`` at a corner.

    Returns
    -------
    merged : patches of twice the size. kept : those patches of the old size that did not merge.
    """
    if len(patches.axis) == 0:
        return patches, patches
    parent = patches.cell >> 1
    lift = ((2 * parent - patches.cell + 0.5) * size_m * patches.slope).sum(axis=1)
    height_m = patches.height_m + lift
    order = np.lexsort((height_m, parent[:, 1], parent[:, 0], patches.axis))
    sorted_patches = _take(patches, order)
    new_column = np.any(np.diff(parent[order], axis=0) != 0, axis=1)
    new_column |= np.diff(sorted_patches.axis) != 0
    new_group = new_column | (np.diff(height_m[order]) > tolerance_m)
    starts = np.concatenate([[0], np.flatnonzero(new_group) + 1, [len(order)]])
    merged, kept = _merge(sorted_patches, height_m[order], starts, size_m, tolerance_m)
    return merged, _take(sorted_patches, kept)


@compiled()
def _merge(
    patches: Patches, height_m: Floats, starts: Ints, size_m: float, tolerance_m: float
) -> tuple[Patches, Bools]:
    """Merge groups between consecutive ``starts``; heights are those at the parents' centres."""
    groups = len(starts) - 1
    axis, cell = np.empty(groups, np.int64), np.empty((groups, 2), np.int64)
    height, slope = np.empty(groups), np.empty((groups, 2))
    kept = np.ones(len(height_m), np.bool_)
    merged = 0
    for group in range(groups):
        begin, end = starts[group], starts[group + 1]
        mean = _mean_plane(patches.slope, height_m, begin, end)
        if not _covers_parent(patches.cell, begin, end):
            continue
        if not _agree(patches, height_m, begin, end, mean, size_m, tolerance_m):
            continue
        axis[merged] = patches.axis[begin]
        cell[merged, 0], cell[merged, 1] = patches.cell[begin, 0] >> 1, patches.cell[begin, 1] >> 1
        height[merged], slope[merged, 0], slope[merged, 1] = mean
        kept[begin:end] = False
        merged += 1
    return Patches(axis[:merged], cell[:merged], height[:merged], slope[:merged]), kept


@compiled_part()
def _covers_parent(cell: Ints, begin: int, end: int) -> bool:
    """Whether all four cells of the parent are present."""
    present = 0
    for i in range(begin, end):
        present |= 1 << (2 * (cell[i, 0] & 1) + (cell[i, 1] & 1))
    return present == 15


@compiled_part()
def _mean_plane(
    slope: Floats, height_m: Floats, begin: int, end: int
) -> tuple[float, float, float]:
    height, along_u, along_v = 0.0, 0.0, 0.0
    for i in range(begin, end):
        height += height_m[i]
        along_u += slope[i, 0]
        along_v += slope[i, 1]
    count = end - begin
    return height / count, along_u / count, along_v / count


@compiled_part()
def _agree(
    patches: Patches,
    height_m: Floats,
    begin: int,
    end: int,
    mean: tuple[float, float, float],
    size_m: float,
    tolerance_m: float,
) -> bool:
    """Whether every patch is within the tolerance of the mean plane over its cell."""
    for i in range(begin, end):
        du, dv = patches.slope[i, 0] - mean[1], patches.slope[i, 1] - mean[2]
        u = ((patches.cell[i, 0] & 1) - 0.5) * size_m
        v = ((patches.cell[i, 1] & 1) - 0.5) * size_m
        gap_m = abs(height_m[i] - mean[0] + du * u + dv * v)
        if gap_m + (abs(du) + abs(dv)) * size_m / 2 > tolerance_m:
            return False
    return True
