"""A cloud as oriented surfels: small squares that close its surfaces.

A surfel is the part of its plane over a square cell of edge ``2 half_m`` that is normal to the axis
nearest to its normal: surfels of one surface meet at their cells' borders whatever its tilt.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from roadsight.base.arrays import Bools, Floats32, Ints
from roadsight.scene.surfels.patches import (
    Patches,
    centres_and_normals,
    join,
    merge_coplanar,
    no_patches,
    patches_of_planes,
)
from roadsight.scene.surfels.plane_fit import Planes, fit_planes, open_neighbours
from roadsight.scene.surfels.voxel_moments import VoxelMoments, coarsen, pack_cells, unpack_keys

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
                sparse &= _is_wide(keys, coarser, flat * _FLATTER)
            near = _near_plane(points[pending] / 2**level, keys[member], planes, member)
            thin.append(finest[pending[settled[member] & ~(sparse[member] & near)]])
            good = sparse & (np.bincount(member[near], minlength=len(keys)) > 0)
        holes = _holes(keys, planes, good, voxels, flat)
        by_size.append(join([_patches(keys, planes, good, voxels.edge_m), holes]))
        pending, voxels = pending[~settled[member]], coarser
    thin.append(finest[pending])
    return by_size, np.sort(np.concatenate(thin))


def _is_wide(keys: Ints, coarser: VoxelMoments, flat: float) -> Bools:
    """Whether the surface goes on over voxels of twice the edge.

    Sparse ground does; parallel wires, and stray points beside an object, span no wide plane.
    """
    parents, member = np.unique(pack_cells(unpack_keys(keys) >> 1), return_inverse=True)
    planes = fit_planes(parents, coarser, _MIN_POINTS, flat)
    return ((planes.spread <= flat) & (planes.variance[:, 1] > _WIDE))[member]


def _patches(keys: Ints, planes: Planes, chosen: Bools, size_m: float) -> Patches:
    cells = unpack_keys(keys[chosen])
    return patches_of_planes(cells, planes.normal[chosen], planes.offset[chosen], size_m)


def _near_plane(points: NDArray[np.floating], keys: Ints, planes: Planes, rows: Ints) -> Bools:
    """Whether points, in voxel edges, lie on the planes (by row) of the voxels ``keys``."""
    offset = (points - unpack_keys(keys) - 0.5) * planes.normal[rows]
    distance = np.abs(offset.sum(axis=1) - planes.offset[rows])
    return distance <= 2.5 * np.sqrt(planes.spread[rows]) + _NEAR


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
    first = _across(planes.axis, planes.normal)
    normal = np.concatenate([first[line], np.cross(planes.axis, first)[line]])
    half_m = np.tile(half[line] * voxels.edge_m, 2)
    return _as_surfels(np.tile(centre * voxels.edge_m, (2, 1)), normal, half_m)


def _across(axis: NDArray[np.floating], normal: NDArray[np.floating]) -> NDArray[np.floating]:
    """Unit vectors (n, 3) across the axes, the normals where they are.

    Points on a perfect line lie in any plane through it, and the normal that was fitted may lie
    along it: one across the coordinate axis that is least along the line will do.
    """
    least = np.eye(3)[np.abs(axis).argmin(axis=1)]
    lost = np.abs((axis * normal).sum(axis=1)) > 0.5
    second = np.cross(axis, np.where(lost[:, None], least, normal))
    other = np.cross(second, axis)
    return np.asarray(other / np.linalg.norm(other, axis=1, keepdims=True))


def _as_surfels(centre_m: NDArray, normal: NDArray, half_m: NDArray) -> Surfels:
    return Surfels(*(part.astype(np.float32) for part in (centre_m, normal, half_m)))


def concatenate(parts: list[Surfels]) -> Surfels:
    """Surfels of several lists, one after the other."""
    return Surfels(
        np.concatenate([part.centre_m for part in parts]),
        np.concatenate([part.normal for part in parts]),
        np.concatenate([part.half_m for part in parts]),
    )
