"""What a crew takes along: one row for each sensor of each plan."""

from __future__ import annotations

import argparse
import logging
import sys

import pandas as pd

from roadsight.geometry.frames import Frame
from roadsight.io.records.atomic import atomic_path, read_json
from roadsight.io.vector.vectors import read_layer
from roadsight.report.handover.stakeout import stakeout
from roadsight.stages.command import run_stage

log = logging.getLogger("write_stakeout")


def write_stakeout(arguments: argparse.Namespace) -> None:
    """Write the table."""
    frame = Frame.from_dict(read_json(arguments.frame))
    edges = read_layer(arguments.edges, "edges", frame)
    solutions = [read_json(path) for path in arguments.solutions]
    table = pd.concat(
        [stakeout(found["plan"], found["sensors"], edges, frame) for found in solutions],
        ignore_index=True,
    )
    with atomic_path(arguments.out) as temporary:
        table.to_csv(temporary, index=False)
    log.info("%d sensors of %d plans", len(table), len(solutions))


def main(argv: list[str] | None = None) -> int:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    for name in ("frame", "edges", "out"):
        parser.add_argument(f"--{name}", required=True)
    parser.add_argument("--solutions", nargs="+", required=True, help="solution.json of each plan")
    return run_stage(parser, write_stakeout, argv)


if __name__ == "__main__":
    sys.exit(main())
