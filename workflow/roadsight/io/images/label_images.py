"""Folders of label images or depth images that somebody else made for a videolog."""

from __future__ import annotations

import logging
import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

import cv2

from roadsight.base.arrays import Numbers
from roadsight.base.doubts import Doubt
from roadsight.base.errors import InputError
from roadsight.base.matches import tell_matches
from roadsight.io.images.exif import decoded_image

_NAMED = 5
"""So many images are named in a message; the number tells of the others."""


def _some(names: Sequence[str]) -> str:
    return ", ".join(names[:_NAMED]) + (", ..." if len(names) > _NAMED else "")


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
    """PNGs named as the images they belong to, in the same folders or all in one.

    Raises
    ------
    InputError : there is no such folder.
    """

    def __init__(self, folder: str | os.PathLike[str]) -> None:
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
            all_lack = len(without) == total
            hint = f"such as {example}" if all_lack else f"left out: {_some(without)}"
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
