"""Pictures of the cloud from above that lie below the map: colour, intensity, height."""

from __future__ import annotations

import base64
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from roadsight.base.arrays import Bools, Bytes, Floats
from roadsight.report.packing import to_byte

_MOST_CELLS = 1200  # Cells along the longer side of a picture: what a large screen shows at once
# Points that a cell should have on average; smaller cells leave holes between scan lines
_POINTS_A_CELL = 1.5
_REACH_CELLS = 2.0  # Holes so near to a point take its value; wider ones stay empty
# Intensity is that of points so near to the ground, where a cell has any: markings and kerbs
_SURFACE_M = 0.5
_HIGHEST_M = 12.0  # Height above ground at which the colours end, as in the 3D view
_QUALITY = 78  # Of WebP, 1 to 100: a tenth of the bytes of PNG, and no blocks that can be seen


@dataclass(frozen=True)
class Backdrop:
    """Picture in the local frame.

    Parameters
    ----------
    pixels : (rows, columns, 4) uint8, red, green, blue and opacity; first row north.
    west_m, north_m : outer corner of the first pixel.
    """

    pixels: Bytes
    west_m: float
    north_m: float
    cell_size_m: float

    def packed(self) -> dict[str, Any]:
        """As the page holds it: place, size and a data address."""
        coded = cv2.imencode(
            ".webp",
            cv2.cvtColor(self.pixels, cv2.COLOR_RGBA2BGRA),
            [cv2.IMWRITE_WEBP_QUALITY, _QUALITY],
        )[1]
        text = base64.b64encode(coded.tobytes()).decode("ascii")
        rows, columns = self.pixels.shape[:2]
        return {
            "west_m": self.west_m,
            "north_m": self.north_m,
            "cell_size_m": self.cell_size_m,
            "rows": rows,
            "columns": columns,
            "address": f"data:image/webp;base64,{text}",
        }


def backdrops(
    xyz_m: NDArray, above_ground_m: NDArray, intensity: NDArray, colour: NDArray | None
) -> dict[str, Backdrop]:
    """Pictures of a cloud from above: ``colour``, ``intensity`` (if it has them), ``height``.

    Colour and height are those of the highest point of a pixel. Intensity is the mean of the points
    near the ground, of all where there are none.

    Parameters
    ----------
    xyz_m : (n, 3) local metres.
    above_ground_m : (n,) height above the terrain model, NaN where it has none.
    intensity : (n,) uint16. colour : (n, 3) uint8, or None.
    """
    if not len(xyz_m):
        return {}
    xy = np.asarray(xyz_m, np.float64)[:, :2]
    west, north = float(xy[:, 0].min()), float(xy[:, 1].max())
    wide, high = float(np.ptp(xy[:, 0])), float(np.ptp(xy[:, 1]))
    cell = max(wide, high, 1e-3) / _MOST_CELLS
    cell = max(cell, float(np.sqrt(_POINTS_A_CELL * wide * high / len(xy))))
    columns, rows = int(wide / cell) + 1, int(high / cell) + 1
    column = ((xy[:, 0] - west) / cell).astype(np.int64)
    row = ((north - xy[:, 1]) / cell).astype(np.int64)
    cells, shape = row * columns + column, (rows, columns)

    def drawn(values: NDArray, known: NDArray) -> Backdrop:
        """Picture of (rows * columns, 3) values where they are known."""
        return Backdrop(_filled(values.reshape(*shape, 3), known.reshape(shape)), west, north, cell)

    order = np.argsort(xyz_m[:, 2], kind="stable")
    top = np.full(rows * columns, -1, np.int64)
    top[cells[order]] = order  # of several, the last one assigned stays: the highest
    known = top >= 0
    found = {}
    if colour is not None:
        found["colour"] = drawn(np.where(known[:, None], colour[top], 0).astype(np.uint8), known)
    grey = to_byte(intensity)
    if grey is not None:
        near = np.abs(above_ground_m) < _SURFACE_M
        means = _means(cells, grey, near, rows * columns)
        found["intensity"] = drawn(np.repeat(means[:, None], 3, axis=1), known)
    above = np.where(known, above_ground_m[top], np.nan)
    step = np.rint(255 * np.clip(np.nan_to_num(above) / _HIGHEST_M, 0, 1)).astype(np.uint8)
    ramp = cv2.applyColorMap(step, cv2.COLORMAP_CIVIDIS).reshape(-1, 3)[:, ::-1]
    found["height"] = drawn(ramp, known & np.isfinite(above))
    return found


def _means(cells: NDArray, values: Bytes, first: Bools, count: int) -> Bytes:
    """Mean value of each cell: of the points marked ``first`` where there are any, else of all."""
    sums: list[Floats] = []
    for chosen in (first, np.ones(len(cells), bool)):
        number = np.bincount(cells[chosen], minlength=count)
        total = np.bincount(cells[chosen], values[chosen].astype(np.float64), minlength=count)
        sums.append(np.where(number > 0, total / np.maximum(number, 1), np.nan))
    means = np.where(np.isfinite(sums[0]), sums[0], np.nan_to_num(sums[1]))
    return np.asarray(np.rint(means).astype(np.uint8))


def _filled(values: Bytes, known: Bools) -> Bytes:
    """RGBA picture, small holes with the value of the nearest known pixel."""
    if not known.any():
        return np.zeros((*known.shape, 4), np.uint8)
    distance, labels = cv2.distanceTransformWithLabels(
        (~known).astype(np.uint8), cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL
    )
    of_label = np.zeros((int(labels.max()) + 1, 3), np.uint8)
    of_label[labels[known]] = values[known]
    opaque = np.where(distance <= _REACH_CELLS, 255, 0).astype(np.uint8)
    return np.dstack([of_label[labels], opaque])
