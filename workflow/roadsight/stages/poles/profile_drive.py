"""Measure what a drive is like: what decides which effects of the pole job matter."""

from __future__ import annotations

import json
import logging
import sys
from pathlib import Path
from typing import Annotated

import numpy as np

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
from roadsight.poles.images.repeated_images import repeat_doubts, repeated_images
from roadsight.stages.command import Command
from roadsight.stages.doubts import tell

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


main = Command(profile_drive)


if __name__ == "__main__":
    sys.exit(main())
