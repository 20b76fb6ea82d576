"""Generated videologs: images in ZIPs of JPEGs, and tables as plain CSV."""

from __future__ import annotations

import os
import zipfile
from typing import Any

import cv2
import pandas as pd

from roadsight.base.arrays import Bytes
from roadsight.base.errors import InputError
from roadsight.io.records.atomic import atomic_path, close_within, open_within

_DATE = (1980, 1, 1, 0, 0, 0)


class JpegShardWriter:
    """Writes JPEGs one by one into a ZIP, which appears under its name when all is well.

    A ZIP is one file that a workflow can declare; unpacked, it is the folder of images that a
    videolog usually is. The same images give the same bytes.

    Parameters
    ----------
    path : the ZIP to write. quality : of the JPEGs, 1 to 100.
    """

    def __init__(self, path: str | os.PathLike[str], quality: int = 90) -> None:
        self._place = atomic_path(path)
        self._options = [cv2.IMWRITE_JPEG_QUALITY, quality]

    def __enter__(self) -> JpegShardWriter:
        self._zip = open_within(
            self._place, lambda path: zipfile.ZipFile(path, "w", zipfile.ZIP_STORED)
        )
        return self

    def write(self, name: str, image: Bytes) -> None:
        """Add an image (rows, columns, 3 BGR) under ``name``, which ends in .jpg."""
        done, encoded = cv2.imencode(".jpg", image, self._options)
        if not done:
            raise InputError("cannot be written as JPEG", where=name, found=image.dtype)
        self._zip.writestr(zipfile.ZipInfo(name, _DATE), encoded.tobytes())

    def __exit__(self, kind: Any, error: Any, trace: Any) -> None:
        close_within(self._place, self._zip.close, error)


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
