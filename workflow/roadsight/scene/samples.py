"""A cloud as samples that vote: where points are, how many, and the plane that they lie on.

A sample stands for the points of one voxel. Samples come in several sizes, and each block of the
scene holds all of them, so that a viewer takes fine ones near by and coarse ones far away: what
matters is the angle under which a sample is seen.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from roadsight.base.arrays import Floats, Floats32, Ints
from roadsight.scene.voxel_planes import VoxelMoments, coarsen, fit_planes, pack_cells, unpack_keys

# Sizes of samples, each twice as large: seen at the same angle they reach 8 times as far.
SAMPLE_SIZES = 4
# Edge of the blocks of one sample size: a few metres, so that ranges to them are near enough.
BLOCK_M = 6.4
_MIN_POINTS = 12  # Points that carry a plane, as for surfels.
# Planes of sparse parts come from voxels up to 2**5 times as large: 1.6 m of 5 cm.
_PLANE_DOUBLINGS = 5
# Variance along the second axis, squared voxel edges, below which points lie on a line.
_ON_LINE = 0.02


@dataclass(frozen=True)
class Samples:
    """Samples of all sizes, size by size and block by block.

    Parameters
    ----------
    xyz_m : (n, 3) centroid of the voxel's points, local metres. points : (n,) how many.
    normal : (n, 3) unit normal of the plane around, zero where there is none.
    offset_m : (n,) distance from the sample to that plane along the normal.
    spread_m : (n,) standard deviation of the points about the plane, infinite without a plane.
    reach_m : (n,) standard deviation of the points along the plane's shorter side.
    spacing_m : (n,) between neighbouring points, if they were spread evenly over the plane, plus
        half an edge of the voxel: as far as the sample's own points may be from the next ones.
    block_m : (b, 3) centres of the blocks. starts : (sizes, b + 1) first rows of each block.
    edge_m : edge of the finest voxels; those of size k are 2**k times as large.
    """

    xyz_m: Floats32
    points: Floats32
    normal: Floats32
    offset_m: Floats32
    spread_m: Floats32
    reach_m: Floats32
    spacing_m: Floats32
    block_m: Floats
    starts: Ints
    edge_m: float

    def __len__(self) -> int:
        return len(self.points)


def build_samples(voxels: VoxelMoments) -> Samples:
    """Samples of a cloud given by its moments in the finest voxels."""
    shift = max(round(float(np.log2(BLOCK_M / voxels.edge_m))), SAMPLE_SIZES)
    edge_m, parts, starts, blocks, begin = voxels.edge_m, [], [], np.empty(0, np.int64), 0
    for size in range(SAMPLE_SIZES):
        cells = unpack_keys(voxels.keys)
        keys = pack_cells(cells >> (shift - size))
        order = np.argsort(keys, kind="stable")
        blocks, first = np.unique(keys[order], return_index=True)
        starts.append(begin + np.append(first, len(order)))
        begin += len(order)
        parts.append([column[order] for column in _sized(voxels)])
        voxels = coarsen(voxels)
    xyz_m, points, normal, offset_m, spread_m, reach_m, spacing_m = (
        np.concatenate(column).astype(np.float32) for column in zip(*parts, strict=True)
    )
    block_m = (unpack_keys(blocks) + 0.5) * edge_m * 2**shift
    return Samples(
        xyz_m=xyz_m,
        points=points,
        normal=normal,
        offset_m=offset_m,
        spread_m=spread_m,
        reach_m=reach_m,
        spacing_m=spacing_m,
        block_m=block_m,
        starts=np.array(starts),
        edge_m=edge_m,
    )


def _sized(voxels: VoxelMoments) -> list[NDArray]:
    """Columns of the samples of one size, in the order of the voxels.

    Planes come from the 3 x 3 x 3 voxels around, or from larger ones where these hold too few
    points, or points on one line only.
    """
    cells, edge_m, n = unpack_keys(voxels.keys), voxels.edge_m, len(voxels.keys)
    xyz_m = (cells + 0.5 + voxels.moments[:, 1:4] / voxels.moments[:, :1]) * edge_m
    normal, offset_m, reach_m = np.zeros((n, 3), np.float32), np.zeros(n), np.zeros(n)
    spread_m, spacing_m = np.full(n, np.inf), np.full(n, 1.5 * edge_m)
    points, pending, half_m = voxels.moments[:, 0], np.arange(n), edge_m / 2
    for doubling in range(_PLANE_DOUBLINGS + 1):
        keys, member = np.unique(pack_cells(cells[pending] >> doubling), return_inverse=True)
        planes = fit_planes(keys, voxels, _MIN_POINTS, np.inf)
        settled = (planes.points >= _MIN_POINTS) & (planes.variance[:, 1] > _ON_LINE)
        rows, own = pending[settled[member]], member[settled[member]]
        centroid_m = (unpack_keys(keys)[own] + 0.5 + planes.centroid[own]) * voxels.edge_m
        normal[rows] = planes.normal[own]
        offset_m[rows] = ((centroid_m - xyz_m[rows]) * planes.normal[own]).sum(axis=1)
        spread_m[rows] = np.sqrt(planes.spread[own]) * voxels.edge_m
        reach_m[rows] = np.sqrt(planes.variance[own, 1]) * voxels.edge_m
        area_m2 = 12 * np.sqrt(planes.variance[own, 1] * planes.variance[own, 2]) * voxels.edge_m**2
        spacing_m[rows] = half_m + np.sqrt(area_m2 / planes.points[own])
        pending = pending[~settled[member]]
        voxels = coarsen(voxels)
    return [xyz_m, points, normal, offset_m, spread_m, reach_m, spacing_m]
