"""Axes of the poles in the masks of a shard's views: landmarks for the cameras."""

from __future__ import annotations

import logging
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pandas as pd

from roadsight.base.sections.poles import PoleMasks
from roadsight.base.shards import WHOLE, Shard
from roadsight.io.images.image_shards import ImageShard
from roadsight.io.records.tables import read_table, write_table
from roadsight.poles.images.pole_masks import Instance, find_instances
from roadsight.poles.images.views import VIEWS, View, ViewName, usable, views_of
from roadsight.stages.command import Command, logged

log = logging.getLogger("trace_pole_axes")
TEXTS = ("image", "view", "kind", "foot")
"""Columns of the table that hold texts."""
NUMBERS = (
    "u",
    "v",
    "slope",
    "u_foot",
    "v_foot",
    "v_top",
    "width_px",
    "width_view_px",
    "height_view_px",
)
"""Columns of the table that hold numbers; `foot_visible` and `top_cut` come after them."""
_KIND = "pole"
"""Kind of object whose axes are landmarks."""


def trace_pole_axes(
    frames_path: Path,
    masks_path: Path,
    settings: PoleMasks,
    views: Sequence[ViewName] = VIEWS,
    shard: Shard = WHOLE,
    *,
    out: Path,
) -> None:
    """Write a row for each pole that is large and slender enough, by image and view."""
    frames = usable(read_table(frames_path), shard)
    masks = ImageShard(masks_path)
    shown = [view for view in views_of(frames, tuple(views)) if view.name in masks]
    rows = []
    for view in logged(shown, len(shown), log, "images"):
        mask = masks.read(view.name)
        found = find_instances(mask, _KIND, settings)
        rows += [_row(view, one, mask.shape) for one in found if not one.reason]
    names = {name: pd.Series([row[name] for row in rows], dtype=str) for name in TEXTS}
    numbers = {name: np.array([row[name] for row in rows], np.float64) for name in NUMBERS}
    flags = {
        name: np.array([row[name] for row in rows], bool) for name in ("foot_visible", "top_cut")
    }
    table = pd.DataFrame(names | numbers | flags)
    log.info("%d views, %d pole axes", len(shown), len(table))
    write_table(out, table, {"settings": settings.model_dump()})


def _row(view: View, one: Instance, shape: tuple[int, ...]) -> dict[str, object]:
    middle = 0.5 * (one.v_min + one.v_foot)
    return {
        "image": view.image,
        "view": view.view,
        "kind": one.kind,
        "foot": one.foot,
        "u": float(one.axis_u(np.array(middle))),
        "v": middle,
        "slope": one.slope,
        "u_foot": one.u_foot,
        "v_foot": one.v_foot,
        "v_top": one.v_min,
        "width_px": one.width_px,
        "width_view_px": shape[1],
        "height_view_px": shape[0],
        "foot_visible": one.foot == "visible",
        "top_cut": "top" in one.cut,
    }


main = Command(trace_pole_axes)


if __name__ == "__main__":
    sys.exit(main())
