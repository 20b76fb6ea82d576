"""Table and page of both studies: published, ours as published, ours by default."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import pandas as pd

from roadsight import __version__
from roadsight.evidence import paper
from roadsight.io.records.atomic import read_json, write_text
from roadsight.report.files import read_assets
from roadsight.report.paper_page import ASSETS, render_paper
from roadsight.stages.command import Command


def write_paper(
    size: paper.Size,
    runs: Annotated[Sequence[Path], "what measure_paper wrote, named by run"],
    *,
    csv: Path,
    page: Path,
) -> None:
    """Write the CSV file and the page."""
    measured = {path.stem: read_json(path) for path in runs}
    rows = paper.rows(measured)
    table = pd.DataFrame(rows, columns=list(paper.COLUMNS))
    html = render_paper(rows, measured, size, read_assets(ASSETS), __version__)
    for path, text in ((csv, table.to_csv(index=False)), (page, html)):
        write_text(path, text)


main = Command(write_paper)


if __name__ == "__main__":
    sys.exit(main())
