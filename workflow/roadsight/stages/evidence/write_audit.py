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
from roadsight.io.records.atomic import read_json, write_text
from roadsight.report.audit_page import STYLES, TEMPLATE, plain_table, render_page
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
    write_text(csv, pd.DataFrame(rows, columns=list(COLUMNS)).to_csv(index=False))
    write_text(table, plain_table(rows))
    write_text(page, render_page(rows, assets, __version__))


main = Command(write_audit)


if __name__ == "__main__":
    sys.exit(main())
