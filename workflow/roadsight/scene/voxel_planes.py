"""Points summed up in cubic voxels: count, first and second moments.

Moments are about each voxel's own centre and in units of its edge, so that they keep their
precision in float32 anywhere in the scene. Voxels lie on multiples of their edge in the local
frame; the voxels of twice the edge are made of whole voxels.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from roadsight.base.arrays import Floats, Floats32, Ints
from roadsight.base.errors import InputError
from roadsight.base.kernels import compiled, compiled_part

_BITS = 21  # Bits of an index in a key: three of them fill the 63 bits that the sign leaves.
_HALF = 1 << (_BITS - 1)  # What is added to an index, so that it is not negative.
_MASK = (1 << _BITS) - 1  # The bits of one index.
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


# Planes through the points of voxel neighbourhoods, from moments alone.

# Points of a 2 x 2 x 2 corner that carry a plane of its own: two more than define one.
_BLOCK_POINTS = 5


class Planes(NamedTuple):
    """Planes through neighbourhoods of voxels; lengths in voxel edges, from the voxel's centre.

    Parameters
    ----------
    normal : (n, 3) unit normal, sign arbitrary.
    offset : (n,) distance of the plane along its normal.
    spread : (n,) variance of the plane's points across it.
    variance : (n, 3) of all points of the neighbourhood, increasing.
    centroid : (n, 3) of all points of the neighbourhood.
    axis : (n, 3) unit vector of the greatest variance.
    points : (n,) points of the neighbourhood.
    own : (n,) points of the voxel itself.
    """

    normal: Floats32
    offset: Floats32
    spread: Floats32
    variance: Floats32
    centroid: Floats32
    axis: Floats32
    points: Floats32
    own: Floats32


def fit_planes(keys: Ints, voxels: VoxelMoments, min_points: int, flat_variance: float) -> Planes:
    """Least-squares planes through the 3 x 3 x 3 voxels around each key.

    Where the neighbourhood is not flat (an edge, a corner, a thin object) the plane is that of the
    flattest of its eight 2 x 2 x 2 corners that holds the voxel, so that surfaces are not rounded
    off where they meet. Neighbourhoods of fewer than ``min_points`` points have a zero normal.

    Parameters
    ----------
    keys : (m,) increasing; they need not be occupied.
    flat_variance : greatest variance across a plane that counts as flat, squared voxel edges.
    """
    n = len(keys)
    normal, variance, centroid, axis = (np.zeros((n, 3), np.float32) for _ in range(4))
    offset, spread, points, own = (np.zeros(n, np.float32) for _ in range(4))
    planes = Planes(normal, offset, spread, variance, centroid, axis, points, own)
    _fit(keys, voxels.keys, voxels.moments, min_points, flat_variance, planes)
    return planes


def open_neighbours(keys: Ints, planes: Planes, voxels: VoxelMoments) -> Ints:
    """Empty voxels beside the given ones in which their planes continue; increasing keys."""
    return np.unique(_continue_planes(keys, planes.normal, planes.offset, voxels.keys))


@compiled_part()
def _find_block(key: int, occupied: Ints, pointers: Ints, block: Ints) -> None:
    """Rows of the 27 voxels around a key, -1 where empty.

    Keys come in increasing order, so each of the nine columns only ever moves its pointer on.
    """
    block[:] = -1
    for column in range(9):
        lowest = key + (column // 3 - 1) * X_STEP + (column % 3 - 1) * Y_STEP - Z_STEP
        row = pointers[column]
        while row < len(occupied) and occupied[row] < lowest:
            row += 1
        pointers[column] = row
        while row < len(occupied) and occupied[row] <= lowest + 2:
            block[column, occupied[row] - lowest] = row
            row += 1


@compiled_part()
def _sum_block(
    block: Ints, moments: Floats32, x_from: int, y_from: int, z_from: int, width: int, total: Floats
) -> None:
    """Moments of a cube of ``width`` voxels of the block about the block's centre."""
    total[:] = 0
    for i in range(x_from, x_from + width):
        for j in range(y_from, y_from + width):
            for k in range(z_from, z_from + width):
                row = block[3 * i + j, k]
                if row >= 0:
                    add_shifted(total, moments[row], i - 1, j - 1, k - 1)


@compiled_part()
def point_covariance(total: Floats, covariance: Floats) -> tuple[float, float, float]:
    """Centroid; fills the covariance matrix."""
    count = total[0]
    x, y, z = total[1] / count, total[2] / count, total[3] / count
    covariance[0, 0] = total[4] / count - x * x
    covariance[0, 1] = covariance[1, 0] = total[5] / count - x * y
    covariance[0, 2] = covariance[2, 0] = total[6] / count - x * z
    covariance[1, 1] = total[7] / count - y * y
    covariance[1, 2] = covariance[2, 1] = total[8] / count - y * z
    covariance[2, 2] = total[9] / count - z * z
    return x, y, z


@compiled_part()
def eigenvalues(a: Floats) -> tuple[float, float, float]:
    """Eigenvalues of a covariance matrix, increasing (trigonometric solution)."""
    mean = (a[0, 0] + a[1, 1] + a[2, 2]) / 3
    off = a[0, 1] ** 2 + a[0, 2] ** 2 + a[1, 2] ** 2
    p, q, r = a[0, 0] - mean, a[1, 1] - mean, a[2, 2] - mean
    scale = np.sqrt((p * p + q * q + r * r + 2 * off) / 6)
    if scale < 1e-12:
        return max(mean, 0.0), max(mean, 0.0), max(mean, 0.0)
    determinant = (
        p * (q * r - a[1, 2] ** 2)
        - a[0, 1] * (a[0, 1] * r - a[1, 2] * a[0, 2])
        + a[0, 2] * (a[0, 1] * a[1, 2] - q * a[0, 2])
    )
    angle = np.arccos(min(1.0, max(-1.0, determinant / (2 * scale**3)))) / 3
    high = mean + 2 * scale * np.cos(angle)
    low = mean + 2 * scale * np.cos(angle + 2 * np.pi / 3)
    return max(low, 0.0), max(3 * mean - low - high, 0.0), high


@compiled_part()
def eigenvector(a: Floats, value: float, vector: Floats) -> None:
    """Unit eigenvector: the longest cross product of two rows of a - value * identity.

    A matrix with a repeated eigenvalue has no single answer: z is taken where nothing is left.
    """
    longest = 0.0
    vector[0], vector[1], vector[2] = 0.0, 0.0, 1.0
    for first in range(2):
        for second in range(first + 1, 3):
            u0 = a[first, 0] - (value if first == 0 else 0.0)
            u1 = a[first, 1] - (value if first == 1 else 0.0)
            u2 = a[first, 2]
            v0 = a[second, 0]
            v1 = a[second, 1] - (value if second == 1 else 0.0)
            v2 = a[second, 2] - (value if second == 2 else 0.0)
            x, y, z = u1 * v2 - u2 * v1, u2 * v0 - u0 * v2, u0 * v1 - u1 * v0
            length = np.sqrt(x * x + y * y + z * z)
            if length > longest and length > 1e-18:
                longest = length
                vector[0], vector[1], vector[2] = x / length, y / length, z / length


@compiled_part()
def _flattest_corner(
    block: Ints, moments: Floats32, total: Floats, covariance: Floats, low: float
) -> None:
    """Moments of the 2 x 2 x 2 corner with the least variance across its plane into ``total``."""
    best = -1
    for corner in range(8):
        _sum_block(block, moments, corner >> 2, (corner >> 1) & 1, corner & 1, 2, total)
        if total[0] >= _BLOCK_POINTS:
            point_covariance(total, covariance)
            variance = eigenvalues(covariance)[0]
            if variance < low:
                best, low = corner, variance
    if best >= 0:
        _sum_block(block, moments, best >> 2, (best >> 1) & 1, best & 1, 2, total)
    else:
        _sum_block(block, moments, 0, 0, 0, 3, total)


@compiled()
def _fit(
    keys: Ints,
    occupied: Ints,
    moments: Floats32,
    min_points: int,
    flat_variance: float,
    planes: Planes,
) -> None:
    block, pointers = np.empty((9, 3), np.int64), np.zeros(9, np.int64)
    total, covariance, vector = np.empty(10), np.empty((3, 3)), np.empty(3)
    for i in range(len(keys)):
        _find_block(keys[i], occupied, pointers, block)
        planes.own[i] = moments[block[4, 1], 0] if block[4, 1] >= 0 else 0
        _sum_block(block, moments, 0, 0, 0, 3, total)
        planes.points[i] = total[0]
        if total[0] < min_points:
            continue
        x, y, z = point_covariance(total, covariance)
        low, middle, high = eigenvalues(covariance)
        planes.variance[i, 0], planes.variance[i, 1], planes.variance[i, 2] = low, middle, high
        planes.centroid[i, 0], planes.centroid[i, 1], planes.centroid[i, 2] = x, y, z
        eigenvector(covariance, high, vector)
        planes.axis[i, 0], planes.axis[i, 1], planes.axis[i, 2] = vector
        if low > flat_variance and planes.own[i] > 0:
            _flattest_corner(block, moments, total, covariance, low)
            x, y, z = point_covariance(total, covariance)
            low = eigenvalues(covariance)[0]
        eigenvector(covariance, low, vector)
        planes.normal[i, 0], planes.normal[i, 1], planes.normal[i, 2] = vector
        planes.spread[i] = low
        planes.offset[i] = x * vector[0] + y * vector[1] + z * vector[2]


@compiled()
def _continue_planes(keys: Ints, normal: Floats32, offset: Floats32, occupied: Ints) -> Ints:
    block, pointers = np.empty((9, 3), np.int64), np.zeros(9, np.int64)
    found = np.empty(8 * len(keys), np.int64)
    step = np.empty(3, np.int64)
    n = 0
    for i in range(len(keys)):
        _find_block(keys[i], occupied, pointers, block)
        k = np.argmax(np.abs(normal[i]))
        u, v = (k + 1) % 3, (k + 2) % 3
        for neighbour in range(9):
            if neighbour == 4:
                continue
            step[u], step[v] = neighbour // 3 - 1, neighbour % 3 - 1
            height = (offset[i] - normal[i, u] * step[u] - normal[i, v] * step[v]) / normal[i, k]
            step[k] = int(np.floor(height + 0.5))
            if abs(step[k]) <= 1 and block[3 * (step[0] + 1) + step[1] + 1, step[2] + 1] < 0:
                found[n] = keys[i] + step[0] * X_STEP + step[1] * Y_STEP + step[2] * Z_STEP
                n += 1
    return found[:n]
