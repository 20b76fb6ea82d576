"""First look at a cloud: how many points, where, of which classes; noise left out."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from roadsight.base.arrays import Bools, Floats
from roadsight.base.errors import InputError
from roadsight.io.cloud.chunks import Chunk
from roadsight.io.cloud.clouds import CHUNK_POINTS, iter_chunks, read_header
from roadsight.io.cloud.las_header import CloudHeader
from roadsight.io.records.checksums import sha256

NOISE_CLASSES = (7, 18)
"""ASPRS classes of low and high noise."""

Move = Callable[[Floats], Floats]

Take = Callable[[str | os.PathLike[str], Chunk], None]


@dataclass(frozen=True)
class CloudScan:
    """What a pass over all points of one cloud has found.

    Parameters
    ----------
    header : what its header says.
    points : points that are neither withheld nor noise.
    lower, upper : least and greatest native x, y, z of these points, shape (3,).
    withheld, noise : points left out as withheld, and as noise but not withheld.
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

    def take(self, _: str | os.PathLike[str], chunk: Chunk) -> None:
        """Count points; meant for `scan_cloud`."""
        counts = np.bincount(chunk.classification)
        self.classes.update({int(c): int(counts[c]) for c in np.flatnonzero(counts)})
        self.intense = self.intense or bool(chunk.intensity.any())


def kept_chunks(
    path: str | os.PathLike[str], move: Move | None = None, chunk_points: int = CHUNK_POINTS
) -> Iterator[tuple[Chunk, int, int]]:
    """Stream the points that are neither withheld nor noise, in file order.

    Parameters
    ----------
    move : reprojection of native x, y, z, or None.

    Yields
    ------
    points that stay, number of withheld points, number of noise points that are not withheld

    Raises
    ------
    InputError : the cloud cannot be read, or a point cannot be reprojected.
    """
    for chunk in iter_chunks(path, chunk_points):
        noisy = _noisy(chunk)
        kept = chunk.select(~(chunk.withheld | noisy))
        if move is not None:
            kept = replace(kept, xyz=move(kept.xyz))
            if not np.isfinite(kept.xyz).all():
                raise InputError("has points that cannot be reprojected", where=str(path))
        yield kept, int(np.count_nonzero(chunk.withheld)), int(np.count_nonzero(noisy))


def _noisy(chunk: Chunk) -> Bools:
    """Points of a chunk (n,) that are noise but not withheld."""
    noisy = np.zeros(len(chunk), bool)
    for cls in NOISE_CLASSES:
        noisy |= chunk.classification == cls
    return noisy & ~chunk.withheld


def scan_cloud(
    path: str | os.PathLike[str],
    move: Move | None = None,
    chunk_points: int = CHUNK_POINTS,
    take: Take | None = None,
) -> CloudScan:
    """Read all points of a cloud once and keep what ingest has to know beforehand.

    Parameters
    ----------
    take : called with the path and each chunk of points that stay, as they come.

    Raises
    ------
    InputError : as `kept_chunks`, or every point is withheld or noise.
    """
    lower, upper = np.full(3, np.inf), np.full(3, -np.inf)
    points = withheld = noise = brightest = 0
    for chunk, chunk_withheld, chunk_noise in kept_chunks(path, move, chunk_points):
        withheld, noise, points = (
            withheld + chunk_withheld,
            noise + chunk_noise,
            points + len(chunk),
        )
        lower = np.minimum(lower, chunk.xyz.min(axis=0, initial=np.inf))
        upper = np.maximum(upper, chunk.xyz.max(axis=0, initial=-np.inf))
        if chunk.colour is not None:
            brightest = max(brightest, int(chunk.colour.max(initial=0)))
        if take is not None:
            take(path, chunk)
    if points == 0:
        raise InputError(
            "holds no points but noise and withheld ones",
            where=str(path),
            found=f"{withheld} withheld, {noise} noise",
        )
    return CloudScan(
        read_header(path), points, lower, upper, withheld, noise, brightest, sha256(path)
    )
