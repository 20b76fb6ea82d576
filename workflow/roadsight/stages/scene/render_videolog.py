"""Render one shard of the embedded rural site's videolog, with its labels and depth if asked."""

from __future__ import annotations

import logging
import sys
import zlib
from contextlib import ExitStack
from pathlib import Path
from typing import Annotated

import numpy as np

from roadsight.base.sections.run import Run, RuralLenses, RuralScene, Sample
from roadsight.base.shards import WHOLE, Shard
from roadsight.geometry.cameras import Intrinsics
from roadsight.geometry.lens import RadialLens
from roadsight.io.images.image_shards import ImageShardWriter, JpegShardWriter
from roadsight.poles.images.views import view_name
from roadsight.stages.command import Command, logged
from roadsight_worlds.rendering.images import RuralRenderer
from roadsight_worlds.rendering.rendering_look import drive_look, random_finish
from roadsight_worlds.rural.rural_road import build_rural
from roadsight_worlds.rural.videolog import random_drives, shots

log = logging.getLogger("render_videolog")


def render_videolog(
    scene: RuralScene,
    lenses: RuralLenses,
    length_m: Annotated[float, Sample],
    seed: Annotated[int, Run],
    shard: Shard = WHOLE,
    labels_path: Annotated[Path | None, "ZIP of PNGs with project classes to write"] = None,
    depth: Annotated[Path | None, "ZIP of 16-bit PNGs with inverse depth to write"] = None,
    *,
    images_path: Annotated[Path, "ZIP of JPEGs to write"],
) -> None:
    """Write the images of the shard's places, and what is true about their pixels."""
    site = build_rural(seed, length_m, scene=scene)
    renderer = RuralRenderer(site)
    drives = random_drives(
        seed,
        hfov_deg=scene.hfov_deg,
        side_views=scene.side_views,
        principal_point_px=scene.principal_point_px,
    )
    taken = [
        (shot, number) for number, drive in enumerate(drives) for shot in shots(site, drive, seed)
    ]
    dealt = shard.dealt(shot.name() for shot, _ in taken)
    wanted = [
        (shot, view, number)
        for shot, number in taken
        if shot.name() in dealt
        for view in shot.cameras
    ]
    with ExitStack() as stack:
        images = stack.enter_context(JpegShardWriter(images_path))
        labels, depths = (
            stack.enter_context(ImageShardWriter(path, {"scale": 1.0})) if path else None
            for path in (labels_path, depth)
        )
        for shot, view, number in logged(wanted, len(wanted), log, "images"):
            name = shot.name(view)
            own = [seed, zlib.crc32(name.encode())]
            finish = random_finish(np.random.default_rng(own))
            look = drive_look(seed, number)
            lens = _lens(shot.cameras[view].intrinsics, lenses.k1, lenses.k2)
            picture = renderer.render_view(shot.cameras[view], look, finish, own[1], lens)
            images.write(name, picture.colour)
            if labels is not None:
                labels.write(view_name(shot.name(), view), picture.classes)
            if depths is not None:
                depths.write(view_name(shot.name(), view), picture.inverse_depth())


def _lens(camera: Intrinsics, k1: float, k2: float) -> RadialLens | None:
    """Lens of a camera, None for a pinhole."""
    if k1 == k2 == 0.0:
        return None
    size = camera.width_px, camera.height_px
    lens = RadialLens.centred(k1, k2, *size, camera.focal_px)
    lens.check(*size, where="--k1, --k2")
    return lens


main = Command(render_videolog)


if __name__ == "__main__":
    sys.exit(main())
