"""Lanes and the edges of the travelled way by station, from markings that images show.

Along a road lines keep their offset from the centreline. Around each station the offset that most
pieces of road have is a line, then the next one a lane away, and so on. The outermost line of a
side is its edge line if it is solid and the pavement ends near it; lanes are what lies between
neighbouring lines.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

from roadsight.base.arrays import Bools, Floats, Ints

# Lines are looked for over so much road either way: two and a half periods of a dashed line, which
# is seen in a quarter of them wherever the window lies.
WINDOW_M = 15.0
_PIECE_M = 1.0  # a piece of road along a line, in which it is seen or not
# Points of a line lie so near to its middle: double lines are 0.2 m apart, places of an image 0.1 m
# off.
_HALF_M = 0.3
# Widths of lanes. What is nearer to a line than the narrowest is an arrow, hatching or a stray.
_NARROWEST_M, _WIDEST_M = 2.4, 4.8
# A line is seen in so many of the pieces that images look at: a dashed one in a quarter.
_LEAST_SEEN = 0.15
# An edge line in so many; a dashed one in a third, as its ends are drawn longer by far images.
_SOLID = 0.6
# An edge line is no farther from the pavement's edge: shoulders of motorways are 3.0 m wide, and a
# lane whose edge line is not seen is as wide and has 0.3 m of pavement beyond that line.
_WIDEST_SHOULDER_M = 3.2
# Two solid lines so far apart have a median between them; double lines are 0.2 to 0.3 m apart.
_MEDIAN_M = 0.4
_FEWEST_PIECES = 10  # pieces that images must look at
_FEWEST_IMAGES = 3
# Of two lines too near to each other that one stays which more pieces of road show, so far either
# way: hatching begins and ends, and so does the foot of a bridge's parapet, which a network takes
# for paint.
_AROUND_M = 60.0
_ALIKE = 0.9  # the outer one stays as well if its pieces are at least this share of the other's
# Images whose camera is off by the same: they follow each other every 8 m, and what ties them is
# smooth over some.
_SHARED = 4.0
# Least standard deviation of a line: what all images share, their lens and the terrain model. With
# it errors on three generated roads of two lanes are 0.8 sigma (root mean square), with 0.02 up to
# 1.4 of one edge; on one of four lanes 1.6.
_FLOOR_M = 0.03
# Where lanes are from, as tables say it.
MARKINGS, INVENTORY, PAVED = "markings", "inventory", "paved width"
LANE_COLUMNS = (
    "left_m", "right_m", "sigma_left_m", "sigma_right_m", "lanes", "lane_width_m",
    "sigma_lane_width_m",
)  # fmt: skip


class _Line(NamedTuple):
    """A line in a window."""

    offset_m: float  # of its middle
    sigma_m: float
    share: float  # of the pieces that images look at, those that show it
    half_m: float  # how far its points are from the middle of their image's


def marked_lanes(
    station_m: Floats, offset_m: Floats, image: ArrayLike, at_m: Floats, paved_m: Floats
) -> pd.DataFrame:
    """Lanes of a road at stations.

    Parameters
    ----------
    station_m, offset_m : (n,) points on markings, offsets from the centreline, positive right.
    image : (n,) that shows them. at_m : (k,) stations.
    paved_m : (k, 2) from the centreline to the pavement's left and right edge, NaN where unknown.

    Returns
    -------
    columns `LANE_COLUMNS`: distances from the centreline to the edge lines' middles on both sides,
    number of lanes and their mean width; NaN where images do not show it
    """
    order = np.argsort(station_m, kind="stable")
    station, offset = station_m[order], offset_m[order]
    number = np.unique(np.asarray(image), return_inverse=True)[1].ravel()[order]
    looked_at = _looked_at(station, number)
    rows = []
    for at, paved in zip(at_m, paved_m, strict=True):
        near, around = (
            slice(*np.searchsorted(station, [at - reach, at + reach]))
            for reach in (WINDOW_M, _AROUND_M)
        )
        ends = np.floor((at - WINDOW_M) / _PIECE_M), np.ceil((at + WINDOW_M) / _PIECE_M)
        pieces = int(np.diff(np.searchsorted(looked_at, ends))[0])
        lines = _lines(station[near], offset[near], number[near], pieces)
        kept, median = _apart(lines, station[around], offset[around])
        rows.append(_lanes_of(kept, paved, median))
    return pd.DataFrame(rows, columns=list(LANE_COLUMNS), dtype=np.float64)


def _looked_at(station: Floats, image: Ints) -> Ints:
    """Pieces of road between the first and last point of some image; all stations ascend."""
    if not len(station):
        return np.empty(0, np.int64)
    piece = np.floor(station / _PIECE_M).astype(np.int64)
    first = np.unique(image, return_index=True)[1]
    last = len(image) - 1 - np.unique(image[::-1], return_index=True)[1]
    looking = np.zeros(piece[-1] - piece[0] + 2, np.int64)
    np.add.at(looking, piece[first] - piece[0], 1)
    np.add.at(looking, piece[last] - piece[0] + 1, -1)
    return np.asarray(piece[0] + np.flatnonzero(looking.cumsum()), np.int64)


def _lines(station: Floats, offset: Floats, image: Ints, looked_at: int) -> list[_Line]:
    """Lines of one window from left to right; ``looked_at`` counts pieces without paint as well."""
    if looked_at < _FEWEST_PIECES:
        return []
    piece = np.floor(station / _PIECE_M).astype(np.int64)
    found: list[_Line] = []
    free = np.ones(len(offset), bool)
    while free.any():
        middle = _densest(offset[free], piece[free])
        own = free & (np.abs(offset - middle) <= _HALF_M)
        share = len(np.unique(piece[own])) / looked_at
        if share < _LEAST_SEEN:
            break
        free &= np.abs(offset - middle) > _HALF_M
        if len(np.unique(image[own])) >= _FEWEST_IMAGES:
            # Sigma by how much images differ.
            _, group = np.unique(image[own], return_inverse=True)
            means = np.bincount(group, offset[own]) / np.bincount(group)
            at = float(np.median(means))
            spread = 1.4826 * float(np.median(np.abs(means - at)))
            sigma = float(np.hypot(spread / np.sqrt(max(len(means) / _SHARED, 1.0)), _FLOOR_M))
            half = float(np.median(np.abs(offset[own] - means[group])))
            found.append(_Line(at, sigma, share, half))
    return sorted(found)


def _densest(offset: Floats, piece: Ints) -> float:
    """Middle of the strip with most paint: a piece counts for each of five cells that show it."""
    step = _HALF_M / 3
    cell = np.floor(offset / step).astype(np.int64)
    pairs = np.unique(np.column_stack([cell, piece]), axis=0)
    first = int(cell.min())
    seen = np.bincount(pairs[:, 0] - first)
    near = np.convolve(seen, np.ones(5), "same") if len(seen) > 5 else seen.astype(np.float64)
    best = first + int(np.argmax(near))
    own: Bools = np.abs(cell - best) <= 2
    return float(np.median(offset[own]))


def _apart(lines: list[_Line], station: Floats, offset: Floats) -> tuple[list[_Line], bool]:
    """Lines without those too near to one that goes on further; whether inner ones hold a median.

    Points are those around, see `_AROUND_M`.
    """
    kept, median = list(lines), False
    while len(kept) > 1:
        gaps = np.diff([line.offset_m for line in kept])
        near = int(np.argmin(gaps))
        if gaps[near] >= _NARROWEST_M:
            break
        pair = kept[near : near + 2]
        if 0 < near < len(kept) - 2:
            median |= min(line.share for line in pair) >= _SOLID
        inner, outer = sorted(pair, key=lambda line: abs(line.offset_m))
        goes_on = [
            len(np.unique(np.floor(station[np.abs(offset - line.offset_m) <= _HALF_M] / _PIECE_M)))
            for line in (inner, outer)
        ]
        kept.remove(inner if goes_on[1] >= _ALIKE * goes_on[0] else outer)
    return kept, median or any(2 * line.half_m > _MEDIAN_M for line in kept[1:-1])


def _lanes_of(lines: list[_Line], paved_m: Floats, median: bool) -> tuple[float, ...]:
    """Values of `LANE_COLUMNS` of the lines at one station; no lanes beside a median."""
    nan = float("nan")
    ends = []
    for side, end, paved in ((-1, 0, paved_m[0]), (1, -1, paved_m[1])):
        found = nan, nan
        if lines and lines[end].share >= _SOLID:
            away = side * lines[end].offset_m
            if away > _NARROWEST_M / 2 and paved - away <= _WIDEST_SHOULDER_M:
                found = away, lines[end].sigma_m
        ends.append(found)
    (left, sigma_left), (right, sigma_right) = ends
    widths = np.diff([line.offset_m for line in lines])
    count, width = nan, nan
    known = np.isfinite(left + right) and len(widths) > 0 and not median
    if known and ((widths >= _NARROWEST_M) & (widths <= _WIDEST_M)).all():
        count, width = float(len(widths)), float(widths.mean())
    sigma = float(np.hypot(sigma_left, sigma_right)) / count
    return left, right, sigma_left, sigma_right, count, width, sigma


def with_inventory(
    marked: pd.DataFrame, known: pd.DataFrame, paved_width_m: Floats
) -> pd.DataFrame:
    """Lanes by markings, and where images do not show them as an inventory states them.

    Parameters
    ----------
    marked : `LANE_COLUMNS`. known : lanes and lane_width_m of the inventory, NaN where unknown.
    paved_width_m : no lane is wider than its share of it.

    Returns
    -------
    `LANE_COLUMNS`; lanes_from: ``markings``, ``inventory``, ``paved width`` (the inventory's lanes,
    each as wide as its share), or empty where nobody tells a number of lanes; left_from,
    right_from: ``markings``, ``inventory`` or empty; travelled_from: both of them
    """
    lanes, wide = (known[name].to_numpy(np.float64) for name in ("lanes", "lane_width_m"))
    seen = marked["lanes"].notna().to_numpy()
    found = marked.reset_index(drop=True).copy()
    share = np.asarray(paved_width_m, np.float64) / lanes
    stated = np.where(np.isnan(wide), share, wide)
    found["lanes"] = np.where(seen, found["lanes"], lanes)
    found["lane_width_m"] = np.where(seen, found["lane_width_m"], stated)
    told = np.isfinite(lanes)
    by = [seen, told & np.isnan(wide) & np.isfinite(share), told]
    found["lanes_from"] = np.select(by, [MARKINGS, PAVED, INVENTORY], "").astype(object)
    half = lanes * wide / 2
    for side in ("left", "right"):
        own = found[f"{side}_m"]
        found[f"{side}_from"] = np.select(
            [own.notna(), np.isfinite(half)], [MARKINGS, INVENTORY], ""
        ).astype(object)
        found[f"{side}_m"] = own.fillna(pd.Series(half))
    found["travelled_from"] = [
        " and ".join(sorted(set(sides) - {""}, reverse=True))
        for sides in zip(found["left_from"], found["right_from"], strict=True)
    ]
    return found
