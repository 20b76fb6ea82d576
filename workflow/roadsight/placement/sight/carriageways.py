"""Which lanes are of one road, and how many of them lie abreast."""

from __future__ import annotations

import numpy as np
import pandas as pd

from roadsight.base.arrays import Ints

_APART_M = 40.0
"""Carriageways of one road are no farther apart, and all of them lie within twice of it."""
_PARALLEL = float(np.cos(np.radians(20.0)))
"""Cosine of the angle up to which directions are about the same."""
_BESIDE_M = 1.0 + 1e-6
"""Along the road, half the distance of a lane's points and a little for rounding: every lane
abreast has a point so near."""
_ALONGSIDE_SHARE = 0.5
"""Share of new lanes' points that must run along a road for them to be its."""
_MOST_SAMPLES = 400
"""Places of a road at which lanes abreast are counted; their median needs no more."""
_NEIGHBOURS = 16
"""Nearest known points that are looked at; the nearest of them may be of a road that crosses."""


def road_alongside(points: pd.DataFrame, known: pd.DataFrame) -> int | None:
    """Number of the road along which most of the new lanes' points run; None where none is.

    A point runs alongside a road if a lane of it lies no more than 40 m off and within 20 degrees
    of its direction, either way.

    Parameters
    ----------
    points, known : columns x, y, along_x, along_y; of the known ones road as well.
    """
    from scipy.spatial import cKDTree  # noqa: PLC0415  # slow to load

    tree = cKDTree(known[["x", "y"]].to_numpy(np.float64))
    count = min(_NEIGHBOURS, len(known))
    away, near = tree.query(points[["x", "y"]].to_numpy(np.float64), k=[*range(1, count + 1)])
    along = known[["along_x", "along_y"]].to_numpy(np.float64)
    ways = points[["along_x", "along_y"]].to_numpy(np.float64)
    found = away <= _APART_M
    near = np.where(found, near, 0)
    parallel = np.abs((along[near] * ways[:, None]).sum(axis=2)) >= _PARALLEL
    beside = found & parallel
    first = beside.argmax(axis=1)
    rows = np.flatnonzero(beside.any(axis=1))
    if len(rows) < _ALONGSIDE_SHARE * len(points):
        return None
    roads = known["road"].to_numpy(np.int64)[near[rows, first[rows]]]
    return int(np.bincount(roads).argmax())


def lanes_abreast(lanes: pd.DataFrame) -> pd.Series:
    """How many lanes lie abreast on each road: the median over its points, at least 1.

    Beside a point lie those lanes of its road that have a point no more than 1 m before or behind
    it and within 80 m across, in about its direction. Long roads are looked at in 400 places.

    Parameters
    ----------
    lanes : as `trace_lanes` gives them.
    """
    counts = {}
    for road, points in lanes.groupby("road"):
        chosen = np.unique(np.linspace(0, len(points) - 1, _MOST_SAMPLES).astype(np.int64))
        counts[road] = max(int(np.median(_abreast(points, chosen))), 1)
    return pd.Series(counts, dtype=np.int64)


def _abreast(points: pd.DataFrame, chosen: Ints) -> Ints:
    """Lanes beside each chosen point of a road, its own among them."""
    from scipy.spatial import cKDTree  # noqa: PLC0415  # slow to load

    xy = points[["x", "y"]].to_numpy(np.float64)
    along = points[["along_x", "along_y"]].to_numpy(np.float64)
    lane = points["lane"].to_numpy(np.int64)
    around = cKDTree(xy).query_ball_point(xy[chosen], 2 * _APART_M)
    counts = np.empty(len(chosen), np.int64)
    for number, (point, near) in enumerate(zip(chosen, around, strict=True)):
        ahead = np.abs((xy[near] - xy[point]) @ along[point])
        parallel = np.abs(along[near] @ along[point]) >= _PARALLEL
        beside = lane[near][(ahead <= _BESIDE_M) & parallel]
        counts[number] = len(np.unique(beside))
    return counts
