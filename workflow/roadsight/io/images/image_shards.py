"""Many small images in one file: a ZIP of PNGs that any viewer opens."""

from __future__ import annotations

import json
import logging
import os
import zipfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from roadsight.base.arrays import AnyPath, Bytes, Numbers
from roadsight.base.doubts import Doubt, tell_matches
from roadsight.base.errors import InputError, unreadable
from roadsight.io.images.exif import decoded_image
from roadsight.io.records.atomic import WholeFile

_SHARD = "a shard of images"  # what messages call it
_ABOUT = "about.json"  # name of the description in the ZIP
# The earliest date that a ZIP can hold, so that the same images give the same bytes.
_DATE = (1980, 1, 1, 0, 0, 0)
# Depth maps are 1 % larger than at level 3 and masks smaller, in half the time.
_PNG = [
    *(cv2.IMWRITE_PNG_COMPRESSION, 1),
    *(cv2.IMWRITE_PNG_STRATEGY, cv2.IMWRITE_PNG_STRATEGY_RLE),
]


class ImageShardWriter(WholeFile):
    """Writes images one by one; the file appears under its name when all is well.

    Parameters
    ----------
    path : the ZIP to write. about : JSON description kept in it.
    """

    def __init__(self, path: AnyPath, about: dict[str, Any] | None = None) -> None:
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

    def __init__(self, path: AnyPath) -> None:
        self._path = os.fspath(path)
        try:
            self._zip = zipfile.ZipFile(path)
            self.about: dict[str, Any] = json.loads(self._zip.read(_ABOUT))
        except (OSError, KeyError, ValueError, zipfile.BadZipFile) as error:
            raise unreadable(_SHARD, self._path, error) from error
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
            raise unreadable(_SHARD, self._path, error) from error
        image = cv2.imdecode(content, cv2.IMREAD_UNCHANGED) if content.size else None
        if image is None:
            raise unreadable(_SHARD, self._path, f"{name} is no image")
        return image


class JpegShardWriter(WholeFile):
    """Writes JPEGs one by one into a ZIP, which appears under its name when all is well.

    A ZIP is one file that a workflow can declare; unpacked, it is the folder of images that a
    videolog usually is. The same images give the same bytes.
    """

    def _open(self, temporary: Path) -> None:
        self._zip = zipfile.ZipFile(temporary, "w", zipfile.ZIP_STORED)

    def _close(self) -> None:
        self._zip.close()

    def write(self, name: str, image: Bytes) -> None:
        """Add an image (rows, columns, 3 BGR) under ``name``, which ends in .jpg."""
        done, encoded = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, 90])
        if not done:
            raise InputError("cannot be written as JPEG", where=name, found=image.dtype)
        self._zip.writestr(zipfile.ZipInfo(name, _DATE), encoded.tobytes())


_NAMED = 5  # so many images are named in a message; the number tells of the others


@dataclass(frozen=True)
class Matching:
    """What a folder has of a videolog's images.

    Parameters
    ----------
    doubts : where few have one. without : paths of the images that have none.
    """

    doubts: list[Doubt]
    without: tuple[str, ...]


class LabelImages:
    """Label or depth images that somebody else made for a videolog.

    PNGs named as the images they belong to, in the same folders or all in one.

    Raises
    ------
    InputError : there is no such folder.
    """

    def __init__(self, folder: AnyPath) -> None:
        self.folder = Path(folder)
        if not self.folder.is_dir():
            raise InputError("is no folder", where=str(folder))

    def find(self, image_path: str) -> Path | None:
        """File of the image that belongs to ``image_path``, None where there is none."""
        name = PurePosixPath(image_path).with_suffix(".png")
        files = (self.folder / name, self.folder / name.name)
        return next((file for file in files if file.is_file()), None)

    def matching(self, image_paths: Sequence[str], what: str, log: logging.Logger) -> Matching:
        """Which images have one here; those without are named in the log.

        Parameters
        ----------
        image_paths : of all images of a videolog that are used. what : what lies here, plural.

        Raises
        ------
        InputError : none has one.
        """
        without = tuple(path for path in image_paths if self.find(path) is None)
        total, hint = len(image_paths), ""
        if without:
            example = PurePosixPath(without[0]).with_suffix(".png")
            some = ", ".join(without[:_NAMED]) + (", ..." if len(without) > _NAMED else "")
            hint = f"such as {example}" if len(without) == total else f"left out: {some}"
        met, where = f"images have {what}", str(self.folder)
        return Matching(tell_matches(log, met, total - len(without), total, where, hint), without)

    def read(self, image_path: str) -> Numbers:
        """Pixels (rows, columns) of the image that belongs to ``image_path``, as stored.

        Raises
        ------
        InputError : it is missing, damaged, or has more than one channel.
        """
        file = self.find(image_path)
        if file is None:
            raise InputError(f"has no image for {image_path}", where=str(self.folder))
        pixels = decoded_image(file.read_bytes(), cv2.IMREAD_UNCHANGED)
        if pixels is None or pixels.ndim != 2:
            raise InputError(
                "is no image of one channel",
                where=str(file),
                found="nothing readable" if pixels is None else f"{pixels.shape[2]} channels",
            )
        return pixels
