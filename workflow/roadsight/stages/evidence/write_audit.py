"""Table and page of the audit of decisions on effects."""

from __future__ import annotations

import logging
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import pandas as pd

from roadsight import __version__
from roadsight.evidence.effects_audit import COLUMNS, never_mattering
from roadsight.io.records.atomic import atomic_path, read_json
from roadsight.report.evidence.audit_page import STYLES, TEMPLATE, plain_table, render_page
from roadsight.report.files import read_assets
from roadsight.stages.command import Command

log = logging.getLogger("write_audit")


def write_audit(
    rows_paths: Annotated[Sequence[Path], "one file a site"] = (),
    *,
    csv: Path,
    table: Path,
    page: Path,
) -> None:
    """Write the CSV file, the plain table and the page."""
    rows = [row for path in rows_paths for row in read_json(path)]
    for row in rows:
        if not row["right"]:
            log.warning("%s: to skip %s changes the answer", row["site"], row["effect"])
    for effect in never_mattering(rows):
        log.warning("%s matters at none of the sites", effect)
    assets = read_assets((TEMPLATE, *STYLES))
    _write(csv, pd.DataFrame(rows, columns=list(COLUMNS)).to_csv(index=False))
    _write(table, plain_table(rows))
    _write(page, render_page(rows, assets, __version__))


def _write(path: Path, text: str) -> None:
    with atomic_path(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


main = Command(write_audit)


if __name__ == "__main__":
    sys.exit(main())
