"""Which targets no candidate of a plan sees."""

from __future__ import annotations

import argparse
import logging
import sys
from collections import defaultdict

import pandas as pd

from roadsight.base.errors import InputError
from roadsight.geometry.frames import Frame
from roadsight.io.records.atomic import read_json, write_json
from roadsight.io.records.detections import read_seen_targets
from roadsight.io.records.tables import read_table
from roadsight.stages.command import run_stage
from roadsight.stages.placement.shared.allowed import add_allowed_arguments, allowed_candidates

log = logging.getLogger("check_coverage")


def check_coverage(arguments: argparse.Namespace) -> None:
    """Write the uncovered targets of each plan."""
    targets = pd.Index(read_table(arguments.targets)["target"])
    if targets.empty:
        raise InputError(
            "no target: no pavement cell has enough points",
            where=arguments.targets,
            hint="lower targets.min_points or raise targets.cell_size_m",
        )
    candidates = pd.concat([read_table(path) for path in arguments.candidates], ignore_index=True)
    allowed = None
    if arguments.frame:
        frame = Frame.from_dict(read_json(arguments.frame))
        free, _, _ = allowed_candidates(arguments, candidates, frame)
        allowed = None if free.all() else set(candidates["candidate"][free].astype(str))
        log.info("%d of %d candidates may carry a sensor", free.sum(), len(free))
    seen: dict[str, set[str]] = defaultdict(set)
    for path in arguments.detections:
        sensor, names = read_seen_targets(path, allowed)
        seen[sensor] |= set(names)
    plans = {}
    for entry in arguments.plans:
        name, _, sensors = entry.partition("=")
        covered = set().union(*(seen[sensor] for sensor in sensors.split(",")))
        gaps = targets[~targets.isin(covered)]
        plans[name] = {
            "uncovered": list(gaps),
            "covered_share": 1 - len(gaps) / len(targets),
        }
        log.info("%s: %d of %d targets uncovered", name, len(gaps), len(targets))
    count = len(candidates) if allowed is None else len(allowed)
    content = {"targets": len(targets), "candidates": count, "plans": plans}
    write_json(arguments.out, content)


def main(argv: list[str] | None = None) -> int:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--targets", required=True)
    parser.add_argument("--candidates", nargs="+", required=True)
    parser.add_argument("--detections", nargs="+", required=True)
    parser.add_argument("--plans", nargs="+", required=True, help="plan=sensor,sensor")
    parser.add_argument("--frame", help="needed with zones and rules of mounting")
    add_allowed_arguments(parser)
    parser.add_argument("--out", required=True)
    return run_stage(parser, check_coverage, argv)


if __name__ == "__main__":
    sys.exit(main())
