"""Small pieces of Markdown."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence

_CODE = re.compile(r"(`+)(?:(?!\1).)+?\1", re.DOTALL)


def escaped(text: str) -> str:
    """Text without what Markdown would read as HTML; code spans stay as they are."""
    parts, at = [], 0
    for code in _CODE.finditer(text):
        parts += [_plain(text[at : code.start()]), code.group()]
        at = code.end()
    return "".join([*parts, _plain(text[at:])])


def _plain(text: str) -> str:
    return text.replace("&", "&amp;").replace("<", "&lt;").replace("*", r"\*").replace("$", r"\$")


def table(head: Sequence[str], rows: Iterable[Sequence[str]], right: Sequence[int] = ()) -> str:
    """Markdown table with a blank line behind it.

    Parameters
    ----------
    right : numbers of the columns that are aligned to the right.
    """
    rule = ["--:" if n in right else "---" for n in range(len(head))]
    lines = [_line(head), "|" + "|".join(rule) + "|"]
    lines += [_line([cell.replace("|", r"\|") for cell in row]) for row in rows]
    return "\n".join(lines) + "\n\n"


def _line(cells: Sequence[str]) -> str:
    return "| " + " | ".join(" ".join(cell.split()) for cell in cells) + " |"


def code(text: object) -> str:
    """Text as a code span; nothing for an empty one."""
    shown = f"{text}"
    return f"`{shown}`" if shown else ""
