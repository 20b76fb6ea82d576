"""Each effect of the pole job with and without it, to see whether its decision was right."""

from __future__ import annotations

import argparse
import json
import logging
import shutil
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pandas as pd

from roadsight.effects.catalogue import load_catalogue
from roadsight.evidence.pole_audit import PoleAnswer, answer_change, kept_places
from roadsight.evidence.variants import Variant
from roadsight.io.atomic import read_json
from roadsight.io.sighting_tables import write_csv
from roadsight.io.tables import read_table
from roadsight.stages.command import run_stage

log = logging.getLogger("audit_pole_effects")
_TARGETS = ("poles/hazard.parquet",)
_OTHER = {"simulate": "skip", "skip": "simulate"}


def audit_pole_effects(arguments: argparse.Namespace) -> None:
    """Write a row for each effect: both answers, their difference, the time between them."""
    config = json.loads(arguments.config)
    catalogue = load_catalogue(config["effects_file"])
    base = Variant.prepare(".", f"{arguments.work}/base", config, arguments.site, {})
    base.run(_TARGETS, arguments.cores)
    decisions = {e["effect"]: e for e in read_json(base.result("effects.json"))}
    rows = []
    for name in arguments.effects:
        decision, tolerance = decisions[name], catalogue[name].tolerance
        changes = {"effects": {name: _OTHER[decision["decision"]]}}
        folder = f"{arguments.work}/{name}"
        other = Variant.prepare(".", folder, config, arguments.site, changes)
        other.run(_TARGETS, arguments.cores)
        rows.append(_row(decision, tolerance, base, other))
        log.info("%s", rows[-1])
        shutil.rmtree(other.folder)
    shutil.rmtree(base.folder)
    write_csv(arguments.out, pd.DataFrame(rows).assign(site=arguments.site))


def _row(
    decision: dict[str, Any], tolerance: float, base: Variant, other: Variant
) -> dict[str, Any]:
    simulated = decision["decision"] == "simulate"
    with_it, without = (base, other) if simulated else (other, base)
    answers = [_answer(variant) for variant in (with_it, without)]
    seconds = [sum(r.cpu_s for r in variant.records(_TARGETS)) for variant in (with_it, without)]
    change = answer_change(*answers)
    return {
        "effect": decision["effect"],
        "decision": decision["decision"],
        "quantity": decision["quantity"],
        "value": decision["value"],
        "unit": decision["unit"],
        "threshold": decision["threshold"],
        "poles_simulated": len(kept_places(answers[0].poles)),
        "poles_skipped": len(kept_places(answers[1].poles)),
        "change": change,
        "tolerance": tolerance,
        "cpu_s_simulated": seconds[0],
        "cpu_s_skipped": seconds[1],
        "right": simulated or change <= tolerance,
    }


def _answer(variant: Variant) -> PoleAnswer:
    sightings = sorted(Path(variant.result("poles/sightings")).glob("*.parquet"))
    return PoleAnswer(
        read_table(variant.result("poles/poles.parquet")),
        pd.concat([read_table(path) for path in sightings], ignore_index=True),
        read_table(variant.result("poles/hazard.parquet")),
    )


def main(argv: Sequence[str] | None = None) -> int:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--site", required=True)
    parser.add_argument("--config", required=True, help="whole configuration, JSON")
    parser.add_argument("--effects", nargs="+", required=True, help="names of effects")
    parser.add_argument("--cores", type=int, default=1)
    parser.add_argument("--work", required=True, help="folder to work in, deleted afterwards")
    parser.add_argument("--out", required=True, help="CSV to write")
    return run_stage(parser, audit_pole_effects, argv)


if __name__ == "__main__":
    sys.exit(main())
