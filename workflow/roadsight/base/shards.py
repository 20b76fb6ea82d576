"""Which shard an item belongs to."""

from __future__ import annotations

import zlib
from dataclasses import dataclass


def shard_of(name: str, shards: int) -> int:
    """Shard of an item, by its name alone, so that other items coming or going do not move it."""
    return zlib.crc32(name.encode()) % shards


@dataclass(frozen=True)
class Shard:
    """One of so many shards; the whole, where nothing is shared out."""

    shard: int = 0
    shards: int = 1

    def has(self, name: str) -> bool:
        """Whether an item belongs to it."""
        return shard_of(name, self.shards) == self.shard


WHOLE = Shard()
