"""Points that each image of a shard's runs of images shares with the next one of its drive."""

from __future__ import annotations

import json
import logging
import sys
from collections.abc import Hashable, Mapping
from functools import lru_cache
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import pandas as pd

from roadsight.base.arrays import Floats
from roadsight.base.shards import WHOLE, Shard
from roadsight.io.images.videologs import ImageSource
from roadsight.io.records.atomic import read_json
from roadsight.io.records.tables import read_table, write_table
from roadsight.poles.drive.drive_lenses import lens_of, with_given
from roadsight.poles.images.image_matches import Features, consecutive, features, matched
from roadsight.stages.command import Command, logged

log = logging.getLogger("match_images")
_FRAME = ["image", "path", "route", "sequence", "status", "x", "y", "width_px", "height_px"]
"""Columns of the frames that are read."""
_TOGETHER = 16
"""Images in a row that one shard takes: with more, fewer images are looked at in two shards, but
shards differ more in size."""
COLUMNS = ("image", "other", "u", "v", "u_other", "v_other")


def match_images(
    frames: Path,
    images_path: str,
    drive: Annotated[Path | None, "profile whose lenses distort; none: pinholes"] = None,
    lenses_json: Annotated[str, "given lenses as JSON: route, k1, k2, focal_px"] = "[]",
    shard: Shard = WHOLE,
    *,
    out: Path,
) -> None:
    """Write the pixels that show the same, of each image of the shard and the next one."""
    pairs = list(consecutive(read_table(frames, _FRAME)))
    own = shard.dealt(_run(one) for one, _ in pairs)
    pairs = [(one, other) for one, other in pairs if _run(one) in own]
    images = ImageSource(images_path)
    lenses = None
    if drive:
        lenses = with_given(read_json(drive)["lenses"], json.loads(lenses_json))

    @lru_cache(maxsize=2)
    def found(path: str) -> Features:
        return features(images.read(path))

    tables = [pd.DataFrame({name: [] for name in COLUMNS})]
    for one, other in logged(pairs, len(pairs), log, "pairs"):
        first, second = found(one["path"]), found(other["path"])
        numbers = matched(first, second)
        here, there = first.uv_px[numbers[:, 0]], second.uv_px[numbers[:, 1]]
        if lenses is not None:
            here, there = _straight(here, one, lenses), _straight(there, other, lenses)
        known = np.isfinite(here).all(axis=1) & np.isfinite(there).all(axis=1)
        rows = pd.DataFrame(np.column_stack([here, there])[known], columns=list(COLUMNS[2:]))
        tables.append(rows.assign(image=one["image"], other=other["image"]))
    kinds = dict.fromkeys(COLUMNS[:2], str) | dict.fromkeys(COLUMNS[2:], np.float64)
    table = pd.concat(tables, ignore_index=True).astype(kinds)
    log.info("%d points shared by %d pairs", len(table), len(pairs))
    write_table(out, table)


def _run(row: Mapping[Hashable, Any]) -> str:
    """Key of a few images in a row: an image between two of them is looked at once."""
    return f"{row['route']}/{int(row['sequence']) // _TOGETHER}"


def _straight(uv_px: Floats, row: Mapping[Hashable, Any], lenses: list[dict[str, Any]]) -> Floats:
    """Pixels as a pinhole camera would have shown them."""
    size = int(row["width_px"]), int(row["height_px"])
    return lens_of(lenses, (str(row["route"]), *size), size[::-1]).undistort(uv_px)


main = Command(match_images)


if __name__ == "__main__":
    sys.exit(main())
