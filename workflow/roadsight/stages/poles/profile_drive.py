"""Measure what a drive is like: what decides which effects of the pole job matter."""

from __future__ import annotations

import json
import logging
import math
import sys
from collections.abc import Callable, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Annotated

import cv2
import numpy as np
import pandas as pd

from roadsight.base.arrays import Bytes
from roadsight.base.doubts import Doubt, listed
from roadsight.geometry.frames import Frame
from roadsight.io.images.videologs import ImageSource
from roadsight.io.raster.rasters import read_raster
from roadsight.io.records.atomic import read_json, write_json
from roadsight.io.records.tables import read_table
from roadsight.poles.drive.drive_profile import (
    FIELDS_DEG,
    frames_of,
    front_view_gap,
    has_sides,
    hidden_share,
    keys_of,
    measured_lens,
)
from roadsight.poles.images.image_matches import consecutive
from roadsight.stages.command import Command, tell

log = logging.getLogger("profile_drive")


def profile_drive(
    frames_path: Path,
    dem: Path,
    frame_path: Path,
    images: str,
    doubts: Annotated[Path | None, "what is wrong with the images"] = None,
    *,
    out: Path,
) -> None:
    """Write the profile of a site's drives."""
    frame = Frame.from_dict(read_json(frame_path))
    frames = read_table(frames_path)
    usable = frames[(frames["status"] == "ok") & np.isfinite(frames["z_road"])]
    picture = ImageSource(images).read
    content = {
        "images": len(usable),
        "hidden_road_share": hidden_share(usable, read_raster(dem, frame).sample),
        "side_share": float(has_sides(usable).mean()) if len(usable) else 0.0,
        "front_view_gaps": [[fov, front_view_gap(usable, fov)] for fov in FIELDS_DEG],
        "lenses": [
            measured_lens(key, frames_of(usable, key)["path"], picture) for key in keys_of(usable)
        ],
    }
    log.info("%s", json.dumps(content))
    if doubts:
        tell(repeat_doubts(repeated_images(usable, picture)), doubts, images, log)
    write_json(out, content)


# Images that repeat the one before although the vehicle moved on: the recorder hung.

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


main = Command(profile_drive)


if __name__ == "__main__":
    sys.exit(main())
