"""A cloud as oriented surfels: small squares that close its surfaces.

A surfel is the part of its plane over a square cell of edge ``2 half_m`` that is normal to the axis
nearest to its normal: surfels of one surface meet at their cells' borders whatever its tilt.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from roadsight.base.arrays import Bools, Floats, Floats32, Ints, Numbers
from roadsight.base.engines import OWN, Engine, open3d
from roadsight.base.kernels import compiled, compiled_part
from roadsight.scene.voxel_planes import (
    Planes,
    VoxelMoments,
    coarsen,
    fit_planes,
    open_neighbours,
    pack_cells,
    unpack_keys,
)

_COARSEST_M = 0.8  # sparse parts get voxels up to this edge, or two doublings
_MERGE_DOUBLINGS = 5  # flat parts get patches up to 2**5 times as large
_MIN_POINTS = 12  # points of a neighbourhood that carry a plane and its coverage
_HOLE_POINTS = 5  # points around an empty voxel that carry a plane
_FLAT = 0.08  # variance across a flat neighbourhood, squared voxel edges
_FLATTER = 0.35  # times that for each doubling, or twigs and wires pass for sparse surfaces
_WIDE = 0.25  # variance along both axes of a wide surface, squared voxel edges
_NEAR = 0.05  # points this near to a plane are on it, whatever its spread, voxel edges
_CLOSE = 0.8  # an empty voxel is a hole if its neighbours' centroid is this near, voxel edges
_OVERLAP = 0.1  # surfels extend this far beyond their cell, finest voxel edges
_MERGE = 0.2  # merged patches depart this far from their parts, finest voxel edges
_LONE_HALF = 0.25  # half edge of the crossed squares of a lone voxel, voxel edges


@dataclass(frozen=True)
class Surfels:
    """Oriented squares.

    Parameters
    ----------
    centre_m : (n, 3) local metres. normal : (n, 3) unit, sign arbitrary. half_m : (n,).
    """

    centre_m: Floats32
    normal: Floats32
    half_m: Floats32

    def __len__(self) -> int:
        return len(self.half_m)


def build_surfels(voxels: VoxelMoments, own: Bools | None = None) -> Surfels:
    """Surfels of a cloud given by its moments in the finest voxels.

    Planes come from 3 x 3 x 3 voxels; where these hold too few points, or points on one line only,
    from voxels twice as large, and so on. Empty voxels amid a flat neighbourhood are filled. What
    is no surface at any size (wires, twigs, stray points) becomes small crossed squares. At last
    patches that agree merge.

    Parameters
    ----------
    own : (n,) voxels that become surfels; the others only help to find their planes. None: all.
    """
    by_size, thin = _fit_patches(voxels, own)
    by_size += [no_patches()] * (_MERGE_DOUBLINGS + 1 - len(by_size))
    parts, merged = [_thin_surfels(thin, voxels)], no_patches()
    for doubling, part in enumerate(by_size):
        size_m, patches = voxels.edge_m * 2**doubling, join([merged, part])
        if doubling < len(by_size) - 1:
            merged, patches = merge_coplanar(patches, size_m, _MERGE * voxels.edge_m)
        centre, normal = centres_and_normals(patches, size_m)
        half_m = np.full(len(centre), size_m / 2 + _OVERLAP * voxels.edge_m)
        parts.append(_as_surfels(centre, normal, half_m))
    return concatenate(parts)


def _fit_patches(voxels: VoxelMoments, own: Bools | None) -> tuple[list[Patches], Ints]:
    """Patches of each size, finest first, and keys of the finest voxels that carry none."""
    finest, cells = voxels.keys, unpack_keys(voxels.keys)
    points = cells + 0.5 + voxels.moments[:, 1:4] / voxels.moments[:, :1]
    pending = np.arange(len(finest)) if own is None else np.flatnonzero(own)
    by_size, thin = [], []
    doublings = max(round(np.log2(_COARSEST_M / voxels.edge_m)), 2)
    for level in range(doublings + 1):
        flat = _FLAT * _FLATTER**level
        keys, member = np.unique(pack_cells(cells[pending] >> level), return_inverse=True)
        planes = fit_planes(keys, voxels, _MIN_POINTS, flat)
        settled = (planes.points >= _MIN_POINTS) & (planes.variance[:, 1] > flat)
        coarser = coarsen(voxels)
        good = settled
        if level:
            sparse = settled & (planes.spread <= flat)
            if level > 1:
                # Sparse ground goes on over voxels of twice the edge; parallel wires, and stray
                # points beside an object, span no wide plane.
                parents, child = np.unique(pack_cells(unpack_keys(keys) >> 1), return_inverse=True)
                wide = fit_planes(parents, coarser, _MIN_POINTS, flat * _FLATTER)
                goes_on = (wide.spread <= flat * _FLATTER) & (wide.variance[:, 1] > _WIDE)
                sparse &= goes_on[child]
            away = points[pending] / 2**level - unpack_keys(keys[member]) - 0.5
            away = away * planes.normal[member]
            distance = np.abs(away.sum(axis=1) - planes.offset[member])
            near = distance <= 2.5 * np.sqrt(planes.spread[member]) + _NEAR
            thin.append(finest[pending[settled[member] & ~(sparse[member] & near)]])
            good = sparse & (np.bincount(member[near], minlength=len(keys)) > 0)
        holes = _holes(keys, planes, good, voxels, flat)
        by_size.append(join([_patches(keys, planes, good, voxels.edge_m), holes]))
        pending, voxels = pending[~settled[member]], coarser
    thin.append(finest[pending])
    return by_size, np.sort(np.concatenate(thin))


def _patches(keys: Ints, planes: Planes, chosen: Bools, size_m: float) -> Patches:
    cells = unpack_keys(keys[chosen])
    return patches_of_planes(cells, planes.normal[chosen], planes.offset[chosen], size_m)


def _holes(keys: Ints, planes: Planes, good: Bools, voxels: VoxelMoments, flat: float) -> Patches:
    """Patches in empty voxels whose neighbours surround them in one plane."""
    flat_around = good & (planes.variance[:, 0] <= flat)
    found = open_neighbours(
        keys[flat_around], Planes(*(column[flat_around] for column in planes)), voxels
    )
    around = fit_planes(found, voxels, _HOLE_POINTS, flat)
    steepest = np.abs(around.normal).max(axis=1, initial=1e-6)
    beside = around.centroid - around.offset[:, None] * around.normal
    hole = (
        (around.points >= _HOLE_POINTS)
        & (around.spread <= flat)
        & (np.linalg.norm(beside, axis=1) <= _CLOSE)
        & (np.abs(around.offset) <= 0.5 * steepest)
    )
    return _patches(found, around, hole, voxels.edge_m)


def _thin_surfels(keys: Ints, voxels: VoxelMoments) -> Surfels:
    """Crossed squares along lines, and around lone points."""
    planes = fit_planes(keys, voxels, 1, np.inf)
    linear = (planes.variance[:, 1] <= _FLAT) & (planes.variance[:, 2] > _FLAT)
    cells = unpack_keys(keys) + 0.5
    rows = np.searchsorted(voxels.keys, keys[~linear])
    own = voxels.moments[rows, 1:4] / voxels.moments[rows, :1]
    lines = _line_surfels(cells[linear], Planes(*(column[linear] for column in planes)), voxels)
    lone = np.repeat((cells[~linear] + own) * voxels.edge_m, 3, axis=0)
    normal = np.tile(np.eye(3), (len(own), 1))
    half_m = np.full(len(lone), _LONE_HALF * voxels.edge_m)
    return concatenate([lines, _as_surfels(lone, normal, half_m)])


def _line_surfels(cells: NDArray[np.floating], planes: Planes, voxels: VoxelMoments) -> Surfels:
    """Squares as wide as the line is thick, strung along it through each voxel, in two planes."""
    half = np.clip(np.sqrt(3 * planes.variance[:, 1]), 0.1, 0.5)
    length = 1 / np.abs(planes.axis).max(axis=1, initial=0.5)
    count = np.ceil(length / (2 * half)).astype(np.int64)
    line = np.repeat(np.arange(len(cells)), count)
    place = np.arange(len(line)) - np.repeat(np.cumsum(count) - count, count)
    along = ((place + 0.5) / count[line] - 0.5) * length[line]
    middle = planes.centroid - (planes.centroid * planes.axis).sum(axis=1)[:, None] * planes.axis
    centre = (cells + middle)[line] + along[:, None] * planes.axis[line]
    # Across the axes, the normals where they are. Points on a perfect line lie in any plane through
    # it, and the fitted normal may lie along it: one across the coordinate axis that is least along
    # the line will do.
    least = np.eye(3)[np.abs(planes.axis).argmin(axis=1)]
    lost = np.abs((planes.axis * planes.normal).sum(axis=1)) > 0.5
    second = np.cross(planes.axis, np.where(lost[:, None], least, planes.normal))
    across = np.cross(second, planes.axis)
    first = across / np.linalg.norm(across, axis=1, keepdims=True)
    normal = np.concatenate([first[line], np.cross(planes.axis, first)[line]])
    half_m = np.tile(half[line] * voxels.edge_m, 2)
    return _as_surfels(np.tile(centre * voxels.edge_m, (2, 1)), normal, half_m)


def _as_surfels(centre_m: NDArray, normal: NDArray, half_m: NDArray) -> Surfels:
    return Surfels(*(part.astype(np.float32) for part in (centre_m, normal, half_m)))


def concatenate(parts: list[Surfels]) -> Surfels:
    """Surfels of several lists, one after the other."""
    return Surfels(
        np.concatenate([part.centre_m for part in parts]),
        np.concatenate([part.normal for part in parts]),
        np.concatenate([part.half_m for part in parts]),
    )


# Square patches of surface over the cells of a grid, and their merging.
#
# A patch is a plane over one square cell of a grid that is normal to the patch's dominant axis
# (the axis nearest to its normal). Neighbouring patches of one surface share their cells'
# borders, so that they close it without overlapping, and four of them make one of twice the size
# where they agree.


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


# Points that stand alone: birds, dust, multipath. Radius outlier removal before surfels are
# built.
#
# A point stays that has at least so many others within a radius. The test is local: it needs no
# statistic of the whole cloud, so that tiles decide alike, and distant sparse ground is not
# judged by the spacing beside the scanner (docs/decisions/075-engines-and-kept-libraries.md).


def in_company(
    xyz_m: Numbers, around_m: Numbers, radius_m: float, others: int, engine: Engine = OWN
) -> Bools:
    """Points (n,) with at least ``others`` other points nearer than ``radius_m``.

    Parameters
    ----------
    xyz_m : (n, 3) points to judge, local metres. around_m : (m, 3) points that count, too.
    engine : who counts.

    Raises
    ------
    InputError : the engine open3d cannot be loaded.
    """
    n = len(xyz_m)
    if n == 0:
        return np.zeros(0, bool)
    both = np.concatenate([xyz_m, around_m]).astype(np.float64)
    if engine == "own":
        if len(both) <= others:
            return np.zeros(n, bool)
        farthest = cKDTree(both).query(both[:n], k=[others + 1], distance_upper_bound=radius_m)[0]
        return np.isfinite(farthest[:, 0])
    o3d = open3d("lidar.outlier_engine")
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(both))
    _, kept = cloud.remove_radius_outlier(others, radius_m)
    mask = np.zeros(len(both), bool)
    mask[np.asarray(kept, np.int64)] = True
    return mask[:n]


# Surfels whose size follows the density where they are.
#
# One voxel size for a whole cloud lets sparse points anywhere coarsen the surfaces everywhere.
# Here the scene is divided into blocks, and each block gets voxels about as large as the spacing
# of its own points.

# Blocks are 2**6 of the finest voxels wide (6.4 m of 0.1 m): some thousand points of a mobile
# cloud, some hundred of an airborne one, and finer than density changes along a road.
_BLOCK_DOUBLINGS = 6
# Voxels are up to 2**5 times the finest ones (3.2 m): sparser points span no surface.
_MOST_DOUBLINGS = 5
# A block with fewer carries no plane: its points stay what they are, in the finest voxels; large
# ones would string them up as wires.
_FEWEST_POINTS = 12
# Blocks around those of a size that its surfels may draw on; they reach a few voxels at most.
_MARGIN_BLOCKS = 1


def build_local_surfels(voxels: VoxelMoments) -> Surfels:
    """Surfels of a cloud given by its moments in the finest voxels.

    Blocks whose points lie farther apart than the finest voxels take voxels twice as large, and so
    on. What lies in one block does not hang on others, but for those beside it.
    """
    if not len(voxels.keys):
        return build_surfels(voxels)
    from scipy import ndimage  # noqa: PLC0415  # slow to load

    west_south = (unpack_keys(voxels.keys)[:, :2] >> _BLOCK_DOUBLINGS).min(axis=0)
    level = _levels(voxels, west_south)
    parts: list[Surfels] = []
    for doubling in range(_MOST_DOUBLINGS + 1):
        own = level == doubling
        if own.any():
            # From voxels of this size in these blocks and around them.
            around = ndimage.binary_dilation(own, np.ones((3, 3)), _MARGIN_BLOCKS)
            cells = unpack_keys(voxels.keys)[:, :2] >> (_BLOCK_DOUBLINGS - doubling)
            column, row = (cells - west_south).T
            near = around[column, row]
            part = VoxelMoments(voxels.edge_m, voxels.keys[near], voxels.moments[near])
            parts.append(build_surfels(part, own[column, row][near]))
        voxels = coarsen(voxels)
    return concatenate(parts)


def _levels(voxels: VoxelMoments, west_south: Ints) -> Ints:
    """Doublings of the finest voxels in each block (columns, rows); -1 where it is empty.

    The spacing is that of points spread evenly over the block's occupied quarters: a block at the
    border of a cloud is not sparse because half of it is empty. It is rounded down: on a generated
    highway thinned to 1, 3, 10 and 100 % of its points, larger voxels stop 1 to 5 % more of the
    beams that pass, and close 1 to 2 % more surfaces.
    """
    quarter = (unpack_keys(voxels.keys)[:, :2] >> (_BLOCK_DOUBLINGS - 1)) - 2 * west_south
    shape = 2 * (quarter.max(axis=0) // 2 + 1)
    points = np.zeros(shape)
    np.add.at(points, (quarter[:, 0], quarter[:, 1]), voxels.moments[:, 0])
    blocks = points.reshape(shape[0] // 2, 2, shape[1] // 2, 2)
    filled = (blocks > 0).sum(axis=(1, 3))
    area_m2 = filled * (voxels.edge_m * 2 ** (_BLOCK_DOUBLINGS - 1)) ** 2
    total = blocks.sum(axis=(1, 3))
    spacing_m = np.sqrt(area_m2 / np.maximum(total, 1))
    level = np.floor(np.log2(np.maximum(spacing_m / voxels.edge_m, 1.0))).astype(np.int64)
    level[total < _FEWEST_POINTS] = 0
    return np.where(total > 0, np.minimum(level, _MOST_DOUBLINGS), -1)
