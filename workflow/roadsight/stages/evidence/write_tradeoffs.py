"""Table and page of what accuracy costs in time."""

from __future__ import annotations

import argparse
import logging
import sys
from pathlib import Path
from typing import Any

import pandas as pd

from roadsight import __version__
from roadsight.evidence.base_costs import with_base_costs
from roadsight.evidence.studies import Tradeoffs, load_tradeoffs
from roadsight.evidence.tradeoffs import COLUMNS, Cost, precision_rows, study_rows
from roadsight.io.records.atomic import atomic_path, read_json
from roadsight.report.evidence.tradeoffs_page import (
    STYLES,
    TEMPLATE,
    plain_table,
    render_page,
    stage_rows,
)
from roadsight.report.files import read_assets
from roadsight.stages.command import run_stage

log = logging.getLogger("write_tradeoffs")


def write_tradeoffs(arguments: argparse.Namespace) -> None:
    """Write the CSV file, the plain table and the page."""
    tradeoffs = load_tradeoffs(arguments.studies)
    base = {Path(path).stem: read_json(path) for path in arguments.base}
    levels = _levels(tradeoffs, arguments.levels, base)
    rows = [
        {"study": name, **row}
        for name, study in tradeoffs.studies.items()
        for row in study_rows(study, levels[name])
    ]
    measured = read_json(arguments.precision)
    rows += [{"study": "coordinates", **row} for row in precision_rows(measured)]
    for row in rows:
        if row["is_default"] and not row["on_frontier"]:
            log.warning("%s: the default is off the frontier of %s", row["knob"], row["metric"])
    stages = stage_rows(
        tradeoffs.published_stages, _pole_costs(tradeoffs, levels), arguments.length_km
    )
    assets = read_assets((TEMPLATE, *STYLES))
    _write(arguments.csv, pd.DataFrame(rows)[list(COLUMNS)].to_csv(index=False))
    _write(arguments.table, plain_table(rows))
    _write(arguments.page, render_page(tradeoffs.studies, rows, stages, assets, __version__))


def _levels(
    tradeoffs: Tradeoffs, files: list[str], base: dict[str, Any]
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


def _write(path: str, text: str) -> None:
    with atomic_path(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def main(argv: list[str] | None = None) -> int:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--studies", required=True, help="config/tradeoffs.yaml")
    parser.add_argument("--levels", nargs="+", required=True, help="in the order of the studies")
    parser.add_argument("--base", nargs="+", required=True, help="<job>.json of measure_base")
    parser.add_argument("--precision", required=True, help="what measure_precision wrote")
    parser.add_argument("--length-km", type=float, required=True, help="road of the pole site")
    for name in ("csv", "table", "page"):
        parser.add_argument(f"--{name}", required=True)
    return run_stage(parser, write_tradeoffs, argv)


if __name__ == "__main__":
    sys.exit(main())
