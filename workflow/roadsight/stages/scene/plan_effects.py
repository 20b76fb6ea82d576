"""Which effects a site simulates, and why: ``results/<site>/effects.json``."""

from __future__ import annotations

import argparse
import json
import logging
import sys
from collections.abc import Sequence
from dataclasses import asdict

from roadsight.effects.catalogue import load_catalogue
from roadsight.effects.circumstances import Circumstances
from roadsight.effects.planner import plan
from roadsight.io.records.atomic import read_json, write_json
from roadsight.placement.sensors.sensors import define_sensor
from roadsight.stages.command import run_stage

log = logging.getLogger("plan_effects")


def plan_effects(arguments: argparse.Namespace) -> None:
    """Write the decisions."""
    asked = json.loads(arguments.circumstances)
    decisions = plan(
        load_catalogue(arguments.catalogue),
        asked["modes"],
        asked["jobs"],
        Circumstances(
            read_json(arguments.profile),
            read_json(arguments.frame),
            asked["settings"],
            {name: define_sensor(about, name) for name, about in asked["sensors"].items()},
            asked["given"],
            read_json(arguments.drive) if arguments.drive else {},
        ),
    )
    for decision in decisions:
        log.info("%s: %s, %s", decision.effect, decision.decision, decision.reason)
    write_json(arguments.out, [asdict(decision) for decision in decisions])


def main(argv: Sequence[str] | None = None) -> int:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    for name in ("profile", "frame", "catalogue", "circumstances", "out"):
        parser.add_argument(f"--{name}", required=True)
    parser.add_argument("--drive", nargs="?", help="profile of the drives, where poles are asked")
    return run_stage(parser, plan_effects, argv)


if __name__ == "__main__":
    sys.exit(main())
