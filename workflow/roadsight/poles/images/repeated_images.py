"""Images that repeat the one before although the vehicle moved on: the recorder hung."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import lru_cache

import cv2
import pandas as pd

from roadsight.base.arrays import Bytes
from roadsight.base.doubts import Doubt, listed
from roadsight.poles.images.image_matches import consecutive

_SAME_BITS = 40
"""Bits (of 576) by which hashes of one view differ at most. Copies stored again as JPEG of
quality 50, or with another line of text in the picture, differ by up to 21 bits. Images 1.1 m apart
differ by 62 and more on four real streets, images 8 m apart on a generated road by 115 and more
(`docs/decisions/104-opencv-contrib.md`)."""
_MOVED_M = 1.0
"""Positions of a vehicle that stands still scatter by less."""


def repeated_images(frames: pd.DataFrame, picture: Callable[[str], Bytes]) -> list[str]:
    """Front images that show what the image before them shows, although the vehicle moved on.

    Compared by the Marr-Hildreth hash (C. Zauner, Implementation and Benchmarking of Perceptual
    Image Hash Functions, 2010), which looks at the outlines of an image brought to 512 by 512 px.

    Parameters
    ----------
    frames : as of `consecutive`. picture : reads the image (rows, columns, 3 BGR) at a path.
    """
    hasher = cv2.img_hash.MarrHildrethHash.create()
    hashed = lru_cache(maxsize=2)(lambda path: hasher.compute(picture(path)))
    found = []
    for one, other in consecutive(frames):
        moved_m = math.hypot(other["x"] - one["x"], other["y"] - one["y"])
        if moved_m > _MOVED_M:
            bits = hasher.compare(hashed(one["path"]), hashed(other["path"]))
            if bits <= _SAME_BITS:
                found.append(str(other["image"]))
    return found


def repeat_doubts(images: Sequence[str]) -> list[Doubt]:
    """Warning about the images of `repeated_images`."""
    if not images:
        return []
    text = (
        "the vehicle moved on, but these images show the same as the image before them:"
        f" {listed(images)} (the recorder may have hung; leave them out of the videolog)"
    )
    return [Doubt("images_repeated", "doubt", text, len(images))]
