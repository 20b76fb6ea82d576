"""Generated videologs: images in ZIPs of JPEGs, and tables as plain CSV."""

from __future__ import annotations

import os
import zipfile
from pathlib import Path

import cv2
import pandas as pd

from roadsight.base.arrays import Bytes
from roadsight.base.errors import InputError
from roadsight.io.records.atomic import WholeFile, atomic_path

_DATE = (1980, 1, 1, 0, 0, 0)
"""The earliest date that a ZIP can hold, so that the same images give the same bytes."""


class JpegShardWriter(WholeFile):
    """Writes JPEGs one by one into a ZIP, which appears under its name when all is well.

    A ZIP is one file that a workflow can declare; unpacked, it is the folder of images that a
    videolog usually is. The same images give the same bytes.

    Parameters
    ----------
    path : the ZIP to write. quality : of the JPEGs, 1 to 100.
    """

    def __init__(self, path: str | os.PathLike[str], quality: int = 90) -> None:
        super().__init__(path)
        self._options = [cv2.IMWRITE_JPEG_QUALITY, quality]

    def _open(self, temporary: Path) -> None:
        self._zip = zipfile.ZipFile(temporary, "w", zipfile.ZIP_STORED)

    def _close(self) -> None:
        self._zip.close()

    def write(self, name: str, image: Bytes) -> None:
        """Add an image (rows, columns, 3 BGR) under ``name``, which ends in .jpg."""
        done, encoded = cv2.imencode(".jpg", image, self._options)
        if not done:
            raise InputError("cannot be written as JPEG", where=name, found=image.dtype)
        self._zip.writestr(zipfile.ZipInfo(name, _DATE), encoded.tobytes())


def write_csv(path: str | os.PathLike[str], table: pd.DataFrame, decimals: dict[str, int]) -> None:
    """Write a table as CSV.

    Parameters
    ----------
    decimals : digits after the point by column; other columns are written as they are.
    """
    texts = table.copy()
    for name, digits in decimals.items():
        # Adding zero turns -0 into 0.
        texts[name] = [f"{round(float(v), digits) + 0.0:.{digits}f}" for v in table[name]]
    with atomic_path(path) as temporary:
        texts.to_csv(temporary, index=False, lineterminator="\n")
