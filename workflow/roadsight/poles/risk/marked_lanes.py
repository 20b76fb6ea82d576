"""Lanes and the edges of the travelled way by station, from markings that images show.

Along a road lines keep their offset from the centreline. Around each station the offset that most
pieces of road have is a line, then the next one a lane away, and so on. The outermost line of a
side is its edge line if it is solid; lanes are what lies between neighbouring lines.
"""

from __future__ import annotations

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

from roadsight.base.arrays import Bools, Floats, Ints

WINDOW_M = 15.0
"""Lines are looked for over so much road either way: two and a half periods of a dashed line, which
is seen in a quarter of them wherever the window lies."""
_PIECE_M = 1.0
"""A piece of road along a line, in which it is seen or not."""
_HALF_M = 0.3
"""Points of a line lie so near to its middle: double lines are 0.2 m apart, places of an image 0.1
m off."""
_NARROWEST_M, _WIDEST_M = 2.4, 4.8
"""Widths of lanes. What is nearer to a line than the narrowest is an arrow, hatching or a stray."""
_LEAST_SEEN = 0.15
"""A line is seen in so many of the pieces that images look at: a dashed one in a quarter."""
_SOLID = 0.6
"""An edge line in so many; a dashed one in a third, as its ends are drawn longer by far images."""
_FEWEST_PIECES = 10
"""Pieces that images must look at."""
_FEWEST_IMAGES = 3
_AROUND_M = 60.0
"""Of two lines too near to each other the one stays that is seen in more of so much road either
way: hatching begins and ends, and so does the foot of a bridge's parapet, which a network takes for
paint."""
_ALIKE = 0.9
"""The outer one also if it is seen in so much of what the other is."""
_SHARED = 4.0
"""Images whose camera is off by the same: they follow each other every 8 m, and what ties them is
smooth over some."""
_FLOOR_M = 0.03
"""Least standard deviation of a line: what all images share, their lens and the terrain model. With
it errors on three generated roads of two lanes are 0.8 sigma (root mean square), with 0.02 up to
1.4 of one edge; on one of four lanes 1.6."""
MARKINGS, INVENTORY, PAVED = "markings", "inventory", "paved width"
"""Where lanes are from, as tables say it."""
Line = tuple[float, float, float]
"""Offset of a line, its sigma, and the share of the pieces in which it is seen."""
LANE_COLUMNS = (
    "left_m",
    "right_m",
    "sigma_left_m",
    "sigma_right_m",
    "lanes",
    "lane_width_m",
    "sigma_lane_width_m",
)


def marked_lanes(
    station_m: Floats, offset_m: Floats, image: ArrayLike, at_m: Floats
) -> pd.DataFrame:
    """Lanes of a road at stations.

    Parameters
    ----------
    station_m, offset_m : (n,) points on markings, offsets from the centreline, positive right.
    image : (n,) that shows them. at_m : (k,) stations.

    Returns
    -------
    columns `LANE_COLUMNS`: distances from the centreline to the edge lines' middles on both sides,
    number of lanes and their mean width; NaN where images do not show it
    """
    order = np.argsort(station_m, kind="stable")
    station, offset = station_m[order], offset_m[order]
    number = np.unique(np.asarray(image), return_inverse=True)[1].ravel()[order]
    rows = []
    for at in at_m:
        near, around = (
            slice(*np.searchsorted(station, [at - reach, at + reach]))
            for reach in (WINDOW_M, _AROUND_M)
        )
        lines = _lines(station[near], offset[near], number[near])
        rows.append(_lanes_of(_apart(lines, station[around], offset[around])))
    return pd.DataFrame(rows, columns=list(LANE_COLUMNS), dtype=np.float64)


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
    `LANE_COLUMNS`; lanes_from and travelled_from: ``markings``, ``inventory``, ``paved width``
    (over the inventory's lanes), or empty where nothing tells
    """
    lanes, wide = (known[name].to_numpy(np.float64) for name in ("lanes", "lane_width_m"))
    seen = marked["lanes"].notna().to_numpy()
    found = marked.reset_index(drop=True).copy()
    share = np.asarray(paved_width_m, np.float64) / lanes
    stated = np.where(np.isnan(wide), share, wide)
    found["lanes"] = np.where(seen, found["lanes"], lanes)
    found["lane_width_m"] = np.where(seen, found["lane_width_m"], stated)
    told = np.isfinite(stated)
    by = [seen, told & np.isfinite(wide), told]
    found["lanes_from"] = np.select(by, [MARKINGS, INVENTORY, PAVED], "").astype(object)
    half = lanes * wide / 2
    sides = np.isfinite(found[["left_m", "right_m"]].to_numpy(np.float64))
    for number, side in enumerate(("left_m", "right_m")):
        found[side] = np.where(sides[:, number], found[side], half)
    both = [sides.all(axis=1), sides.any(axis=1) & np.isfinite(half), np.isfinite(half)]
    names = [MARKINGS, f"{MARKINGS} and {INVENTORY}", INVENTORY]
    one = np.where(sides.any(axis=1), MARKINGS, "")
    found["travelled_from"] = np.select(both, names, one).astype(object)
    return found


def _lanes_of(lines: list[Line]) -> tuple[float, ...]:
    """Values of `LANE_COLUMNS` of the lines at one station."""
    nan = float("nan")
    ends = []
    for side, end in ((-1.0, 0), (1.0, -1)):
        outer = lines[end] if lines else None
        solid = outer is not None and outer[2] >= _SOLID and side * outer[0] > _NARROWEST_M / 2
        ends.append((side * outer[0], outer[1]) if solid and outer is not None else (nan, nan))
    (left, sigma_left), (right, sigma_right) = ends
    widths = np.diff([line[0] for line in lines])
    count, width = nan, nan
    known = np.isfinite(left + right) and len(widths) > 0
    if known and ((widths >= _NARROWEST_M) & (widths <= _WIDEST_M)).all():
        count, width = float(len(widths)), float(widths.mean())
    sigma = float(np.hypot(sigma_left, sigma_right)) / count
    return left, right, sigma_left, sigma_right, count, width, sigma


def _lines(station: Floats, offset: Floats, image: Ints) -> list[Line]:
    """Lines of one window from left to right."""
    piece = np.floor(station / _PIECE_M).astype(np.int64)
    looked_at = len(np.unique(piece))
    if looked_at < _FEWEST_PIECES:
        return []
    found: list[Line] = []
    free = np.ones(len(offset), bool)
    while free.any():
        middle = _densest(offset[free], piece[free])
        own = free & (np.abs(offset - middle) <= _HALF_M)
        share = len(np.unique(piece[own])) / looked_at
        if share < _LEAST_SEEN:
            break
        free &= np.abs(offset - middle) > _HALF_M
        if len(np.unique(image[own])) >= _FEWEST_IMAGES:
            found.append((*_middle(offset[own], image[own]), share))
    return sorted(found)


def _densest(offset: Floats, piece: Ints) -> float:
    """Middle of the strip that is seen in most pieces."""
    step = _HALF_M / 3
    cell = np.floor(offset / step).astype(np.int64)
    pairs = np.unique(np.column_stack([cell, piece]), axis=0)
    first = int(cell.min())
    seen = np.bincount(pairs[:, 0] - first)
    near = np.convolve(seen, np.ones(5), "same") if len(seen) > 5 else seen.astype(np.float64)
    best = first + int(np.argmax(near))
    own: Bools = np.abs(cell - best) <= 2
    return float(np.median(offset[own]))


def _middle(offset: Floats, image: Ints) -> tuple[float, float]:
    """Offset of a line, and its sigma by how much images differ."""
    _, group = np.unique(image, return_inverse=True)
    means = np.bincount(group, offset) / np.bincount(group)
    middle = float(np.median(means))
    spread = 1.4826 * float(np.median(np.abs(means - middle)))
    return middle, float(np.hypot(spread / np.sqrt(max(len(means) / _SHARED, 1.0)), _FLOOR_M))


def _apart(lines: list[Line], station: Floats, offset: Floats) -> list[Line]:
    """Lines without those that are too near to one that goes on further.

    Parameters
    ----------
    station, offset : of the points around, see `_AROUND_M`.
    """
    kept = list(lines)
    while len(kept) > 1:
        gaps = np.diff([line[0] for line in kept])
        near = int(np.argmin(gaps))
        if gaps[near] >= _NARROWEST_M:
            break
        inner, outer = sorted(kept[near : near + 2], key=lambda line: abs(line[0]))
        goes_on = [
            len(np.unique(np.floor(station[np.abs(offset - line[0]) <= _HALF_M] / _PIECE_M)))
            for line in (inner, outer)
        ]
        kept.remove(inner if goes_on[1] >= _ALIKE * goes_on[0] else outer)
    return kept
