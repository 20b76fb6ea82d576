"""Points summed up in cubic voxels: count, first and second moments.

Moments are about each voxel's own centre and in units of its edge, so that they keep their
precision in float32 anywhere in the scene. Voxels lie on multiples of their edge in the local
frame; the voxels of twice the edge are made of whole voxels.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from roadsight.base.arrays import Floats32, Ints
from roadsight.base.errors import InputError
from roadsight.base.kernels import compiled, compiled_part

_BITS = 21
"""Bits of an index in a key: three of them fill the 63 bits that the sign leaves."""
_HALF = 1 << (_BITS - 1)
"""What is added to an index, so that it is not negative."""
_MASK = (1 << _BITS) - 1
"""The bits of one index."""

# What a step to the next voxel along an axis adds to a key.
X_STEP = 1 << (2 * _BITS)
Y_STEP = 1 << _BITS
Z_STEP = 1


@dataclass(frozen=True)
class VoxelMoments:
    """Occupied voxels in increasing order of their keys (x, then y, then z).

    Parameters
    ----------
    edge_m : edge of a voxel.
    keys : (n,) int64, indices along x, y, z packed in one number; see `pack_cells`.
    moments : (n, 10) float32: count, sums of x, y, z, xx, xy, xz, yy, yz, zz.
    """

    edge_m: float
    keys: Ints
    moments: Floats32


def pack_cells(cells: Ints) -> Ints:
    """Voxel indices (n, 3), each within +-2**20, as keys (n,) that sort by x, y, z."""
    x, y, z = (np.asarray(cells, np.int64) + _HALF).T
    return (x << (2 * _BITS)) | (y << _BITS) | z


def unpack_keys(keys: Ints) -> Ints:
    """Voxel indices (n, 3) of keys (n,)."""
    parts = (keys >> (2 * _BITS), (keys >> _BITS) & _MASK, keys & _MASK)
    return np.stack(parts, axis=1) - _HALF


def sum_moments(xyz_m: NDArray[np.floating], edge_m: float) -> VoxelMoments:
    """Sum up points (n, 3), local metres, in voxels of edge ``edge_m``.

    Raises
    ------
    InputError : a coordinate is not finite, or too far from the origin for voxels of this size.
    """
    reach_m = (_HALF - 8) * edge_m
    if len(xyz_m) and not np.abs(xyz_m).max() < reach_m:
        raise InputError(
            "points are not finite or too far from the local origin",
            where=f"voxels of {edge_m:g} m",
            allowed=f"coordinates within {reach_m:g} m",
            hint="choose larger voxels, or remove stray points",
        )
    keys = _point_keys(xyz_m, edge_m)
    order = np.argsort(keys, kind="stable")
    ordered = keys[order]
    first = np.flatnonzero(np.diff(ordered, prepend=-1))
    moments = _point_moments(xyz_m, edge_m, order, ordered, len(first))
    return VoxelMoments(edge_m, ordered[first], moments)


def add_moments(parts: Sequence[VoxelMoments]) -> VoxelMoments:
    """Sum of voxel grids of one edge; the order of the parts matters in the last digit only."""
    keys = np.concatenate([part.keys for part in parts])
    moments = np.concatenate([part.moments for part in parts])
    return _grouped(parts[0].edge_m, keys, moments)


def coarsen(voxels: VoxelMoments) -> VoxelMoments:
    """The same points in voxels of twice the edge."""
    cells = unpack_keys(voxels.keys)
    moments = _shifted(voxels.moments, (cells & 1) - 0.5)
    moments[:, 1:4] /= 2
    moments[:, 4:] /= 4
    return _grouped(2 * voxels.edge_m, pack_cells(cells >> 1), moments)


def _grouped(edge_m: float, keys: Ints, moments: Floats32) -> VoxelMoments:
    """Add up rows of equal keys."""
    if len(keys) == 0:
        return VoxelMoments(edge_m, keys, moments)
    order = np.argsort(keys, kind="stable")
    ordered = keys[order]
    first = np.flatnonzero(np.diff(ordered, prepend=-1))
    return VoxelMoments(edge_m, ordered[first], np.add.reduceat(moments[order], first, axis=0))


@compiled()
def _point_keys(xyz_m: NDArray[np.floating], edge_m: float) -> Ints:
    keys = np.empty(len(xyz_m), np.int64)
    for i in range(len(xyz_m)):
        x = int(np.floor(xyz_m[i, 0] / edge_m)) + _HALF
        y = int(np.floor(xyz_m[i, 1] / edge_m)) + _HALF
        z = int(np.floor(xyz_m[i, 2] / edge_m)) + _HALF
        keys[i] = (x << (2 * _BITS)) | (y << _BITS) | z
    return keys


@compiled()
def _point_moments(
    xyz_m: NDArray[np.floating], edge_m: float, order: Ints, ordered: Ints, voxels: int
) -> Floats32:
    moments = np.zeros((voxels, 10), np.float32)
    row = -1
    for n in range(len(order)):
        if n == 0 or ordered[n] != ordered[n - 1]:
            row += 1
        point = xyz_m[order[n]]
        x = point[0] / edge_m - np.floor(point[0] / edge_m) - 0.5
        y = point[1] / edge_m - np.floor(point[1] / edge_m) - 0.5
        z = point[2] / edge_m - np.floor(point[2] / edge_m) - 0.5
        total = moments[row]
        total[0] += 1
        total[1] += x
        total[2] += y
        total[3] += z
        total[4] += x * x
        total[5] += x * y
        total[6] += x * z
        total[7] += y * y
        total[8] += y * z
        total[9] += z * z
    return moments


@compiled_part()
def add_shifted(total: NDArray, moments: NDArray, dx: float, dy: float, dz: float) -> None:
    """Add ``moments`` of points that lie (dx, dy, dz) away to ``total``, both of shape (10,)."""
    count, x, y, z = moments[0], moments[1], moments[2], moments[3]
    total[0] += count
    total[1] += x + count * dx
    total[2] += y + count * dy
    total[3] += z + count * dz
    total[4] += moments[4] + dx * (2 * x + count * dx)
    total[5] += moments[5] + dy * x + dx * (y + count * dy)
    total[6] += moments[6] + dz * x + dx * (z + count * dz)
    total[7] += moments[7] + dy * (2 * y + count * dy)
    total[8] += moments[8] + dz * y + dy * (z + count * dz)
    total[9] += moments[9] + dz * (2 * z + count * dz)


@compiled()
def _shifted(moments: Floats32, shift: NDArray[np.floating]) -> Floats32:
    moved = np.zeros_like(moments)
    for i in range(len(moments)):
        add_shifted(moved[i], moments[i], shift[i, 0], shift[i, 1], shift[i, 2])
    return moved
