"""Reference of the verbs of ``roadsight``: what ``--help`` says of each."""

from __future__ import annotations

import argparse
import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager

from roadsight.__main__ import build_parser

_WIDTH = "90"
"""Of the help texts, characters."""
_INTRODUCTION = """\
# Verbs

Each verb takes files and writes files. It ends with exit code 0, or with 2 and one message.

"""


def verbs_page() -> str:
    """Markdown of all verbs, in the order of ``roadsight --help``."""
    with _width(_WIDTH):
        parts = [
            f"## roadsight {name}\n\n```text\n{parser.format_help().rstrip()}\n```\n\n"
            for name, parser in _verbs(build_parser()).items()
        ]
    return _INTRODUCTION + "".join(parts)


def _verbs(parser: argparse.ArgumentParser) -> Mapping[str, argparse.ArgumentParser]:
    actions = parser._subparsers._group_actions if parser._subparsers else []
    return next(action.choices for action in actions if isinstance(action.choices, Mapping))


@contextmanager
def _width(columns: str) -> Iterator[None]:
    """Help texts of one width, whatever the terminal's."""
    before = os.environ.get("COLUMNS")
    os.environ["COLUMNS"] = columns
    try:
        yield
    finally:
        if before is None:
            del os.environ["COLUMNS"]
        else:
            os.environ["COLUMNS"] = before
