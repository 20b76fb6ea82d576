"""Camera poses against known ones, where a site has them."""

from __future__ import annotations

import argparse
import logging
import sys

import pandas as pd

from roadsight.base.matches import tell_named
from roadsight.evidence.camera_scores import camera_errors, camera_scores
from roadsight.geometry.frames import Frame
from roadsight.io.images.camera_tables import read_cameras
from roadsight.io.records.atomic import read_json, write_json
from roadsight.io.records.tables import read_table, write_table
from roadsight.stages.command import run_stage

log = logging.getLogger("score_cameras")


def score_cameras(arguments: argparse.Namespace) -> None:
    """Write the errors of each camera and their summary."""
    frame = Frame.from_dict(read_json(arguments.frame))
    cameras = pd.concat([read_table(path) for path in arguments.cameras], ignore_index=True)
    truth = read_cameras(arguments.truth, frame, arguments.intrinsics)
    told = "known cameras are of an image that is used"
    tell_named(log, told, set(truth["image"]), set(cameras["image"]), arguments.truth)
    edges = read_table(arguments.road_edges, ["x", "y", "z", "tangent_x", "tangent_y"]).to_numpy()
    errors = camera_errors(
        cameras.sort_values("image", ignore_index=True), truth, edges[:, :3], edges[:, 3:]
    )
    scores = camera_scores(errors, len(cameras))
    log.info("%s", {name: value for name, value in scores.items() if name != "errors"})
    write_table(arguments.errors, errors)
    write_json(arguments.out, scores)


def main(argv: list[str] | None = None) -> int:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cameras", nargs="+", required=True, help="all shards")
    for name in ("truth", "frame", "road-edges", "errors", "out"):
        parser.add_argument(f"--{name}", required=True)
    parser.add_argument("--intrinsics", nargs="?", help="CSV, where the truth has no focal length")
    return run_stage(parser, score_cameras, argv)


if __name__ == "__main__":
    sys.exit(main())
