"""Masks or depth of a shard's views as a pinhole camera would have given them."""

from __future__ import annotations

import json
import logging
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

from roadsight.base.arrays import Floats
from roadsight.base.shards import WHOLE, Shard
from roadsight.io.images.image_shards import ImageShard, ImageShardWriter
from roadsight.io.images.videologs import ImageSource
from roadsight.io.records.atomic import read_json
from roadsight.io.records.tables import read_table
from roadsight.poles.drive.drive_lenses import Key, lens_of, with_given
from roadsight.poles.images.views import (
    VIEWS,
    ViewName,
    source_places,
    straightened,
    usable,
    views_of,
)
from roadsight.stages.command import Command, logged

log = logging.getLogger("undistort_views")


def undistort_views(
    frames_path: Path,
    images_path: str,
    drive: Path,
    maps_path: Path,
    lenses_json: Annotated[str, "given lenses as JSON: route, k1, k2, focal_px"] = "[]",
    views: Sequence[ViewName] = VIEWS,
    shard: Shard = WHOLE,
    *,
    out: Path,
) -> None:
    """Write the shard's maps without the distortion of their lenses."""
    lenses = with_given(read_json(drive)["lenses"], json.loads(lenses_json))
    frames = usable(read_table(frames_path), shard)
    maps, images = ImageShard(maps_path), ImageSource(images_path)
    names = ("route", "width_px", "height_px")
    keys = {
        str(row["image"]): (str(row[names[0]]), int(row[names[1]]), int(row[names[2]]))
        for row in frames.to_dict("records")
    }
    places: dict[tuple[Key, tuple[int, int], tuple[int, ...]], Floats] = {}
    shown = [view for view in views_of(frames, tuple(views)) if view.name in maps]
    with ImageShardWriter(out, maps.about) as writer:
        for view in logged(shown, len(shown), log, "images"):
            one = maps.read(view.name)
            key, size = keys[view.image], images.size(view.path)
            kind = key, size, one.shape[:2]
            if kind not in places:
                lens = lens_of(lenses, key, size[::-1])
                places[kind] = source_places(lens, size, (one.shape[0], one.shape[1]))
            writer.write(view.name, straightened(one, places[kind]))


main = Command(undistort_views)


if __name__ == "__main__":
    sys.exit(main())
