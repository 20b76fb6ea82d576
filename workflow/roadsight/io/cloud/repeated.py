"""Points that are there twice: in tiles that overlap, in copies of a file, in clouds joined twice.

While clouds are read for the first time, a sample of points tells whether any are repeated. Equal
points are in the sample together, because a hash of their place chooses them. Only where it has
some are all points looked at, through a file of their hashes, with bounded memory.
"""

from __future__ import annotations

import os
import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from roadsight.base.arrays import Bools, Floats
from roadsight.base.errors import InputError
from roadsight.io.cloud.chunks import Chunk
from roadsight.io.cloud.cloud_scan import kept_chunks
from roadsight.io.cloud.clouds import read_header
from roadsight.io.cloud.point_filter import key_steps, point_keys
from roadsight.io.records.sources import sha256

# Points of the sample at most (1 MB of hashes); a cloud of fewer is looked at as a whole.
_SAMPLE = 1 << 17
# Share of a sample that may be repeated by chance: a few points of dense clouds agree to the
# millimetre and in intensity.
_CHANCE = 1e-4
_AT_ONCE = 1 << 24  # hashes sorted at once (16 million, some 400 MB with their places)


class RepeatedSample:
    """Sample of points in which equal ones are together.

    Parameters
    ----------
    steps : what coordinates are rounded to (3,).
    """

    def __init__(self, steps: Floats) -> None:
        self._steps = steps
        self._keys = np.empty(0, np.uint64)
        self._bits = 0
        self._waiting: list[NDArray[np.uint64]] = []
        self._count = 0

    def take(self, _: str | os.PathLike[str], chunk: Chunk) -> None:
        """Look at the points of a chunk; meant for `scan_cloud`."""
        if not len(chunk):
            return
        place = np.rint(chunk.xyz[:, 0] / self._steps[0]).astype(np.int64).view(np.uint64)
        chosen = self._chosen(place)
        keys = point_keys(
            chunk.xyz[chosen],
            self._steps,
            None,
            chunk.return_number[chosen],
            chunk.intensity[chosen],
        )
        self._waiting.append(np.stack([place[chosen], keys]))
        self._count += int(np.count_nonzero(chosen))
        while self._count > _SAMPLE:
            self._bits += 1
            joined = np.concatenate(self._waiting, axis=1)
            self._waiting = [joined[:, self._chosen(joined[0])]]
            self._count = self._waiting[0].shape[1]

    def _chosen(self, place: NDArray[np.uint64]) -> Bools:
        if self._bits == 0:
            return np.ones(len(place), bool)
        mixed = place * np.uint64(0x9E3779B97F4A7C15)
        return np.asarray(mixed >> np.uint64(64 - self._bits) == 0)

    @property
    def share(self) -> float:
        """Share of the points that repeat another one; 0 where it may be chance."""
        if not self._waiting:
            return 0.0
        keys = np.concatenate(self._waiting, axis=1)[1]
        share = 1 - len(np.unique(keys)) / max(len(keys), 1)
        return share if self._bits == 0 or share > _CHANCE else 0.0


def steps_of(clouds: Sequence[Path]) -> Floats:
    """What coordinates of clouds are rounded to when they are compared."""
    return key_steps(np.array([read_header(cloud).scale for cloud in clouds]))


def first_ones(clouds: Sequence[Path], folder: Path, overlap: str) -> list[Bools]:
    """Which of the points of each cloud that take part are there for the first time.

    Parameters
    ----------
    folder : where hashes wait, eight bytes a point. overlap : see `kept_chunks`.
    """
    steps, counts = steps_of(clouds), []
    folder.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryFile(dir=folder) as stream:
        for cloud in clouds:
            count = 0
            for chunk, *_ in kept_chunks(cloud, overlap=overlap, times=True):
                parts_of = chunk.time, chunk.return_number, chunk.intensity
                stream.write(point_keys(chunk.xyz, steps, *parts_of).data)
                count += len(chunk)
            counts.append(count)
        stream.flush()
        first = np.zeros(sum(counts), bool)
        keys = np.memmap(stream, np.uint64, "r") if len(first) else np.empty(0, np.uint64)
        parts = -(-len(keys) // _AT_ONCE)
        for part in range(parts):
            places = [
                np.flatnonzero(keys[start : start + _AT_ONCE] % np.uint64(parts) == part) + start
                for start in range(0, len(keys), _AT_ONCE)
            ]
            place = np.concatenate(places)
            _, at = np.unique(keys[place], return_index=True)
            first[place[at]] = True
    return np.split(first, np.cumsum(counts)[:-1])


def check_copies(clouds: Sequence[Path]) -> None:
    """Refuse a file that is there twice, under one name or two.

    Raises
    ------
    InputError : two have the same content.
    """
    by_size: dict[int, list[Path]] = {}
    for cloud in clouds:
        if cloud.is_file():
            by_size.setdefault(cloud.stat().st_size, []).append(cloud)
    for group in by_size.values():
        known: dict[str, Path] = {}
        for cloud in group if len(group) > 1 else ():
            other = known.setdefault(sha256(cloud), cloud)
            if other is not cloud:
                raise InputError(
                    "is the same file as another one (sha256)",
                    where=str(cloud),
                    found=str(other),
                    hint="leave one of them out",
                )
