"""Audit of a site's placement effects: its answer with and without each of them."""

from __future__ import annotations

import json
import logging
import shutil
import sys
from pathlib import Path

from roadsight.effects.catalogue import load_catalogue
from roadsight.evidence.effects_audit import audited, read_answer
from roadsight.evidence.variants import Variant
from roadsight.io.records.atomic import read_json, write_json
from roadsight.stages.command import Command

log = logging.getLogger("audit_effects")


def audit_effects(
    site: str,
    plan: str,
    effects: Path,
    catalogue_path: Path,
    config_json: str,
    work: Path,
    *,
    out: Path,
) -> None:
    """Run the other decision on each effect and write what it changes."""
    catalogue, config = load_catalogue(catalogue_path), json.loads(config_json)
    planned = read_answer(Path(), site, plan)
    rows = []
    for decision in read_json(effects):
        effect = decision["effect"]
        if decision["job"] != "placement":
            continue
        simulated = decision["decision"] == "simulate"
        change = {"effects": {effect: "skip" if simulated else "simulate"}}
        variant = Variant.prepare(".", work, config, site, change)
        ran = variant.run([f"placement/{plan}/solution.json"])
        other = read_answer(variant.folder, site, plan, effect if simulated else "")
        pair = (planned, other) if simulated else (other, planned)
        rows.append(audited(site, decision, catalogue[effect].tolerance, *pair))
        log.info("%s changes %.4f, ran %s", effect, rows[-1]["change"], sorted(ran))
        shutil.rmtree(variant.folder)
    write_json(out, rows)


main = Command(audit_effects)


if __name__ == "__main__":
    sys.exit(main())
