"""Images part by part, and between their pixels."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from roadsight.base.arrays import Floats, Ints


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


class Block(NamedTuple):
    """Part of an image: ``inner`` of the image, ``outer`` with its surroundings, ``core`` of it.

    What is computed for ``image[outer]`` holds for ``image[inner]`` in ``[core]``.
    """

    inner: tuple[slice, slice]
    outer: tuple[slice, slice]
    core: tuple[slice, slice]


def blocks(shape: tuple[int, int], size: int, halo: int) -> Iterator[Block]:
    """Blocks of at most ``size`` rows and columns, with ``halo`` more where there are any."""
    for first_row in range(0, shape[0], size):
        for first_column in range(0, shape[1], size):
            parts = [
                _span(first, size, halo, end)
                for first, end in zip((first_row, first_column), shape, strict=True)
            ]
            inner, outer, core = zip(*parts, strict=True)
            yield Block(inner, outer, core)


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


def _span(first: int, size: int, halo: int, end: int) -> tuple[slice, slice, slice]:
    last, start = min(first + size, end), max(first - halo, 0)
    return (
        slice(first, last),
        slice(start, min(last + halo, end)),
        slice(first - start, last - start),
    )
