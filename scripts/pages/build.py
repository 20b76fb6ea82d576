"""The documentation as a site: ``python -m scripts.pages.build OUT`` (``make docs``).

Pages of ``docs/`` and the generated ones meet in ``OUT/source``, Sphinx makes ``OUT/html`` of them,
and a link or an anchor that leads nowhere fails the build.
"""

from __future__ import annotations

import re
import shutil
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

from sphinx.cmd.build import main as sphinx_build

from scripts.pages import api, decisions, results, sensors, settings, verbs
from scripts.pages.links import broken_links

PROJECT = Path(__file__).resolve().parents[2]
DOCS = PROJECT / "docs"
PACKAGE = PROJECT / "workflow" / "roadsight"
_DOCS_LINK = re.compile(r"\]\(docs/")
_API = "reference/api"

CONTENTS: Mapping[str, Sequence[str]] = {
    "Begin": ("tutorial", "glossary"),
    "How to": (
        "howto/poles-from-a-videolog",
        "howto/own-edges",
        "howto/read-the-answer",
        "howto/from-python",
        "howto/engines",
        "placement/sensors",
        "placement/targets",
        "placement/candidates",
        "placement/plans",
        "placement/depth-maps",
        "scene/ground",
        "scene/effects",
        "poles/hazard",
        "poles/objects",
        "poles/known-lenses",
        "poles/models",
        "poles/training",
        "running/running",
        "running/studio",
        "running/files",
        "running/clusters",
        "running/scaling",
    ),
    "Method": ("method/placement", "method/poles", "architecture"),
    "Results": (
        "evidence/accuracy-vs-time",
        "evidence/speed",
        "poles/pole-components",
        "results/tradeoffs",
        "results/truth",
        "results/bench",
        "results/published",
    ),
    "Reference": ("reference/settings", "reference/sensors", "reference/verbs", f"{_API}/index"),
    "Project": ("decisions/index", "contributing", "changelog"),
}
"""What the index of the site lists, by caption. A page that is nowhere fails the build."""


def main(out: Path, results_folder: Path = PROJECT / "results") -> int:
    """Build the site; exit code 0, or 1 if anything leads nowhere.

    Parameters
    ----------
    out : folder for ``source`` and ``html``, made anew. results_folder : of measured tables.
    """
    source, html = out / "source", out / "html"
    for folder in (source, html):
        shutil.rmtree(folder, ignore_errors=True)
    write_sources(source, results_folder)
    options = ["--builder", "html", "--fail-on-warning", "--keep-going", "--quiet"]
    if sphinx_build([*options, "--nitpicky", str(source), str(html)]):
        return 1
    broken = broken_links(html)
    print("\n".join(broken) or f"built {html / 'index.html'}", file=sys.stderr)
    return 1 if broken else 0


def write_sources(source: Path, results_folder: Path) -> None:
    """All pages, written and generated, as Sphinx reads them."""
    shutil.copytree(DOCS, source)
    for path, text in generated_pages(results_folder).items():
        file = source / path
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(text, encoding="utf-8")
    lists = "".join(_list(pages, caption) for caption, pages in CONTENTS.items())
    with (source / "index.md").open("a", encoding="utf-8") as index:
        index.write("\n" + lists)


def generated_pages(results_folder: Path) -> dict[str, str]:
    """Markdown of all generated pages by their path below ``docs``."""
    names = [name for _, _, name in decisions.titles(DOCS / "decisions")]
    packages = {api.name_of(folder, PACKAGE): folder for folder in api.packages(PACKAGE)}
    pages = {
        "reference/settings.md": settings.settings_page(),
        "reference/sensors.md": sensors.sensors_page(PROJECT / "config" / "sensors.yaml"),
        "reference/verbs.md": verbs.verbs_page(),
        "decisions/index.md": decisions.decisions_page(DOCS / "decisions") + _list(names),
        "results/published.md": results.published_page(PROJECT / "config" / "tradeoffs.yaml"),
        "contributing.md": _of_the_root("CONTRIBUTING.md"),
        "changelog.md": _of_the_root("CHANGELOG.md"),
        f"{_API}/index.md": api.index_page(PACKAGE) + _list(packages),
    }
    for name, folder in packages.items():
        pages[f"{_API}/{name}.md"] = api.package_page(folder, PACKAGE)
    for name, text in results.results_pages(results_folder).items():
        pages[f"results/{name}.md"] = text
    return pages


def _of_the_root(name: str) -> str:
    """Page of the repository's root, with links that hold within the site."""
    return _DOCS_LINK.sub("](", (PROJECT / name).read_text("utf-8"))


def _list(pages: Sequence[str] | Mapping[str, object], caption: str = "") -> str:
    """Contents of the sidebar; they do not show on the page itself."""
    head = f":caption: {caption}\n" if caption else ""
    lines = "\n".join(page.removesuffix(".md") for page in pages)
    return f"```{{toctree}}\n:hidden:\n{head}\n{lines}\n```\n\n"


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1])))
