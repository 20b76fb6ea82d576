"""What every stage shares: logging, one message for bad input, exit codes."""

from __future__ import annotations

import argparse
import logging
import sys
from collections.abc import Callable, Sequence

from roadsight.errors import InputError


def run_stage(
    parser: argparse.ArgumentParser,
    stage: Callable[[argparse.Namespace], None],
    argv: Sequence[str] | None = None,
) -> int:
    """Parse ``argv``, run ``stage`` and turn bad input into one line and exit code 2."""
    logging.basicConfig(
        level=logging.INFO, stream=sys.stderr, format="%(asctime)s %(levelname)s %(message)s"
    )
    logging.getLogger("pyogrio").setLevel(logging.WARNING)
    arguments = parser.parse_args(argv)
    try:
        stage(arguments)
    except InputError as error:
        print(f"roadsight: {error}", file=sys.stderr)
        return 2
    return 0
