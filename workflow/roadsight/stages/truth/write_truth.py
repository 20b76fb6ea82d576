"""Table and page of the product on real data beside peers: ``results/truth/truth.csv``."""

from __future__ import annotations

import logging
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import pandas as pd

from roadsight import __version__
from roadsight.evidence.truth_catalogue import AREAS, Figure, truth_rows
from roadsight.io.records.atomic import atomic_path, read_json, write_text
from roadsight.report.files import read_assets
from roadsight.report.truth_page import ASSETS, render_truth
from roadsight.stages.command import Command

log = logging.getLogger("write_truth")


def write_truth(
    figures: Annotated[Sequence[Path], "JSON files, area/dataset.json"],
    *,
    csv: Annotated[Path, "CSV file to write"],
    page_path: Annotated[Path, "HTML file to write"],
) -> None:
    """Gather the figures of all data sets; write the table and the page."""
    measured: dict[str, dict[str, list[Figure]]] = {area: {} for area in AREAS}
    for path in figures:
        content = read_json(path)
        if content["missing"]:
            log.warning("%s: no such file: %s", path.stem, ", ".join(content["missing"]))
            continue
        measured[path.parent.name][path.stem] = [Figure(**row) for row in content["figures"]]
    parts = [truth_rows(name, area, measured[name]) for name, area in AREAS.items()]
    table = pd.concat([part.astype(object) for part in parts], ignore_index=True)
    with atomic_path(csv) as temporary:
        table.to_csv(temporary, index=False, float_format="%.5g")
    page = render_truth(table, read_assets(ASSETS), __version__)
    write_text(page_path, page)


main = Command(write_truth)


if __name__ == "__main__":
    sys.exit(main())
