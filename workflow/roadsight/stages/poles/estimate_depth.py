"""Relative inverse depth of a shard's images, by a network or by depth images made elsewhere."""

from __future__ import annotations

import logging
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from roadsight.base.errors import InputError
from roadsight.base.sections.poles import Networks
from roadsight.base.shards import WHOLE, Shard
from roadsight.io.images.image_shards import ImageShardWriter, LabelImages
from roadsight.io.images.models import open_model
from roadsight.io.images.videologs import ImageSource
from roadsight.poles.images.networks import (
    METRIC_NEAREST_M,
    downward_trend,
    inverse_depth,
    is_stretched,
    packed_depth,
    tensor_of,
)
from roadsight.poles.images.views import VIEWS, View, ViewName
from roadsight.stages.command import Command, logged
from roadsight.stages.poles.shared.view_inputs import Stretched, views_with_images

log = logging.getLogger("estimate_depth")

_INVERTED = -0.3
"""Correlation of nearness with the row below which depth is the wrong way round; where there is
ground it is well above 0, where there is none it may be anything near 0."""
_ENOUGH = 5
"""Images after which the direction is checked first, so that a wrong one costs no full run."""
Depth = Callable[[View], NDArray[np.uint16]]


def estimate_depth(
    frames: Path,
    images: str,
    source: Annotated[str, "manifest (.yaml), or folder of 16-bit PNGs, 0 = unknown"],
    image_height_px: Annotated[int, Networks],
    folder_kind: Literal["inverse_depth", "depth"] = "inverse_depth",
    views: Sequence[ViewName] = VIEWS,
    shard: Shard = WHOLE,
    threads: Annotated[int, "threads of a network"] = 1,
    *,
    out: Path,
) -> None:
    """Write the depth of every view of every usable frame of the shard."""
    folders = [] if _is_manifest(source) else [LabelImages(source)]
    shown, left_out = views_with_images(frames, views, shard, folders, "depth images", log)
    metric, key, depth_of = _open(source, threads, images, image_height_px, folder_kind)
    about: dict[str, Any] = {
        "source": source,
        "metric_nearest_m": METRIC_NEAREST_M if metric else None,
    }
    about |= {"left_out": left_out}
    trends: list[float] = []
    flat = 0
    with ImageShardWriter(out, about) as writer:
        for view in logged(shown, len(shown), log, "images"):
            depth = depth_of(view)
            if not depth.any():
                flat += 1
                log.warning("%s: the depth map is constant, so it has no depth", view.name)
            elif view.view == "front":
                trends.append(downward_trend(depth))
                if len(trends) == _ENOUGH:
                    _check_direction(trends, key)
            writer.write(view.name, depth)
        _check_direction(trends, key)
    log.info("%d images, %d of them without depth", len(shown), flat)


def _check_direction(trends: list[float], key: str) -> None:
    """Refuse depth that grows towards the camera; the middle image decides."""
    known = [trend for trend in trends if np.isfinite(trend)]
    if known and np.median(known) < _INVERTED:
        raise InputError(
            "depth is inverted: the ground seems to come nearer towards the horizon",
            where=key,
            found=f"correlation of nearness with the row {np.median(known):.2f}",
            allowed="above 0",
            hint="change it from inverse_depth to depth, or the other way round",
        )


def _is_manifest(source: str) -> bool:
    return source.endswith((".yaml", ".yml"))


def _open(
    source: str,
    threads: int,
    images_path: str,
    image_height_px: int,
    folder_kind: Literal["inverse_depth", "depth"],
) -> tuple[bool, str, Depth]:
    """Whether the scale is metric, what to change if depth is inverted, depth of a view."""
    if not _is_manifest(source):
        return False, "--folder-kind", _from_folder(folder_kind, source, images_path)
    model = open_model(source, threads)
    spec = model.manifest
    if spec.task == "classes":
        raise InputError(
            "must be relative_depth or metric_depth", where=f"{source}: task", found=spec.task
        )
    images, metric = ImageSource(images_path), spec.task == "metric_depth"

    def depth_of(view: View) -> NDArray[np.uint16]:
        image = images.read(view.path)
        tensor = tensor_of(image, spec.input, image_height_px)
        outputs = model.session.run(list(model.output_names), {model.input_name: tensor})
        inverse = inverse_depth(outputs, spec)
        if is_stretched(inverse.shape, tensor.shape[2:], source):
            raise InputError(
                "the network's output has other proportions than its input, as if its export had"
                " fixed one shape",
                where=source,
                found=f"{inverse.shape[1]} x {inverse.shape[0]} of {tensor.shape[3]} x"
                f" {tensor.shape[2]}",
                hint="export it again as docs/poles/models.md says",
            )
        if inverse.shape[0] > image.shape[0]:
            resized = cv2.resize(inverse, image.shape[1::-1], interpolation=cv2.INTER_NEAREST)
            inverse = np.asarray(resized, np.float32)
        return packed_depth(inverse, metric)

    return metric, f"{source}: output.kind", depth_of


def _from_folder(
    folder_kind: Literal["inverse_depth", "depth"], source: str, images_path: str
) -> Depth:
    folder, kind = LabelImages(source), folder_kind
    images, stretched = ImageSource(images_path), Stretched("depth images", log)

    def depth_of(view: View) -> NDArray[np.uint16]:
        pixels, shape = folder.read(view.path).astype(np.float32), images.size(view.path)[::-1]
        if is_stretched(pixels.shape, shape, f"{folder.folder}: {view.path}"):
            stretched.tell(view.path, pixels.shape, shape)
        known = np.where(pixels > 0, pixels, np.float32(np.nan))
        inverse = known if kind == "inverse_depth" else 1.0 / known
        return packed_depth(inverse.astype(np.float32), metric=False)

    return depth_of


main = Command(estimate_depth)


if __name__ == "__main__":
    sys.exit(main())
