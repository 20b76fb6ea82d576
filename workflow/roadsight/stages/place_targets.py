"""Pole-like targets on the pavement."""

from __future__ import annotations

import argparse
import logging
import sys

from roadsight.io.tables import read_table, write_table
from roadsight.placement.targets import place_targets
from roadsight.stages.command import run_stage

log = logging.getLogger("place_targets")


def write_targets(arguments: argparse.Namespace) -> None:
    """Write the targets."""
    points = read_table(arguments.pavement, ["x", "y", "z"])
    targets = place_targets(points.to_numpy(), arguments.cell_size_m, arguments.min_points)
    log.info("%d targets on %d pavement points", len(targets), len(points))
    settings = {"cell_size_m": arguments.cell_size_m, "min_points": arguments.min_points}
    write_table(arguments.out, targets, settings)


def main(argv: list[str] | None = None) -> int:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--pavement", required=True, help="pavement points")
    parser.add_argument("--cell-size-m", type=float, default=1.0)
    parser.add_argument("--min-points", type=int, default=25)
    parser.add_argument("--out", required=True)
    return run_stage(parser, write_targets, argv)


if __name__ == "__main__":
    sys.exit(main())
