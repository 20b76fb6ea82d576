"""What a run has told: decisions on effects, frontiers of accuracy and time, pages to open."""

from __future__ import annotations

from pathlib import Path
from typing import Any, cast

import pandas as pd

from roadsight.base.errors import InputError
from roadsight.io.records.atomic import read_json
from roadsight.report.evidence.tradeoffs_page import measure_views
from roadsight.studio.project import SiteFolder

# Pages of the workflow by their path under results
PAGES = {
    "report.html": "Report",
    "tradeoffs/index.html": "Accuracy and time",
    "hardcases/index.html": "Hard cases",
    "audit/index.html": "Effects audited",
    "bench/index.html": "Benchmarks",
}

_EFFECT_FIELDS = {"effect", "job", "decision", "quantity", "value", "unit", "threshold", "reason"}


def effects_of(site: SiteFolder) -> dict[str, Any]:
    """Decisions on effects; none before they were made.

    Raises
    ------
    InputError : the file is damaged.
    """
    path = site.results / "effects.json"
    if not path.exists():
        return {"effects": []}
    content = read_json(path)
    if not isinstance(content, list) or not all(
        isinstance(row, dict) and row.keys() >= _EFFECT_FIELDS for row in content
    ):
        raise InputError("is damaged", where=str(path), hint="delete it and run the workflow")
    return {"effects": content}


def frontiers(results: Path) -> dict[str, Any]:
    """Chart (SVG), verdict and rows of each measure of each knob that was swept.

    Raises
    ------
    InputError : the table is damaged.
    """
    path = results / "tradeoffs/tradeoffs.csv"
    if not path.exists():
        return {"studies": []}
    try:
        table = pd.read_csv(path)
        groups = table.groupby(["job", "knob"], sort=False)
        studies = [
            {"job": job, "knob": knob, "views": measure_views(cast(Any, part.to_dict("records")))}
            for (job, knob), part in groups
        ]
    except (ValueError, KeyError, TypeError) as error:
        raise InputError(
            "is damaged", where=str(path), hint="delete it and run: snakemake tradeoffs"
        ) from error
    return {"studies": studies}


def pages(results: Path, address: str) -> list[dict[str, str]]:
    """Pages that are there, with the addresses under which the studio shows them."""
    return [
        {"title": title, "url": f"{address}/{path}"}
        for path, title in PAGES.items()
        if (results / path).is_file()
    ]
