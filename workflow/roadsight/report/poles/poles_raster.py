"""The LiDAR's classes seen from above, as a small picture for the map."""

from __future__ import annotations

import base64
from typing import Any

import cv2
import numpy as np
from numpy.typing import ArrayLike

from roadsight.base.arrays import Bools, Bytes, Floats, Ints
from roadsight.io.raster.top_rasters import TopRaster

KINDS = ("nothing", "other", "ground", "vegetation", "building", "road", "bridge")
"""What a pixel shows; of several in one pixel the last one wins."""

LEVELS = 40
"""Grey levels between two kinds, so that no rounding in a browser mixes them up."""

_KIND_OF_CLASS = {2: 2, 3: 3, 4: 3, 5: 3, 6: 4, 11: 5, 17: 6}
"""Colours of the picture by class of LAS: vegetation, of any height, has one."""
_MOST_CELLS = 2200
"""Cells along the longer side of the picture; cells are merged until it is no larger."""
_REACH_M = 80.0
"""The picture ends so far from the route: what is further off tells nothing of its poles."""


def class_layer(top: TopRaster, cameras_xy_m: ArrayLike) -> dict[str, Any] | None:
    """Kinds near the cameras as PNG of grey levels (kind times `LEVELS`), in base64.

    Parameters
    ----------
    top : overhead view of the cloud.
    cameras_xy_m : (n, 2) local metres; cells further than 80 m from all of them are left out.

    Returns
    -------
    place and size of the picture and its PNG; None if nothing of it lies near a camera
    """
    xy = np.asarray(cameras_xy_m, np.float64).reshape(-1, 2)
    xy = xy[np.isfinite(xy).all(axis=1)]
    window = _window(top, xy)
    if window is None:
        return None
    low_row, high_row, low_column, high_column = window
    kinds = _kinds(top.cls[low_row:high_row, low_column:high_column])
    factor = max(1, -(-max(kinds.shape) // _MOST_CELLS))
    coarse = _coarser(kinds, factor)
    cell_m = top.cell_size_m * factor
    west_m = top.west_m + low_column * top.cell_size_m
    north_m = top.north_m - low_row * top.cell_size_m
    column = np.floor((xy[:, 0] - west_m) / cell_m).astype(np.int64)
    row = np.floor((north_m - xy[:, 1]) / cell_m).astype(np.int64)
    coarse[_far(coarse.shape, row, column, _REACH_M / cell_m)] = 0
    _, png = cv2.imencode(".png", coarse * LEVELS, [cv2.IMWRITE_PNG_COMPRESSION, 9])
    return {
        "west_m": west_m,
        "north_m": north_m,
        "cell_size_m": cell_m,
        "rows": coarse.shape[0],
        "columns": coarse.shape[1],
        "png": base64.b64encode(png.tobytes()).decode("ascii"),
    }


def _window(top: TopRaster, xy_m: Floats) -> tuple[int, int, int, int] | None:
    """Rows and columns of the raster within reach of the cameras' box."""
    if not len(xy_m):
        return None
    rows, columns = top.cls.shape
    (west, south), (east, north) = xy_m.min(axis=0) - _REACH_M, xy_m.max(axis=0) + _REACH_M
    cell = top.cell_size_m
    low_column = int(np.clip(np.floor((west - top.west_m) / cell), 0, columns))
    high_column = int(np.clip(np.ceil((east - top.west_m) / cell), 0, columns))
    low_row = int(np.clip(np.floor((top.north_m - north) / cell), 0, rows))
    high_row = int(np.clip(np.ceil((top.north_m - south) / cell), 0, rows))
    if low_row >= high_row or low_column >= high_column:
        return None
    return low_row, high_row, low_column, high_column


def _kinds(classes: Bytes) -> Bytes:
    """Kind of each cell by its ASPRS class."""
    table = np.ones(256, np.uint8)
    table[0] = 0
    for number, kind in _KIND_OF_CLASS.items():
        table[number] = kind
    return table[classes]


def _coarser(kinds: Bytes, factor: int) -> Bytes:
    rows, columns = kinds.shape
    padded = np.pad(kinds, ((0, -rows % factor), (0, -columns % factor)))
    blocks = padded.reshape(padded.shape[0] // factor, factor, -1, factor)
    return np.ascontiguousarray(blocks.max(axis=(1, 3)))


def _far(shape: tuple[int, int], row: Ints, column: Ints, reach: float) -> Bools:
    """Cells further than ``reach`` cells from every camera; those near the rim count as on it."""
    free = np.ones(shape, np.uint8)
    on_rim = row.clip(0, shape[0] - 1), column.clip(0, shape[1] - 1)
    near = np.hypot(row - on_rim[0], column - on_rim[1]) <= reach
    free[on_rim[0][near], on_rim[1][near]] = 0
    return cv2.distanceTransform(free, cv2.DIST_L2, 5) > reach
