"""The report of one site on paper, as PDF."""

from __future__ import annotations

import json
import logging
import sys
import tempfile
from importlib import resources
from pathlib import Path
from typing import Annotated

import typst

from roadsight.io.records.atomic import atomic_path, read_json
from roadsight.io.records.run_records import RunRecord
from roadsight.report.printed import paper_content
from roadsight.stages.command import Command

log = logging.getLogger("write_pdf")

_TEMPLATE = "report.typ"


def write_pdf(
    page_path: Annotated[Path | None, "page.json of the site"] = None,
    poles_page_path: Annotated[Path | None, "poles/page.json of the site"] = None,
    run: Annotated[Path | None, "run.json of the site"] = None,
    *,
    out: Annotated[Path, "PDF file to write"],
) -> None:
    """Typeset what the site's pages hold."""
    page = read_json(page_path) if page_path else None
    poles_page = read_json(poles_page_path) if poles_page_path else None
    made = RunRecord.from_dict(read_json(run)) if run else None
    content, pictures = paper_content(page, poles_page, made)
    template = resources.files("roadsight.report") / "assets" / "paper" / _TEMPLATE
    with tempfile.TemporaryDirectory() as folder, atomic_path(out) as temporary:
        for name, data in pictures.items():
            (Path(folder) / name).write_bytes(data)
        text = json.dumps(content, ensure_ascii=False, allow_nan=False)
        (Path(folder) / "content.json").write_text(text, encoding="utf-8")
        source = Path(folder) / _TEMPLATE
        source.write_text(template.read_text(encoding="utf-8"), encoding="utf-8")
        typst.compile(str(source), output=str(temporary), root=folder, format="pdf")
    size_mb = out.stat().st_size / 1e6
    log.info("%d plans, %.1f MB", len(content["plans"]), size_mb)


main = Command(write_pdf)


if __name__ == "__main__":
    sys.exit(main())
