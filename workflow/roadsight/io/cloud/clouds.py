"""LAS and LAZ point clouds in their native coordinates."""

from __future__ import annotations

import logging
import os
import struct
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import date
from pathlib import Path

import laspy
import lazrs
import numpy as np
from laspy import DecompressionSelection
from laspy.vlrs.known import WktCoordinateSystemVlr
from numpy.typing import ArrayLike, NDArray
from pyproj import CRS
from pyproj.exceptions import CRSError

from roadsight.base.arrays import AnyPath, Floats
from roadsight.base.errors import InputError
from roadsight.geometry.frames import Frame
from roadsight.io.cloud.chunks import Chunk, chunk_of, native_xyz
from roadsight.io.cloud.las_header import (
    COLOURS,
    Carried,
    CloudHeader,
    ExtraField,
    carry,
    check_structure,
    cloud_header,
    counted,
)
from roadsight.io.records.atomic import atomic_path

CHUNK_POINTS = 125_000  # what is computed of so many points stays in the processor's cache
# Points decoded at once: several chunks of a file, which threads decode beside each other. More
# would take more memory.
_DECODED_POINTS = 8 * CHUNK_POINTS
# Step of written coordinates, in the cloud's own unit (a millimetre where that is the metre).
_LAZ_SCALE = 0.001
# A fixed date of creation, so that the same points give the same bytes.
_LAZ_DATE = date(2000, 1, 1)
_DEGREES_PER_SCAN_ANGLE = 0.006  # unit of the scan angle in point formats 6 to 10 (LAS 1.4)
# Fields that lead to waveforms, which are not carried along: they are places in a .wdp file, or in
# the cloud's own, that a cloud written anew would not have.
WAVEFORM = (
    "wavepacket_index",
    "wavepacket_offset",
    "wavepacket_size",
    "return_point_wave_location",
    "x_t",
    "y_t",
    "z_t",
)
_ALL_LAYERS = DecompressionSelection.all()
# What a `Chunk` holds; time, angles and the producer's own fields stay compressed.
_CHUNK_LAYERS = (
    DecompressionSelection.base()
    | DecompressionSelection.Z
    | DecompressionSelection.CLASSIFICATION
    | DecompressionSelection.FLAGS
    | DecompressionSelection.INTENSITY
    | DecompressionSelection.RGB
    | DecompressionSelection.POINT_SOURCE_ID
)

# What laspy logs as an error also arrives as an exception, which becomes one message here.
logging.getLogger("laspy").setLevel(logging.CRITICAL)


@dataclass(frozen=True)
class NativeCloud:
    """A whole cloud in memory.

    Parameters
    ----------
    xyz : native coordinates, shape (n, 3), float64.
    dims : every other dimension by its LAS name, each of length n, (n, k) where a field has k
        values; without bytes that no record describes (`CloudHeader.left_out`).
    header : what its header says.
    """

    xyz: Floats
    dims: dict[str, NDArray]
    header: CloudHeader


def read_header(path: AnyPath) -> CloudHeader:
    """Header of a LAS or LAZ file.

    Raises
    ------
    InputError : the file is missing, of another kind, damaged, without points, or its scale or
        offset are no numbers to work with.
    """
    with _open(path) as reader:
        return cloud_header(Path(path), reader.header)


def read_extent(path: AnyPath) -> Floats:
    """Lower and upper corner (2, 3) of a cloud as its header states them, native coordinates.

    They are rounded to the file's own steps, so that they equal the coordinates of points.

    Raises
    ------
    InputError : as `read_header`.
    """
    with _open(path) as reader:
        header = cloud_header(Path(path), reader.header)
        stated = np.array([reader.header.mins, reader.header.maxs], np.float64)
        return np.rint((stated - header.offset) / header.scale) * header.scale + header.offset


def iter_chunks(
    path: AnyPath, chunk_points: int = CHUNK_POINTS, times: bool = False
) -> Iterator[Chunk]:
    """Stream a cloud in file order, at most ``chunk_points`` points at a time.

    Parameters
    ----------
    times : whether GPS times come along, which take time to decode.

    Raises
    ------
    InputError : as `read_header`, or the points end early or cannot be decoded.
    """
    at_once = chunk_points * max(_DECODED_POINTS // chunk_points, 1)
    layers = _CHUNK_LAYERS | DecompressionSelection.GPS_TIME if times else _CHUNK_LAYERS
    with _open(path, layers) as reader:
        header = cloud_header(Path(path), reader.header)
        for points in _decoded(path, reader, at_once):
            for start in range(0, len(points), chunk_points):
                yield chunk_of(points[start : start + chunk_points], header, times)


def read_laz(path: AnyPath) -> NativeCloud:
    """Read a whole cloud with all its dimensions; meant for clouds that fit in memory.

    Raises
    ------
    InputError : as `iter_chunks`.
    """
    with _open(path) as reader:
        header = cloud_header(Path(path), reader.header)
        parts = list(_decoded(path, reader, _DECODED_POINTS))
        left_out = ("X", "Y", "Z", *header.left_out)
        names = [n for n in reader.header.point_format.dimension_names if n not in left_out]
        dims = {name: np.concatenate([np.asarray(part[name]) for part in parts]) for name in names}
        return NativeCloud(
            np.concatenate([native_xyz(part, header) for part in parts]), dims, header
        )


def write_laz(
    path: AnyPath,
    xyz_m: ArrayLike,
    frame: Frame,
    dims: Mapping[str, ArrayLike] | None = None,
    carried: Carried | None = None,
) -> None:
    """Write points as LAZ 1.4 in the native CRS and units, to 0.001 of a native unit.

    The same points give the same bytes. Colours are written when red, green and blue are all there.

    Parameters
    ----------
    xyz_m : local metres, shape (n, 3).
    dims : further dimensions by name, each of length n, or (n, 2) or (n, 3); names that LAS 1.4
        does not know become extra dimensions of their own type.
    carried : what the writer of the points' cloud knew beside them.

    Raises
    ------
    InputError : a coordinate is not finite or beyond what LAS integers hold.
    """
    xyz = frame.to_native(np.asarray(xyz_m).reshape(-1, 3))
    offset = np.floor(frame.origin)
    integers = np.rint((xyz - offset) / _LAZ_SCALE)
    if not np.all(np.abs(integers) < 2**31):
        raise InputError(
            "cannot be written: a coordinate is not finite or too far from the origin",
            where=str(path),
        )
    carried = carried or Carried()
    given = (dims or {}).items()
    fields = {name: np.asarray(values) for name, values in given if name not in WAVEFORM}
    las = laspy.LasData(_new_header(frame, offset, fields, carried))
    las.x, las.y, las.z = xyz.T
    for name, values in fields.items():
        stored = _las_values(name, values)
        description = carried.extra.get(name, ExtraField())
        if description.scales is None or description.offsets is None:
            las[_las_name(name)] = stored
        else:
            steps = (values - description.offsets) / description.scales
            las.points.array[name] = np.rint(steps.reshape(las.points.array[name].shape))
    with atomic_path(path) as temporary:
        las.write(str(temporary), do_compress=True, laz_backend=laspy.LazBackend.Lazrs)


@contextmanager
def _open(path: AnyPath, layers: DecompressionSelection = _ALL_LAYERS) -> Iterator[laspy.LasReader]:
    """Open a cloud; whatever laspy and its decoder raise becomes one InputError.

    Only the ``layers`` of points are decoded, where the point format has layers.
    """
    check_structure(Path(path))
    try:
        with laspy.open(
            os.fspath(path), laz_backend=laspy.LazBackend.Lazrs, decompression_selection=layers
        ) as reader:
            reader.header.point_count = counted(Path(path))[0]
            layered = _compressor(reader.header) == _LAYERED
            if layered and _layered_chunks(Path(path), reader.header) is None:
                raise InputError(
                    "is damaged: a compressed layer reaches beyond its end",
                    where=str(path),
                    hint="copy or download it again",
                )
            yield reader
    except (InputError, KeyboardInterrupt, SystemExit, GeneratorExit):
        raise
    except BaseException as error:  # panics of the decoder are no Exceptions
        raise InputError(
            f"is damaged ({type(error).__name__}: {error})",
            where=str(path),
            hint="copy or download it again",
        ) from error


def _decoded(
    path: AnyPath, reader: laspy.LasReader, chunk_points: int
) -> Iterator[laspy.ScaleAwarePointRecord]:
    """Decode the points of an open cloud and count them.

    As many threads work as ``RAYON_NUM_THREADS`` says.
    """
    if are_apart(Path(path), reader.header):
        reader.laz_backend = laspy.LazBackend.LazrsParallel
    count = 0
    for points in reader.chunk_iterator(chunk_points):
        count += len(points)
        yield points
    if count != reader.header.point_count:
        raise InputError(
            "ends early",
            where=str(path),
            found=f"{count} points",
            allowed=f"{reader.header.point_count}, as its header says",
            hint="copy or download it again",
        )


def _new_header(
    frame: Frame, offset: Floats, dims: Mapping[str, NDArray], carried: Carried
) -> laspy.LasHeader:
    """LAS 1.4 header with a fixed date, the CRS, and the extra dimensions that ``dims`` need."""
    coloured = set(COLOURS) <= set(dims)
    point_format = (8 if "nir" in dims else 7) if coloured else 6
    header = laspy.LasHeader(version="1.4", point_format=point_format)
    header.creation_date = _LAZ_DATE
    header.system_identifier = header.generating_software = "roadsight"
    header.scales, header.offsets = np.full(3, _LAZ_SCALE), offset
    if frame.crs_wkt is not None:
        crs = CRS.from_wkt(frame.crs_wkt)
        try:  # WKT 1, which LAS asks for, or WKT 2 where WKT 1 cannot say it
            text = crs.to_wkt("WKT1_GDAL")
        except CRSError:
            text = crs.to_wkt()
        header.vlrs.append(WktCoordinateSystemVlr(text))
    carry(header, carried)
    header.global_encoding.wkt = True
    known = set(header.point_format.dimension_names)
    for name, values in dims.items():
        if _las_name(name) in known:
            continue
        description = carried.extra.get(name, ExtraField())
        kind = _las_values(name, values).dtype if description.dtype is None else description.dtype
        count = values.shape[1] if values.ndim > 1 else 1
        header.add_extra_dim(
            laspy.ExtraBytesParams(
                name,
                np.dtype((kind, (count,))) if count > 1 else kind,
                description.description,
                description.offsets,
                description.scales,
            )
        )
    return header


def _las_name(name: str) -> str:
    """Name in LAS 1.4 of a dimension of an older LAS format."""
    return "scan_angle" if name == "scan_angle_rank" else name


def _las_values(name: str, values: NDArray) -> NDArray:
    """Values in LAS 1.4 of a dimension: scan angles in its unit, bool as 8 bit."""
    if name == "scan_angle_rank":
        return np.rint(values / _DEGREES_PER_SCAN_ANGLE).astype(np.int16)
    return values.astype(np.uint8) if values.dtype == bool else values


# Chunks of compressed points in a LAZ file, checked before the decoder relies on their sizes.
#
# The sizes of all chunks stand in a table at the end of the file: by it, threads decode them
# beside each other. In point formats 6 to 10 a chunk is made of layers, each preceded by its
# size. The decoder sets that much memory aside, so one damaged size would cost gigabytes.

_Chunks = list[tuple[int, int]]  # points and bytes of each chunk
# Compressors of LAZ that write chunks: points one after the other, and layer by layer.
_CHUNKED, _LAYERED = 2, 3
_LAZ_ITEMS_AT = 34  # byte of the LAZ record at which the list of a point's items begins
# Points of a chunk: where one has more, chunks are not decoded beside each other, because their
# memory would not be bounded.
_LARGEST_CHUNK = 1_000_000
# Layers of each kind of item: point, colour, colour with infrared, waveform; extra bytes have one
# layer a byte.
_LAYERS = {10: 9, 11: 1, 12: 2, 13: 1}
_EXTRA_BYTES = 14  # kind of the item of extra bytes


def are_apart(path: Path, header: laspy.LasHeader) -> bool:
    """Whether threads can decode the chunks beside each other, with bounded memory.

    They cannot where there is one alone, the table does not fit the points, or large chunks would
    be held at once.
    """
    if _compressor(header) not in (_CHUNKED, _LAYERED):
        return False
    record = lazrs.LazVlr(_laz_record(header))
    try:
        with path.open("rb") as stream:
            stream.seek(header.offset_to_point_data)
            table: _Chunks = lazrs.read_chunk_table(stream, record)
    except (lazrs.LazrsError, OSError):
        return False
    if table and not record.uses_variable_size_chunks():  # it has the last as full as the others
        table[-1] = (header.point_count - (len(table) - 1) * record.chunk_size(), table[-1][1])
    small = all(0 < points <= _LARGEST_CHUNK and size > 0 for points, size in table)
    if len(table) < 2 or not small:
        return False
    if _compressor(header) == _LAYERED:
        return table == _layered_chunks(path, header)
    points, sizes = (sum(column) for column in zip(*table, strict=True))
    return points == header.point_count and sizes <= path.stat().st_size


def _compressor(header: laspy.LasHeader) -> int:
    """How points are compressed, 0 where they are not."""
    if not header.are_points_compressed:
        return 0
    return int(struct.unpack_from("<H", _laz_record(header))[0])


def _laz_record(header: laspy.LasHeader) -> bytes:
    return bytes(header.vlrs.get("LasZipVlr")[0].record_data)


def _layered_chunks(path: Path, header: laspy.LasHeader) -> _Chunks | None:
    """What the chunks say of themselves, one after the other; None where they leave the file."""
    record = _laz_record(header)
    count = struct.unpack_from("<H", record, _LAZ_ITEMS_AT - 2)[0]
    items = [struct.unpack_from("<HH", record, _LAZ_ITEMS_AT + 6 * i) for i in range(count)]
    point_bytes = sum(size for _, size in items)
    layers = sum(size if kind == _EXTRA_BYTES else _LAYERS.get(kind, 0) for kind, size in items)
    head = struct.Struct(f"<{1 + layers}I")
    size, left = path.stat().st_size, header.point_count
    position = header.offset_to_point_data + 8
    chunks: _Chunks = []
    with path.open("rb") as stream:
        while left > 0:
            if position + point_bytes + head.size > size:
                return None
            stream.seek(position + point_bytes)
            points, *layer_bytes = head.unpack(stream.read(head.size))
            chunks.append((points, point_bytes + head.size + sum(layer_bytes)))
            left, position = left - points, position + chunks[-1][1]
            if points == 0 or position > size:
                return None
    return chunks
