"""Large arrays in pages: few points that show all, and numbers as compact text."""

from __future__ import annotations

import base64
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from roadsight.base.arrays import Bools, Bytes, Floats, Ints

_LEVELS = 65535  # Steps of a coordinate within its span: what 16 bits hold


def pack(values: ArrayLike, dtype: str) -> dict[str, Any]:
    """Base64 of an array in little-endian order.

    Parameters
    ----------
    values : any shape; flattened row by row.
    dtype : u1, u2, u4 or f4.

    Returns
    -------
    dtype, count and base64 data

    Raises
    ------
    ValueError : a value is not finite or does not fit the type.
    """
    given = np.asarray(values).ravel()
    with np.errstate(over="ignore", invalid="ignore"):
        packed = given.astype(f"<{dtype}")
    if not np.all(np.isfinite(packed)):
        raise ValueError("values that are not finite cannot be packed")
    if dtype.startswith("u") and not np.array_equal(packed, given):
        raise ValueError(f"values do not fit {dtype}")
    return {
        "dtype": dtype,
        "count": len(packed),
        "data": base64.b64encode(packed.tobytes()).decode("ascii"),
    }


def pack_points(xyz_m: NDArray) -> dict[str, Any]:
    """Points in 16 bits an axis: ``xyz = offset + step * integer``, off by half a step at most.

    Parameters
    ----------
    xyz_m : (n, 3) finite, local metres; n may be 0.
    """
    xyz = np.asarray(xyz_m, np.float64).reshape(-1, 3)
    lower = xyz.min(axis=0) if len(xyz) else np.zeros(3)
    span = xyz.max(axis=0) - lower if len(xyz) else np.zeros(3)
    step = np.where(span > 0, span / _LEVELS, 1.0)
    return {
        "offset_m": lower.tolist(),
        "step_m": step.tolist(),
        "xyz": pack(np.rint((xyz - lower) / step), "u2"),
    }


def to_byte(
    values: NDArray, low_percentile: float = 2.0, high_percentile: float = 98.0
) -> Bytes | None:
    """Values (n,) stretched to 0..255 between two percentiles; None where they do not vary."""
    if len(values) == 0:
        return None
    low, high = np.percentile(values, [low_percentile, high_percentile])
    if high <= low:
        low, high = float(values.min()), float(values.max())
    if high <= low:
        return None
    share = (values.astype(np.float64) - low) / (high - low)
    return np.rint(np.clip(share, 0, 1) * 255).astype(np.uint8)


def unpack(packed: dict[str, Any]) -> NDArray:
    """The flat array that `pack` packed."""
    data = base64.b64decode(packed["data"])
    return np.frombuffer(data, f"<{packed['dtype']}", packed["count"])


def unpack_points(packed: dict[str, Any]) -> Floats:
    """Points (n, 3) in local metres that `pack_points` packed."""
    steps = unpack(packed["xyz"]).reshape(-1, 3).astype(np.float64)
    return np.array(packed["offset_m"]) + steps * np.array(packed["step_m"])


# Few points that still show the whole scene, chosen the same way every time.

_STEPS = 10  # Halvings of the search for the cell that leaves so many points
_MOST = 250_000  # Most points that may be asked for; a page holds them all


def sample_mask(start: int, count: int, share: float) -> Bools:
    """Which of the points ``start .. start + count`` belong to a pseudo-random sample.

    The choice depends on a point's number alone, so that it is the same tile by tile and has no
    pattern that interferes with scan lines.

    Parameters
    ----------
    share : expected share of points kept; 1 or more keeps all.
    """
    if share >= 1:
        return np.ones(count, dtype=bool)
    with np.errstate(over="ignore"):  # SplitMix64
        bits = np.arange(start + 1, start + count + 1, dtype=np.uint64)
        bits *= np.uint64(0x9E3779B97F4A7C15)
        bits = (bits ^ (bits >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
        bits = (bits ^ (bits >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
        bits ^= bits >> np.uint64(31)
    return (bits >> np.uint64(11)).astype(np.float64) < share * 2.0**53


def thin(xyz_m: NDArray, at_most: int) -> Ints:
    """Indices of the first point in each cube, the cubes as small as the number allows.

    Even in space, so that sparse verges stay visible beside a dense road.

    Parameters
    ----------
    xyz_m : (n, 3) finite, local metres.
    at_most : points to keep, from 8 to 250,000.

    Returns
    -------
    increasing indices; all of them if there are no more than ``at_most``
    """
    if not 8 <= at_most <= _MOST:
        raise ValueError(f"at_most is {at_most}, allowed: 8 to {_MOST}")
    if len(xyz_m) <= at_most:
        return np.arange(len(xyz_m))
    offset = np.asarray(xyz_m, np.float64) - np.min(xyz_m, axis=0)
    extent = offset.max(axis=0)
    longest = float(extent.max())
    if longest == 0:
        return np.zeros(1, dtype=np.int64)
    large = 2 * longest
    small = max(float(np.sqrt(extent[0] * extent[1] / at_most)), longest / at_most) / 8
    for _ in range(_STEPS):
        size = float(np.sqrt(small * large))
        cubes = np.sort(_cubes(offset, size))
        if 1 + np.count_nonzero(cubes[1:] != cubes[:-1]) <= at_most:
            large = size
        else:
            small = size
    # Finding the first of each takes several times as long as counting them.
    _, first = np.unique(_cubes(offset, large), return_index=True)
    return np.sort(first)


def _cubes(offset_m: Floats, size_m: float) -> Ints:
    """Number of each point's cube; at most 2 million cubes an axis."""
    column, row, layer = (offset_m / size_m).astype(np.int64).T
    return column + (column.max() + 1) * (row + (row.max() + 1) * layer)
