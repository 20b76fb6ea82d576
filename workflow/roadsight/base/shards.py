"""Which shard an item belongs to: candidates by name alone, images by an even deal."""

from __future__ import annotations

import hashlib
import zlib
from collections.abc import Iterable
from dataclasses import dataclass
from itertools import count


def shard_of(name: str, shards: int) -> int:
    """Shard of an item by its name alone: for many items, of which none may move with another."""
    return zlib.crc32(name.encode()) % shards


def deal(names: Iterable[str], shards: int) -> dict[str, int]:
    """Shard of each of few items: sizes differ by one at most, and one item more moves few others.

    Each item, in the order of a hash, draws shards by further hashes until one has room. An item
    more takes room that another would have had, which draws on: with four shards two of them
    change on average, with eight about three.

    Parameters
    ----------
    names : all items; their order and repetitions do not matter.
    """
    items = sorted(set(names), key=lambda name: (_draw(name, 0), name))
    rooms = [len(items) // shards + (shard < len(items) % shards) for shard in range(shards)]
    found = {}
    for name in items:
        found[name] = next(
            shard for draw in count(1) if rooms[shard := _draw(name, draw) % shards] > 0
        )
        rooms[found[name]] -= 1
    return found


def _draw(name: str, number: int) -> int:
    """A random number of an item: a checksum would send numbered names to few shards."""
    digest = hashlib.blake2b(name.encode(), digest_size=8, salt=number.to_bytes(4, "little"))
    return int.from_bytes(digest.digest(), "little")


@dataclass(frozen=True)
class Shard:
    """One of so many shards; the whole, where nothing is shared out."""

    shard: int = 0
    shards: int = 1

    def has(self, name: str) -> bool:
        """Whether an item that is shared out by its name alone belongs to it."""
        return shard_of(name, self.shards) == self.shard

    def dealt(self, names: Iterable[str]) -> set[str]:
        """Those items of an even deal that belong to it."""
        return {name for name, shard in deal(names, self.shards).items() if shard == self.shard}


WHOLE = Shard()
