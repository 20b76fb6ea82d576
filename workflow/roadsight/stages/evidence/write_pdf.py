"""The report of one site on paper, as PDF."""

from __future__ import annotations

import argparse
import json
import logging
import sys
import tempfile
from importlib import resources
from pathlib import Path

import typst

from roadsight import __version__
from roadsight.io.records.atomic import atomic_path, read_json
from roadsight.io.records.run_records import run_record
from roadsight.report.paper.content import paper_content
from roadsight.stages.command import run_stage

log = logging.getLogger("write_pdf")

_TEMPLATE = "report.typ"


def write_pdf(arguments: argparse.Namespace) -> None:
    """Typeset what the site's pages hold."""
    page = read_json(arguments.page) if arguments.page else None
    poles_page = read_json(arguments.poles_page) if arguments.poles_page else None
    run = run_record(arguments.benchmarks, __version__)
    content, pictures = paper_content(page, poles_page, run)
    template = resources.files("roadsight.report") / "assets" / "paper" / _TEMPLATE
    with tempfile.TemporaryDirectory() as folder, atomic_path(arguments.out) as temporary:
        for name, data in pictures.items():
            (Path(folder) / name).write_bytes(data)
        text = json.dumps(content, ensure_ascii=False, allow_nan=False)
        (Path(folder) / "content.json").write_text(text, encoding="utf-8")
        source = Path(folder) / _TEMPLATE
        source.write_text(template.read_text(encoding="utf-8"), encoding="utf-8")
        typst.compile(str(source), output=str(temporary), root=folder, format="pdf")
    size_mb = Path(arguments.out).stat().st_size / 1e6
    log.info("%d plans, %.1f MB", len(content["plans"]), size_mb)


def main(argv: list[str] | None = None) -> int:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--page", nargs="?", help="page.json of the site")
    parser.add_argument("--poles-page", nargs="?", help="poles/page.json of the site")
    parser.add_argument(
        "--benchmarks", nargs="*", default=[], help="folders with the times of the site's steps"
    )
    parser.add_argument("--out", required=True, help="PDF file to write")
    return run_stage(parser, write_pdf, argv)


if __name__ == "__main__":
    sys.exit(main())
