"""Edges of the road in the overhead view of a classified cloud (paper 2, section 3.2.1).

The paper takes the edge pixels of the dilated and eroded road image. Ours follows the outline of
the same image, but finds the edge between the pixels: a pixel that a road covers in part holds
road points in part, so that the edge runs where half of the points are of the road.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from roadsight.base.arrays import Bools, Bytes, Floats, Floats32, Ints, Ints32
from roadsight.base.sections.poles import RoadEdges

# Rows and columns of the blocks in which levels and distances are computed: what a block takes is
# used again, while memory of the whole view would be touched for the first time.
_BLOCK = 256


@dataclass(frozen=True)
class RoadImage:
    """Cleaned overhead image of a road.

    Parameters
    ----------
    road : (rows, columns) whether road. closing : radius that cleaned it, cells.
    surveyed : whether surveyed, with 2 closing + 1 cells more on each side.
    """

    road: Bools
    surveyed: Bools
    closing: int

    @property
    def margin(self) -> int:
        """Cells around the image that were looked at."""
        return 2 * self.closing + 1


def clean_road(
    is_road: Bools, occupied: Bools, cell_size_m: float, settings: RoadEdges
) -> RoadImage:
    """Close and open the road image, fill small holes and drop small islands.

    Parameters
    ----------
    is_road : (rows, columns) pixels with road points. occupied : those with any points.
    """
    radius = closing_radius(occupied, is_road, settings.closing_cells)
    margin = 2 * radius + 1
    disc = _disc(radius)
    least_cells = np.array([settings.smallest_road_m2, settings.smallest_hole_m2]) / cell_size_m**2
    road = np.pad(is_road.view(np.uint8), margin)
    for step in (cv2.MORPH_CLOSE, cv2.MORPH_OPEN):
        road = np.asarray(cv2.morphologyEx(road, step, disc), np.uint8)
    road = without_small(road, least_cells[0])
    road = 1 - without_small(1 - road, least_cells[1])
    wide = _disc(radius + 1)
    seen = cv2.morphologyEx(np.pad(occupied.view(np.uint8), margin), cv2.MORPH_CLOSE, wide)
    surveyed = 1 - without_small(1 - np.maximum(seen, road), least_cells[1])
    inner = (slice(margin, -margin), slice(margin, -margin))
    return RoadImage(road[inner].view(bool), surveyed.view(bool), radius)


# Probability that a disc on the road is empty by chance, at most; it sets the closing radius.
_MISSED_HOLES = 1e-4
# Cells; a larger radius would round off corners and join carriageways of very sparse clouds.
_LARGEST_CLOSING = 6


def closing_radius(occupied: Bools, is_road: Bools, least: int) -> int:
    """Radius in cells at which next to no disc on the road is empty by chance.

    Points that fall at random with a mean of d a cell leave a disc of radius r empty with
    probability exp(-pi d r^2).
    """
    density = points_per_cell(occupied, is_road)
    radius = np.sqrt(-np.log(_MISSED_HOLES) / (np.pi * density))
    # Discs are drawn a quarter of a cell larger than their radius, see `_disc`.
    return int(np.clip(np.ceil(radius - 0.25), max(least, 1), max(least, _LARGEST_CLOSING)))


def points_per_cell(occupied: Bools, is_road: Bools) -> float:
    """Mean number of points of a cell on and around the road, from the share of occupied ones.

    0.001 to 7: where next to all cells are occupied, the share tells no more.
    """
    around = cv2.dilate(is_road.view(np.uint8), _disc(2)).view(bool)
    cells = np.count_nonzero(around)
    share = np.count_nonzero(occupied & around) / cells if cells else 1.0
    return max(float(-np.log(max(1.0 - share, 1e-3))), 1e-3)


def smoothing_cells(image: RoadImage, cell_size_m: float, settings: RoadEdges) -> float:
    """Smoothing window of an image's outlines, cells: wider where closing is."""
    return settings.smoothing_m * image.closing / cell_size_m


def edge_pixels(image: RoadImage, border_cells: float) -> Bools:
    """Edge pixels of the road (rows, columns), without the ends of the data (the paper's way)."""
    road = image.road.astype(np.uint8)
    inner = cv2.erode(np.pad(road, 1), np.ones((3, 3), np.uint8))[1:-1, 1:-1]
    edge = road > inner
    place = np.argwhere(edge)
    edge[tuple(place[~in_survey(image, place.astype(np.float64), border_cells)].T)] = False
    return edge


def in_survey(image: RoadImage, place: Floats, border_cells: float) -> Bools:
    """Whether places (n, 2) are farther than ``border_cells`` from what was not surveyed.

    Windows are so wide that what lies beyond them is farther.
    """
    inside = np.empty(len(place), bool)
    held = np.clip(place, 0.0, np.array(image.road.shape) - 1.0) + image.margin
    reach = int(np.ceil(border_cells)) + 2
    for own, window in windows_around(held, image.surveyed.shape, _BLOCK, reach):
        surveyed = image.surveyed[window].view(np.uint8)
        distance = cv2.distanceTransform(surveyed, cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
        row, column = (held[own] - [part.start for part in window]).T
        inside[own] = between_pixels(distance - 0.5, row, column) > border_cells
    return inside


def edge_level(road_share: NDArray[np.floating], occupied: Bools, image: RoadImage) -> Floats32:
    """Smoothed share of road points (rows, columns): the edge runs at a half.

    Pixels without points say nothing. Well inside and well outside the cleaned road, the level is
    1 and 0, so that what was filled or dropped has no edge.
    """
    halo = 2 * image.closing + 4
    level = np.zeros(image.road.shape, np.float32)
    for inner, outer, core in blocks(image.road.shape, _BLOCK, halo):
        if image.road[outer].any():
            near = _level(road_share[outer], occupied[outer], image.road[outer], image.closing)
            level[inner] = near[core]
    return level


def _level(
    road_share: NDArray[np.floating], occupied: Bools, road: Bools, closing: int
) -> Floats32:
    """Level of a block (rows, columns), right where its surroundings are in it."""
    sigma = max(0.7, 0.5 * closing)
    weight = cv2.GaussianBlur(occupied.astype(np.float32), (0, 0), sigma)
    paved = np.where(occupied, road_share, 0.0).astype(np.float32, copy=False)
    share = np.asarray(cv2.GaussianBlur(paved, (0, 0), sigma), np.float32)
    pixels, reach = road.astype(np.uint8), _disc(closing + 2)
    share = np.where(weight > 1e-3, share / np.maximum(weight, 1e-3), pixels)
    share[cv2.dilate(pixels, reach, borderValue=0) == 0] = 0.0
    share[cv2.erode(pixels, reach, borderValue=1) > 0] = 1.0
    return share


def outlines(image: RoadImage, level: NDArray[np.floating], window_cells: float) -> list[Floats]:
    """Closed outlines of the road as fractional (row, column) pairs, each (n, 2).

    The chain of edge pixels is smoothed and every place moved across it to where the level is a
    half, at most a few cells.
    """
    padded = np.pad(image.road, 1).astype(np.uint8)
    chains, _ = cv2.findContours(padded, cv2.RETR_CCOMP, cv2.CHAIN_APPROX_NONE)
    lines = []
    for chain in chains:
        pixels = chain[:, 0, ::-1].astype(np.float64) - 1.0
        if len(pixels) < 8:
            continue
        rough = resampled(smoothed(pixels, window_cells), 1.0)
        moved = _to_level(rough, level, image.closing + 1.5)
        lines.append(smoothed(moved, window_cells))
    return lines


# Places of an outline worked on together: their samples stay in the processor's cache.
_BATCH = 1_000


def _to_level(line: Floats, level: NDArray[np.floating], reach: float) -> Floats:
    """Move places of a closed line (n, 2) across it to the nearest crossing of level one half."""
    tangent = np.roll(line, -1, axis=0) - np.roll(line, 1, axis=0)
    tangent /= np.maximum(np.linalg.norm(tangent, axis=1, keepdims=True), 1e-9)
    normal = np.column_stack([-tangent[:, 1], tangent[:, 0]])
    steps = np.arange(-reach, reach + 0.125, 0.25)
    offset = np.empty(len(line))  # to the nearest level of a half, or infinite
    for start in range(0, len(line), _BATCH):
        own = slice(start, start + _BATCH)
        places = line[own][:, None] + steps[:, None] * normal[own][:, None]
        row, column = places.transpose(2, 0, 1)
        values = between_pixels(level, row, column) - 0.5
        crossing = (values[:, :-1] <= 0) != (values[:, 1:] <= 0)
        share = values[:, :-1] / np.where(crossing, values[:, :-1] - values[:, 1:], 1.0)
        reached = np.where(crossing, steps[:-1] + 0.25 * share, np.inf)
        offset[own] = reached[np.arange(len(reached)), np.abs(reached).argmin(axis=1)]
    found = np.isfinite(offset)
    if not found.any():
        return line
    # Where nothing crosses, the line keeps the offset of its neighbours.
    index = np.arange(len(line))
    offset = np.interp(index, index[found], offset[found], period=len(line))
    return line + offset[:, None] * normal


@dataclass(frozen=True)
class EdgeLines:
    """Edge points along polylines.

    Parameters
    ----------
    place : (n, 2) fractional row and column. tangent : (n, 2) unit vector in rows and columns,
        over a metre to either side.
    polyline : (n,) number of the line, from 0; the points of a line follow each other.
    """

    place: Floats
    tangent: Floats
    polyline: Ints32


_SHORTEST_M = 3.0  # Shorter pieces of edge are dropped.
BORDER_CELLS = 1.5  # Edge points this near to what was not surveyed are ends of the data.


def edge_lines(
    rings: list[Floats], image: RoadImage, cell_size_m: float, settings: RoadEdges
) -> EdgeLines:
    """Cut closed outlines where the data end and sample what is left at equal steps.

    What the window smoothed together with the cut goes too.
    """
    step = settings.spacing_m / cell_size_m
    trim = int(np.ceil(2.0 * smoothing_cells(image, cell_size_m, settings) / step))
    reach = max(1, round(1.0 / settings.spacing_m))  # tangents over a metre to either side
    places, tangents = [np.empty((0, 2))], [np.empty((0, 2))]
    lengths = []
    sampled = [resampled(outline, step) for outline in rings]
    inside = in_survey(image, np.concatenate([*places, *sampled]), BORDER_CELLS)
    for ring, kept in zip(
        sampled, np.split(inside, np.cumsum([len(r) for r in sampled])), strict=False
    ):
        tangent = np.roll(ring, -reach, axis=0) - np.roll(ring, reach, axis=0)
        tangent /= np.maximum(np.linalg.norm(tangent, axis=1, keepdims=True), 1e-9)
        for run in runs_of(trimmed(kept, trim)):
            if len(run) * settings.spacing_m >= _SHORTEST_M:
                places.append(ring[run])
                tangents.append(tangent[run])
                lengths.append(len(run))
    number = np.repeat(np.arange(len(lengths), dtype=np.int32), lengths)
    return EdgeLines(np.concatenate(places), np.concatenate(tangents), number)


_ROWS = 16  # Rows whose labels are counted together: a copy of few labels, not of all.
_LABELS_BLOCK = 4096  # The same for labels of components, which need wide surroundings.


def without_small(mask: Bytes, least_cells: float) -> Bytes:
    """Mask without components (of pixels that share a side) of fewer cells.

    A component that reaches from a block to the end of its surroundings has at least as many cells
    as the surroundings are wide.
    """
    halo = int(min(np.ceil(least_cells), max(mask.shape)))
    kept = np.empty_like(mask)
    for inner, outer, core in blocks(mask.shape, max(_LABELS_BLOCK, 4 * halo), halo):
        count, labels = cv2.connectedComponents(mask[outer], connectivity=4)
        cells = np.zeros(count, np.int64)
        for start in range(0, len(labels), _ROWS):
            cells += np.bincount(labels[start : start + _ROWS].ravel(), minlength=count)
        keep = (cells >= least_cells).astype(np.uint8)
        keep[0] = 0
        kept[inner] = keep[labels][core]
    return kept


def _disc(radius: int) -> Bytes:
    step = np.arange(-radius, radius + 1)
    return (np.hypot(step[:, None], step) <= radius + 0.25).astype(np.uint8)


# Images part by part, and between their pixels.


def between_pixels(image: NDArray[np.floating], row: ArrayLike, column: ArrayLike) -> Floats:
    """Values of an image (rows, columns) at fractional places, bilinear between pixels' centres.

    Beyond the outermost centres the nearest value holds.
    """
    rows, columns = image.shape
    row = np.clip(np.asarray(row, np.float64), 0.0, rows - 1.0)
    column = np.clip(np.asarray(column, np.float64), 0.0, columns - 1.0)
    upper, left = row.astype(np.int64), column.astype(np.int64)
    down, right = row - upper, column - left
    lower, next_column = np.minimum(upper + 1, rows - 1), np.minimum(left + 1, columns - 1)
    top = image[upper, left] * (1.0 - right) + image[upper, next_column] * right
    bottom = image[lower, left] * (1.0 - right) + image[lower, next_column] * right
    return top * (1.0 - down) + bottom * down


def blocks(
    shape: tuple[int, int], size: int, halo: int
) -> Iterator[tuple[tuple[slice, ...], tuple[slice, ...], tuple[slice, ...]]]:
    """Blocks of at most ``size`` rows and columns, with ``halo`` more where there are any.

    Yields
    ------
    inner part of the image, outer one with its surroundings, core of that: what is computed for
    ``image[outer]`` holds for ``image[inner]`` in ``[core]``.
    """
    for first_row in range(0, shape[0], size):
        for first_column in range(0, shape[1], size):
            parts = []
            for first, end in zip((first_row, first_column), shape, strict=True):
                start, last = max(first - halo, 0), min(first + size, end)
                around = slice(start, min(last + halo, end))
                parts.append((slice(first, last), around, slice(first - start, last - start)))
            inner, outer, core = zip(*parts, strict=True)
            yield inner, outer, core


def windows_around(
    place: Floats, shape: tuple[int, int], size: int, halo: int
) -> Iterator[tuple[Ints, tuple[slice, slice]]]:
    """Windows of an image around places (n, 2) of the same block: which places, and the window.

    A window reaches ``halo`` pixels beyond those between which its places lie, if the image does.
    Places beyond the image belong to its nearest pixels.
    """
    pixel = np.clip(np.floor(place), 0, np.array(shape) - 1).astype(np.int64)
    number = pixel[:, 0] // size * shape[1] + pixel[:, 1] // size
    order = np.argsort(number, kind="stable")
    for own in np.split(order, np.flatnonzero(np.diff(number[order])) + 1):
        if len(own):
            low = np.maximum(pixel[own].min(axis=0) - halo, 0)
            high = pixel[own].max(axis=0) + 2 + halo  # places lie between two pixels
            yield own, (slice(low[0], high[0]), slice(low[1], high[1]))


# Closed lines: places that follow each other, and the first the last.
#
# NumPy alone: the filters of larger libraries take longer to load than to run.

# Half width of a Gaussian window in standard deviations, as SciPy cuts it; 6e-5 lies outside.
_DEVIATIONS = 4.0


def smoothed(ring: Floats, sigma: float) -> Floats:
    """Ring (n, 2) smoothed by a Gaussian window that does not shrink arcs.

    Parameters
    ----------
    sigma : standard deviation of the window in places of the ring; 0 leaves it as it is.
    """
    if sigma <= 0:
        return ring
    reach = int(_DEVIATIONS * sigma + 0.5)
    weight = np.exp(-0.5 * (np.arange(-reach, reach + 1) / sigma) ** 2)
    once = _convolved(ring, weight / weight.sum())
    return 2 * once - _convolved(once, weight / weight.sum())


def resampled(ring: Floats, spacing: float) -> Floats:
    """Ring (n, 2) at equal steps of about ``spacing``, eight of them at least."""
    closed = np.vstack([ring, ring[:1]])
    station = np.append(0.0, np.cumsum(np.hypot(*np.diff(closed, axis=0).T)))
    count = max(8, round(station[-1] / spacing))
    at = np.arange(count) * station[-1] / count
    return np.column_stack([np.interp(at, station, closed[:, axis]) for axis in (0, 1)])


def trimmed(keep: Bools, places: int) -> Bools:
    """Mask (n,) of the places on a ring that have none to drop within so many places."""
    lost = np.convolve(_wrapped((~keep).astype(int), places), np.ones(2 * places + 1, int), "valid")
    return lost == 0


def runs_of(keep: Bools) -> list[Ints]:
    """Indices of the runs of kept places on a ring; a ring that is kept whole is one run."""
    if keep.all():
        return [np.arange(len(keep))]
    if not keep.any():
        return []
    first = int(np.flatnonzero(~keep)[0])
    index = (np.arange(len(keep)) + first) % len(keep)
    kept = keep[index]
    starts = np.flatnonzero(np.diff(kept.astype(np.int8), prepend=0) == 1)
    ends = np.flatnonzero(np.diff(kept.astype(np.int8), append=0) == -1) + 1
    return [index[a:b] for a, b in zip(starts, ends, strict=True)]


def _convolved(ring: Floats, weight: Floats) -> Floats:
    reach = len(weight) // 2
    return np.column_stack([np.convolve(_wrapped(at, reach), weight, "valid") for at in ring.T])


def _wrapped(values: NDArray, reach: int) -> NDArray:
    """Values (n,) with so many of the other end before and after them."""
    return values[np.arange(-reach, len(values) + reach) % len(values)]
