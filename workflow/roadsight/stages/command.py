"""What every stage shares: logging, one message for bad input, exit codes."""

from __future__ import annotations

import argparse
import errno
import logging
import os
import pickle
import signal
import sys
import time
import traceback
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

from roadsight.base.doubts import Doubt, by_severity, refuse
from roadsight.base.errors import InputError
from roadsight.base.options import add_options, called
from roadsight.io.records.atomic import write_json, written
from roadsight.io.records.run_records import own_usage

log = logging.getLogger("roadsight")

_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
"""What writing fails with where there is no room: on the disk, in a quota, for so large a file."""

_CHAPTERS = ("sample", "scene", "placement", "poles")
"""Folders of the results of a site, ``results/<site>/<chapter>``, which rules give relatively."""

_TERMINATED = 128 + signal.SIGTERM
"""Exit code of what a signal ended, as shells have it."""


@dataclass(frozen=True)
class Command:
    """Command line of a stage: its options are the parameters of a typed function.

    Parameters
    ----------
    stage : the function; its module's name and first words are those of the command line.
    about : what it does, where the module's words are of something else.
    """

    stage: Callable[..., None]
    about: str | None = None

    def parser(self) -> argparse.ArgumentParser:
        """Parser of the stage's options."""
        module = sys.modules[self.stage.__module__]
        about = (self.about or module.__doc__ or "").partition("\n\n")[0]
        parser = argparse.ArgumentParser(description=about)
        add_options(parser, self.stage)
        return parser

    def __call__(self, argv: Sequence[str] | None = None) -> int:
        """Run the stage; exit code 0, or 2 after one message."""
        return run_stage(self.parser(), partial(called, self.stage), argv)


def run_stage(
    parser: argparse.ArgumentParser,
    stage: Callable[[argparse.Namespace], None],
    argv: Sequence[str] | None = None,
) -> int:
    """Parse ``argv``, run ``stage`` and turn what a user can mend into one line and exit code 2.

    That is bad input, too little memory or disk, and an input that changed while it was read.
    The last line of the log says what the stage used: Snakemake's benchmark files sample it every
    half second at first and every 30 s later, and miss what happens in between.
    """
    logging.basicConfig(
        level=logging.INFO, stream=sys.stderr, format="%(asctime)s %(levelname)s %(message)s"
    )
    logging.getLogger("pyogrio").setLevel(logging.WARNING)
    arguments = parser.parse_args(argv)
    before = _states(vars(arguments).values())
    try:
        with told_clearly(parser.prog):
            stage(arguments)
            _check_unchanged(before)
    except InputError as error:
        print(f"roadsight: {_of_site(str(error), arguments)}", file=sys.stderr)
        return 2
    log.info("%s", own_usage())
    return 0


@contextmanager
def told_clearly(stage: str) -> Iterator[None]:
    """Within, what a user can mend becomes an `InputError`, and a stop leaves the usual way.

    Raises
    ------
    InputError : bad input, too little memory or disk, damaged kernels. A failure that nobody
        foresaw stays as it is.
    """
    try:
        with _clean_termination():
            yield
    except Exception as error:
        mendable = _mendable(error, stage)
        if mendable is None:
            raise
        raise mendable from error


def _mendable(error: Exception, stage: str) -> InputError | None:
    """What to tell of a failure; None for one that nobody foresaw."""
    if isinstance(error, MemoryError) or "std::bad_alloc" in str(error):  # so GEOS tells it
        hint = "give it more, use smaller tiles or more shards"
        return InputError("ran out of memory", where=stage, hint=hint)
    if isinstance(error, OSError) and error.errno in _FULL:
        return InputError("the disk is full", where=error.filename or stage, hint="free some")
    if _in_kernel_cache(error):
        where = os.environ.get("NUMBA_CACHE_DIR", "__pycache__")
        return InputError("the compiled kernels are damaged", where=where, hint="delete them")
    return error if isinstance(error, InputError) else None


def _in_kernel_cache(error: Exception) -> bool:
    """Whether Numba failed to read what it compiled before."""
    if not isinstance(error, EOFError | pickle.UnpicklingError):
        return False
    frames = traceback.extract_tb(error.__traceback__)
    return any(Path(frame.filename).parts[-2:] == ("core", "caching.py") for frame in frames)


@contextmanager
def _clean_termination() -> Iterator[None]:
    """Leave through the usual way out when asked to stop, so that temporary files go."""

    def stop(*_: object) -> None:
        raise SystemExit(_TERMINATED)

    try:
        before = signal.signal(signal.SIGTERM, stop)
    except ValueError:  # signals belong to the main thread
        yield
        return
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


def _of_site(message: str, arguments: argparse.Namespace) -> str:
    """Message that names the site first, where the arguments name the results of one."""
    found = set(_sites(vars(arguments).values()))
    if len(found) != 1:
        return message
    site = found.pop()
    named = message.startswith(("site ", f"results/{site}/", f"config/sites/{site}.yaml"))
    return message if named else f"site {site}: {message}"


def _sites(values: Iterable[Any]) -> Iterator[str]:
    for value in values:
        if isinstance(value, list | tuple):
            yield from _sites(value)
        elif isinstance(value, str | Path):
            parts = Path(value).parts
            if parts[:1] == ("results",) and len(parts) > 3 and parts[2] in _CHAPTERS:
                yield parts[1]


def _states(values: Iterable[Any]) -> dict[Path, tuple[int, int]]:
    """Size and date of each file that the arguments name."""
    found: dict[Path, tuple[int, int]] = {}
    for value in values:
        if isinstance(value, list | tuple):
            found |= _states(value)
        elif isinstance(value, str | Path) and os.path.isfile(value):  # noqa: PTH113  # any text
            found[Path(value).absolute()] = _state(value)
    return found


def _state(path: str | Path) -> tuple[int, int]:
    stat = os.stat(path)  # noqa: PTH116
    return stat.st_size, stat.st_mtime_ns


def _check_unchanged(before: dict[Path, tuple[int, int]]) -> None:
    """Check the files that were there when the stage began and that it did not write itself."""
    for path, state in before.items():
        if path not in written and not (path.is_file() and _state(path) == state):
            raise InputError("changed while it was read", where=str(path), hint="run again")


# How stages tell what their answers rest on.

_LEVEL = {"note": logging.INFO, "doubt": logging.WARNING, "refused": logging.ERROR}


def tell(
    doubts: Sequence[Doubt], path: str | os.PathLike[str], where: str, log: logging.Logger
) -> None:
    """Log doubts and write them for the summary; a refusal ends the run and writes nothing.

    Raises
    ------
    InputError : one of them is a refusal.
    """
    ordered = by_severity(doubts)
    for doubt in ordered:
        beside = "" if doubt.limit is None else f" (limit {doubt.limit})"
        found = "" if doubt.measured is None else f": {doubt.measured}{beside}"
        log.log(_LEVEL[doubt.severity], "%s: %s%s", doubt.severity, doubt.message, found)
    refuse(ordered, where)
    write_json(path, [doubt.to_dict() for doubt in ordered])


def keep(doubts: Sequence[Doubt], path: str | os.PathLike[str]) -> None:
    """Write doubts that are logged already for the summary."""
    write_json(path, [doubt.to_dict() for doubt in by_severity(doubts)])


# Progress of long loops in the log.

Item = TypeVar("Item")

_SECONDS = 5.0
"""Least time between two lines of the log."""


def logged(items: Iterable[Item], total: int, log: logging.Logger, what: str) -> Iterator[Item]:
    """Pass items on; every few seconds say how many are done and how long the rest will take.

    Parameters
    ----------
    total : number of items. what : their name in the plural.
    """
    start = last = time.monotonic()
    for done, item in enumerate(items, start=1):
        yield item
        now = time.monotonic()
        if now - last >= _SECONDS or done == total:
            last = now
            left_s = (now - start) / done * (total - done)
            log.info("%d of %d %s, %.0f s left", done, total, what, left_s)
