"""A cloud as oriented surfels: small rectangles that close its surfaces.

A surfel is the part of its plane over a rectangle normal to the axis nearest to its normal:
surfels of one surface meet at their borders whatever its tilt.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from roadsight.base.arrays import Bools, Floats, Floats32, Ints, Ints32, Numbers
from roadsight.base.engines import OWN, Engine, open3d
from roadsight.base.kernels import compiled, compiled_part
from roadsight.scene.voxel_planes import (
    Planes,
    VoxelMoments,
    add_shifted,
    coarsen,
    eigenvalues,
    eigenvector,
    fit_planes,
    open_neighbours,
    pack_cells,
    point_covariance,
    unpack_keys,
)

_FINE_DOUBLINGS = 2  # voxels of up to 2**2 times the finest edge carry planes of their own
_MERGE_DOUBLINGS = 5  # flat parts get patches up to 2**5 times as large
_MIN_POINTS = 12  # points of a neighbourhood that carry a plane and its coverage
_HOLE_POINTS = 5  # points around an empty voxel that carry a plane
_FLAT = 0.08  # variance across a flat neighbourhood, squared voxel edges
_TIGHT = (0.02, 0.02, 0.005)  # variance of a plane's points across it, for each doubling
_WIDE = 0.45  # variance along both axes of a wide surface, squared voxel edges
_CENTRED = 0.4  # a wide surface has its centroid this near to its voxel's centre, voxel edges
_CLOSE = 0.8  # an empty voxel is a hole if its neighbours' centroid is this near, voxel edges
_OVERLAP = 0.1  # surfels extend this far beyond their cell, finest voxel edges
_MERGE = 0.2  # merged patches depart this far from their parts, finest voxel edges
_LONE_HALF = 0.25  # half edge of the crossed squares of a lone voxel, voxel edges


@dataclass(frozen=True)
class Surfels:
    """Oriented rectangles.

    Parameters
    ----------
    centre_m : (n, 3) local metres. normal : (n, 3) unit, sign arbitrary.
    half_m : (n, 2) half edges along the two axes that follow the dominant axis of the normal,
        cyclically.
    """

    centre_m: Floats32
    normal: Floats32
    half_m: Floats32

    def __len__(self) -> int:
        return len(self.half_m)

    def select(self, chosen: NDArray) -> Surfels:
        """Surfels of a mask or of rows."""
        return Surfels(*(getattr(self, field.name)[chosen] for field in fields(self)))


def build_surfels(voxels: VoxelMoments) -> Surfels:
    """Surfels of a cloud given by its moments in the finest voxels.

    Where 3 x 3 x 3 voxels hold one dense and flat surface, patches over their cells close it, and
    patches that agree merge. Elsewhere each voxel looks for a plane among the points around it,
    at their own spacing, so that the two surfaces of an edge each get theirs. What is no surface
    at any size (wires, twigs, stray points) becomes small crossed squares.
    """
    by_size, pending, crowded = _dense_patches(voxels)
    parts, merged = [], no_patches()
    for doubling, part in enumerate(by_size):
        size_m, patches = voxels.edge_m * 2**doubling, join([merged, part])
        if doubling < len(by_size) - 1:
            merged, patches = merge_coplanar(patches, size_m, _MERGE * voxels.edge_m)
        centre, normal = centres_and_normals(patches, size_m)
        half_m = np.full((len(centre), 2), size_m / 2 + _OVERLAP * voxels.edge_m)
        parts.append(_as_surfels(centre, normal, half_m))
    sparse, thin = _sparse_surfels(voxels, pending, crowded)
    return concatenate([*parts, *sparse, _thin_surfels(thin, voxels)])


def _dense_patches(voxels: VoxelMoments) -> tuple[list[Patches], Ints, Bools]:
    """Patches of each size, finest first; the finest voxels without one, and which are crowded."""
    finest, cells = voxels.keys, unpack_keys(voxels.keys)
    pending = np.arange(len(finest))
    by_size = [no_patches()] * (_MERGE_DOUBLINGS + 1)
    crowded = np.zeros(len(finest), bool)
    for level in range(_FINE_DOUBLINGS + 1):
        keys, member = np.unique(pack_cells(cells[pending] >> level), return_inverse=True)
        planes = fit_planes(keys, voxels, _MIN_POINTS, _FLAT)
        good = (planes.points >= _MIN_POINTS) & (planes.variance[:, 1] > _FLAT)
        good &= planes.spread <= _TIGHT[level]
        if level == 0:
            crowded = planes.points >= _MIN_POINTS
        else:
            # Sparse points span a plane also where they are a few wires or the foot of a wall.
            aside = planes.centroid - planes.offset[:, None] * planes.normal
            good &= (planes.variance[:, 0] <= _FLAT) & (planes.variance[:, 1] > _WIDE)
            good &= np.linalg.norm(aside, axis=1) <= _CENTRED
        holes = _holes(keys, planes, good, voxels)
        by_size[level] = join([_patches(keys, planes, good, voxels.edge_m), holes])
        pending, voxels = pending[~good[member]], coarsen(voxels)
    return by_size, finest[pending], crowded[pending]


# Planes of sparse points and of edges, by consensus of the nearest points. The limits were chosen
# on three generated highways and three real streets, see
# docs/decisions/106-surfaces-that-do-not-leak.md.

_NEIGHBOURS = 28  # points around a point that tell its plane
_PAIRED = 12  # the nearest of them give planes to try: each two, with the point itself
_SPACING_OF_SIXTH = 1 / 1.38  # spacing of evenly spread points over the distance of the sixth
# Points farther apart than this carry no plane, spacings of the cloud in plan; of each doubling.
_WIDEST = (6.0, 3.0, 3.0)
_COARSEST = 2.0  # coarser voxels are asked up to this edge, spacings of the cloud in plan
_BLOCK_DOUBLINGS = 6  # that spacing is a mean over blocks of 2**6 of the finest voxels, 6.4 m
_NEAR_PLANE = 0.25  # points this near to a plane are on it, spacings; or this, for the noise:
_NEAR_PLANE_M = 0.03
_SUPPORTERS = 7  # points on a plane that carry it; it also takes this share of those around:
_SUPPORT = 0.25
_ACROSS = 0.35  # variance of a plane's points along both its axes, squared spacings, at least
_SLIM = 0.12  # and that along the shorter axis over that along the longer one
_ALIKE = 0.9  # cosine between the normals of one surface
_CONSISTENT = 0.6  # share of a plane's points that have to find it, too, where points are dense
_AT_ONCE = 100_000  # points whose neighbours are looked up at one time: it bounds memory
_ONE_POINT = np.array([1.0] + [0.0] * 9)  # moments of a point about itself
_ASIDE = 1.2  # points so far aside, and half as far as ahead, lie on a side of a surfel, spacings
# How far a surfel reaches to each side, in spacings. Where its surface goes on:
_ON = 1.4
_TO_NEXT = 0.75  # of the way to the next point of it, if that is more,
_FARTHEST = 2.5  # and no farther than this.
_TO_CORNER = 1.5  # Where another surface begins: to its farthest point and this at most.
_BEYOND_CORNER = 0.15  # So far beyond that point.
_TO_END = 0.6  # Where nothing is near.


def _sparse_surfels(
    voxels: VoxelMoments, pending: Ints, crowded: Bools
) -> tuple[list[Surfels], Ints]:
    """Surfels of voxels whose nearest points agree on a plane, and keys of voxels without one.

    Where the cloud is sparse, a voxel that finds none asks those of twice the edge, and so on.
    """
    parts: list[Surfels] = []
    spacing_m = _plan_spacing_m(voxels, pending)
    cells, left = unpack_keys(pending), np.arange(len(pending))
    closed = np.zeros(len(pending), bool)
    for level, widest in enumerate(_WIDEST):
        if level:
            voxels = coarsen(voxels)
            left = left[~closed[left] & ~crowded[left]]
            left = left[voxels.edge_m <= _COARSEST * spacing_m[left]]
        if not len(left) or len(voxels.keys) <= _SUPPORTERS:
            break
        keys, first, member = np.unique(
            pack_cells(cells[left] >> level), return_index=True, return_inverse=True
        )
        rows = np.searchsorted(voxels.keys, keys)
        points = unpack_keys(voxels.keys) + 0.5 + voxels.moments[:, 1:4] / voxels.moments[:, :1]
        points *= voxels.edge_m
        # Voxels lie within one block, whose spacing all their parts have.
        planes = _agreed_planes(points, rows, widest * spacing_m[left[first]])
        found = planes.found
        if level == 0:
            found = found & (~crowded | _consistent(planes, rows, len(points)))
        rectangles = planes.centre_m, planes.normal, planes.half_m
        parts.append(_as_surfels(*(part[found] for part in rectangles)))
        closed[left] = found[member]
    return parts, pending[~closed]


def _plan_spacing_m(voxels: VoxelMoments, keys: Ints) -> Floats:
    """Spacing (n,) of the cloud in plan, over the block of columns that each voxel is in."""

    def block(keys: Ints) -> Ints:
        cells = unpack_keys(keys) >> _BLOCK_DOUBLINGS
        cells[:, 2] = 0
        return pack_cells(cells)

    blocks, member = np.unique(block(voxels.keys), return_inverse=True)
    points = np.bincount(member, voxels.moments[:, 0])[np.searchsorted(blocks, block(keys))]
    return voxels.edge_m * 2**_BLOCK_DOUBLINGS / np.sqrt(points)


class _Agreed(NamedTuple):
    """Planes that the points around some points agree on.

    Parameters
    ----------
    found : (n,) whether they agree on one. normal : (n, 3) of it.
    centre_m, half_m : (n, 3), (n, 2) of its rectangle, as of `Surfels`.
    near : (n, 28) rows of the nearest points. on : (n, 28) those of them that are on it.
    """

    found: Bools
    centre_m: Floats
    normal: Floats
    half_m: Floats
    on: Bools
    near: Ints32


def _agreed_planes(points: Floats, rows: Ints, most_m: Floats) -> _Agreed:
    """Planes around rows (n,) of points (m, 3); none where these are more than ``most_m`` apart."""
    tree, parts = cKDTree(points), []
    for begin in range(0, len(rows), _AT_ONCE):
        some = rows[begin : begin + _AT_ONCE]
        away, near = tree.query(points[some], min(_NEIGHBOURS, len(points)))
        planes = _planes_of(points, some, away, near, most_m[begin : begin + _AT_ONCE])
        parts.append((*planes, near.astype(np.int32)))
    return _Agreed(*(np.concatenate(column) for column in zip(*parts, strict=True)))


@compiled()
def _planes_of(
    points: Floats, rows: Ints, away: Floats, near: Ints, most_m: Floats
) -> tuple[Bools, Floats, Floats, Floats, Bools]:
    n, count = near.shape
    found, all_on = np.zeros(n, np.bool_), np.zeros((n, count), np.bool_)
    centre, normal, half_m = np.zeros((n, 3)), np.zeros((n, 3)), np.zeros((n, 2))
    offset, covariance = np.empty((count, 3)), np.empty((3, 3))
    needed = max(_SUPPORTERS, _SUPPORT * count)
    for i in range(n):
        spacing_m = away[i, 6] * _SPACING_OF_SIXTH
        if spacing_m > most_m[i]:
            continue
        tolerance_m = max(_NEAR_PLANE_M, _NEAR_PLANE * spacing_m)
        for j in range(count):
            offset[j] = points[near[i, j]] - points[rows[i]]
        if _most_supported(offset, away[i], tolerance_m, normal[i]) < needed:
            continue
        level_m, middle, high = 0.0, 0.0, 0.0
        for _ in range(2):
            level_m, middle, high = _refit(
                offset, tolerance_m, level_m, covariance, normal[i], all_on[i]
            )
        if all_on[i].sum() < needed or abs(level_m) > tolerance_m:
            continue
        if middle < max(_ACROSS * spacing_m**2, _SLIM * high):
            continue
        found[i] = True
        _rectangle(offset, normal[i], level_m, all_on[i], spacing_m, centre[i], half_m[i])
        centre[i] += points[rows[i]]
    return found, centre, normal, half_m, all_on


@compiled_part()
def _most_supported(offset: Floats, away_m: Floats, tolerance_m: float, normal: Floats) -> int:
    """Points on the plane through the first and two of the nearest that has most; its normal."""
    most, count = 0, len(offset)
    paired = min(_PAIRED, count - 1)
    for a in range(1, paired):
        for b in range(a + 1, paired + 1):
            x = offset[a, 1] * offset[b, 2] - offset[a, 2] * offset[b, 1]
            y = offset[a, 2] * offset[b, 0] - offset[a, 0] * offset[b, 2]
            z = offset[a, 0] * offset[b, 1] - offset[a, 1] * offset[b, 0]
            length = np.sqrt(x * x + y * y + z * z)
            if length < 0.5 * away_m[a] * away_m[b] or length == 0:
                continue  # nearly in line: any plane about them would do
            x, y, z = x / length, y / length, z / length
            support = 0
            for j in range(count):
                distance_m = x * offset[j, 0] + y * offset[j, 1] + z * offset[j, 2]
                support += -tolerance_m <= distance_m <= tolerance_m
            if support > most:
                most = support
                normal[0], normal[1], normal[2] = x, y, z
    return most


@compiled_part()
def _refit(
    offset: Floats,
    tolerance_m: float,
    level_m: float,
    covariance: Floats,
    normal: Floats,
    on: Bools,
) -> tuple[float, float, float]:
    """Least-squares plane of the points near a plane, in its place.

    Returns its distance along its normal, and the variances of its points along its two axes.
    """
    total = np.zeros(10)
    for j in range(len(offset)):
        x, y, z = offset[j]
        on[j] = abs(normal[0] * x + normal[1] * y + normal[2] * z - level_m) <= tolerance_m
        if on[j]:
            add_shifted(total, _ONE_POINT, x, y, z)
    x, y, z = point_covariance(total, covariance)
    low, middle, high = eigenvalues(covariance)
    eigenvector(covariance, low, normal)
    return normal[0] * x + normal[1] * y + normal[2] * z, middle, high


@compiled()
def _consistent(planes: _Agreed, rows: Ints, points: int) -> Bools:
    """Planes that the points on them found, too: among leaves each point finds another one."""
    found, normal, on, near = planes.found, planes.normal, planes.on, planes.near
    row_of = np.full(points, -1, np.int64)
    for i in range(len(rows)):
        row_of[rows[i]] = i
    kept = np.zeros(len(found), np.bool_)
    for i in range(len(rows)):
        if not found[i]:
            continue
        asked, alike = 0, 0
        for j in range(1, near.shape[1]):
            if not on[i, j]:
                continue
            asked += 1
            other = row_of[near[i, j]]
            if other < 0:  # a part of a dense surface
                alike += 1
            elif found[other]:
                cosine = 0.0
                for k in range(3):
                    cosine += normal[i, k] * normal[other, k]
                alike += abs(cosine) >= _ALIKE
        kept[i] = alike >= _CONSISTENT * asked
    return kept


@compiled_part()
def _rectangle(
    offset: Floats,
    normal: Floats,
    level_m: float,
    on: Bools,
    spacing_m: float,
    centre: Floats,
    half_m: Floats,
) -> None:
    """Centre, from the point, and half edges of the rectangle that closes the plane around it."""
    axis = np.argmax(np.abs(normal))
    sides = ((axis + 1) % 3, (axis + 2) % 3)
    for number in range(2):
        along, across = sides[number], sides[1 - number]
        reach = np.zeros(2)
        for end in range(2):
            next_m, corner_m = np.inf, 0.0
            for j in range(1, len(offset)):
                d = offset[j, along] * (2 * end - 1)
                if d <= 0 or abs(offset[j, across]) > _ASIDE * spacing_m + 0.5 * d:
                    continue
                if on[j]:
                    if 0.5 * spacing_m < d < next_m:
                        next_m = d
                elif d <= _FARTHEST * spacing_m:
                    x, y, z = offset[j]
                    distance_m = normal[0] * x + normal[1] * y + normal[2] * z - level_m
                    if abs(distance_m) <= _FARTHEST * spacing_m:
                        corner_m = max(corner_m, d)
            if next_m < np.inf:
                reach[end] = min(max(_ON * spacing_m, _TO_NEXT * next_m), _FARTHEST * spacing_m)
            elif corner_m > 0:
                reach[end] = min(corner_m + _BEYOND_CORNER * spacing_m, _TO_CORNER * spacing_m)
            else:
                reach[end] = _TO_END * spacing_m
        centre[along] = (reach[1] - reach[0]) / 2
        half_m[number] = (reach[1] + reach[0]) / 2
    flat = normal[sides[0]] * centre[sides[0]] + normal[sides[1]] * centre[sides[1]]
    centre[axis] = (level_m - flat) / normal[axis]


def _patches(keys: Ints, planes: Planes, chosen: Bools, size_m: float) -> Patches:
    cells = unpack_keys(keys[chosen])
    return patches_of_planes(cells, planes.normal[chosen], planes.offset[chosen], size_m)


def _holes(keys: Ints, planes: Planes, good: Bools, voxels: VoxelMoments) -> Patches:
    """Patches in empty voxels whose neighbours surround them in one plane."""
    flat_around = good & (planes.variance[:, 0] <= _FLAT)
    found = open_neighbours(
        keys[flat_around], Planes(*(column[flat_around] for column in planes)), voxels
    )
    around = fit_planes(found, voxels, _HOLE_POINTS, _FLAT)
    steepest = np.abs(around.normal).max(axis=1, initial=1e-6)
    beside = around.centroid - around.offset[:, None] * around.normal
    hole = (
        (around.points >= _HOLE_POINTS)
        & (around.spread <= _FLAT)
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
    half_m = np.full((len(lone), 2), _LONE_HALF * voxels.edge_m)
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
    half_m = np.tile(half[line, None] * voxels.edge_m, (2, 2))
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
