"""Folders of label images or depth images that somebody else made for a videolog."""

from __future__ import annotations

import os
from pathlib import Path, PurePosixPath

import cv2

from roadsight.base.arrays import Numbers
from roadsight.base.errors import InputError
from roadsight.io.images.exif import decoded_image


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

    def read(self, image_path: str) -> Numbers:
        """Pixels (rows, columns) of the image that belongs to ``image_path``, as stored.

        Raises
        ------
        InputError : it is missing, damaged, or has more than one channel.
        """
        name = PurePosixPath(image_path).with_suffix(".png")
        file = self.folder / name
        if not file.is_file():
            file = self.folder / name.name
        if not file.is_file():
            raise InputError(f"has no image for {image_path}", where=str(self.folder))
        pixels = decoded_image(file.read_bytes(), cv2.IMREAD_UNCHANGED)
        if pixels is None or pixels.ndim != 2:
            raise InputError(
                "is no image of one channel",
                where=str(file),
                found="nothing readable" if pixels is None else f"{pixels.shape[2]} channels",
            )
        return pixels
