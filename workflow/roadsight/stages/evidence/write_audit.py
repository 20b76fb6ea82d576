"""Table and page of the audit of decisions on effects."""

from __future__ import annotations

import argparse
import logging
import sys
from collections.abc import Sequence

import pandas as pd

from roadsight import __version__
from roadsight.evidence.effects_audit import COLUMNS, never_mattering
from roadsight.io.records.atomic import atomic_path, read_json
from roadsight.report.evidence.audit_page import STYLES, TEMPLATE, plain_table, render_page
from roadsight.report.files import read_assets
from roadsight.stages.command import run_stage

log = logging.getLogger("write_audit")


def write_audit(arguments: argparse.Namespace) -> None:
    """Write the CSV file, the plain table and the page."""
    rows = [row for path in arguments.rows for row in read_json(path)]
    for row in rows:
        if not row["right"]:
            log.warning("%s: to skip %s changes the answer", row["site"], row["effect"])
    for effect in never_mattering(rows):
        log.warning("%s matters at none of the sites", effect)
    assets = read_assets((TEMPLATE, *STYLES))
    _write(arguments.csv, pd.DataFrame(rows, columns=list(COLUMNS)).to_csv(index=False))
    _write(arguments.table, plain_table(rows))
    _write(arguments.page, render_page(rows, assets, __version__))


def _write(path: str, text: str) -> None:
    with atomic_path(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def main(argv: Sequence[str] | None = None) -> int:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rows", nargs="*", default=[], help="one file a site")
    for name in ("csv", "table", "page"):
        parser.add_argument(f"--{name}", required=True)
    return run_stage(parser, write_audit, argv)


if __name__ == "__main__":
    sys.exit(main())
