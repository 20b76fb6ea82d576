"""Tiles of a cloud written while it is first read, in the frame that its header promises."""

from __future__ import annotations

import os
from collections.abc import Sequence
from contextlib import ExitStack

import numpy as np
from numpy.typing import NDArray

from roadsight.geometry.frames import Frame
from roadsight.io.cloud.chunks import Chunk
from roadsight.io.cloud.cloud_scan import CloudScan
from roadsight.io.cloud.tile_writer import TileWriter
from roadsight.io.cloud.tiles import COLOUR, Tile


class TileDraft(ExitStack):
    """Tiles that count only if the headers were right about corner and colour.

    Parameters
    ----------
    path, tile_size_m : as `TileWriter`.
    frame : what the headers promise, or None: nothing is drafted.
    coloured : whether the headers promise colour.
    """

    def __init__(
        self, path: str | os.PathLike[str], tile_size_m: float, frame: Frame | None, coloured: bool
    ) -> None:
        super().__init__()
        self._frame, self._coloured = frame, coloured
        self._shift: dict[str, int] = {}
        self._writer: TileWriter | None = None
        if frame is not None:
            self._writer = self.enter_context(TileWriter(path, tile_size_m, coloured))

    def take(self, path: str | os.PathLike[str], chunk: Chunk) -> None:
        """Add points of a cloud, or give up where they lie beyond the promised corner."""
        if self._writer is None or self._frame is None:
            return
        if len(chunk) and not (chunk.xyz.min(axis=0) >= self._frame.origin).all():
            self.close()
            self._writer = None
            return
        brightest = 0 if chunk.colour is None else int(chunk.colour.max(initial=0))
        shift = self._shift.setdefault(os.fspath(path), colour_shift(brightest))
        self._writer.append(tile_columns(chunk, self._frame, shift))

    def finish(self, frame: Frame, scans: Sequence[CloudScan]) -> list[Tile] | None:
        """Write the tiles, or return None where the headers were wrong.

        Parameters
        ----------
        frame, scans : what reading all points has found.
        """
        seen = {os.fspath(scan.header.path): colour_shift(scan.brightest) for scan in scans}
        right = frame == self._frame and self._coloured == is_coloured(scans)
        if self._writer is None or not right or (self._coloured and seen != self._shift):
            return None
        return self._writer.finish()


def is_coloured(scans: Sequence[CloudScan]) -> bool:
    """Whether every cloud has colour, not only room for it."""
    return all(scan.brightest > 0 for scan in scans)


def colour_shift(brightest: int) -> int:
    """Bits by which colours are cut to 8."""
    return 8 if brightest > 255 else 0


def tile_columns(chunk: Chunk, frame: Frame, shift: int) -> dict[str, NDArray]:
    """Columns of the tiled cloud; colours of 16 bits are cut to 8 by ``shift``."""
    columns: dict[str, NDArray] = dict(zip("xyz", frame.to_local(chunk.xyz).T, strict=True))
    columns |= {
        "intensity": chunk.intensity,
        "scan": chunk.scan,
        "classification": chunk.classification,
        "return_number": chunk.return_number,
        "number_of_returns": chunk.number_of_returns,
    }
    if chunk.colour is not None:
        columns |= dict(zip(COLOUR, (np.right_shift(chunk.colour, shift)).T, strict=True))
    return columns
