"""Class of each voxel of a classified cloud, and what an overhead view of it shows.

A voxel is road or bridge as soon as one of its points is, and else of its most frequent class
(paper 2, section 3.2.1). Points are counted by column, or as sorted 64 bit keys where that would
take too much memory or time, in whole numbers throughout, so that the result depends neither on
their order nor on how the cloud is cut into tiles.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from roadsight.base.arrays import Bools, Bytes, Floats, Ints, Ints32
from roadsight.base.errors import InputError
from roadsight.base.kernels import compiled
from roadsight.geometry.frames import Frame
from roadsight.scene.classes import BRIDGE, ROAD

CLASS_BITS = 8  # Bits of a point's class in its key: LAS has 256 classes.
# Bits of a point's height above its voxel's floor: 256ths of an edge, a millimetre at 0.25 m.
_HEIGHT_BITS = 8
# What the sign, class and height leave of a 64 bit key for the number of the voxel.
_KEY_BITS = 63 - CLASS_BITS - _HEIGHT_BITS
# How far points are moved, so that all on a face fall to the same side, see `VoxelGrid`.
_NUDGE_M = 2.5e-4
# Rounding of a tile's borders: voxels this near to one may still get points of the next tile.
_SLACK_M = 1e-6
# Points are counted by column where the box around them has at most so many columns for each; a
# sparser box, such as that of stray points, would take more memory than sorting keys does.
_COLUMNS_A_POINT = 8
# Steps along chains of runs for each point, on average, before keys are sorted instead: columns of
# very many layers would otherwise take a time that grows with their square.
_STEPS_A_POINT = 32


@dataclass(frozen=True)
class VoxelGrid:
    """Cubes whose corners are multiples of their edge from native coordinates 0, 0, 0.

    Clouds come in whole millimetres or hundredths of a foot, so that many points lie on a face.
    They are moved up by a quarter of a millimetre, which is more than what single precision rounds
    off within 4 km, so that such a point always falls into the voxel above the face.

    Parameters
    ----------
    cell_size_m : edge. anchor_m : lower corner of voxel (0, 0, 0), local metres.
    low : least indices ix, iy, iz of the window that the cloud fills.
    shape : columns, rows, layers of the window.
    """

    cell_size_m: float
    anchor_m: tuple[float, float, float]
    low: tuple[int, int, int]
    shape: tuple[int, int, int]

    @classmethod
    def over(cls, frame: Frame, cell_size_m: float, bounds_m: ArrayLike) -> VoxelGrid:
        """Grid of a cloud with bounds least x, y, z and greatest x, y, z, local metres.

        Raises
        ------
        InputError : the bounds are not finite, or the window has too many voxels.
        """
        corners = np.asarray(bounds_m, np.float64).reshape(2, 3)
        anchor = -np.asarray(frame.origin, np.float64) * frame.scale
        index = np.floor((corners - anchor + _NUDGE_M) / cell_size_m)
        shape = index[1] - index[0] + 1
        if not (np.isfinite(index).all() and np.prod(shape) < 2.0**_KEY_BITS):
            raise InputError(
                "the cloud spans too many voxels",
                where="voxel edge",
                found=f"{cell_size_m:g} m",
                allowed=f"fewer than 2^{_KEY_BITS} voxels in the cloud's box",
                hint="choose larger voxels, or remove stray points",
            )
        x, y, z = anchor.tolist()
        ix, iy, iz = index[0].astype(int).tolist()
        columns, rows, layers = shape.astype(int).tolist()
        return cls(cell_size_m, (x, y, z), (ix, iy, iz), (columns, rows, layers))

    @property
    def corner_m(self) -> Floats:
        """Lower corner of the window (3,), local metres."""
        return np.asarray(self.anchor_m) + np.asarray(self.low) * self.cell_size_m

    def indices(self, voxel: Ints) -> Ints32:
        """Indices ix, iy, iz (n, 3) of voxel numbers (n,)."""
        return indices_of(voxel, np.array(self.shape), np.array(self.low)).T

    def first_open_row(self, north_m: float) -> int:
        """First row of the window that points north of ``north_m`` may still fall into."""
        return int(np.clip(self._reached(1, north_m - _SLACK_M), 0, self.shape[1]))

    def _reached(self, axis: int, at_m: float) -> int:
        return int(np.floor((at_m - self.corner_m[axis] + _NUDGE_M) / self.cell_size_m))

    def within(self, voxel: Ints, west_m: float, south_m: float, size_m: float) -> Bools:
        """Which voxels (n,) no point outside a half open square of the plan can fall into."""
        row, column = np.divmod(voxel // self.shape[2], self.shape[0])
        inside = np.ones(len(voxel), bool)
        for axis, low_m, index in ((0, west_m, column), (1, south_m, row)):
            inside &= index > self._reached(axis, low_m + _SLACK_M)
            inside &= index < self._reached(axis, low_m + size_m - _SLACK_M)
        return inside

    def row_start(self, row: int) -> int:
        """Number of the first voxel of a row of the window."""
        return row * self.shape[0] * self.shape[2]


@dataclass(frozen=True)
class ClassRuns:
    """Points of one class in one voxel, by rising voxel and class.

    Parameters
    ----------
    voxel : (n,) number in the window, by row, then column, then layer. cls : (n,).
    points : (n,) how many. heights : (n,) sum of their heights above the voxel's floor in 256ths.
    """

    voxel: Ints
    cls: Bytes
    points: Ints
    heights: Ints

    def split(self, voxel: int) -> tuple[ClassRuns, ClassRuns]:
        """Runs below a voxel number, and the rest."""
        cut = int(np.searchsorted(self.voxel, voxel))
        south, north = slice(None, cut), slice(cut, None)
        return self.part(south), self.part(north)

    def part(self, rows: slice | Bools) -> ClassRuns:
        """Some of the runs."""
        return ClassRuns(self.voxel[rows], self.cls[rows], self.points[rows], self.heights[rows])


@dataclass(frozen=True)
class Voxels:
    """Occupied voxels by rising number.

    Parameters
    ----------
    voxel : (n,) number in the window. cls : (n,) class.
    own : (n,) points that count for the height: those of road and bridge, or all where none is.
    points : (n,) all points. heights : (n,) sum of the own points' heights as in `ClassRuns`.
    """

    voxel: Ints
    cls: Bytes
    own: Ints
    points: Ints
    heights: Ints


@dataclass(frozen=True)
class Columns:
    """What is seen from above, by row from the south, then column from the west.

    Parameters
    ----------
    row, column : (n,) in the grid's window, 32 bits.
    cls : (n,) of the highest voxel; road or bridge where the column has any.
    height_m : (n,) mean of that voxel's points, or of the uppermost road surface's; local metres.
    road_share : (n,) share of road and bridge among the points at that surface, 0 without road.
    """

    row: Ints32
    column: Ints32
    cls: Bytes
    height_m: Floats
    road_share: Floats


def count_classes(grid: VoxelGrid, xyz_m: Sequence[NDArray[np.floating]], cls: Bytes) -> ClassRuns:
    """Runs of points given as x, y, z, each (n,), local metres, and classes (n,)."""
    shape, box = np.array(grid.shape, np.int64), _columns_around(grid, xyz_m)
    columns = int(box[2] * box[3])
    if columns <= _COLUMNS_A_POINT * len(cls):
        place, keys = _keys(grid, xyz_m, cls, box)
        first, runs, used = chained(place, keys, columns, _STEPS_A_POINT * len(cls))
        if used >= 0:
            return ClassRuns(*by_column(first, runs, used, shape, box))
    keys, rest = _keys(grid, xyz_m, cls, np.array([0, 0, *grid.shape[:2]]))
    keys *= grid.shape[2] << (CLASS_BITS + _HEIGHT_BITS)
    keys += rest
    keys.sort()
    return ClassRuns(*runs_of(keys))


def _keys(
    grid: VoxelGrid, xyz_m: Sequence[NDArray[np.floating]], cls: Bytes, box: Ints
) -> tuple[Ints, Ints]:
    """Columns in a box and keys in these of points, each (n,), see `point_keys`."""
    x, y, z = xyz_m
    start, shape = grid.corner_m - _NUDGE_M, np.array(grid.shape, np.int64)
    return point_keys(x, y, z, cls, start, grid.cell_size_m, shape, box)


def _columns_around(grid: VoxelGrid, xyz_m: Sequence[NDArray[np.floating]]) -> Ints:
    """First column and row, columns and rows around points; of the window where they have no ends.

    The ends round as the points do, so that none of them lies outside.
    """
    cells = np.array(grid.shape[:2])
    ends = [[axis.min(initial=np.inf), axis.max(initial=-np.inf)] for axis in xyz_m[:2]]
    start = (grid.corner_m - _NUDGE_M)[:2, None]
    index = np.floor((np.array(ends, np.float64) - start) / grid.cell_size_m)
    if not np.isfinite(index).all():
        return np.array([0, 0, *cells])
    low, high = np.clip(index.T, 0, cells - 1).astype(np.int64)
    return np.concatenate([low, high - low + 1])


def add_runs(parts: Sequence[ClassRuns]) -> ClassRuns:
    """Sum of runs, in any order of the parts."""
    voxel, cls, points, heights = (
        np.concatenate([getattr(part, name) for part in parts])
        for name in ("voxel", "cls", "points", "heights")
    )
    voxel <<= CLASS_BITS
    voxel |= cls
    order = np.argsort(voxel, kind="stable")
    keys = voxel[order]
    if not len(keys):
        return ClassRuns(voxel, cls, points, heights)
    first = np.flatnonzero(np.diff(keys, prepend=-1))
    sums = (np.add.reduceat(column[order], first) for column in (points, heights))
    keys = keys[first]
    return ClassRuns(keys >> CLASS_BITS, (keys & 255).astype(np.uint8), *sums)


def settle(runs: ClassRuns) -> Voxels:
    """Class of each voxel: road or bridge wins, then the most frequent, then the lowest class."""
    return Voxels(*winners(runs.voxel, runs.cls, runs.points, runs.heights))


def seen_from_above(grid: VoxelGrid, voxels: Voxels) -> Columns:
    """Highest voxel of each column, or its uppermost road where there is any (Fig. 4c and d)."""
    columns, _, layers = grid.shape
    number, cls, layer, share = tops(
        voxels.voxel, voxels.cls, voxels.own, voxels.points, voxels.heights, layers
    )
    row, column = (index.astype(np.int32) for index in np.divmod(number, columns))
    height = grid.corner_m[2] + layer * grid.cell_size_m - _NUDGE_M
    return Columns(row, column, cls, height, share)


# Compiled loops over sorted voxels.


@compiled(nogil=True, error_model="numpy")
def point_keys(
    x: NDArray[np.floating],
    y: NDArray[np.floating],
    z: NDArray[np.floating],
    cls: Bytes,
    start: Floats,
    edge_m: float,
    shape: Ints,
    box: Ints,
) -> tuple[Ints, Ints]:
    """Column of points in a box of columns, and layer, class and height above its floor in 256ths.

    Parameters
    ----------
    x, y, z, cls : (n,) metres and class. start : (3,) corner of the window. shape : (3,) its cells.
    box : (4,) first column and row, columns and rows.
    """
    place, key = np.empty(len(x), np.int64), np.empty(len(x), np.int64)
    # Without branches, processors take several points at once.
    for i in range(len(x)):
        column = min(max(int(np.floor((x[i] - start[0]) / edge_m)), 0), shape[0] - 1)
        row = min(max(int(np.floor((y[i] - start[1]) / edge_m)), 0), shape[1] - 1)
        height = (z[i] - start[2]) / edge_m
        layer = min(max(int(np.floor(height)), 0), shape[2] - 1)
        part = min(max(int((height - layer) * 256.0), 0), 255)
        place[i] = (row - box[1]) * box[2] + column - box[0]
        key[i] = (layer << 16) | (np.int64(cls[i]) << 8) | part
    return place, key


@compiled(nogil=True)
def indices_of(voxel: Ints, shape: Ints, low: Ints) -> Ints32:
    """Indices ix, iy, iz (3, n) of voxel numbers (n,)."""
    indices = np.empty((3, len(voxel)), np.int32)
    for i in range(len(voxel)):
        column = voxel[i] // shape[2]
        row = column // shape[0]
        indices[0, i] = column - row * shape[0] + low[0]
        indices[1, i] = row + low[1]
        indices[2, i] = voxel[i] - column * shape[2] + low[2]
    return indices


@compiled(nogil=True)
def runs_of(keys: Ints) -> tuple[Ints, Bytes, Ints, Ints]:
    """Voxel, class, points and heights of the runs of sorted keys."""
    count = 0
    for i in range(len(keys)):
        count += i == 0 or keys[i] >> 8 != keys[i - 1] >> 8
    voxel, cls = np.empty(count, np.int64), np.empty(count, np.uint8)
    points, heights = np.zeros(count, np.int64), np.zeros(count, np.int64)
    run = -1
    for i in range(len(keys)):
        if i == 0 or keys[i] >> 8 != keys[i - 1] >> 8:
            run += 1
            voxel[run], cls[run] = keys[i] >> 16, (keys[i] >> 8) & 255
        points[run] += 1
        heights[run] += keys[i] & 255
    return voxel, cls, points, heights


@compiled(nogil=True)
def winners(
    voxel: Ints, cls: Bytes, points: Ints, heights: Ints
) -> tuple[Ints, Bytes, Ints, Ints, Ints]:
    """Voxel, class, own points, points and heights of each voxel; see `Voxels`."""
    count = 0
    for i in range(len(voxel)):
        count += i == 0 or voxel[i] != voxel[i - 1]
    number, winner = np.empty(count, np.int64), np.empty(count, np.uint8)
    own, total = np.zeros(count, np.int64), np.zeros(count, np.int64)
    height = np.zeros(count, np.int64)
    k, most, paved = -1, 0, False
    for i in range(len(voxel)):
        road = cls[i] == ROAD or cls[i] == BRIDGE
        if i == 0 or voxel[i] != voxel[i - 1]:
            k, most, paved = k + 1, 0, False
            number[k] = voxel[i]
        if road and not paved:
            paved, most = True, 0
            own[k] = height[k] = 0
        total[k] += points[i]
        if road == paved:
            own[k] += points[i]
            height[k] += heights[i]
            if points[i] > most:
                most, winner[k] = points[i], cls[i]
    return number, winner, own, total, height


@compiled(nogil=True)
def tops(
    voxel: Ints, cls: Bytes, own: Ints, points: Ints, heights: Ints, layers: int
) -> tuple[Ints, Bytes, Floats, Floats]:
    """Column, class, height in layers and road share of each column; see `Columns`."""
    count = 0
    for i in range(len(voxel)):
        count += i == 0 or voxel[i] // layers != voxel[i - 1] // layers
    number, shown = np.empty(count, np.int64), np.empty(count, np.uint8)
    layer, share = np.empty(count, np.float64), np.zeros(count, np.float64)
    k, end = count, len(voxel)
    while end > 0:  # columns from the last to the first, so that each is met at its top
        column, top, first = voxel[end - 1] // layers, end - 1, end - 1
        while first > 0 and voxel[first - 1] // layers == column:
            first -= 1
        while top >= first and cls[top] != ROAD and cls[top] != BRIDGE:
            top -= 1
        paved = top >= first
        top = top if paved else end - 1
        mine, around = own[top], points[top]
        level = (voxel[top] - column * layers) * 256 * own[top] + heights[top]
        if paved:
            below, above = top - 1, top + 1
            if below >= first and voxel[below] == voxel[top] - 1:
                around += points[below]
                # The surface may pass through the floor of its voxel.
                if cls[below] == ROAD or cls[below] == BRIDGE:
                    mine += own[below]
                    level += (voxel[below] - column * layers) * 256 * own[below] + heights[below]
            if above < end and voxel[above] == voxel[top] + 1:
                around += points[above]
            share[k - 1] = mine / around
        k -= 1
        number[k], shown[k] = column, cls[top]
        layer[k] = (level / mine + 0.5) / 256.0  # heights were cut off to 256ths: half of one more
        end = first
    return number, shown, layer, share


# Points of each class in each voxel, counted column by column without sorting them.
#
# The runs of a column hang on each other by rising layer and class. They are few, however many
# points there are, so that a point soon finds its own.

# Columns of a run: layer and class, the next run of its column, points, sum of their heights.
_KIND, _NEXT, _POINTS, _HEIGHTS = range(4)


@compiled(nogil=True)
def chained(place: Ints, key: Ints, columns: int, steps: int) -> tuple[Ints32, Ints, int]:
    """Runs of points, chained by column.

    Parameters
    ----------
    place : (n,) column. key : (n,) layer, class and height, see `point_keys`.
    columns : how many. steps : along the chains that may be taken in all.

    Returns
    -------
    first run of each column (columns,), -1 without any; layer and class, next run or -1, points and
    heights of the runs (n, 4); and how many of these there are, -1 if it would take more steps
    """
    first = np.full(columns, -1, np.int32)
    runs = np.empty((len(place), 4), np.int64)
    used = 0
    for i in range(len(place)):
        kind = key[i] >> 8
        before, run = -1, int(first[place[i]])
        while run >= 0 and runs[run, _KIND] < kind:
            before, run = run, int(runs[run, _NEXT])
            steps -= 1
        if steps < 0:
            return first, runs, -1
        if run < 0 or runs[run, _KIND] != kind:
            runs[used, _KIND], runs[used, _NEXT] = kind, run
            runs[used, _POINTS] = runs[used, _HEIGHTS] = 0
            if before < 0:
                first[place[i]] = used
            else:
                runs[before, _NEXT] = used
            run, used = used, used + 1
        runs[run, _POINTS] += 1
        runs[run, _HEIGHTS] += key[i] & 255
    return first, runs, used


@compiled(nogil=True)
def by_column(
    first: Ints32, runs: Ints, used: int, shape: Ints, box: Ints
) -> tuple[Ints, Bytes, Ints, Ints]:
    """Voxel, class, points and heights of chained runs, by rising voxel and class.

    Parameters
    ----------
    first, runs, used : see `chained`. shape : (3,) cells of the window. box : see `point_keys`.
    """
    voxel, cls = np.empty(used, np.int64), np.empty(used, np.uint8)
    points, heights = np.empty(used, np.int64), np.empty(used, np.int64)
    i = 0
    for place in range(len(first)):
        row = place // box[2]
        floor = ((row + box[1]) * shape[0] + place - row * box[2] + box[0]) * shape[2]
        run = int(first[place])
        while run >= 0:
            voxel[i], cls[i] = floor + (runs[run, _KIND] >> 8), runs[run, _KIND] & 255
            points[i], heights[i] = runs[run, _POINTS], runs[run, _HEIGHTS]
            i, run = i + 1, int(runs[run, _NEXT])
    return voxel, cls, points, heights
