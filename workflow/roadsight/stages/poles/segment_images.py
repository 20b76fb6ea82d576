"""What each pixel of a shard's images shows, by networks or by label images made elsewhere."""

from __future__ import annotations

import argparse
import logging
import sys
from collections.abc import Callable

import numpy as np

from roadsight.base.arrays import Bytes
from roadsight.base.errors import InputError
from roadsight.base.options import add_settings
from roadsight.config.sections.poles import Networks
from roadsight.io.images.image_shards import ImageShardWriter
from roadsight.io.images.label_images import LabelImages
from roadsight.io.images.models import open_model, read_label_map
from roadsight.io.images.videologs import ImageSource
from roadsight.poles.images.classes import PixelClass
from roadsight.poles.images.manifest import Labels
from roadsight.poles.images.networks import (
    class_mask,
    folder_mask,
    is_stretched,
    merge_masks,
    tensor_of,
)
from roadsight.poles.images.views import VIEWS, View
from roadsight.stages.command import run_stage
from roadsight.stages.poles.view_inputs import Stretched, views_with_images
from roadsight.stages.progress import logged

log = logging.getLogger("segment_images")

Source = tuple[Labels, Callable[[View, Bytes], Bytes]]


def segment_images(arguments: argparse.Namespace) -> None:
    """Write the mask of every view of every usable frame of the shard."""
    sources = [_open(source, arguments) for source in arguments.source]
    folders = [LabelImages(source[0]) for source in arguments.source if len(source) == 2]
    views, left_out = views_with_images(arguments, folders, "label images", log)
    images = ImageSource(arguments.images)
    pixels = np.zeros(256, np.int64)
    about = {"sources": [" ".join(s) for s in arguments.source], "scale": 1.0}
    about |= {"left_out": left_out}
    with ImageShardWriter(arguments.out, about) as shard:
        for view in logged(views, len(views), log, "images"):
            image = images.read(view.path)
            masks = [mask_of(view, image) for _, mask_of in sources]
            mask = merge_masks(masks, [labels for labels, _ in sources])
            pixels += np.bincount(mask.ravel(), minlength=256)
            shard.write(view.name, mask)
    shares = pixels / max(pixels.sum(), 1)
    named = [f"{c.name.lower()} {shares[c]:.1%}" for c in PixelClass if pixels[c]]
    log.info("%d images: %s", len(views), ", ".join(named) or "nothing to do")


def _open(source: list[str], arguments: argparse.Namespace) -> Source:
    """One source: a model's manifest, or a folder and its label map."""
    if len(source) == 2:
        folder, labels = LabelImages(source[0]), read_label_map(source[1])
        stretched = Stretched("label images", log)

        def from_folder(view: View, image: Bytes) -> Bytes:
            where = f"{folder.folder}: {view.path}"
            labelled, shape = folder.read(view.path), image.shape[:2]
            if is_stretched(labelled.shape, shape, where):
                stretched.tell(view.path, labelled.shape, shape)
            return folder_mask(labelled, labels, shape, where)

        return labels, from_folder
    if len(source) != 1:
        raise InputError(
            "--source takes a manifest, or a folder and its label map", found=" ".join(source)
        )
    model = open_model(source[0], arguments.threads)
    if model.manifest.task != "classes":
        raise InputError("must be classes", where=f"{source[0]}: task", found=model.manifest.task)

    def from_network(view: View, image: Bytes) -> Bytes:
        tensor = tensor_of(image, model.manifest.input, arguments.image_height_px)
        outputs = model.session.run(list(model.output_names), {model.input_name: tensor})
        return class_mask(outputs, model.manifest, image.shape[:2], source[0])

    return model.manifest, from_network


def main(argv: list[str] | None = None) -> int:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    for name in ("frames", "images", "out"):
        parser.add_argument(f"--{name}", required=True)
    parser.add_argument(
        "--source",
        nargs="+",
        action="append",
        required=True,
        metavar="MANIFEST | FOLDER MAP",
        help="repeat it: later sources replace what earlier ones say, with their own classes only",
    )
    parser.add_argument("--views", nargs="+", choices=VIEWS, default=list(VIEWS))
    parser.add_argument("--shard", type=int, default=0)
    parser.add_argument("--shards", type=int, default=1)
    parser.add_argument("--threads", type=int, default=1, help="threads of a network")
    add_settings(parser, Networks, "image_height_px")
    return run_stage(parser, segment_images, argv)


if __name__ == "__main__":
    sys.exit(main())
