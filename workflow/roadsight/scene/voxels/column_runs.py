"""Points of each class in each voxel, counted column by column without sorting them.

The runs of a column hang on each other by rising layer and class. They are few, however many points
there are, so that a point soon finds its own.
"""

from __future__ import annotations

import numpy as np

from roadsight.base.arrays import Bytes, Ints, Ints32
from roadsight.base.kernels import compiled

_KIND, _NEXT, _POINTS, _HEIGHTS = range(4)
"""Columns of a run: layer and class, the next run of its column, points, sum of their heights."""


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
