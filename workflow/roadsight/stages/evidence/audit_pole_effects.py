"""Audit of a site's pole effects: its answer with and without each of them."""

from __future__ import annotations

import json
import logging
import shutil
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import pandas as pd

from roadsight.effects.catalogue import load_catalogue
from roadsight.evidence.effects_audit import PoleAnswer, answer_change, row_of
from roadsight.evidence.variants import Variant
from roadsight.io.records.atomic import read_json, write_json
from roadsight.io.records.tables import read_table
from roadsight.stages.command import Command

log = logging.getLogger("audit_pole_effects")
_TARGETS = ("poles/hazard.parquet",)


def audit_pole_effects(
    site: str,
    effects: Path,
    catalogue_path: Path,
    config_json: str,
    work: Path,
    leave_out: Annotated[Sequence[str], "effects that have one way only"] = (),
    *,
    out: Path,
) -> None:
    """Run the other decision on each effect and write what it changes."""
    catalogue, config = load_catalogue(catalogue_path), json.loads(config_json)
    planned, _ = _answered(config, work, site, {})
    rows = []
    for decision in read_json(effects):
        effect = decision["effect"]
        if decision["job"] != "poles" or effect in leave_out:
            continue
        simulated = decision["decision"] == "simulate"
        changes = {"effects": {effect: "skip" if simulated else "simulate"}}
        other, ran = _answered(config, work, site, changes)
        pair = (planned, other) if simulated else (other, planned)
        rows.append(_row(site, decision, catalogue[effect].tolerance, *pair))
        log.info("%s changes %.4f, ran %s", effect, rows[-1]["change"], sorted(ran))
    write_json(out, rows)


def _answered(
    config: dict[str, Any], work: Path, site: str, changes: dict[str, Any]
) -> tuple[PoleAnswer, dict[str, int]]:
    """The answer under changed settings, and the jobs that ran for it."""
    variant = Variant.prepare(".", work, config, site, changes)
    ran = variant.run(_TARGETS)
    shards = sorted(variant.result("poles/sightings").glob("*.parquet"))
    answer = PoleAnswer(
        read_table(variant.result("poles/poles.parquet")),
        pd.concat([read_table(path) for path in shards], ignore_index=True),
        read_table(variant.result(_TARGETS[0])),
        sum(record.cpu_s for record in variant.records(_TARGETS)),
    )
    shutil.rmtree(variant.folder)
    return answer, ran


def _row(
    site: str,
    decision: dict[str, Any],
    tolerance: float,
    simulated: PoleAnswer,
    skipped: PoleAnswer,
) -> dict[str, Any]:
    numbers = {
        "found_with": simulated.found,
        "found_without": skipped.found,
        "seen_with": simulated.seen,
        "seen_without": skipped.seen,
        "change": answer_change(simulated, skipped),
        "cpu_seconds": max(simulated.cpu_s - skipped.cpu_s, 0.0),
    }
    return row_of(site, decision, tolerance, numbers)


main = Command(audit_pole_effects)


if __name__ == "__main__":
    sys.exit(main())
