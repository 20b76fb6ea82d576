"""Road borders that bound the carriageway itself: the first on either side of the camera's path.

Where forecourts and drives are paved like the street, the road of a mask runs on into them and
its far border says nothing about the street. A kerb ends the road even where paving goes on, and
what lies behind a parked car is not looked for.
"""

from __future__ import annotations

import numpy as np

from roadsight.base.arrays import Bools, Bytes, Floats
from roadsight.base.kernels import compiled
from roadsight.poles.images.classes import PixelClass

# 1 for the classes over which the road runs on.
_OPEN = np.zeros(256, np.uint8)
_OPEN[[PixelClass.ROAD, PixelClass.MARKING]] = 1
_KERB = int(PixelClass.KERB)
"""As a plain number, for comparisons with masks."""


def on_nearest_border(
    points: Floats,
    mask: Bytes,
    road: Bytes,
    dividing: Floats,
    reach_px: float,
) -> Bools:
    """Whether border points lie on the first border of their row and side.

    Parameters
    ----------
    points : (n, 2) u, v. mask : project classes (rows, columns). road : the cleaned road, 0 or 1.
    dividing : (rows,) column between left and right. reach_px : how far beside the border.
    """
    # Small holes that cleaning closed do not end the road, kerbs do.
    open_road = np.where(mask == _KERB, 0, np.maximum(road, _OPEN[mask])).astype(np.uint8)
    ends = _first_ends(open_road, (mask == _KERB).astype(np.uint8), dividing)
    row = np.clip(np.round(points[:, 1]), 0, len(mask) - 1).astype(np.int64)
    left = points[:, 0] < dividing[row]
    low = np.where(left, ends[row, 0], ends[row, 2]) - reach_px
    high = np.where(left, ends[row, 1], ends[row, 3]) + reach_px
    return (points[:, 0] >= low) & (points[:, 0] <= high)


@compiled()
def _first_ends(road: Bytes, kerb: Bytes, dividing: Floats) -> Floats:
    """Columns (rows, 4) between which the left and the right border lie; NaN without road."""
    rows, columns = road.shape
    ends = np.full((rows, 4), np.nan)
    for row in range(rows):
        middle = int(min(max(round(dividing[row]), 0), columns - 1))
        for side in range(2):
            step = 2 * side - 1
            at = middle
            if not road[row, at]:
                continue
            while 0 <= at < columns and road[row, at]:
                at += step
            beyond = at
            while 0 <= beyond < columns and kerb[row, beyond]:
                beyond += step
            ends[row, 2 * side] = min(at, beyond)
            ends[row, 2 * side + 1] = max(at, beyond)
    return ends
