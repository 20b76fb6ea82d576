"""One self-contained HTML report of all sites."""

from __future__ import annotations

import logging
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

from plotly.offline import get_plotlyjs

from roadsight import __version__
from roadsight.io.records.atomic import read_json, write_text
from roadsight.io.records.run_records import RunRecord
from roadsight.report.document import render_report, result_files
from roadsight.report.files import ASSETS, read_assets
from roadsight.stages.command import Command

log = logging.getLogger("write_report")


def write_report(
    pages_paths: Annotated[Sequence[Path], "page.json of each site"] = (),
    poles_pages: Annotated[Sequence[Path], "poles/page.json of each site with poles"] = (),
    runs: Annotated[Sequence[Path], "run.json of each site"] = (),
    evidence: Annotated[Sequence[str], "title=path of further pages, from the report"] = (),
    *,
    out: Annotated[Path, "HTML file to write"],
) -> None:
    """Render the sites' pages into one file."""
    assets = read_assets(ASSETS)
    pages = [read_json(path) for path in pages_paths]
    poles = [read_json(path) for path in poles_pages]
    sites = dict.fromkeys(page["summary"]["site"] for page in (*pages, *poles))
    results = out.parent
    further = dict(entry.split("=", 1) for entry in evidence)
    made = {found["site"]: RunRecord.from_dict(found) for found in map(read_json, runs)}
    files = {site: result_files(results, site) for site in sites}
    html = render_report(pages, poles, assets, get_plotlyjs(), __version__, further, made, files)
    write_text(out, html)
    log.info("%d sites, %.1f MB", len(sites), len(html) / 1e6)


main = Command(write_report)


if __name__ == "__main__":
    sys.exit(main())
