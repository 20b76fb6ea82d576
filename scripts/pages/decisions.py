"""Index of the decisions, by their numbers."""

from __future__ import annotations

import re
from pathlib import Path

from scripts.pages.markdown import escaped, table

_TITLE = re.compile(r"# (\d{3}) (.+)")
_INTRODUCTION = """\
# Decisions

A page each: what was chosen, why, what it costs, with the figures that decided. Numbers that are
missing were never used.

"""


def titles(folder: Path) -> list[tuple[str, str, str]]:
    """Number, title and file name of each decision, in order.

    Raises
    ------
    ValueError : a page does not begin with its number, or two have the same.
    """
    found = []
    for file in sorted(folder.glob("*.md")):
        match = _TITLE.fullmatch(file.read_text("utf-8").split("\n", 1)[0].strip())
        if match is None or not file.name.startswith(f"{match[1]}-"):
            raise ValueError(f"{file.name} must begin with '# NNN Title', with the file's number")
        found.append((match[1], match[2], file.name))
    numbers = [number for number, _, _ in found]
    twice = sorted({number for number in numbers if numbers.count(number) > 1})
    if twice:
        raise ValueError(f"decisions of the same number: {', '.join(twice)}")
    return found


def decisions_page(folder: Path) -> str:
    """Markdown of the index."""
    rows = [(number, f"[{escaped(title)}]({name})") for number, title, name in titles(folder)]
    return _INTRODUCTION + table(("Number", "Decision"), rows)
