"""Consecutive points of a cloud as they come from the decoder of LAS and LAZ files."""

from __future__ import annotations

from dataclasses import dataclass

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
    """

    xyz: Floats
    intensity: NDArray[np.uint16]
    classification: Bytes
    return_number: Bytes
    number_of_returns: Bytes
    withheld: Bools
    colour: NDArray[np.uint16] | None

    def __len__(self) -> int:
        return len(self.xyz)

    def select(self, mask: Bools) -> Chunk:
        """Points where ``mask``, of shape (n,), is true."""
        if mask.all():
            return self
        return Chunk(
            self.xyz[mask],
            self.intensity[mask],
            self.classification[mask],
            self.return_number[mask],
            self.number_of_returns[mask],
            self.withheld[mask],
            None if self.colour is None else self.colour[mask],
        )


def chunk_of(points: laspy.ScaleAwarePointRecord, header: CloudHeader) -> Chunk:
    """What a `Chunk` holds of decoded points."""
    return Chunk(
        xyz=native_xyz(points, header),
        intensity=np.asarray(points.intensity, np.uint16),
        classification=np.asarray(points.classification, np.uint8),
        return_number=np.asarray(points.return_number, np.uint8),
        number_of_returns=np.asarray(points.number_of_returns, np.uint8),
        withheld=np.asarray(points.withheld, bool),
        colour=_colour(points) if header.coloured else None,
    )


def native_xyz(points: laspy.ScaleAwarePointRecord, header: CloudHeader) -> Floats:
    """Native coordinates (n, 3) of decoded points."""
    xyz = np.empty((3, len(points)))  # each axis in one piece
    for axis, name in enumerate("XYZ"):
        np.multiply(points[name], header.scale[axis], out=xyz[axis])
        xyz[axis] += header.offset[axis]
    return xyz.T


def _colour(points: laspy.ScaleAwarePointRecord) -> NDArray[np.uint16]:
    return np.stack([np.asarray(points[name], np.uint16) for name in COLOURS], axis=1)
