"""Which shard an item belongs to."""

from __future__ import annotations

import zlib


def shard_of(name: str, shards: int) -> int:
    """Shard of an item, by its name alone, so that other items coming or going do not move it."""
    return zlib.crc32(name.encode()) % shards
