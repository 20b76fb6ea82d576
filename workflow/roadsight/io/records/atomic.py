"""Outputs appear whole or not at all."""

from __future__ import annotations

import glob
import json
import os
import socket
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from typing import Any, TypeVar

from roadsight.base.errors import InputError

_HOST = socket.gethostname().partition(".")[0]
_PROBE_BYTES = 1 << 20

File = TypeVar("File")

written: set[Path] = set()
"""Files that this process wrote, by absolute path."""


@contextmanager
def atomic_path(path: str | os.PathLike[str]) -> Iterator[Path]:
    """Yield a temporary sibling of ``path``; rename it onto ``path`` if the block succeeds.

    The temporary name keeps the suffix, because some writers choose their format by it. What a
    killed process of this host left behind of the same file is removed first.

    Raises
    ------
    InputError : the disk is full, whatever the library in the block says of it.
    """
    target = Path(path)
    target.parent.mkdir(parents=True, exist_ok=True)
    _remove_leftovers(target)
    temporary = target.with_name(_temporary_name(target, str(os.getpid())))
    try:
        yield temporary
        os.replace(temporary, target)
        written.add(target.absolute())
    except Exception as error:
        if isinstance(error, InputError) or _has_room(temporary):
            raise
        raise no_room(target) from error
    finally:
        for file in [temporary, *_beside(temporary)]:
            file.unlink(missing_ok=True)


def no_room(path: Path) -> InputError:
    """Message that the disk is full."""
    return InputError(
        "there is no room to write it",
        where=str(path),
        hint="free some and run again; what was finished is kept",
    )


def open_within(place: AbstractContextManager[Path], open_file: Callable[[Path], File]) -> File:
    """Enter ``place``, which is `atomic_path`, and open its temporary; leave it if that fails."""
    temporary = place.__enter__()
    try:
        return open_file(temporary)
    except Exception as error:
        place.__exit__(type(error), error, error.__traceback__)
        raise


def close_within(
    place: AbstractContextManager[Path], close: Callable[[], None], error: BaseException | None
) -> None:
    """Close a file that was opened in ``place``, which is `atomic_path`, at the end of a block.

    Parameters
    ----------
    close : writes the rest and closes the file. error : what ended the block early, if anything.
    """
    late = None
    try:
        close()
    except Exception as raised:
        late = raised
    failure = error or late
    if failure is None:
        place.__exit__(None, None, None)
        return
    place.__exit__(type(failure), failure, failure.__traceback__)
    if error is None:
        raise failure


def _temporary_name(target: Path, process: str) -> str:
    return f".{target.stem}.{_HOST}-{process}.tmp{target.suffix}"


def _beside(temporary: Path) -> list[Path]:
    """What a library wrote beside its file, such as a journal."""
    return sorted(temporary.parent.glob(f"{glob.escape(temporary.name)}-*"))


def _remove_leftovers(target: Path) -> None:
    """Remove temporaries of this file whose process is no more."""
    before, after = _temporary_name(target, "\0").split("\0")
    for file in target.parent.glob(f"{glob.escape(before)}*{glob.escape(after)}*"):
        process = file.name.removeprefix(before).partition(".")[0]
        if process.isdecimal() and not Path(f"/proc/{process}").exists():
            file.unlink(missing_ok=True)


def _has_room(temporary: Path) -> bool:
    """Whether the file that could not be written could still grow."""
    try:
        with temporary.open("ab") as stream:
            stream.write(bytes(_PROBE_BYTES))
            stream.flush()
    except OSError:
        return False
    return True


def write_json(path: str | os.PathLike[str], content: Any) -> None:
    """Write ``content`` as sorted, indented JSON; NaN and infinity are refused."""
    text = json.dumps(content, indent=2, sort_keys=True, allow_nan=False, ensure_ascii=False)
    with atomic_path(path) as temporary:
        temporary.write_text(text + "\n", encoding="utf-8")


def read_json(path: str | os.PathLike[str]) -> Any:
    """Read a JSON file.

    Raises
    ------
    InputError : the file is missing, cut off or otherwise no JSON.
    """
    try:
        return json.loads(Path(path).read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError) as error:
        raise InputError(
            f"cannot be read as JSON ({error})",
            where=str(path),
            hint="if the workflow wrote it, delete it and run again",
        ) from error
