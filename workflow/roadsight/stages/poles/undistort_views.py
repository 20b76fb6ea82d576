"""Masks or depth of a shard's views as a pinhole camera would have given them."""

from __future__ import annotations

import argparse
import json
import logging
import sys

from roadsight.base.arrays import Floats
from roadsight.io.images.image_shards import ImageShard, ImageShardWriter
from roadsight.io.images.videologs import ImageSource
from roadsight.io.records.atomic import read_json
from roadsight.io.records.tables import read_table
from roadsight.poles.drive.drive_lenses import Key, lens_of, with_given
from roadsight.poles.images.straightening import source_places, straightened
from roadsight.poles.images.views import VIEWS, usable, views_of
from roadsight.stages.command import run_stage
from roadsight.stages.progress import logged

log = logging.getLogger("undistort_views")


def undistort_views(arguments: argparse.Namespace) -> None:
    """Write the shard's maps without the distortion of their lenses."""
    lenses = with_given(read_json(arguments.drive)["lenses"], json.loads(arguments.lenses))
    frames = usable(read_table(arguments.frames), arguments.shard, arguments.shards)
    maps, images = ImageShard(arguments.maps), ImageSource(arguments.images)
    names = ("route", "width_px", "height_px")
    keys = {
        str(row["image"]): (str(row[names[0]]), int(row[names[1]]), int(row[names[2]]))
        for row in frames.to_dict("records")
    }
    places: dict[tuple[Key, tuple[int, int], tuple[int, ...]], Floats] = {}
    views = [view for view in views_of(frames, tuple(arguments.views)) if view.name in maps]
    with ImageShardWriter(arguments.out, maps.about) as shard:
        for view in logged(views, len(views), log, "images"):
            one = maps.read(view.name)
            key, size = keys[view.image], images.size(view.path)
            kind = key, size, one.shape[:2]
            if kind not in places:
                lens = lens_of(lenses, key, size[::-1])
                places[kind] = source_places(lens, size, (one.shape[0], one.shape[1]))
            shard.write(view.name, straightened(one, places[kind]))


def main(argv: list[str] | None = None) -> int:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    for name in ("frames", "images", "drive", "maps", "out"):
        parser.add_argument(f"--{name}", required=True)
    parser.add_argument(
        "--lenses", default="[]", help="given lenses as JSON: route, k1, k2, focal_px"
    )
    parser.add_argument("--views", nargs="+", choices=VIEWS, default=list(VIEWS))
    parser.add_argument("--shard", type=int, default=0)
    parser.add_argument("--shards", type=int, default=1)
    return run_stage(parser, undistort_views, argv)


if __name__ == "__main__":
    sys.exit(main())
