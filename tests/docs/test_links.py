"""Links of pages as they are read in the repository, and the check of a built site."""

import re
from pathlib import Path
from urllib.parse import urlsplit

import pytest

from scripts.pages.build import CONTENTS, DOCS, generated_pages
from scripts.pages.links import broken_links
from tests.conftest import PROJECT

_LINK = re.compile(r"\[[^\]]*\]\(([^)\s]+)\)")
_ROOT = ("README.md", "CONTRIBUTING.md", "CODE_OF_CONDUCT.md", ".github/PULL_REQUEST_TEMPLATE.md")


@pytest.fixture(scope="module")
def generated() -> set[Path]:
    """Pages that exist only while the site is built."""
    return {(DOCS / path).resolve() for path in generated_pages(PROJECT / "none")}


def test_pages_of_the_repository_link_to_what_is_there(generated: set[Path]):
    files = [PROJECT / name for name in _ROOT] + sorted(DOCS.rglob("*.md"))
    missing = []
    for file in files:
        for target in _LINK.findall(file.read_text("utf-8")):
            url = urlsplit(target)
            path = (file.parent / url.path).resolve() if url.path else file
            if url.scheme or path in generated:
                continue
            anchored = path.suffix != ".md" or not url.fragment or url.fragment in anchors(path)
            if not path.exists() or not anchored:
                missing.append(f"{file.relative_to(PROJECT)}: {target}")
    assert missing == []


def anchors(page: Path) -> set[str]:
    """Anchors of a page's headings, as a repository's pages and the built site name them."""
    if not page.exists():
        return set()
    headings = re.findall(r"^#+ (.+)$", page.read_text("utf-8"), re.MULTILINE)
    return {re.sub(r"[^\w -]", "", text.lower()).replace(" ", "-") for text in headings}


def test_every_page_is_in_the_contents(generated: set[Path]):
    listed = {(DOCS / f"{page}.md").resolve() for pages in CONTENTS.values() for page in pages}
    written = {file.resolve() for file in DOCS.rglob("*.md")}
    decisions = {file for file in written if file.parent.name == "decisions"}
    assert written - decisions - listed == {(DOCS / "index.md").resolve()}
    assert listed - written <= generated


def test_what_leads_nowhere_is_told(tmp_path: Path):
    (tmp_path / "a.html").write_text(
        '<h1 id="top">A</h1><a href="b.html#place">1</a><a href="#top">2</a>'
        '<a href="gone.html">3</a><a href="b.html#none">4</a><a href="https://other.org">5</a>'
        '<img src="gone.png"><script src="https://other.org/x.js"></script>'
    )
    (tmp_path / "b.html").write_text('<p id="place">B</p>')
    assert broken_links(tmp_path) == [
        "a.html: gone.html is not there",
        "a.html: b.html#none: no such place on that page",
        "a.html: gone.png is not there",
        "a.html: https://other.org/x.js is fetched from elsewhere",
    ]


def test_pictures_are_small():
    heavy = [file.name for file in (DOCS / "images").iterdir() if file.stat().st_size > 1_500_000]
    assert heavy == []
