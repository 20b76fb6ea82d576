"""Scans, drives and files that lie apart: how far the ground says that they do.

Where points tell their scan (``point_source_id``), heights of scans are compared on the cells of
ground that they share. Without, differences of heights of points beside each other tell: if both
come of one layer, their density falls from zero on, whatever the layer's noise (differences of a
unimodal law: Hodges and Lehmann 1954, Matching in paired comparisons). A second peak is a second
layer, and its place the distance. Files that adjoin are compared across their border.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy import ndimage

from roadsight.base.arrays import Bools, Floats, Ints
from roadsight.base.doubts import Doubt
from roadsight.scene.grids import Grid, lowest_per_cell
from roadsight.scene.pavement.scan_levels import robust_plane

_CELL_M = 1.0  # Cells in which scans are compared.
_BLOCK_CELLS = 5  # Side of a block, which has one slope and says one difference of two scans.
_NEAR_M = 0.5  # Points so high above the lowest ground of their cell may be another scan's ground.
_FLAT_M = 0.06  # Spread of a scan's points in a cell of flat ground: noise of 3 cm, and lawn.
_FEWEST_POINTS = 3  # Of a scan in a cell.
_FEWEST_CELLS = 4  # Shared ones in a block.
_FEWEST_BLOCKS = 8  # Whose spread tells how sure their median is.
_NEXT_SCANS = 4  # Scans that each is compared with in a cell, by number: a turn and those after it.
LEAST_APART_M = 0.015  # Scans 2 cm apart change 1.4 % of a sensor's beams.
_SIGMAS = 3.0
_BESIDE_M = 2.0  # Ground so far from a border of two files is compared across it.
_GAP_M = 1.0  # Files with less between them, or in common, adjoin.
_LAG_POINTS = 20_000  # Of a tile whose differences of height are counted.
_PAIRED_POINTS = 3  # In the small cell in which a point is paired.
_WIDEST_STEP_M = 0.02  # Of heights in a file.
_WIDTHS_MM = (3, 6, 12)  # Of the Gaussians that differences are smoothed with.
# A peak so many sigmas above what is lower before it, and pairs in it: of ten clouds of streets
# and towns none reaches 3 sigmas. Four kerbs in 20 m hold up to 2.8 % of the pairs.
_SURE_SIGMAS = 5.0
_LEAST_SHARE = 0.03
_SURE_M = 0.02  # A horizontal shift counts where the slopes of the ground leave it so uncertain.


class Registration:
    """Heights of scans beside each other, gathered tile by tile.

    Parameters
    ----------
    boxes_m : west, south, east, north of each file, local metres. files : their names.

    Attributes
    ----------
    lags : (300,) pairs of points beside each other by their difference of height, mm.
    """

    def __init__(self, boxes_m: Sequence[Sequence[float]] = (), files: Sequence[str] = ()) -> None:
        self._borders, self._files = file_borders(np.array(boxes_m).reshape(-1, 4)), files
        # Border, distance east or north of it, place along it, height.
        self._beside: list[Floats] = [np.empty((0, 4))]
        self.lags = np.zeros(300)
        # Lower and higher number of two scans, block, second's height over the first's, slopes.
        self._pairs: list[Floats] = [np.empty((0, 6))]
        self._blocks = 0

    def add(self, xyz_m: Floats, ground: Bools, scan: Ints) -> None:
        """Compare heights in a part of the cloud made of whole cells of 1 m.

        Parameters
        ----------
        xyz_m : (n, 3) points. ground : (n,) labels. scan : (n,) numbers of their scans.
        """
        if not ground.any():
            return
        if len(self._borders):
            self._add_borders(xyz_m[ground])
        x, y, z = xyz_m.T
        grid = Grid.around(x, y, _CELL_M)
        cell = grid.flat(x, y)
        lowest = lowest_per_cell(grid, x[ground], y[ground], z[ground]).ravel()
        near = np.flatnonzero(z < lowest[cell] + _NEAR_M)
        cell, ids = cell[near], np.unique(scan)
        row, column = np.divmod(cell, grid.columns)
        centre_x, centre_y = grid.centres(column, row)
        # Places from the middle of their cell, heights from its lowest ground.
        x, y, z = x[near] - centre_x, y[near] - centre_y, z[near] - lowest[cell]
        wide = -(-grid.columns // _BLOCK_CELLS)
        block = row // _BLOCK_CELLS * wide + column // _BLOCK_CELLS
        key = cell * len(ids) + np.searchsorted(ids, scan[near])
        count = np.bincount(key)
        kept = np.flatnonzero(count >= _FEWEST_POINTS)
        if len(kept) == 0:
            return
        means = [np.bincount(key, of)[kept] / count[kept] for of in (x, y, z, z**2)]
        east, north, height, square = means
        at, owner = kept // len(ids), kept % len(ids)
        row, column = np.divmod(at, grid.columns)
        of = row // _BLOCK_CELLS * wide + column // _BLOCK_CELLS
        slopes = _slopes(
            np.column_stack([column + east, row + north]) * _CELL_M,
            height + lowest[at],
            of * len(ids) + owner,
            of,
            int(block.max()) + 1,
        )
        self._add_lags(x, y, z, cell, slopes[block])
        steep = slopes[of]
        flat = square - height**2 < _FLAT_M**2 + (steep**2).sum(axis=1) * _CELL_M**2 / 12
        height -= east * steep[:, 0] + north * steep[:, 1]
        at, owner, of, height, steep = (kind[flat] for kind in (at, owner, of, height, steep))
        for step in range(1, _NEXT_SCANS + 1):
            one = np.flatnonzero(at[step:] == at[:-step])
            two = one + step
            names = ids[owner[one]], ids[owner[two]], of[one] + self._blocks
            self._pairs.append(np.column_stack([*names, height[two] - height[one], steep[one]]))
        self._blocks += len(slopes)

    def _add_lags(self, x: Floats, y: Floats, z: Floats, cell: Ints, slope: Floats) -> None:
        """Count pairs of points beside each other by their difference of height.

        Parameters
        ----------
        x, y, z : (n,) from the middle of their cell. cell : (n,). slope : (n, 2) of the ground.
        """
        own = np.flatnonzero(cell % -(-len(z) // _LAG_POINTS) == 0)
        heights = np.unique(z[own].round(4))
        if len(heights) < 2:
            return
        # Heights in steps have differences in steps, too: noise as wide as a step fills them.
        step_m = min(float(np.median(np.diff(heights))), _WIDEST_STEP_M)
        level = z[own] - x[own] * slope[own, 0] - y[own] * slope[own, 1]
        level += np.random.default_rng(0).uniform(-0.5, 0.5, len(own)) * step_m
        each = len(own) / len(np.unique(cell[own])) / _PAIRED_POINTS
        parts = int(2 ** np.clip(np.floor(np.log2(max(each, 1)) / 2), 1, 4))
        small = cell[own] * parts + np.floor((x[own] / _CELL_M + 0.5) * parts).astype(np.int64)
        small = small * parts + np.floor((y[own] / _CELL_M + 0.5) * parts).astype(np.int64)
        order = np.argsort(small, kind="stable")
        _, start, count = np.unique(small[order], return_index=True, return_counts=True)
        # The first half of a cell's points with its second half: drives come one after the other.
        first = np.flatnonzero(np.arange(len(own)) < np.repeat(start + count // 2, count))
        second = first + np.repeat((count + 1) // 2, count)[first]
        lag_m = np.abs(level[order[first]] - level[order[second]])
        self.lags += np.histogram(lag_m, len(self.lags), (0, 1e-3 * len(self.lags)))[0]

    def _add_borders(self, ground_m: Floats) -> None:
        """Gather ground points (n, 3) beside borders of files, as means of cells along them."""
        low, high = ground_m[:, :2].min(axis=0), ground_m[:, :2].max(axis=0)
        for number, (axis, at_m, start_m, end_m) in enumerate(self._borders[:, :4]):
            across, along = int(axis), 1 - int(axis)
            if low[across] > at_m + _BESIDE_M or high[across] < at_m - _BESIDE_M:
                continue
            if low[along] > end_m or high[along] < start_m:
                continue
            off, v = ground_m[:, across] - at_m, ground_m[:, along]
            near = (np.abs(off) < _BESIDE_M) & (v >= start_m) & (v < end_m)
            off, v, z = off[near], v[near], ground_m[near, 2]
            # Four columns of cells across the border, the cells of a row along it.
            row = np.floor(v).astype(np.int64)
            key = row * 4 + np.floor(off / _BESIDE_M * 2 + 2).astype(np.int64)
            _, index, count = np.unique(key, return_inverse=True, return_counts=True)
            means = [np.bincount(index, of) / count for of in (off, v, z)]
            self._beside.append(np.column_stack([np.full(len(count), number), *means]))

    def _steps(self) -> Floats:
        """Steps (n, 6) along borders of files, with the columns that pairs of scans have."""
        cells = np.concatenate(self._beside)
        place = np.column_stack([cells[:, 0], cells[:, 2] // (_BLOCK_CELLS * _CELL_M)])
        places, block = np.unique(place, axis=0, return_inverse=True)
        block, size = block.ravel(), len(places)
        off, z = cells[:, 1], cells[:, 3]
        slopes = _slopes(cells[:, 1:3], z, block * 2 + (off > 0), block, size)
        level = z - (slopes[block] * cells[:, 1:3]).sum(axis=1)
        key = block * 4 + np.floor(off / _BESIDE_M * 2 + 2).astype(np.int64)
        count = np.bincount(key, minlength=4 * size)
        mean = np.bincount(key, level, 4 * size) / np.maximum(count, 1)
        # A kerb beside the border bends what must be straight on either side of it.
        far, left, right, other = mean.reshape(-1, 4).T
        whole = (count.reshape(-1, 4) > 0).all(axis=1)
        whole &= np.maximum(np.abs(left - far), np.abs(other - right)) < LEAST_APART_M
        files = self._borders[places[:, 0].astype(np.int64), 4:]
        step = (right + other - left - far) / 2
        return np.column_stack([files, places[:, 1], step, slopes])[whole]

    def doubts(self) -> list[Doubt]:
        """Doubts about the scans and files that lie farthest apart; none where all agree."""
        blocks, count = _medians(np.concatenate(self._pairs), 3)
        scans = _farthest(blocks[count >= _FEWEST_CELLS])
        found = [] if scans is not None else self._second_layer()
        why = "m: sight lines end too early or pass between; register them again"
        if scans is not None:
            shift, text = _horizontal(scans), ""
            apart_m = float(np.median(scans[:, 3]))
            if shift is not None:
                apart_m, text = float(shift[0]), f" and {np.hypot(*shift[1:]):.2f} m beside it"
            low, high = scans[0, :2].astype(int)[:: 1 if apart_m > 0 else -1]
            told = f"scan {high} lies above scan {low}{text} (point_source_id), {why}, or give one"
            apart_m = round(abs(apart_m), 3)
            found.append(Doubt("scans_apart", "doubt", told, apart_m, LEAST_APART_M))
        files = _farthest(self._steps()) if len(self._beside) > 1 else None
        if files is not None:
            step_m = float(np.median(files[:, 3]))
            low, high = files[0, :2].astype(int)[:: 1 if step_m > 0 else -1]
            told = f"{self._files[high]} lies above {self._files[low]} along their border, {why}"
            step_m = round(abs(step_m), 3)
            found.append(Doubt("files_apart", "doubt", told, step_m, LEAST_APART_M))
        return found

    def _second_layer(self) -> list[Doubt]:
        """A doubt where points beside each other differ by a height more often than by less."""
        found = _SURE_SIGMAS, 0.0
        for width in _WIDTHS_MM:
            density = ndimage.gaussian_filter1d(self.lags, width)
            least = np.minimum.accumulate(density)
            above = density - least
            above[: int(max(1e3 * LEAST_APART_M, 2 * width))] = 0
            peak = int(np.argmax(above))
            # Counts vary by their square root; a Gaussian averages over 2 sqrt(pi) widths.
            noise = np.sqrt((density[peak] + least[peak]) / (2 * np.sqrt(np.pi) * width))
            if above.sum() > _LEAST_SHARE * density.sum():
                core = np.where(above > 0.75 * above[peak], above, 0)
                apart_mm = 0.5 + core @ np.arange(len(core)) / core.sum()
                found = max(found, (above[peak] / noise, float(apart_mm) / 1e3))
        text = (
            "the ground lies in two layers (drives or epochs that were registered badly?), m apart:"
            " sight lines end too early or pass between; register them again, or give one"
        )
        layers = Doubt("ground_doubled", "doubt", text, round(found[1], 3), LEAST_APART_M)
        return [layers] if found[1] else []


def file_borders(boxes_m: Floats) -> Floats:
    """Borders (k, 6) of files that adjoin: axis across it, place, start, end, the two files.

    Parameters
    ----------
    boxes_m : (n, 4) west, south, east, north of each file, local metres.
    """
    found = [np.empty((0, 6))]
    for axis in (0, 1):
        low, high = boxes_m[:, axis], boxes_m[:, axis + 2]
        start, end = (
            bound(boxes_m[:, None, side], boxes_m[None, :, side])
            for bound, side in ((np.maximum, 1 - axis), (np.minimum, 3 - axis))
        )
        met = (np.abs(high[:, None] - low[None]) < _GAP_M) & (end - start > _BESIDE_M)
        one, two = np.nonzero(met & ~np.eye(len(low), dtype=bool))
        at_m = (high[one] + low[two]) / 2
        axes = np.full(len(one), axis)
        found.append(np.column_stack([axes, at_m, start[one, two], end[one, two], one, two]))
    return np.concatenate(found)


def _farthest(blocks: Floats) -> Floats | None:
    """Blocks of the two scans or files that lie farthest apart; None where all agree.

    Parameters
    ----------
    blocks : (n, 6), see `Registration`.
    """
    middle, count = _medians(blocks, 2)
    blocks = blocks[np.lexsort((blocks[:, 1], blocks[:, 0]))]
    number = np.repeat(np.arange(len(count)), count)
    far = blocks.copy()
    far[:, 3] = np.abs(blocks[:, 3] - middle[number, 3])
    apart_m = np.abs(middle[:, 3])
    # Standard error of a median.
    sigma_m = 1.2533 * 1.4826 * _medians(far, 2)[0][:, 3] / np.sqrt(count)
    sure = (count >= _FEWEST_BLOCKS) & (apart_m > np.maximum(_SIGMAS * sigma_m, LEAST_APART_M))
    if not sure.any():
        return None
    return blocks[number == np.argmax(np.where(sure, apart_m, 0))]


def _horizontal(blocks: Floats) -> Floats | None:
    """Shift (3,) up, east and north of one scan on another; None where slopes do not tell it.

    Parameters
    ----------
    blocks : (n, 6), see `Registration`: a shift to the side lowers what rises towards it.
    """
    design = np.column_stack([np.ones(len(blocks)), -blocks[:, 4:]])
    shift = robust_plane(design, blocks[:, 3])
    spread_m = 1.4826 * float(np.median(np.abs(blocks[:, 3] - design @ shift))) + 1e-3
    covariance = spread_m**2 * np.linalg.inv(design.T @ design + 1e-9 * np.eye(3))
    sigma_m = float(np.sqrt(np.linalg.eigvalsh(covariance[1:, 1:])[-1]))
    beside_m = float(np.hypot(*shift[1:]))
    least_m = max(_SIGMAS * sigma_m, LEAST_APART_M)
    return shift if sigma_m < _SURE_M and beside_m > least_m else None


def _slopes(xy_m: Floats, height_m: Floats, group: Ints, block: Ints, blocks: int) -> Floats:
    """Slopes (blocks, 2) east and north that the groups (scans) of each block have in common.

    Parameters
    ----------
    xy_m : (n, 2). height_m : (n,). group, block : (n,) of each place.
    """
    count = np.maximum(np.bincount(group), 1)
    x, y, z = (axis - (np.bincount(group, axis) / count)[group] for axis in (*xy_m.T, height_m))
    xx, yy, xy, xz, yz = (
        np.bincount(block, product, blocks) for product in (x * x, y * y, x * y, x * z, y * z)
    )
    area = xx * yy - xy**2
    thin = area <= 1e-3 * (xx + yy) ** 2  # a row of cells tells no slope across it
    area[thin] = np.inf
    return np.column_stack([xz * yy - yz * xy, yz * xx - xz * xy]) / area[:, None]


def _medians(table: Floats, keys: int) -> tuple[Floats, Ints]:
    """Rows of each distinct first ``keys`` columns: the one of median column 3, and their number.

    Parameters
    ----------
    table : (n, 6), see `Registration`.
    """
    table = table[np.lexsort((table[:, 3], *table[:, keys - 1 :: -1].T))]
    new = np.r_[True, (np.diff(table[:, :keys], axis=0) != 0).any(axis=1)][: len(table)]
    first = np.flatnonzero(new)
    count = np.diff(np.append(first, len(table)))
    return table[first + count // 2], count
