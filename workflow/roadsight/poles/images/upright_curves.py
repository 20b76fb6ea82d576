"""Upright outlines in an image: edges of poles, posts, trunks and walls, to part of a pixel."""

from __future__ import annotations

from itertools import pairwise

import cv2
import numpy as np
from numpy.typing import NDArray

from roadsight.base.arrays import Bools, Bytes, Floats, Floats32

_BLUR_PX = 1.0
"""Standard deviation of the blur: less follows the noise, more joins the sides of thin posts."""
_LEAST_STEP = 40.0
"""Least step of grey across an outline, as Sobel's window sums it: 5 grey levels a pixel."""
_UPRIGHT = 3.0
"""An outline's step across must be this many times that along: within 18 degrees of upright."""
_SHARE_OF_ROWS = 0.95
"""Rows of its own that an outline needs, as a share of its pixels: forks and steps have fewer."""


def upright_curves(image: Bytes, min_height: float = 0.3) -> list[Floats]:
    """Edges that run from row to row within about 18 degrees of upright.

    Parameters
    ----------
    image : (rows, columns, 3) or (rows, columns). min_height : lower ones are left out, as a share
        of the image's height.

    Returns
    -------
    curves (n, 2) of pixels u, v, one for each row, from the top; the leftmost top first
    """
    grey = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY) if image.ndim == 3 else image
    smooth = cv2.GaussianBlur(grey.astype(np.float32), (0, 0), _BLUR_PX)
    gu, gv = (cv2.Sobel(smooth, cv2.CV_32F, *order) for order in ((1, 0), (0, 1)))
    curves = []
    for sign in (1.0, -1.0):
        step = np.maximum(sign * gu, 0.0)
        ridge = _ridge(step) & (step > _LEAST_STEP) & (step > _UPRIGHT * np.abs(gv))
        curves += _traced(ridge, step, min_height * image.shape[0])
    return sorted(curves, key=lambda curve: (curve[0, 0], curve[0, 1], len(curve)))


def _ridge(step: Floats32) -> Bools:
    """Where the step is greatest among its neighbours in the row."""
    ridge = np.zeros(step.shape, bool)
    middle = step[:, 1:-1]
    ridge[:, 1:-1] = (middle > step[:, :-2]) & (middle >= step[:, 2:])
    return ridge


def _traced(ridge: Bools, step: Floats32, least_px: float) -> list[Floats]:
    """Connected ridges with one pixel in nearly every row, each at the parabola's vertex."""
    count, labels = cv2.connectedComponents(ridge.astype(np.uint8), connectivity=8)
    v, u = np.nonzero(labels)
    number = labels[v, u]
    order = np.lexsort((u, v, number))
    v, u, number = v[order], u[order], number[order]
    starts = np.searchsorted(number, np.arange(1, count + 1))
    curves = []
    for start, end in pairwise(starts):
        rows, columns = v[start:end], u[start:end]
        if end - start < least_px or len(np.unique(rows)) < _SHARE_OF_ROWS * (end - start):
            continue
        curves.append(np.column_stack([_vertex(step, rows, columns), rows.astype(np.float64)]))
    return curves


def _vertex(step: Floats32, rows: NDArray[np.intp], columns: NDArray[np.intp]) -> Floats:
    """Columns where parabolas through three neighbours of a row are greatest."""
    left, here, right = (step[rows, columns + k].astype(np.float64) for k in (-1, 0, 1))
    bend = left - 2.0 * here + right
    shift = np.where(bend < 0, 0.5 * (left - right) / np.where(bend < 0, bend, 1.0), 0.0)
    return columns + np.clip(shift, -0.5, 0.5)
