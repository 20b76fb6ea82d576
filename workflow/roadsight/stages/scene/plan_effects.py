"""Which effects a site simulates, and why: ``results/<site>/effects.json``."""

from __future__ import annotations

import json
import logging
import sys
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

from roadsight.effects.catalogue import load_catalogue, plan
from roadsight.effects.quantities import Circumstances
from roadsight.io.records.atomic import read_json, write_json
from roadsight.placement.sensors.sensors import define_sensor
from roadsight.stages.command import Command

log = logging.getLogger("plan_effects")


def plan_effects(
    profile: Path,
    frame: Path,
    catalogue: Path,
    circumstances: str,
    drive: Annotated[Path | None, "profile of the drives, where poles are asked"] = None,
    *,
    out: Path,
) -> None:
    """Write the decisions."""
    asked = json.loads(circumstances)
    decisions = plan(
        load_catalogue(catalogue),
        asked["modes"],
        asked["jobs"],
        Circumstances(
            read_json(profile),
            read_json(frame),
            asked["settings"],
            {name: define_sensor(about, name) for name, about in asked["sensors"].items()},
            asked["given"],
            read_json(drive) if drive else {},
        ),
    )
    for decision in decisions:
        log.info("%s: %s, %s", decision.effect, decision.decision, decision.reason)
    write_json(out, [asdict(decision) for decision in decisions])


main = Command(plan_effects)


if __name__ == "__main__":
    sys.exit(main())
