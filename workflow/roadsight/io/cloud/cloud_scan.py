"""First look at clouds: how many points, where, of which classes, and whether any are repeated."""

from __future__ import annotations

import tempfile
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from roadsight.base.arrays import AnyPath, Bools, Floats
from roadsight.base.errors import InputError
from roadsight.base.sections.scene import Scene
from roadsight.io.cloud.chunks import Chunk, key_steps, noisy, point_keys
from roadsight.io.cloud.clouds import CHUNK_POINTS, iter_chunks, read_header
from roadsight.io.cloud.las_header import CloudHeader
from roadsight.io.records.sources import sha256

OVERLAP = Scene().overlap  # what is done with points of overlapping flight lines where nobody says
Move = Callable[[Floats], Floats]
Take = Callable[[AnyPath, Chunk], None]


@dataclass(frozen=True)
class CloudScan:
    """What a pass over all points of one cloud has found.

    Parameters
    ----------
    header : what its header says.
    points : points that take part.
    lower, upper : least and greatest native x, y, z of these points, shape (3,).
    withheld, noise : points left out as withheld, and as noise but not withheld.
    synthetic, overlap : further points left out as not measured, and by choice.
    brightest : greatest red, green or blue; 0 without colour.
    sha256 : of the file.
    """

    header: CloudHeader
    points: int
    lower: Floats
    upper: Floats
    withheld: int
    noise: int
    brightest: int
    sha256: str
    synthetic: int = 0
    overlap: int = 0


class Contents:
    """What clouds hold beside positions and colour.

    Attributes
    ----------
    classes : number of points by class.
    intense : whether any of them has an intensity above 0.
    """

    def __init__(self) -> None:
        self.classes: Counter[int] = Counter()
        self.intense = False

    def take(self, _: AnyPath, chunk: Chunk) -> None:
        """Count points; meant for `scan_cloud`."""
        counts = np.bincount(chunk.classification)
        self.classes.update({int(c): int(counts[c]) for c in np.flatnonzero(counts)})
        self.intense = self.intense or bool(chunk.intensity.any())


def kept_chunks(
    path: AnyPath,
    move: Move | None = None,
    chunk_points: int = CHUNK_POINTS,
    overlap: str = OVERLAP,
    times: bool = False,
) -> Iterator[tuple[Chunk, int, int, int, int]]:
    """Stream the points that take part, in file order.

    Points that are withheld, noise or synthetic do not, nor those of overlapping flight lines
    where ``overlap`` is ``leave_out``.

    Parameters
    ----------
    move : reprojection of native x, y, z, or None. times : as `iter_chunks`.

    Yields
    ------
    points that stay, and the numbers of points left out: withheld, noise, synthetic, overlap; a
    point counts with the first of these that it is

    Raises
    ------
    InputError : the cloud cannot be read, or a point cannot be reprojected.
    """
    for chunk in iter_chunks(path, chunk_points, times):
        kept, counts = np.ones(len(chunk), bool), []
        reasons = [chunk.withheld, noisy(chunk.classification), chunk.synthetic]
        if overlap == "leave_out":
            reasons.append(chunk.overlap)
        for reason in reasons:
            counts.append(int(np.count_nonzero(kept & reason)))
            kept &= ~reason
        chosen = chunk.select(kept)
        if move is not None:
            chosen = replace(chosen, xyz=move(chosen.xyz))
            if not np.isfinite(chosen.xyz).all():
                raise InputError("has points that cannot be reprojected", where=str(path))
        withheld, noise, synthetic, *more = counts
        yield chosen, withheld, noise, synthetic, sum(more)


def scan_cloud(
    path: AnyPath,
    move: Move | None = None,
    chunk_points: int = CHUNK_POINTS,
    take: Take | None = None,
    overlap: str = OVERLAP,
) -> CloudScan:
    """Read all points of a cloud once and keep what ingest has to know beforehand.

    Parameters
    ----------
    take : called with the path and each chunk of points that stay, as they come.

    Raises
    ------
    InputError : as `kept_chunks`, or no point takes part.
    """
    lower, upper = np.full(3, np.inf), np.full(3, -np.inf)
    points = brightest = 0
    left_out = np.zeros(4, np.int64)
    for chunk, *counts in kept_chunks(path, move, chunk_points, overlap):
        left_out += counts
        points += len(chunk)
        lower = np.minimum(lower, chunk.xyz.min(axis=0, initial=np.inf))
        upper = np.maximum(upper, chunk.xyz.max(axis=0, initial=-np.inf))
        if chunk.colour is not None:
            brightest = max(brightest, int(chunk.colour.max(initial=0)))
        if take is not None:
            take(path, chunk)
    withheld, noise, synthetic, in_overlap = left_out.tolist()
    if points == 0:
        raise InputError(
            "holds no points but noise, withheld and synthetic ones",
            where=str(path),
            found=f"{withheld} withheld, {noise} noise, {synthetic} synthetic",
        )
    return CloudScan(
        read_header(path),
        points,
        lower,
        upper,
        withheld,
        noise,
        brightest,
        sha256(path),
        synthetic,
        in_overlap,
    )


# Points that are there twice: in tiles that overlap, in copies of a file, in clouds joined twice.
#
# While clouds are read for the first time, a sample of points tells whether any are repeated. Equal
# points are in the sample together, because a hash of their place chooses them. Only where it has
# some are all points looked at, through a file of their hashes, with bounded memory.

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

    def take(self, _: AnyPath, chunk: Chunk) -> None:
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
