"""Denser candidates near targets that no candidate sees (paper 1, section 2.5)."""

from __future__ import annotations

import argparse
import logging
import sys

import numpy as np
import pandas as pd

from roadsight.base.arrays import Floats
from roadsight.base.options import add_settings
from roadsight.config.sections.placement import Coverage
from roadsight.geometry.frames import Frame
from roadsight.io.records.atomic import read_json
from roadsight.io.records.poses import FOR_SENSORS
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
    gaps = _gaps_by_sensor(arguments)
    every = np.concatenate([np.empty((0, 2)), *gaps.values()])
    denser = known.iloc[:0]
    if len(every):
        finer = 2**arguments.round
        edges, pavement = read_road(arguments, frame)
        positions = positions_along(edges, pavement, arguments.spacing_m / finer)
        positions = allowed_positions(positions, pavement, arguments, frame)
        positions = positions[near_gaps(positions, every, arguments.radius_m)]
        if len(positions):
            step_m = arguments.height_step_m / finer
            positions = positions.reset_index(drop=True)
            denser = candidates_at(positions, arguments, frame, step_m, pavement)
            denser = denser[~denser["candidate"].isin(known["candidate"])]
    denser = denser[COLUMNS].astype(known[COLUMNS].dtypes).reset_index(drop=True)
    near = {
        sensor: near_gaps(denser, gaps_xy, arguments.radius_m) for sensor, gaps_xy in gaps.items()
    }
    denser[FOR_SENSORS] = [
        " ".join(sensor for sensor, found in near.items() if found[row])
        for row in range(len(denser))
    ]
    denser[FOR_SENSORS] = denser[FOR_SENSORS].astype(str)
    counts = ", ".join(f"{sensor}: {found.sum()}" for sensor, found in near.items())
    log.info("%d new candidates (%s)", len(denser), counts or "no gap")
    write_table(arguments.out, denser)


def _gaps_by_sensor(arguments: argparse.Namespace) -> dict[str, Floats]:
    """Places (n, 2) of the targets that no plan's sensors see, for each sensor of such a plan.

    A sensor all of whose plans see everything has no gap, and gets no denser candidates.
    """
    coverage = read_json(arguments.coverage)["plans"]
    targets = read_table(arguments.targets)
    open_targets: dict[str, set[str]] = {}
    for entry in arguments.plans:
        plan, _, sensors = entry.partition("=")
        for sensor in sensors.split(","):
            open_targets.setdefault(sensor, set()).update(coverage[plan]["uncovered"])
    return {
        sensor: targets.loc[targets["target"].isin(names), ["x", "y"]].to_numpy(np.float64)
        for sensor, names in open_targets.items()
        if names
    }


def main(argv: list[str] | None = None) -> int:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    add_candidate_arguments(parser)
    parser.add_argument("--round", type=int, required=True)
    parser.add_argument("--coverage", required=True, help="coverage of the round before")
    parser.add_argument("--targets", required=True)
    parser.add_argument("--candidates", nargs="+", required=True, help="of all rounds before")
    parser.add_argument("--plans", nargs="+", required=True, help="plan=sensor,sensor")
    add_settings(parser, Coverage, "radius_m")
    return run_stage(parser, densify_candidates, argv)


if __name__ == "__main__":
    sys.exit(main())
