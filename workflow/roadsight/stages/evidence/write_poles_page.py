"""Everything that the report shows of one site's poles, in one compact file."""

from __future__ import annotations

import argparse
import json
import logging
import sys
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from roadsight.base.arrays import Bytes
from roadsight.base.shards import shard_of
from roadsight.geometry.cameras import Intrinsics
from roadsight.geometry.frames import Frame
from roadsight.io.images.image_shards import ImageShard
from roadsight.io.images.videologs import ImageSource
from roadsight.io.raster.rasters import read_raster
from roadsight.io.raster.top_rasters import read_top
from roadsight.io.records.atomic import read_json, write_json
from roadsight.io.records.tables import read_about, read_table
from roadsight.poles.drive.drive_lenses import lens_of, with_given
from roadsight.poles.images.straightening import source_places, straightened
from roadsight.poles.images.views import view_name
from roadsight.poles.sightings.sighting_bearing import ViewCamera
from roadsight.report.poles.poles_depth import depth_fit
from roadsight.report.poles.poles_page import PolesResult, ReadEdges, ReadImage, build_poles_page
from roadsight.stages.command import run_stage

log = logging.getLogger("write_poles_page")

_MOST_FITS_TRIED = 12
"""Images of which the fit of depth is tried, spread over the drive, until one can be shown."""


def write_poles_page(arguments: argparse.Namespace) -> None:
    """Read the artifacts of a site's poles job and write its page."""
    about, summary = read_json(arguments.frame), read_json(arguments.summary)
    edges = read_table(arguments.road_edges, ["x", "y", "z"])
    cameras = _joined(arguments.cameras)
    result = PolesResult(
        read_top(arguments.top, Frame.from_dict(about)),
        edges.to_numpy(np.float64),
        read_table(arguments.frames),
        cameras,
        _joined(arguments.sightings),
        read_table(arguments.poles),
        read_table(arguments.hazard) if arguments.hazard else pd.DataFrame(),
        _image_edges(arguments.image_edges),
        _pictures(arguments) if arguments.images else None,
        _depth_fit(arguments, cameras, Frame.from_dict(about)),
        _validation(arguments),
        [Path(path).name for path in arguments.files],
        read_table(arguments.sections) if arguments.sections else pd.DataFrame(),
        read_about(arguments.sections).get("profiles", {}) if arguments.sections else {},
    )
    page = build_poles_page(arguments.title or arguments.site, summary, about, result)
    counts = page["counts"]
    log.info(
        "%d images, %d shown, %d poles", counts["images"], len(page["images"]), counts["poles"]
    )
    write_json(arguments.out, page)


def _pictures(arguments: argparse.Namespace) -> ReadImage:
    """Reader of images by their path; without the distortion of their lenses, if told of any."""
    source = ImageSource(arguments.images)
    if not arguments.drive:
        return source.read
    lenses = with_given(read_json(arguments.drive)["lenses"], json.loads(arguments.lenses))
    keys = {
        str(path): (str(route), int(width), int(height))
        for path, route, width, height in read_table(arguments.frames)[
            ["path", "route", "width_px", "height_px"]
        ].itertuples(index=False)
    }

    def read(path: str) -> Bytes:
        image = source.read(path)
        lens = lens_of(lenses, keys[path], (image.shape[0], image.shape[1]))
        places = source_places(lens, image.shape[1::-1], image.shape[:2])
        return straightened(image, places, smooth=True)

    return read


def _joined(paths: list[str]) -> pd.DataFrame:
    """Shards of a table in order; those without rows do not decide about its types."""
    tables = [read_table(path) for path in paths]
    filled = [table for table in tables if len(table)]
    return pd.concat(filled or tables[:1], ignore_index=True)


def _image_edges(paths: list[str]) -> ReadEdges:
    """Reader of an image's edges; a shard is read once."""

    @cache
    def shard(number: int) -> pd.DataFrame:
        return read_table(paths[number], ["image", "u", "v"])

    def read(image: str) -> pd.DataFrame:
        table = shard(shard_of(image, len(paths)))
        return table[table["image"] == image]

    return read


def _depth_fit(
    arguments: argparse.Namespace, cameras: pd.DataFrame, frame: Frame
) -> dict[str, Any] | None:
    """Depth fit of the accepted image in the middle of the route that allows one."""
    if not (arguments.masks and arguments.depth and arguments.dem):
        return None
    ground = read_raster(arguments.dem, frame)
    for camera, pose in _middle_first(cameras[cameras["accepted"].astype(bool)]):
        name = view_name(str(pose["image"]))
        number = shard_of(str(pose["image"]), len(arguments.masks))
        shards = [ImageShard(paths[number]) for paths in (arguments.masks, arguments.depth)]
        if not all(name in shard for shard in shards):
            continue
        mask, depth = (shard.read(name) for shard in shards)
        found = depth_fit(str(pose["image"]), camera, mask, depth, ground.sample)
        if found is not None:
            return found
    return None


def _middle_first(accepted: pd.DataFrame) -> Iterator[tuple[ViewCamera, pd.Series]]:
    """A few accepted cameras, spread over the route, from its middle outwards."""
    if accepted.empty:
        return
    ordered = accepted.sort_values("image", kind="stable")
    rows = np.unique(np.linspace(0, len(ordered) - 1, _MOST_FITS_TRIED).astype(int))
    for row in sorted(rows.tolist(), key=lambda r: abs(2 * r - len(ordered))):
        pose = ordered.iloc[row]
        numbers = [float(pose[name]) for name in ("focal_px", "cx_px", "cy_px")]
        own = Intrinsics(int(pose["width_px"]), int(pose["height_px"]), *numbers)
        position = (float(pose["x"]), float(pose["y"]), float(pose["z"]))
        angles = [float(pose[f"{name}_deg"]) for name in ("heading", "pitch", "roll")]
        yield ViewCamera(own, position, *angles), pose


def _validation(arguments: argparse.Namespace) -> dict[str, Any] | None:
    """Scores against known poles, with those of the components where they were compared."""
    if not arguments.validation:
        return None
    content: dict[str, Any] = read_json(arguments.validation)
    if arguments.components:
        content["ablation"] = read_json(arguments.components)
    return content


def main(argv: list[str] | None = None) -> int:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    for name in ("site", "summary", "frame", "top", "road-edges", "frames", "poles", "out"):
        parser.add_argument(f"--{name}", required=True)
    for name in ("cameras", "image-edges", "sightings"):
        parser.add_argument(f"--{name}", nargs="+", required=True, help="shards in order")
    parser.add_argument("--title", default="", help="name of the site for people")
    parser.add_argument("--hazard", nargs="?", help="table of hazards by pole")
    parser.add_argument("--sections", nargs="?", help="cross-sections at poles")
    parser.add_argument("--components", nargs="?", help="scores without each component")
    parser.add_argument("--validation", nargs="?", help="validation.json of a site with truth")
    parser.add_argument("--images", nargs="?", help="folder or archive of the images to embed")
    parser.add_argument("--drive", nargs="?", help="profile of the drives, where lenses distort")
    parser.add_argument("--lenses", default="[]", help="given lenses as JSON")
    parser.add_argument("--dem", nargs="?", help="terrain; with masks and depth for the depth fit")
    for name in ("masks", "depth"):
        parser.add_argument(f"--{name}", nargs="*", default=[], help="shards in order")
    parser.add_argument("--files", nargs="*", default=[], help="files of the poles, to be named")
    return run_stage(parser, write_poles_page, argv)


if __name__ == "__main__":
    sys.exit(main())
