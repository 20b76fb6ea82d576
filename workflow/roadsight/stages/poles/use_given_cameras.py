"""Cameras that come with the videolog, taken as they are and checked against the road."""

from __future__ import annotations

import logging
import sys
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import pandas as pd

from roadsight.base.doubts import tell_named
from roadsight.base.shards import WHOLE, Shard
from roadsight.geometry.frames import Frame
from roadsight.io.images.camera_tables import read_cameras
from roadsight.io.records.atomic import read_json
from roadsight.io.records.tables import read_table, write_table
from roadsight.poles.alignment.given_cameras import GivenSigma, agreement, camera_row
from roadsight.stages.command import Command, logged
from roadsight.stages.poles.align_cameras import CAMERA_COLUMNS, camera_table
from roadsight.stages.poles.shared.alignment_inputs import SceneFiles, read_scene

log = logging.getLogger("use_given_cameras")
NOT_GIVEN = "no camera is given"


def use_given_cameras(
    files: SceneFiles,
    cameras: Annotated[str, "given cameras, CSV"],
    intrinsics: Annotated[str | None, "their lens, CSV, if not with them"] = None,
    sigma_heading_deg: float = GivenSigma.heading_deg,
    sigma_pitch_deg: float = GivenSigma.pitch_deg,
    sigma_place_m: float = GivenSigma.lateral_m,
    shard: Shard = WHOLE,
    *,
    out: Path,
) -> None:
    """Write one row for each usable image of the shard, and say how the road agrees."""
    scene = read_scene(files)
    frame = Frame.from_dict(read_json(files.frame))
    given = read_cameras(cameras, frame, intrinsics)
    images = read_table(files.frames, ["image"])["image"]
    told = "given cameras are of an image of the videolog"
    tell_named(log, told, set(given["image"]), set(images), cameras)
    poses = {str(row["image"]): row for _, row in given.iterrows()}
    sigma = GivenSigma(sigma_heading_deg, sigma_pitch_deg, sigma_place_m, sigma_place_m)
    dealt = shard.dealt(images)
    own = [p for p in scene.places if p.image in dealt]
    nothing: dict[str, Any] = dict.fromkeys(CAMERA_COLUMNS, np.nan) | {"reason": NOT_GIVEN}
    nothing |= dict.fromkeys(("edge_points", "landmarks", "one_sided", "accepted"), 0)
    rows, shares = [], []
    for place in logged(own, len(own), log, "images"):
        width_px, height_px = size = place.start.width_px, place.start.height_px
        row = nothing | {"width_px": width_px, "height_px": height_px}
        if place.image in poses:
            image_edges, map_edges = scene.edges_of(place)
            agrees = agreement(poses[place.image], size, image_edges, map_edges)
            row = camera_row(poses[place.image], size, sigma, agrees, len(image_edges.uv_px))
            shares.append(agrees[1])
        rows.append(row | {"image": place.image})
    table = camera_table(rows)
    about = {"method": "given", **_judged(np.array(shares, np.float64), table)}
    write_table(out, table, about)


def _judged(shares: np.ndarray, table: pd.DataFrame) -> dict[str, Any]:
    """How far given cameras and the road agree, over the images that show enough of it."""
    known = np.isfinite(shares)
    missing = int((table["reason"] == NOT_GIVEN).sum())
    if missing:
        log.warning("%d of %d images: %s", missing, len(table), NOT_GIVEN)
    if not known.any():
        log.warning("no image shows enough road to check the given cameras")
        return {"checked_images": 0, "agreeing_share": None}
    share = float(np.median(shares[known]))
    told = log.info if share >= 0.5 else log.warning
    told("%d images: %.0f %% of their road edges agree (median)", known.sum(), 100 * share)
    return {"checked_images": int(known.sum()), "agreeing_share": share}


main = Command(use_given_cameras)


if __name__ == "__main__":
    sys.exit(main())
