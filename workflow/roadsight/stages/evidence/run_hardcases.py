"""The catalogue of hard cases: both ways run, errors against bounds, a table and a page."""

from __future__ import annotations

import logging
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import pandas as pd

from roadsight import __version__
from roadsight.base.sections.run import Run
from roadsight.io.records.atomic import write_text
from roadsight.io.records.text_tables import write_csv
from roadsight.report.files import read_assets
from roadsight.report.hardcases_page import ASSETS, render_hardcases
from roadsight.stages.command import Command, logged
from roadsight_hardcases.case import CaseResult, measure
from roadsight_hardcases.catalogue import all_cases

log = logging.getLogger("run_hardcases")


def run_hardcases(
    seed: Annotated[int, Run],
    *,
    table: Annotated[Path, "CSV file to write"],
    page: Annotated[Path, "HTML file to write"],
) -> None:
    """Measure every case; write the table and the page."""
    cases = all_cases()
    results = [measure(case, seed) for case in logged(cases, len(cases), log, "cases")]
    for result in results:
        if not result.passed:
            log.warning(
                "%s%s: naive %g, ours %g, bound %g %s",
                result.case.name,
                " (known)" if result.case.known else "",
                result.naive_error,
                result.our_error,
                result.case.bound,
                result.case.unit,
            )
    write_csv(table, case_table(results))
    assets = read_assets(ASSETS)
    write_text(page, render_hardcases(results, assets, __version__))
    log.info("%d of %d cases hold", sum(result.passed for result in results), len(results))
    if news := [r.case.name for r in results if r.passed == bool(r.case.known)]:
        log.error("differ from what the catalogue says of them: %s", ", ".join(news))


def case_table(results: Sequence[CaseResult]) -> pd.DataFrame:
    """Rows as written: one a case, errors to four digits, and why one that fails is known to."""
    return pd.DataFrame(
        {
            "case": [result.case.name for result in results],
            "stage": [result.case.stage for result in results],
            "hazard": [result.case.hazard for result in results],
            "naive_error": [f"{result.naive_error:.4g}" for result in results],
            "our_error": [f"{result.our_error:.4g}" for result in results],
            "bound": [f"{result.case.bound:.4g}" for result in results],
            "unit": [result.case.unit for result in results],
            "passed": ["true" if result.passed else "false" for result in results],
            "known": [result.case.known for result in results],
        }
    )


main = Command(run_hardcases)


if __name__ == "__main__":
    sys.exit(main())
