"""Sizes of the compressed layers of a LAZ file, checked before the decoder makes room for them.

Point formats 6 to 10 are compressed in chunks of layers, each preceded by its size in bytes. The
decoder sets that much memory aside, so one damaged size would cost gigabytes.
"""

from __future__ import annotations

import struct
from pathlib import Path

import laspy

from roadsight.errors import InputError

_LAYERED = 3
_LAZ_ITEMS_AT = 34
# Layers of each kind of item: point, colour, colour with infrared, waveform; extra bytes have one
# layer a byte.
_LAYERS = {10: 9, 11: 1, 12: 2, 13: 1}
_EXTRA_BYTES = 14


def check_layers(path: Path, header: laspy.LasHeader) -> None:
    """Check that the layers of every chunk lie inside the file.

    Raises
    ------
    InputError : they do not.
    """
    if not header.are_points_compressed or header.point_format.id < 6:
        return
    record = header.vlrs.get("LasZipVlr")[0].record_data
    if not _layers_fit(path, header.offset_to_point_data + 8, header.point_count, record):
        raise InputError(
            "is damaged: a compressed layer reaches beyond its end",
            where=str(path),
            hint="copy or download it again",
        )


def _layers_fit(path: Path, position: int, points: int, record: bytes) -> bool:
    """Walk from chunk to chunk by the sizes that each announces."""
    if struct.unpack_from("<H", record)[0] != _LAYERED:
        return True
    count = struct.unpack_from("<H", record, _LAZ_ITEMS_AT - 2)[0]
    items = [struct.unpack_from("<HH", record, _LAZ_ITEMS_AT + 6 * i) for i in range(count)]
    point_bytes = sum(size for _, size in items)
    layers = sum(size if kind == _EXTRA_BYTES else _LAYERS.get(kind, 0) for kind, size in items)
    head = struct.Struct(f"<{1 + layers}I")
    size = path.stat().st_size
    with path.open("rb") as stream:
        while points > 0:
            position += point_bytes
            if position + head.size > size:
                return False
            stream.seek(position)
            in_chunk, *layer_bytes = head.unpack(stream.read(head.size))
            position += head.size + sum(layer_bytes)
            points -= in_chunk
            if in_chunk == 0 or position > size:
                return False
    return True
