"""Headers of LAS and LAZ files: consistency with the file itself, CRS records.

A decoder that believes a damaged count may ask for more memory than there is and end the process,
so counts and offsets are checked before it sees them.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass, field
from pathlib import Path
from typing import BinaryIO

import laspy
import numpy as np
from numpy.typing import NDArray

from roadsight.base.arrays import Floats
from roadsight.base.errors import InputError
from roadsight.geometry.crs import StatedCrs
from roadsight.geometry.stated import stated_crs

SUFFIXES = (".las", ".laz")
COLOURS = ("red", "green", "blue")
_WKT_RECORD = 2112  # number of the record that holds a CRS as WKT (LAS 1.4)
# Number of the record that holds a CRS as WKT 2 (LAS 1.5; PDAL writes it into older files).
_WKT_2_RECORD = 4224
_DOUBLES_RECORD = 34736  # number of the record that holds numbers of GeoTIFF keys
_TEXTS_RECORD = 34737  # number of the record that holds texts of GeoTIFF keys
_NEWEST_MINOR = 4  # second number of the newest version that is read, LAS 1.4
_FIRST_LAYERED_FORMAT = 6  # point formats from here on are of LAS 1.4 and have their CRS as WKT
_UNDOCUMENTED = "ExtraBytes"  # name that laspy gives to bytes of a point which no record describes
_LONGEST_VECTOR = 3  # values of an extra dimension that a record can describe
# Number of the record that holds GeoTIFF keys of the CRS (LAS specification).
_GEO_KEY_RECORD = 34735
# Length of a variable record without its content: more records than fit are not believed.
_RECORD_HEADER_BYTES = 54
_EXTENDED_RECORD_HEADER_BYTES = 60  # the same of an extended record, which lies behind the points
_SHORTEST_HEADER_BYTES = 227  # length of the header of LAS 1.0 to 1.2
_LAS_14_HEADER_BYTES = 375  # length of the header of LAS 1.4, the longest
# Length of the shortest point, of format 0; each chunk begins with a whole point.
_LEAST_POINT_BYTES = 20
_COMPRESSED = 0x80  # bit of the point format by which LAZ marks compressed points
# Place of the chunk table by which a LAZ file says that its last bytes hold the place.
_TABLE_OFFSET_AT_END = -1


@dataclass(frozen=True)
class ExtraField:
    """Description of an extra dimension: scales and offsets (k,) and the type of what is stored.

    All three are None where values are stored as they are.
    """

    description: str = ""
    dtype: np.dtype | None = None
    scales: NDArray[np.float64] | None = None
    offsets: NDArray[np.float64] | None = None


@dataclass(frozen=True)
class Carried:
    """Header fields and records of a cloud that do not depend on what a verb changes.

    Parameters
    ----------
    time_type : bit of the global encoding: 0 GPS week time, 1 adjusted standard GPS time.
    file_source_id, system_identifier : as in the header.
    records : user id, number, description and content of each record that is kept.
    extra : description of each extra dimension by name.
    """

    time_type: int = 0
    file_source_id: int = 0
    system_identifier: str = ""
    records: tuple[tuple[str, int, str, bytes], ...] = ()
    extra: dict[str, ExtraField] = field(default_factory=dict)


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
    notes : what contradicts itself in it, and how it was decided; one sentence each.
    carried : what its writer knew beside the points. left_out : fields of a point without meaning.
    """

    path: Path
    points: int
    scale: Floats
    offset: Floats
    stated: StatedCrs
    coloured: bool
    notes: tuple[str, ...] = ()
    carried: Carried = field(default_factory=Carried)
    left_out: tuple[str, ...] = ()


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
        if head[24] != 1 or head[25] > _NEWEST_MINOR:
            return f"is LAS {head[24]}.{head[25]}, and LAS 1.0 to 1.{_NEWEST_MINOR} are read"
        header_bytes, points_at, records = struct.unpack_from("<HII", head, 94)
        point_format, point_bytes = struct.unpack_from("<BH", head, 104)
        if not _SHORTEST_HEADER_BYTES <= header_bytes <= points_at <= size:
            return "is damaged or cut off: its points would start outside the file"
        if records * _RECORD_HEADER_BYTES > points_at - header_bytes:
            return f"is damaged: there is no room for the {records} records that it announces"
        if head[25] >= 4 and len(head) == _LAS_14_HEADER_BYTES:
            extended_at, extended = struct.unpack_from("<QI", head, 235)
            if extended and extended_at + extended * _EXTENDED_RECORD_HEADER_BYTES > size:
                return "is damaged or cut off: its extended records lie outside the file"
        points = _count(head, size)[0]
        if point_format & _COMPRESSED:
            return _chunk_table_problem(stream, points_at, size, points)
    if points_at + points * point_bytes > size:
        return f"is cut off: there is no room for the {points} points that it announces"
    room = _room(head, size)
    if points == 0 and room:
        return f"its header says 0 points, but there is room for {room:,}: repair the header"
    return ""


def _count(head: bytes, size: int) -> tuple[int, str]:
    """Number of points by the first bytes of a file, and a contradiction between its counts.

    LAS 1.4 has a count of 64 bits that counts, and the old one of 32 bits, which is 0 where it
    cannot hold the number and in point formats from 6 on. Where both are 0, the points of each
    return count if the file has room for just as many.
    """
    old, *returns = struct.unpack_from("<6I", head, 107)
    new = 0
    if head[25] >= 4 and len(head) == _LAS_14_HEADER_BYTES:
        new, *more = struct.unpack_from("<16Q", head, 247)
        returns = more if any(more) else returns
    if old == new == 0 and 0 < sum(returns) == _room(head, size):
        by_return = sum(returns)
        return by_return, (
            f"its header says 0 points, and {by_return:,} by their returns, for which there is"
            " just room: these count"
        )
    if head[25] < 4 or len(head) < _LAS_14_HEADER_BYTES:
        return old, ""
    if old in (0, new):
        return new, ""
    if new == 0:
        return old, f"its header says 0 points, and {old:,} where older versions do: these count"
    return new, f"its header says {new:,} points, and {old:,} where older versions do: the first"


def _room(head: bytes, size: int) -> int:
    """Points for which there is room, uncompressed, before whatever follows them."""
    (points_at,) = struct.unpack_from("<I", head, 96)
    (point_bytes,) = struct.unpack_from("<H", head, 105)
    end = size
    followers: list[int] = []
    if head[25] >= 3 and len(head) >= 235:
        followers += struct.unpack_from("<Q", head, 227)
    if head[25] >= 4 and len(head) == _LAS_14_HEADER_BYTES:
        followers += struct.unpack_from("<Q", head, 235)
    for follower in followers:
        if points_at <= follower < end and follower > 0:
            end = follower
    return (end - points_at) // point_bytes if point_bytes else 0


def counted(path: Path) -> tuple[int, tuple[str, ...]]:
    """Points of a file that `check_structure` has passed, and contradictions about their number."""
    with path.open("rb") as stream:
        head = stream.read(_LAS_14_HEADER_BYTES)
    size = path.stat().st_size
    points, note = _count(head, size)
    notes = [note] if note else []
    room = 0 if head[104] & _COMPRESSED else _room(head, size)
    if room > points:
        notes.append(
            f"its header says {points:,} points, but there is room for {room:,}: the first"
        )
    return points, tuple(notes)


def _chunk_table_problem(stream: BinaryIO, points_at: int, size: int, points: int) -> str:
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
    if points == 0 and chunks and table_at > points_at + 8:
        return f"its header says 0 points, but there are {chunks} compressed chunks of them"
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
    stated = _stated(header)
    left_out = tuple(
        dim.name
        for dim in header.point_format.extra_dimensions
        if dim.name == _UNDOCUMENTED or dim.num_elements > _LONGEST_VECTOR
    )
    notes = counted(path)[1]
    return CloudHeader(
        path,
        header.point_count,
        scale,
        offset,
        stated,
        coloured,
        notes,
        carried_of(header),
        left_out,
    )


def _stated(header: laspy.LasHeader) -> StatedCrs:
    """CRS records of a header, ordinary or extended."""
    contents: dict[int, list[bytes]] = {}
    for record in [*header.vlrs, *(header.evlrs or [])]:
        if record.user_id.rstrip("\0") == "LASF_Projection":
            contents.setdefault(record.record_id, []).append(record.record_data_bytes())
    texts = {}
    for number in (_WKT_RECORD, _WKT_2_RECORD):
        plain = [
            d.decode("utf-8", "replace").rstrip("\0").strip() for d in contents.get(number, [])
        ]
        texts[number] = list(dict.fromkeys(text for text in plain if text))
    if repeated := [number for number, told in texts.items() if len(told) > 1]:
        both = " and ".join(text[:60] for text in texts[repeated[0]])
        return StatedCrs(problem=f"it holds different records {repeated[0]}: {both}")
    middle = (np.asarray(header.mins) + np.asarray(header.maxs)) / 2
    return stated_crs(
        next(iter(texts[_WKT_RECORD]), None),
        _geo_keys(contents),
        wkt_2=next(iter(texts[_WKT_2_RECORD]), None),
        wkt_bit=bool(header.global_encoding.wkt),
        only_wkt=header.point_format.id >= _FIRST_LAYERED_FORMAT,
        centre=(float(middle[0]), float(middle[1])),
    )


def _geo_keys(contents: dict[int, list[bytes]]) -> dict[int, int | float | str]:
    """GeoTIFF keys with their values, which stand in the key or in two other records."""
    directory = contents.get(_GEO_KEY_RECORD, [b""])[-1]
    doubles = contents.get(_DOUBLES_RECORD, [b""])[-1]
    numbers = np.frombuffer(doubles[: len(doubles) // 8 * 8], "<f8")
    letters = contents.get(_TEXTS_RECORD, [b""])[-1].decode("latin-1")
    keys: dict[int, int | float | str] = {}
    entries = np.frombuffer(directory[8 : len(directory) // 8 * 8], "<u2").reshape(-1, 4)
    for key, place, count, value in entries.tolist():
        if place == 0:
            keys[key] = value
        elif place == _DOUBLES_RECORD and value < len(numbers) and np.isfinite(numbers[value]):
            keys[key] = float(numbers[value])
        elif place == _TEXTS_RECORD:
            keys[key] = letters[value : value + count].rstrip("|\0")
    return keys


# Records that are written anew (CRS, compression) or hold for one order of the points only.
_OWN = ("LASF_Projection", "laszip encoded", "copc", "lascompatible")
_SPEC = "LASF_Spec"
# Numbers of records of the specification that belong to fields which are described anew, and to
# waveforms, which are not read.
_EXTRA_BYTES, _SUPERSEDED, _WAVE_FIRST, _WAVE_LAST, _WAVE_DATA = 4, 7, 100, 354, 65535
_LONGEST_RECORD = 65535  # bytes of an ordinary record; longer ones are extended


def carried_of(header: laspy.LasHeader) -> Carried:
    """What is carried of a header."""
    system = header.system_identifier
    text = system.decode("ascii", "replace") if isinstance(system, bytes) else str(system)
    records = []
    for record in [*header.vlrs, *(header.evlrs or [])]:
        user, number = record.user_id.rstrip("\0"), record.record_id
        waves = _WAVE_FIRST <= number <= _WAVE_LAST or number == _WAVE_DATA
        described = user == _SPEC and (waves or number in (_EXTRA_BYTES, _SUPERSEDED))
        if user not in _OWN and not described:
            content = record.record_data_bytes()
            records.append((record.user_id, number, record.description, content))
    extra = {}
    for dim in header.point_format.extra_dimensions:
        extra[dim.name] = ExtraField(dim.description)
        if dim.scales is not None:
            stored = dim.dtype.base if dim.dtype is not None else None
            extra[dim.name] = ExtraField(dim.description, stored, dim.scales, dim.offsets)
    return Carried(
        int(header.global_encoding.gps_time_type),
        int(header.file_source_id),
        text.rstrip("\0 "),
        tuple(records),
        extra,
    )


def carry(header: laspy.LasHeader, carried: Carried) -> None:
    """Put what is carried into a new header."""
    header.global_encoding.gps_time_type = laspy.header.GpsTimeType(carried.time_type)
    header.file_source_id = carried.file_source_id
    if carried.system_identifier:
        header.system_identifier = carried.system_identifier
    for user, number, description, content in carried.records:
        plain = description
        if isinstance(description, bytes):
            plain = description.decode("ascii", "replace")
        record = laspy.VLR(user, number, plain.rstrip("\0"), content)
        if len(content) > _LONGEST_RECORD:
            if header.evlrs is None:
                header.evlrs = laspy.vlrs.vlrlist.VLRList()
            header.evlrs.append(record)
        else:
            header.vlrs.append(record)
