"""What each pixel of a shard's images shows, by networks or by label images made elsewhere."""

from __future__ import annotations

import logging
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Annotated

import numpy as np

from roadsight.base.arrays import Bytes
from roadsight.base.errors import InputError
from roadsight.base.sections.poles import Networks
from roadsight.base.shards import WHOLE, Shard
from roadsight.io.images.image_shards import ImageShardWriter, LabelImages
from roadsight.io.images.models import open_model, read_label_map
from roadsight.io.images.videologs import ImageSource
from roadsight.poles.images.kinds import PixelClass
from roadsight.poles.images.networks import (
    Labels,
    class_mask,
    folder_mask,
    is_stretched,
    merge_masks,
    tensor_of,
)
from roadsight.poles.images.views import VIEWS, View, ViewName
from roadsight.stages.command import Command, logged
from roadsight.stages.poles.shared.view_inputs import Stretched, views_with_images

log = logging.getLogger("segment_images")

Source = tuple[Labels, Callable[[View, Bytes], Bytes]]


def segment_images(
    frames: Path,
    images: str,
    source: Annotated[
        tuple[Sequence[str], ...],
        "repeat it: later sources replace what earlier ones say, with their own classes only",
    ],
    image_height_px: Annotated[int, Networks],
    views: Sequence[ViewName] = VIEWS,
    shard: Shard = WHOLE,
    threads: Annotated[int, "threads of a network"] = 1,
    *,
    out: Path,
) -> None:
    """Write the mask of every view of every usable frame of the shard."""
    sources = [_open(one, threads, image_height_px) for one in source]
    folders = [LabelImages(one[0]) for one in source if len(one) == 2]
    shown, left_out = views_with_images(frames, views, shard, folders, "label images", log)
    pictures = ImageSource(images)
    pixels = np.zeros(256, np.int64)
    about = {"sources": [" ".join(s) for s in source], "scale": 1.0}
    about |= {"left_out": left_out}
    with ImageShardWriter(out, about) as writer:
        for view in logged(shown, len(shown), log, "images"):
            image = pictures.read(view.path)
            masks = [mask_of(view, image) for _, mask_of in sources]
            mask = merge_masks(masks, [labels for labels, _ in sources])
            pixels += np.bincount(mask.ravel(), minlength=256)
            writer.write(view.name, mask)
    shares = pixels / max(pixels.sum(), 1)
    named = [f"{c.name.lower()} {shares[c]:.1%}" for c in PixelClass if pixels[c]]
    log.info("%d images: %s", len(shown), ", ".join(named) or "nothing to do")


def _open(source: Sequence[str], threads: int, image_height_px: int) -> Source:
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
    model = open_model(source[0], threads)
    if model.manifest.task != "classes":
        raise InputError("must be classes", where=f"{source[0]}: task", found=model.manifest.task)

    def from_network(view: View, image: Bytes) -> Bytes:
        tensor = tensor_of(image, model.manifest.input, image_height_px)
        outputs = model.session.run(list(model.output_names), {model.input_name: tensor})
        return class_mask(outputs, model.manifest, image.shape[:2], source[0])

    return model.manifest, from_network


main = Command(segment_images)


if __name__ == "__main__":
    sys.exit(main())
