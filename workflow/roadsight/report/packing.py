"""Arrays as compact text that a browser turns into typed arrays."""

from __future__ import annotations

import base64
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from roadsight.base.arrays import Bytes, Floats

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
