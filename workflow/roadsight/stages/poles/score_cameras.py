"""Camera poses against known ones, where a site has them."""

from __future__ import annotations

import logging
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import pandas as pd

from roadsight.base.doubts import tell_named
from roadsight.evidence.scores import camera_errors, camera_scores
from roadsight.geometry.frames import Frame
from roadsight.io.images.camera_tables import read_cameras
from roadsight.io.records.atomic import read_json, write_json
from roadsight.io.records.tables import read_table, write_table
from roadsight.stages.command import Command

log = logging.getLogger("score_cameras")


def score_cameras(
    cameras_paths: Annotated[Sequence[Path], "all shards"],
    truth_path: str,
    frame_path: Path,
    road_edges: Path,
    intrinsics: Annotated[Path | None, "CSV, where the truth has no focal length"] = None,
    *,
    errors_path: Path,
    out: Path,
) -> None:
    """Write the errors of each camera and their summary."""
    frame = Frame.from_dict(read_json(frame_path))
    cameras = pd.concat([read_table(path) for path in cameras_paths], ignore_index=True)
    truth = read_cameras(truth_path, frame, intrinsics)
    told = "known cameras are of an image that is used"
    tell_named(log, told, set(truth["image"]), set(cameras["image"]), truth_path)
    edges = read_table(road_edges, ["x", "y", "z", "tangent_x", "tangent_y"]).to_numpy()
    errors = camera_errors(
        cameras.sort_values("image", ignore_index=True), truth, edges[:, :3], edges[:, 3:]
    )
    scores = camera_scores(errors, len(cameras))
    log.info("%s", {name: value for name, value in scores.items() if name != "errors"})
    write_table(errors_path, errors)
    write_json(out, scores)


main = Command(score_cameras)


if __name__ == "__main__":
    sys.exit(main())
