"""Scores of the pavement against surveyed or generated truth."""

from __future__ import annotations

import argparse
import logging
import math
import sys

import numpy as np
import shapely

from roadsight.evidence.pavement_scores import pavement_scores
from roadsight.geometry.frames import Frame
from roadsight.io.cloud.tiles import CloudTiles, stack_xyz
from roadsight.io.records.atomic import read_json, write_json
from roadsight.io.records.tables import read_table
from roadsight.io.vector.site_bounds import tell_near
from roadsight.io.vector.vectors import read_layer, read_polygons
from roadsight.stages.command import run_stage

log = logging.getLogger(__name__)


def score_pavement(arguments: argparse.Namespace) -> None:
    """Write accuracy, recall, F1 and outline distances over all ground points."""
    frame = Frame.from_dict(read_json(arguments.frame))
    found = shapely.union_all(read_layer(arguments.pavement, "pavement", frame).geometry.to_numpy())
    polygons = (
        read_layer(arguments.truth, arguments.truth_layer, frame)
        if arguments.truth_layer
        else read_polygons(arguments.truth, frame, arguments.truth_crs or None)
    )
    about = read_json(arguments.frame)
    tell_near(log, "known polygons", polygons.geometry.to_numpy(), about, arguments.truth)
    true = shapely.union_all(polygons.geometry.to_numpy())
    xyz = stack_xyz(CloudTiles(arguments.cloud).read(("x", "y", "z")))
    ground = xyz[read_table(arguments.ground)["ground"].to_numpy()].astype(np.float64)
    write_json(arguments.out, pavement_scores(ground[:, :2], found, true, arguments.reach_m))


def main(argv: list[str] | None = None) -> int:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    for name in ("cloud", "frame", "ground", "pavement", "truth", "out"):
        parser.add_argument(f"--{name}", required=True)
    parser.add_argument("--truth-crs", nargs="?", help="CRS of the truth if its file names none")
    parser.add_argument("--truth-layer", nargs="?", help="layer of a generated truth file")
    parser.add_argument("--reach-m", type=float, default=math.inf, help="extent of the truth")
    return run_stage(parser, score_pavement, argv)


if __name__ == "__main__":
    sys.exit(main())
