"""Render one shard of the embedded rural site's videolog, with its labels and depth if asked."""

from __future__ import annotations

import argparse
import logging
import sys
import zlib
from collections.abc import Sequence
from contextlib import ExitStack

import numpy as np

from roadsight.base.shards import shard_of
from roadsight.geometry.cameras import Intrinsics
from roadsight.geometry.lens import RadialLens
from roadsight.io.images.image_shards import ImageShardWriter
from roadsight.io.images.videolog_shards import JpegShardWriter
from roadsight.poles.images.views import view_name
from roadsight.stages.command import run_stage
from roadsight.stages.progress import logged
from roadsight.synthetic.rendering.images import RuralRenderer
from roadsight.synthetic.rendering.rendering_look import drive_look, random_finish
from roadsight.synthetic.rural.rural_road import build_rural
from roadsight.synthetic.rural.videolog import Drive, random_drives, shots

log = logging.getLogger("render_videolog")


def render_videolog(arguments: argparse.Namespace) -> None:
    """Write the images of the shard's places, and what is true about their pixels."""
    site = build_rural(arguments.seed, arguments.length_m, relief=arguments.relief)
    renderer = RuralRenderer(site)
    wanted = [
        (shot, view, number)
        for number, drive in enumerate(_drives(arguments))
        for shot in shots(site, drive, arguments.seed)
        if shard_of(shot.name(), arguments.shards) == arguments.shard
        for view in shot.cameras
    ]
    with ExitStack() as stack:
        images = stack.enter_context(JpegShardWriter(arguments.images))
        labels, depths = (
            stack.enter_context(ImageShardWriter(path, {"scale": 1.0})) if path else None
            for path in (arguments.labels, arguments.depth)
        )
        for shot, view, number in logged(wanted, len(wanted), log, "images"):
            name = shot.name(view)
            seed = [arguments.seed, zlib.crc32(name.encode())]
            finish = random_finish(np.random.default_rng(seed))
            look = drive_look(arguments.seed, number)
            lens = _lens(shot.cameras[view].intrinsics, arguments)
            picture = renderer.render_view(shot.cameras[view], look, finish, seed[1], lens)
            images.write(name, picture.colour)
            if labels is not None:
                labels.write(view_name(shot.name(), view), picture.classes)
            if depths is not None:
                depths.write(view_name(shot.name(), view), picture.inverse_depth())


def _drives(arguments: argparse.Namespace) -> tuple[Drive, Drive]:
    sides = arguments.side_views == "yes"
    return random_drives(
        arguments.seed,
        hfov_deg=arguments.hfov_deg,
        side_views=sides,
        principal_point_px=arguments.principal_point_px,
    )


def _lens(camera: Intrinsics, arguments: argparse.Namespace) -> RadialLens | None:
    """Lens of a camera, None for a pinhole."""
    if arguments.k1 == arguments.k2 == 0.0:
        return None
    size = camera.width_px, camera.height_px
    lens = RadialLens.centred(arguments.k1, arguments.k2, *size, camera.focal_px)
    lens.check(*size, where="--k1, --k2")
    return lens


def main(argv: Sequence[str] | None = None) -> int:
    """Run the stage."""
    parser = argparse.ArgumentParser(prog="render_videolog", description=__doc__)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--length-m", type=float, default=1000.0, help="of the drive, 60 to 3000")
    parser.add_argument("--relief", type=float, default=1.0, help="heights; 0 is level")
    parser.add_argument("--hfov-deg", type=float, default=0.0, help="first camera; 0: about 20")
    parser.add_argument("--side-views", choices=("yes", "no"), default="yes")
    parser.add_argument("--principal-point-px", type=float, default=0.0, help="from the middle")
    parser.add_argument("--k1", type=float, default=0.0, help="of all lenses, focal length 1")
    parser.add_argument("--k2", type=float, default=0.0)
    parser.add_argument("--shard", type=int, default=0)
    parser.add_argument("--shards", type=int, default=1)
    parser.add_argument("--images", required=True, help="ZIP of JPEGs to write")
    parser.add_argument("--labels", help="ZIP of PNGs with project classes to write")
    parser.add_argument("--depth", help="ZIP of 16-bit PNGs with inverse depth to write")
    return run_stage(parser, render_videolog, argv)


if __name__ == "__main__":
    sys.exit(main())
