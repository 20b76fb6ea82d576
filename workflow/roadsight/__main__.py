"""``roadsight``: single pieces of the workflow on one's own files."""

from __future__ import annotations

import argparse
import importlib
import logging
import sys
from collections.abc import Sequence

from roadsight import __version__
from roadsight.base.errors import InputError

COMMANDS = (
    "init",
    "ground",
    "pavement",
    "edges",
    "geometry",
    "depthmap",
    "cover",
    "accept",
    "align",
    "register",
    "triangulate",
    "changes",
    "draw",
    "score",
    "estimate",
    "studio",
)


def main(argv: Sequence[str] | None = None) -> int:
    """Run one verb; exit code 0, or 2 with one message."""
    logging.basicConfig(level=logging.INFO, stream=sys.stderr, format="%(message)s")
    logging.getLogger("pyogrio").setLevel(logging.WARNING)
    arguments = build_parser().parse_args(argv)
    try:
        arguments.run(arguments)
    except (InputError, OSError) as error:
        print(f"roadsight: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("roadsight: interrupted; nothing was written", file=sys.stderr)
        return 130
    return 0


def build_parser() -> argparse.ArgumentParser:
    """Parser of all verbs."""
    parser = argparse.ArgumentParser(prog="roadsight", description=__doc__)
    parser.add_argument("--version", action="version", version=f"roadsight {__version__}")
    verbs = parser.add_subparsers(title="verbs", required=True, metavar="VERB")
    for name in COMMANDS:
        importlib.import_module(f"roadsight.commands.{name}").VERB.add_to(verbs)
    return parser


if __name__ == "__main__":
    sys.exit(main())
