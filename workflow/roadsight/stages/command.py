"""What every stage shares: logging, one message for bad input, exit codes."""

from __future__ import annotations

import argparse
import logging
import sys
from collections.abc import Callable, Sequence

from roadsight.errors import InputError
from roadsight.io.usage import own_usage

log = logging.getLogger("roadsight")


def run_stage(
    parser: argparse.ArgumentParser,
    stage: Callable[[argparse.Namespace], None],
    argv: Sequence[str] | None = None,
) -> int:
    """Parse ``argv``, run ``stage`` and turn bad input into one line and exit code 2.

    The last line of the log says what the stage used: Snakemake's benchmark files sample it every
    half second at first and every 30 s later, and miss what happens in between.
    """
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
    log.info("%s", own_usage())
    return 0
