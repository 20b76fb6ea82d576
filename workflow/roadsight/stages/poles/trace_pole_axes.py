"""Axes of the poles in the masks of a shard's views: landmarks for the cameras."""

from __future__ import annotations

import argparse
import logging
import sys
from dataclasses import asdict, fields

import numpy as np
import pandas as pd

from roadsight.io.images.image_shards import ImageShard
from roadsight.io.records.tables import read_table, write_table
from roadsight.poles.images.pole_masks import Instance, MaskSettings, find_instances
from roadsight.poles.images.views import VIEWS, View, usable, views_of
from roadsight.stages.command import run_stage
from roadsight.stages.progress import logged

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


def trace_pole_axes(arguments: argparse.Namespace) -> None:
    """Write a row for each pole that is large and slender enough, by image and view."""
    settings = MaskSettings(**{f.name: getattr(arguments, f.name) for f in fields(MaskSettings)})
    frames = usable(read_table(arguments.frames), arguments.shard, arguments.shards)
    masks = ImageShard(arguments.masks)
    views = [view for view in views_of(frames, tuple(arguments.views)) if view.name in masks]
    rows = []
    for view in logged(views, len(views), log, "images"):
        mask = masks.read(view.name)
        found = find_instances(mask, _KIND, settings)
        rows += [_row(view, one, mask.shape) for one in found if not one.reason]
    names = {name: pd.Series([row[name] for row in rows], dtype=str) for name in TEXTS}
    numbers = {name: np.array([row[name] for row in rows], np.float64) for name in NUMBERS}
    flags = {
        name: np.array([row[name] for row in rows], bool) for name in ("foot_visible", "top_cut")
    }
    table = pd.DataFrame(names | numbers | flags)
    log.info("%d views, %d pole axes", len(views), len(table))
    write_table(arguments.out, table, {"settings": asdict(settings)})


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


def main(argv: list[str] | None = None) -> int:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    for name in ("frames", "masks", "out"):
        parser.add_argument(f"--{name}", required=True)
    parser.add_argument("--views", nargs="+", choices=VIEWS, default=list(VIEWS))
    parser.add_argument("--shard", type=int, default=0)
    parser.add_argument("--shards", type=int, default=1)
    for field in fields(MaskSettings):
        parser.add_argument(f"--{field.name.replace('_', '-')}", type=float, default=field.default)
    return run_stage(parser, trace_pole_axes, argv)


if __name__ == "__main__":
    sys.exit(main())
