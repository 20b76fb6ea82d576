"""Consecutive points of a cloud as they come from the decoder, and which of them take no part."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

import laspy
import numpy as np
from numpy.typing import NDArray

from roadsight.base.arrays import Bools, Bytes, Floats
from roadsight.io.cloud.las_header import COLOURS, CloudHeader


@dataclass(frozen=True)
class Chunk:
    """Consecutive points of a cloud.

    Parameters
    ----------
    xyz : native coordinates, shape (n, 3), float64.
    intensity : uint16, shape (n,).
    classification, return_number, number_of_returns : uint8, shape (n,); 0 where not recorded.
    withheld : points that their producer asks to leave out, bool, shape (n,).
    colour : red, green, blue as stored, uint16, shape (n, 3), or None.
    synthetic, overlap : points that were not measured, and of overlapping flight lines, (n,).
    scan : number of the scan, strip or drive (``point_source_id``), uint16, (n,).
    time : GPS time (n,), or None where it was not asked for or is not recorded.
    """

    xyz: Floats
    intensity: NDArray[np.uint16]
    classification: Bytes
    return_number: Bytes
    number_of_returns: Bytes
    withheld: Bools
    colour: NDArray[np.uint16] | None
    synthetic: Bools
    overlap: Bools
    scan: NDArray[np.uint16]
    time: Floats | None = None

    def __len__(self) -> int:
        return len(self.xyz)

    def select(self, mask: Bools) -> Chunk:
        """Points where ``mask``, of shape (n,), is true."""
        if mask.all():
            return self
        parts: dict[str, Any] = {field.name: getattr(self, field.name) for field in fields(self)}
        kept: dict[str, Any] = {
            name: None if of is None else of[mask] for name, of in parts.items()
        }
        return Chunk(**kept)


def chunk_of(
    points: laspy.ScaleAwarePointRecord, header: CloudHeader, times: bool = False
) -> Chunk:
    """What a `Chunk` holds of decoded points; their GPS times where they are asked for."""
    names = set(points.point_format.dimension_names)
    classes = np.asarray(points.classification, np.uint8)
    flagged = "overlap" in names
    timed = times and "gps_time" in names
    colour = None
    if header.coloured:
        colour = np.stack([np.asarray(points[name], np.uint16) for name in COLOURS], axis=1)
    return Chunk(
        xyz=native_xyz(points, header),
        intensity=np.asarray(points.intensity, np.uint16),
        classification=classes,
        return_number=np.asarray(points.return_number, np.uint8),
        number_of_returns=np.asarray(points.number_of_returns, np.uint8),
        withheld=np.asarray(points.withheld, bool),
        colour=colour,
        synthetic=np.asarray(points.synthetic, bool),
        overlap=np.asarray(points.overlap, bool) if flagged else classes == OVERLAP_CLASS,
        scan=np.asarray(points.point_source_id, np.uint16),
        time=np.asarray(points.gps_time, np.float64) if timed else None,
    )


def native_xyz(points: laspy.ScaleAwarePointRecord, header: CloudHeader) -> Floats:
    """Native coordinates (n, 3) of decoded points."""
    xyz = np.empty((3, len(points)))  # each axis in one piece
    for axis, name in enumerate("XYZ"):
        np.multiply(points[name], header.scale[axis], out=xyz[axis])
        xyz[axis] += header.offset[axis]
    return xyz.T


# One filter for the workflow and the verbs.

NOISE_CLASSES = (7, 18)  # ASPRS classes of low and high noise
# Class of points of overlapping flight lines in point formats 0 to 5, which have no such flag.
OVERLAP_CLASS = 12
# Odd numbers without structure (golden ratio; primes of xxHash), as factors of a hash.
_ODD = (0x9E3779B97F4A7C15, 0xC2B2AE3D27D4EB4F, 0x165667B19E3779F9)


def noisy(classification: NDArray) -> Bools:
    """Points (n,) of a class of noise."""
    found = np.zeros(len(classification), bool)
    for cls in NOISE_CLASSES:
        found |= classification == cls
    return found


def point_keys(
    xyz: Floats, steps: Floats, time: NDArray | None, returns: NDArray, intensity: NDArray
) -> NDArray[np.uint64]:
    """A number (n,) of each point that equal points share: same place, time and return.

    Points without a time are told apart by their intensity. Different points share a number once
    in 2**64 pairs.

    Parameters
    ----------
    xyz : native coordinates (n, 3). steps : what they are rounded to (3,).
    time : GPS time (n,), or None. returns : number of the return (n,). intensity : (n,).
    """
    parts = [np.rint(xyz[:, axis] / steps[axis]).astype(np.int64) for axis in range(3)]
    timed = time is not None and bool(np.any(time))
    last = np.asarray(time, np.float64).view(np.int64) if timed else intensity.astype(np.int64)
    found = np.zeros(len(xyz), np.uint64)
    for number, part in enumerate([*parts, last, returns.astype(np.int64)]):
        found += part.view(np.uint64)
        found *= np.uint64(_ODD[number % len(_ODD)])
        found ^= found >> np.uint64(31)
    return found


def in_share(xyz: Floats, steps: Floats, time: NDArray | None, share: float) -> Bools:
    """Points (n,) that a survey with a share of the pulses would have measured.

    Whole pulses are left out where the file tells them by their times, else single returns.

    Parameters
    ----------
    xyz, steps, time : as of `point_keys`. share : of the pulses, 0 to 1.
    """
    timed = time is not None and bool(np.any(time))
    nothing = np.zeros(len(xyz), np.int64)
    keys = point_keys(np.zeros_like(xyz) if timed else xyz, steps, time, nothing, nothing)
    return keys.astype(np.float64) < share * 2.0**64


def key_steps(scales: Floats) -> Floats:
    """A tenth of the finest decimal step (3,) of some clouds, whose scales are (clouds, 3)."""
    return np.asarray(10.0 ** (np.floor(np.log10(np.atleast_2d(scales).min(axis=0)) + 1e-9) - 1))
