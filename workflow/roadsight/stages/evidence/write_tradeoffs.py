"""Table and page of what accuracy costs in time."""

from __future__ import annotations

import logging
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import pandas as pd

from roadsight import __version__
from roadsight.evidence.costs import with_base_costs
from roadsight.evidence.studies import Tradeoffs, load_tradeoffs
from roadsight.evidence.tradeoffs import COLUMNS, Cost, precision_rows, study_rows
from roadsight.io.records.atomic import read_json, write_text
from roadsight.report.files import read_assets
from roadsight.report.tradeoffs_page import STYLES, TEMPLATE, plain_table, render_page, stage_rows
from roadsight.stages.command import Command

log = logging.getLogger("write_tradeoffs")


def write_tradeoffs(
    studies: Annotated[Path, "config/tradeoffs.yaml"],
    levels_paths: Annotated[Sequence[Path], "in the order of the studies"],
    base_paths: Annotated[Sequence[Path], "<job>.json of measure_base"],
    precision: Annotated[Path, "what measure_precision wrote"],
    length_km: Annotated[float, "road of the pole site"],
    *,
    csv: Path,
    table: Path,
    page: Path,
) -> None:
    """Write the CSV file, the plain table and the page."""
    tradeoffs = load_tradeoffs(studies)
    base = {path.stem: read_json(path) for path in base_paths}
    levels = _levels(tradeoffs, levels_paths, base)
    rows = [
        {"study": name, **row}
        for name, study in tradeoffs.studies.items()
        for row in study_rows(study, levels[name])
    ]
    measured = read_json(precision)
    rows += [{"study": "coordinates", **row} for row in precision_rows(measured)]
    for row in rows:
        if row["is_default"] and not row["on_frontier"]:
            log.warning("%s: the default is off the frontier of %s", row["knob"], row["metric"])
    stages = stage_rows(tradeoffs.published_stages, _pole_costs(tradeoffs, levels), length_km)
    assets = read_assets((TEMPLATE, *STYLES))
    write_text(csv, pd.DataFrame(rows)[list(COLUMNS)].to_csv(index=False))
    write_text(table, plain_table(rows))
    write_text(page, render_page(tradeoffs.studies, rows, stages, assets, __version__))


def _levels(
    tradeoffs: Tradeoffs, files: Sequence[Path], base: dict[str, Any]
) -> dict[str, dict[str, Any]]:
    """Content of the files by study and level, which come in this order."""
    left = iter(files)
    found: dict[str, dict[str, Any]] = {}
    for name, study in tradeoffs.studies.items():
        found[name] = {}
        for level in study.levels:
            content = read_json(next(left))
            shared = with_base_costs(content["stages"], base[study.job])
            found[name][level] = content | {"stages": shared}
    return found


def _pole_costs(tradeoffs: Tradeoffs, levels: dict[str, dict[str, Any]]) -> dict[str, Cost]:
    """Costs of the pole job's steps at the default settings, the cheapest timing of each."""
    found: dict[str, Cost] = {}
    for name, study in tradeoffs.studies.items():
        if study.job != "poles":
            continue
        for rule, values in levels[name][study.default]["stages"].items():
            cost = Cost(**values)
            if rule not in found or cost.cpu_s < found[rule].cpu_s:
                found[rule] = cost
    return found


main = Command(write_tradeoffs)


if __name__ == "__main__":
    sys.exit(main())
