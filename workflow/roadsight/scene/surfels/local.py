"""Surfels whose size follows the density where they are.

One voxel size for a whole cloud lets sparse points anywhere coarsen the surfaces everywhere. Here
the scene is divided into blocks, and each block gets voxels about as large as the spacing of its
own points.
"""

from __future__ import annotations

import numpy as np

from roadsight.base.arrays import Bools, Ints
from roadsight.scene.surfels.surfels import Surfels, build_surfels, concatenate
from roadsight.scene.surfels.voxel_moments import VoxelMoments, coarsen, unpack_keys

_BLOCK_DOUBLINGS = 6
"""Blocks are 2**6 of the finest voxels wide (6.4 m of 0.1 m): some thousand points of a mobile
cloud, some hundred of an airborne one, and finer than density changes along a road."""
_MOST_DOUBLINGS = 5
"""Voxels are up to 2**5 times the finest ones (3.2 m): sparser points span no surface."""
_FEWEST_POINTS = 12
"""A block with fewer carries no plane: its points stay what they are, in the finest voxels; large
ones would string them up as wires."""
_MARGIN_BLOCKS = 1
"""Blocks around those of a size that its surfels may draw on; they reach a few voxels at most."""


def build_local_surfels(voxels: VoxelMoments) -> Surfels:
    """Surfels of a cloud given by its moments in the finest voxels.

    Blocks whose points lie farther apart than the finest voxels take voxels twice as large, and so
    on. What lies in one block does not hang on others, but for those beside it.
    """
    if not len(voxels.keys):
        return build_surfels(voxels)
    west_south = (unpack_keys(voxels.keys)[:, :2] >> _BLOCK_DOUBLINGS).min(axis=0)
    level = _levels(voxels, west_south)
    parts: list[Surfels] = []
    for doubling in range(_MOST_DOUBLINGS + 1):
        own = level == doubling
        if own.any():
            parts.append(_surfels_of(voxels, own, west_south, doubling))
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


def _surfels_of(voxels: VoxelMoments, own: Bools, west_south: Ints, doubling: int) -> Surfels:
    """Surfels of the blocks of one size, from voxels of that size in them and around them."""
    from scipy import ndimage  # noqa: PLC0415  # slow to load

    around = ndimage.binary_dilation(own, np.ones((3, 3)), _MARGIN_BLOCKS)
    cells = unpack_keys(voxels.keys)[:, :2] >> (_BLOCK_DOUBLINGS - doubling)
    column, row = (cells - west_south).T
    near = around[column, row]
    part = VoxelMoments(voxels.edge_m, voxels.keys[near], voxels.moments[near])
    return build_surfels(part, own[column, row][near])
