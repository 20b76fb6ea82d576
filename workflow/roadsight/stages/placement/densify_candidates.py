"""Denser candidates near targets that no candidate sees (paper 1, section 2.5)."""

from __future__ import annotations

import argparse
import logging
import sys

import numpy as np
import pandas as pd

from roadsight.geometry.frames import Frame
from roadsight.io.records.atomic import read_json
from roadsight.io.records.tables import read_table, write_table
from roadsight.placement.candidates.positions import near_gaps, positions_along
from roadsight.stages.command import run_stage
from roadsight.stages.placement.place_candidates import (
    COLUMNS,
    add_candidate_arguments,
    allowed_positions,
    candidates_at,
    read_road,
)

log = logging.getLogger("densify_candidates")


def densify_candidates(arguments: argparse.Namespace) -> None:
    """Write the new candidates of a round: half the spacing of the round before, near gaps only."""
    frame = Frame.from_dict(read_json(arguments.frame))
    known = pd.concat([read_table(path) for path in arguments.candidates], ignore_index=True)
    coverage = read_json(arguments.coverage)
    gaps = {target for plan in coverage["plans"].values() for target in plan["uncovered"]}
    targets = read_table(arguments.targets)
    gaps_xy = targets.loc[targets["target"].isin(gaps), ["x", "y"]].to_numpy(np.float64)
    denser = known.iloc[:0]
    if len(gaps_xy):
        finer = 2**arguments.round
        edges, pavement = read_road(arguments, frame)
        positions = positions_along(edges, pavement, arguments.spacing_m / finer)
        positions = allowed_positions(positions, pavement, arguments, frame)
        positions = positions[near_gaps(positions, gaps_xy, arguments.radius_m)]
        if len(positions):
            step_m = arguments.height_step_m / finer
            positions = positions.reset_index(drop=True)
            denser = candidates_at(positions, arguments, frame, step_m, pavement)
            denser = denser[~denser["candidate"].isin(known["candidate"])]
    log.info("%d uncovered targets, %d new candidates", len(gaps_xy), len(denser))
    write_table(arguments.out, denser[COLUMNS].astype(known[COLUMNS].dtypes).reset_index(drop=True))


def main(argv: list[str] | None = None) -> int:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    add_candidate_arguments(parser)
    parser.add_argument("--round", type=int, required=True)
    parser.add_argument("--coverage", required=True, help="coverage of the round before")
    parser.add_argument("--targets", required=True)
    parser.add_argument("--candidates", nargs="+", required=True, help="of all rounds before")
    parser.add_argument("--radius-m", type=float, default=30.0)
    return run_stage(parser, densify_candidates, argv)


if __name__ == "__main__":
    sys.exit(main())
