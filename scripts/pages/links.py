"""Links, pictures and anchors of a built site: all must lead somewhere, and none may fetch."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit


@dataclass
class PageLinks(HTMLParser):
    """What a page refers to, and the anchors that it has.

    Parameters
    ----------
    targets : of links. fetched : what the browser loads by itself. anchors : ids and names.
    """

    targets: list[str] = field(default_factory=list)
    fetched: list[str] = field(default_factory=list)
    anchors: set[str] = field(default_factory=set)

    def __post_init__(self) -> None:
        """Make the parser ready."""
        super().__init__()

    def handle_starttag(self, tag: str, attrs: Sequence[tuple[str, str | None]]) -> None:
        """Take note of one element."""
        values = {name: value for name, value in attrs if value}
        self.anchors |= {values[name] for name in ("id", "name") if name in values}
        if tag == "a" and "href" in values:
            self.targets.append(values["href"])
        elif tag == "link" and "canonical" not in values.get("rel", "") and "href" in values:
            self.fetched.append(values["href"])
        elif "src" in values:
            self.fetched.append(values["src"])


def broken_links(site: Path) -> list[str]:
    """One line for each link that leads nowhere and each file that lies elsewhere."""
    pages = {file.resolve(): _read(file) for file in sorted(site.rglob("*.html"))}
    return [
        f"{file.relative_to(site.resolve())}: {fault}"
        for file, page in pages.items()
        for fault in _faults(file, page, pages)
    ]


def _read(file: Path) -> PageLinks:
    page = PageLinks()
    page.feed(file.read_text("utf-8"))
    return page


def _faults(file: Path, page: PageLinks, pages: Mapping[Path, PageLinks]) -> Iterator[str]:
    for target in dict.fromkeys([*page.targets, *page.fetched]):
        url = urlsplit(target)
        if url.scheme or url.netloc:
            if target in page.fetched and url.scheme != "data":
                yield f"{target} is fetched from elsewhere"
            continue
        path = (file.parent / unquote(url.path)).resolve() if url.path else file
        if not path.is_file():
            yield f"{target} is not there"
        elif url.fragment and path in pages and unquote(url.fragment) not in pages[path].anchors:
            yield f"{target}: no such place on that page"
