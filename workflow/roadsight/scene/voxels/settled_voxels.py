"""Voxels that no point is still to come for, while a cloud is read tile by tile."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np

from roadsight.base.arrays import Bytes, Ints
from roadsight.scene.voxels.voxel_classes import (
    CLASS_BITS,
    ClassRuns,
    Columns,
    VoxelGrid,
    seen_from_above,
    settle,
)

_COLUMNS = tuple(field.name for field in fields(Columns))


@dataclass(frozen=True)
class Settled:
    """Voxels of whole columns and what is seen of them from above, in half of their runs' room.

    Parameters
    ----------
    voxel : (n,) number in the window, rising. cls : (n,) class.
    columns : by row; where the parts of an area are joined, in any order within it.
    """

    voxel: Ints
    cls: Bytes
    columns: Columns

    def split(self, grid: VoxelGrid, row: int) -> tuple[Settled, Settled]:
        """What lies south of a row of the window, and the rest; the columns have to be by row."""
        cut = int(np.searchsorted(self.voxel, grid.row_start(row)))
        seen = int(np.searchsorted(self.columns.row, row))
        return (
            Settled(self.voxel[:cut], self.cls[:cut], _part(self.columns, slice(None, seen))),
            Settled(self.voxel[cut:], self.cls[cut:], _part(self.columns, slice(seen, None))),
        )


def settle_area(grid: VoxelGrid, runs: ClassRuns) -> Settled:
    """Classes and overhead view of runs of whole columns."""
    voxels = settle(runs)
    return Settled(voxels.voxel, voxels.cls, seen_from_above(grid, voxels))


def join(parts: Sequence[Settled]) -> Settled:
    """Parts that share no column as one, its voxels by rising number."""
    keys = np.concatenate([part.voxel for part in parts])
    keys <<= CLASS_BITS
    keys |= np.concatenate([part.cls for part in parts])
    keys.sort(kind="stable")  # fast where parts are sorted
    cls = (keys & (2**CLASS_BITS - 1)).astype(np.uint8)
    keys >>= CLASS_BITS
    columns = [np.concatenate([getattr(part.columns, name) for part in parts]) for name in _COLUMNS]
    return Settled(keys, cls, Columns(*columns))


def _part(columns: Columns, rows: slice) -> Columns:
    return Columns(*(getattr(columns, name)[rows] for name in _COLUMNS))
