"""Whether Snakemake works in the project's folder without the studio, or left its lock there."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

_PROCESSES = Path("/proc")
"""Where Linux lists processes."""
_LOCKS = ".snakemake/locks"
"""Where Snakemake keeps its lock on a folder."""
_RUNNER = b"roadsight.studio.run.runner"
"""By it the processes of the studio's own runs are known."""
_NO_LOCK = (b"--dry-run", b"--dryrun", b"-n", b"--unlock")
"""Calls of Snakemake with one of these do not hold its lock."""


def lock_is_there(root: Path) -> bool:
    """Whether Snakemake's lock on the folder is there, held or left behind."""
    folder = root / _LOCKS
    return folder.is_dir() and any(folder.glob("*.lock"))


def processes_outside(root: Path) -> list[dict[str, Any]]:
    """Running calls of Snakemake in the folder that no studio started: their process numbers.

    Dry runs and other calls that take no lock do not count. Only processes of this machine and
    this user can be seen.
    """
    found = dict(_snakemakes(root))
    ours = {group for group, line in found.values() if any(_RUNNER in part for part in line)}
    return [
        {"pid": pid}
        for pid, (group, line) in sorted(found.items())
        if group not in ours and not any(part in _NO_LOCK for part in line)
    ]


def _snakemakes(root: Path) -> Iterator[tuple[int, tuple[int, list[bytes]]]]:
    """Process number, its group and command line."""
    for folder in _PROCESSES.glob("[0-9]*"):
        try:
            line = (folder / "cmdline").read_bytes().split(b"\0")
            if not _calls_snakemake(line) or (folder / "cwd").readlink() != root:
                continue
            yield int(folder.name), (os.getpgid(int(folder.name)), line)
        except OSError:
            continue


def _calls_snakemake(line: list[bytes]) -> bool:
    """``snakemake ...``, ``python .../snakemake ...`` or ``python -m snakemake ...``."""
    if any(_RUNNER in part for part in line[:4]):
        return True
    return any(os.path.basename(part) == b"snakemake" for part in line[:3])  # noqa: PTH119
