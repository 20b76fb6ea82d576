"""Audit of a site's placement effects: its answer with and without each of them."""

from __future__ import annotations

import argparse
import json
import logging
import shutil
import sys
from collections.abc import Sequence
from pathlib import Path

from roadsight.effects.catalogue import load_catalogue
from roadsight.evidence.effects_audit import audited, read_answer
from roadsight.evidence.variants import Variant
from roadsight.io.records.atomic import read_json, write_json
from roadsight.stages.command import run_stage

log = logging.getLogger("audit_effects")


def audit_effects(arguments: argparse.Namespace) -> None:
    """Run the other decision on each effect and write what it changes."""
    site, plan = arguments.site, arguments.plan
    catalogue, config = load_catalogue(arguments.catalogue), json.loads(arguments.config)
    planned = read_answer(Path(), site, plan)
    rows = []
    for decision in read_json(arguments.effects):
        effect = decision["effect"]
        if decision["job"] != "placement":
            continue
        simulated = decision["decision"] == "simulate"
        change = {"effects": {effect: "skip" if simulated else "simulate"}}
        variant = Variant.prepare(".", arguments.work, config, site, change)
        ran = variant.run([f"placement/{plan}/solution.json"])
        other = read_answer(variant.folder, site, plan, effect if simulated else "")
        pair = (planned, other) if simulated else (other, planned)
        rows.append(audited(site, decision, catalogue[effect].tolerance, *pair))
        log.info("%s changes %.4f, ran %s", effect, rows[-1]["change"], sorted(ran))
        shutil.rmtree(variant.folder)
    write_json(arguments.out, rows)


def main(argv: Sequence[str] | None = None) -> int:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    for name in ("site", "plan", "effects", "catalogue", "config", "work", "out"):
        parser.add_argument(f"--{name}", required=True)
    return run_stage(parser, audit_effects, argv)


if __name__ == "__main__":
    sys.exit(main())
