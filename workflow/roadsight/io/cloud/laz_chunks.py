"""Chunks of compressed points in a LAZ file, checked before the decoder relies on their sizes.

The sizes of all chunks stand in a table at the end of the file: by it, threads decode them beside
each other. In point formats 6 to 10 a chunk is made of layers, each preceded by its size. The
decoder sets that much memory aside, so one damaged size would cost gigabytes.
"""

from __future__ import annotations

import struct
from pathlib import Path

import laspy
import lazrs

from roadsight.base.errors import InputError

_Chunks = list[tuple[int, int]]
"""Points and bytes of each chunk."""

_CHUNKED, _LAYERED = 2, 3
"""Compressors of LAZ that write chunks: points one after the other, and layer by layer."""
_LAZ_ITEMS_AT = 34
"""Byte of the LAZ record at which the list of a point's items begins."""
_LARGEST_CHUNK = 1_000_000
"""Points of a chunk: where one has more, chunks are not decoded beside each other, because their
memory would not be bounded."""
# Layers of each kind of item: point, colour, colour with infrared, waveform; extra bytes have one
# layer a byte.
_LAYERS = {10: 9, 11: 1, 12: 2, 13: 1}
_EXTRA_BYTES = 14
"""Kind of the item of extra bytes."""


def check_layers(path: Path, header: laspy.LasHeader) -> None:
    """Check that the layers of every chunk lie inside the file.

    Raises
    ------
    InputError : they do not.
    """
    if _compressor(header) == _LAYERED and _layered_chunks(path, header) is None:
        raise InputError(
            "is damaged: a compressed layer reaches beyond its end",
            where=str(path),
            hint="copy or download it again",
        )


def are_apart(path: Path, header: laspy.LasHeader) -> bool:
    """Whether threads can decode the chunks beside each other, with bounded memory.

    They cannot where there is one alone, the table does not fit the points, or large chunks would
    be held at once.
    """
    if _compressor(header) not in (_CHUNKED, _LAYERED):
        return False
    table = _table(path, header)
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


def _table(path: Path, header: laspy.LasHeader) -> _Chunks:
    """What the file's table says of its chunks; none where it cannot be read."""
    record = lazrs.LazVlr(_laz_record(header))
    try:
        with path.open("rb") as stream:
            stream.seek(header.offset_to_point_data)
            table: _Chunks = lazrs.read_chunk_table(stream, record)
    except (lazrs.LazrsError, OSError):
        return []
    if table and not record.uses_variable_size_chunks():  # it has the last as full as the others
        table[-1] = (header.point_count - (len(table) - 1) * record.chunk_size(), table[-1][1])
    return table


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
