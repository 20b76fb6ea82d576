"""Consecutive points of a cloud as they come from the decoder of LAS and LAZ files."""

from __future__ import annotations

from dataclasses import dataclass

import laspy
import numpy as np
from numpy.typing import NDArray

from roadsight.base.arrays import Bools, Bytes, Floats
from roadsight.io.cloud.las_header import COLOURS, CloudHeader
from roadsight.io.cloud.point_filter import OVERLAP_CLASS


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
        return Chunk(
            self.xyz[mask],
            self.intensity[mask],
            self.classification[mask],
            self.return_number[mask],
            self.number_of_returns[mask],
            self.withheld[mask],
            None if self.colour is None else self.colour[mask],
            self.synthetic[mask],
            self.overlap[mask],
            self.scan[mask],
            None if self.time is None else self.time[mask],
        )


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
