"""Road edges in the masks of a shard's front images: lane markings and road borders."""

from __future__ import annotations

import logging
import sys
from collections import Counter
from pathlib import Path

import numpy as np
import pandas as pd

from roadsight.base.sections.poles import EdgeTracing
from roadsight.base.shards import WHOLE, Shard
from roadsight.io.images.image_shards import ImageShard
from roadsight.io.records.tables import read_table, write_table
from roadsight.poles.images.image_edges import BORDER, LANE, TracedEdges, trace_edges
from roadsight.poles.images.views import usable, views_of
from roadsight.stages.command import Command, logged

log = logging.getLogger("trace_image_edges")


def trace_image_edges(
    frames_path: Path, masks_path: Path, settings: EdgeTracing, shard: Shard = WHOLE, *, out: Path
) -> None:
    """Write a row for each edge point, by image."""
    frames = usable(read_table(frames_path), shard)
    masks = ImageShard(masks_path)
    views = list(views_of(frames, ("front",)))
    tables, reasons = [], {}
    for view in logged(views, len(views), log, "images"):
        if view.name not in masks:
            reasons[view.image] = "no label image"
            continue
        edges = trace_edges(masks.read(view.name), settings)
        tables.append(_table(view.image, edges))
        if edges.reason:
            reasons[view.image] = edges.reason
    for reason, count in sorted(Counter(reasons.values()).items()):
        log.warning("%d of %d images: %s", count, len(views), reason)
    empty = TracedEdges(np.empty((0, 2), np.float32), np.empty(0, np.int8), np.empty(0, bool))
    table = pd.concat([_table("", empty), *tables], ignore_index=True)
    log.info("%d images, %d edge points", len(views), len(table))
    write_table(out, table, {"settings": settings.model_dump(), "without_edges": reasons})


def _table(image: str, edges: TracedEdges) -> pd.DataFrame:
    count = len(edges.uv_px)
    return pd.DataFrame(
        {
            "image": pd.Series([image] * count, dtype=str),
            "u": edges.uv_px[:, 0],
            "v": edges.uv_px[:, 1],
            "side": edges.side,
            "kind": pd.Series(np.where(edges.is_lane, LANE, BORDER), dtype=str),
        }
    )


main = Command(trace_image_edges)


if __name__ == "__main__":
    sys.exit(main())
