"""Down-sampling on a grid anchored at the local origin."""

from __future__ import annotations

import numpy as np

from roadsight.base.arrays import Floats, Ints
from roadsight.base.sections.scene import GroundClasses, Thinning
from roadsight.scene.grids import Grid

_USUAL = GroundClasses().thinning


def column_means(
    xyz_m: Floats, values: Floats, size_m: float, thinning: Thinning = _USUAL
) -> tuple[Floats, Floats, Ints]:
    """Centroid and mean values of each occupied grid column, row by row from the south-west.

    Ground is single-valued in plan, so it is thinned by columns and not by cubes: a sloping road
    crosses the horizontal faces of cubes, which doubles its points there and makes bands of false
    roughness (see ``docs/decisions/003-columns-not-cubes.md``). Cubes are what paper 1 takes
    (section 2.2, Table 3).

    Parameters
    ----------
    xyz_m : (n, 3) local metres. values : (n, v). size_m : side of a column or cube.
    thinning : voxels parts each column into cubes, lowest first.

    Returns
    -------
    centroids (m, 3), means (m, v), counts (m,).
    """
    columns = np.column_stack([xyz_m, values])
    if len(columns) == 0:
        return columns[:, :3], columns[:, 3:], np.empty(0, np.int64)
    grid = Grid.around(xyz_m[:, 0], xyz_m[:, 1], size_m)
    cells = grid.flat(xyz_m[:, 0], xyz_m[:, 1])
    if thinning == "voxels":
        layer = np.floor(xyz_m[:, 2] / size_m).astype(np.int64)
        layer -= layer.min()
        cells = cells * (layer.max() + 1) + layer
    _, inverse, count = np.unique(cells, return_inverse=True, return_counts=True)
    means = np.stack([np.bincount(inverse, c) for c in columns.T], axis=1) / count[:, None]
    return means[:, :3], means[:, 3:], count
