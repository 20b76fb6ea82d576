"""One self-contained HTML report of all sites."""

from __future__ import annotations

import argparse
import logging
import sys
from pathlib import Path

from plotly.offline import get_plotlyjs

from roadsight import __version__
from roadsight.io.records.atomic import atomic_path, read_json
from roadsight.io.records.run_records import run_record
from roadsight.report.document import render_report
from roadsight.report.files import ASSETS, read_assets
from roadsight.report.result_files import result_files
from roadsight.stages.command import run_stage

log = logging.getLogger("write_report")


def write_report(arguments: argparse.Namespace) -> None:
    """Render the sites' pages into one file."""
    assets = read_assets(ASSETS)
    pages = [read_json(path) for path in arguments.pages]
    poles = [read_json(path) for path in arguments.poles_pages]
    evidence = dict(entry.split("=", 1) for entry in arguments.evidence)
    sites = dict.fromkeys(page["summary"]["site"] for page in (*pages, *poles))
    results = Path(arguments.out).parent
    runs = {site: run_record([results / site / "benchmarks"], __version__) for site in sites}
    files = {site: result_files(results, site) for site in sites}
    html = render_report(pages, poles, assets, get_plotlyjs(), __version__, evidence, runs, files)
    with atomic_path(arguments.out) as temporary:
        temporary.write_text(html, encoding="utf-8")
    log.info("%d sites, %.1f MB", len(sites), len(html) / 1e6)


def main(argv: list[str] | None = None) -> int:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--pages", nargs="*", default=[], help="page.json of each site")
    parser.add_argument(
        "--poles-pages", nargs="*", default=[], help="poles/page.json of each site with poles"
    )
    parser.add_argument(
        "--evidence", nargs="*", default=[], help="title=path of further pages, from the report"
    )
    parser.add_argument("--out", required=True, help="HTML file to write")
    return run_stage(parser, write_report, argv)


if __name__ == "__main__":
    sys.exit(main())
