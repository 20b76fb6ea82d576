"""First look at a cloud: how many points, where, of which classes; noise left out."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from roadsight.base.arrays import Floats
from roadsight.base.errors import InputError
from roadsight.base.sections.scene import Scene
from roadsight.io.cloud.chunks import Chunk
from roadsight.io.cloud.clouds import CHUNK_POINTS, iter_chunks, read_header
from roadsight.io.cloud.las_header import CloudHeader
from roadsight.io.cloud.point_filter import noisy
from roadsight.io.records.sources import sha256

OVERLAP = Scene().overlap  # what is done with points of overlapping flight lines where nobody says
Move = Callable[[Floats], Floats]
Take = Callable[[str | os.PathLike[str], Chunk], None]


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

    def take(self, _: str | os.PathLike[str], chunk: Chunk) -> None:
        """Count points; meant for `scan_cloud`."""
        counts = np.bincount(chunk.classification)
        self.classes.update({int(c): int(counts[c]) for c in np.flatnonzero(counts)})
        self.intense = self.intense or bool(chunk.intensity.any())


def kept_chunks(
    path: str | os.PathLike[str],
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
    path: str | os.PathLike[str],
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
