"""Headers of LAS and LAZ files: consistency with the file itself, CRS records.

A decoder that believes a damaged count may ask for more memory than there is and end the process,
so counts and offsets are checked before it sees them.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import laspy
import numpy as np

from roadsight.base.arrays import Floats
from roadsight.base.errors import InputError
from roadsight.geometry.crs import StatedCrs, stated_crs

SUFFIXES = (".las", ".laz")
COLOURS = ("red", "green", "blue")
_WKT_RECORD = 2112
"""Number of the record that holds a CRS as WKT (LAS 1.4)."""
_GEO_KEY_RECORD = 34735
"""Number of the record that holds GeoTIFF keys of the CRS (LAS specification)."""
_RECORD_HEADER_BYTES = 54
"""Length of a variable record without its content: more records than fit are not believed."""
_EXTENDED_RECORD_HEADER_BYTES = 60
"""The same of an extended record, which lies behind the points."""
_SHORTEST_HEADER_BYTES = 227
"""Length of the header of LAS 1.0 to 1.2."""
_LAS_14_HEADER_BYTES = 375
"""Length of the header of LAS 1.4, the longest."""
_LEAST_POINT_BYTES = 20
"""Length of the shortest point, of format 0; each chunk begins with a whole point."""
_COMPRESSED = 0x80
"""Bit of the point format by which LAZ marks compressed points."""
_TABLE_OFFSET_AT_END = -1
"""Place of the chunk table by which a LAZ file says that its last bytes hold the place."""


@dataclass(frozen=True)
class CloudHeader:
    """What the header of a cloud says, checked against the file's structure.

    Parameters
    ----------
    path : the file.
    points : number of points, at least one.
    scale, offset : native coordinate of LAS integer i is ``i * scale + offset``; shape (3,).
    stated : CRS and vertical unit.
    coloured : whether points have red, green and blue.
    """

    path: Path
    points: int
    scale: Floats
    offset: Floats
    stated: StatedCrs
    coloured: bool


def check_structure(path: Path) -> None:
    """Check that ``path`` is a LAS or LAZ file whose parts lie inside it.

    Raises
    ------
    InputError : the file is missing, of another kind, or cut off.
    """
    if not path.is_file():
        problem = "is a directory" if path.is_dir() else "no such file"
        raise InputError(problem, where=str(path), allowed="a LAS or LAZ file")
    if path.suffix.lower() not in SUFFIXES:
        raise InputError(
            "is no point cloud by its name", where=str(path), allowed=" or ".join(SUFFIXES)
        )
    try:
        problem = _first_problem(path)
    except OSError as error:
        problem = f"cannot be read ({error.strerror})"
    if problem:
        raise InputError(problem, where=str(path), hint="copy, download or export it again")


def _first_problem(path: Path) -> str:  # noqa: PLR0911  # a list of checks
    """First inconsistency found, or nothing."""
    size = path.stat().st_size
    with path.open("rb") as stream:
        head = stream.read(_LAS_14_HEADER_BYTES)
        if len(head) < _SHORTEST_HEADER_BYTES or head[:4] != b"LASF":
            return "is no LAS or LAZ file: its header is missing or cut off"
        header_bytes, points_at, records = struct.unpack_from("<HII", head, 94)
        point_format, point_bytes, points = struct.unpack_from("<BHI", head, 104)
        if not _SHORTEST_HEADER_BYTES <= header_bytes <= points_at <= size:
            return "is damaged or cut off: its points would start outside the file"
        if records * _RECORD_HEADER_BYTES > points_at - header_bytes:
            return f"is damaged: there is no room for the {records} records that it announces"
        if head[25] >= 4 and len(head) == _LAS_14_HEADER_BYTES:
            extended_at, extended, points = struct.unpack_from("<QIQ", head, 235)
            if extended and extended_at + extended * _EXTENDED_RECORD_HEADER_BYTES > size:
                return "is damaged or cut off: its extended records lie outside the file"
        if point_format & _COMPRESSED:
            return _chunk_table_problem(stream, points_at, size)
    if points_at + points * point_bytes > size:
        return f"is cut off: there is no room for the {points} points that it announces"
    return ""


def _chunk_table_problem(stream: BinaryIO, points_at: int, size: int) -> str:
    """What is wrong with the table of compressed chunks, which ends a LAZ file."""
    if points_at + 8 > size:
        return "is cut off: it ends before its points"
    table_at = _integer_at(stream, points_at)
    if table_at == _TABLE_OFFSET_AT_END:
        table_at = _integer_at(stream, size - 8)
    if not points_at + 8 <= table_at <= size - 8:
        return "is cut off: its chunk table lies outside the file"
    chunks = _integer_at(stream, table_at) >> 32 & 0xFFFFFFFF
    if chunks > size // _LEAST_POINT_BYTES + 1:  # each begins with a whole point
        return f"is damaged: its chunk table announces {chunks} chunks"
    return ""


def _integer_at(stream: BinaryIO, position: int) -> int:
    """Signed 64-bit integer at a position inside the file."""
    stream.seek(position)
    return struct.unpack("<q", stream.read(8))[0]


def cloud_header(path: Path, header: laspy.LasHeader) -> CloudHeader:
    """Content of a cloud's header.

    Raises
    ------
    InputError : no points, or a scale or offset that is no number to work with.
    """
    scale, offset = np.array(header.scales), np.array(header.offsets)
    if header.point_count == 0:
        raise InputError("holds no points", where=str(path))
    if not (np.isfinite(offset).all() and np.isfinite(scale).all() and (scale > 0).all()):
        raise InputError(
            "has a header with an unusable scale or offset",
            where=str(path),
            found=f"scale {scale.tolist()}, offset {offset.tolist()}",
            allowed="finite numbers, scale above 0",
            hint="export the cloud again",
        )
    coloured = set(COLOURS) <= set(header.point_format.dimension_names)
    return CloudHeader(path, header.point_count, scale, offset, _stated(header), coloured)


def _stated(header: laspy.LasHeader) -> StatedCrs:
    """CRS records of a header, ordinary or extended."""
    records = [r for r in [*header.vlrs, *(header.evlrs or [])] if r.user_id == "LASF_Projection"]
    wkt, keys = None, {}
    for record in records:
        data = record.record_data_bytes()
        if record.record_id == _WKT_RECORD:
            wkt = data.decode("utf-8", errors="replace").rstrip("\0").strip() or wkt
        elif record.record_id == _GEO_KEY_RECORD:
            entries = np.frombuffer(data[8 : len(data) // 8 * 8], "<u2").reshape(-1, 4)
            keys = {int(key): int(value) for key, tag, _, value in entries if tag == 0}
    return stated_crs(wkt, keys)
