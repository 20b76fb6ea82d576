"""Many small images in one file: a ZIP of PNGs that any viewer opens."""

from __future__ import annotations

import json
import os
import zipfile
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from roadsight.base.arrays import Bytes, Numbers
from roadsight.base.errors import InputError
from roadsight.io.records.atomic import WholeFile

_ABOUT = "about.json"
"""Name of the description in the ZIP."""
_DATE = (1980, 1, 1, 0, 0, 0)
"""The earliest date that a ZIP can hold, so that the same images give the same bytes."""
_PNG = [
    *(cv2.IMWRITE_PNG_COMPRESSION, 1),
    *(cv2.IMWRITE_PNG_STRATEGY, cv2.IMWRITE_PNG_STRATEGY_RLE),
]
"""Depth maps are 1 % larger than at level 3 and masks smaller, in half the time."""


class ImageShardWriter(WholeFile):
    """Writes images one by one; the file appears under its name when all is well.

    Parameters
    ----------
    path : the ZIP to write. about : JSON description kept in it.
    """

    def __init__(self, path: str | os.PathLike[str], about: dict[str, Any] | None = None) -> None:
        super().__init__(path)
        self._about = about or {}

    def _open(self, temporary: Path) -> None:
        self._zip = zipfile.ZipFile(temporary, "w", zipfile.ZIP_STORED)
        self._add(_ABOUT, json.dumps(self._about, sort_keys=True).encode())

    def _close(self) -> None:
        self._zip.close()

    def write(self, name: str, image: Bytes | NDArray[np.uint16]) -> None:
        """Add an image (rows, columns) or (rows, columns, 3 BGR) under ``name`` (no extension)."""
        done, encoded = cv2.imencode(".png", image, _PNG)
        if not done:
            raise InputError("cannot be written as PNG", where=name, found=image.dtype)
        self._add(f"{name}.png", encoded.tobytes())

    def _add(self, name: str, content: bytes) -> None:
        self._zip.writestr(zipfile.ZipInfo(name, _DATE), content)


class ImageShard:
    """Reads what `ImageShardWriter` wrote.

    Raises
    ------
    InputError : the file is missing or damaged.
    """

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self._path = os.fspath(path)
        try:
            self._zip = zipfile.ZipFile(path)
            self.about: dict[str, Any] = json.loads(self._zip.read(_ABOUT))
        except (OSError, KeyError, ValueError, zipfile.BadZipFile) as error:
            raise self._damaged(error) from error
        self.names = [n.removesuffix(".png") for n in self._zip.namelist() if n != _ABOUT]
        self._known = frozenset(self.names)

    def __contains__(self, name: object) -> bool:
        """Whether it has an image of that name."""
        return name in self._known

    def read(self, name: str) -> Numbers:
        """Image of that name with its own depth and channels.

        Raises
        ------
        InputError : no such image, or it cannot be decoded.
        """
        try:
            content = np.frombuffer(self._zip.read(f"{name}.png"), np.uint8)
        except (KeyError, zipfile.BadZipFile, OSError) as error:
            raise self._damaged(error) from error
        image = cv2.imdecode(content, cv2.IMREAD_UNCHANGED) if content.size else None
        if image is None:
            raise self._damaged(f"{name} is no image")
        return image

    def _damaged(self, problem: object) -> InputError:
        return InputError(
            f"cannot be read as a shard of images ({problem})",
            where=self._path,
            hint="delete it and run the workflow again",
        )
