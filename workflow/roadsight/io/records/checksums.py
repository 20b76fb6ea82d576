"""SHA-256 of input files, remembered so that an unchanged file is read once."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from roadsight.base.errors import InputError
from roadsight.io.records.atomic import read_json, write_json


def sha256(path: str | os.PathLike[str]) -> str:
    """SHA-256 of a file's content."""
    with Path(path).open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


class CachedChecksums:
    """Checksums remembered in a JSON file by path, with size and modification time.

    Parameters
    ----------
    path : the JSON file; a damaged or missing one is started anew.
    """

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self._path = Path(path)
        try:
            known = read_json(self._path)
        except InputError:
            known = None
        self._known: dict[str, Any] = known if isinstance(known, dict) else {}

    def of(self, path: str | os.PathLike[str]) -> str:
        """Checksum of a file, "missing" if there is none."""
        checksum, is_new = self._look_up(path)
        if is_new:
            write_json(self._path, self._known)
        return checksum

    def of_all(self, paths: Iterable[str | os.PathLike[str]]) -> str:
        """One checksum of several files and their names, in any order; remembered one by one."""
        found = {str(path): self._look_up(path) for path in paths}
        if any(is_new for _, is_new in found.values()):
            write_json(self._path, self._known)
        lines = [f"{checksum}  {path}\n" for path, (checksum, _) in sorted(found.items())]
        return hashlib.sha256("".join(lines).encode()).hexdigest()

    def _look_up(self, path: str | os.PathLike[str]) -> tuple[str, bool]:
        """Checksum of a file, and whether it was not known before."""
        file = Path(path).absolute()
        if not file.is_file():
            return "missing", False
        stat = file.stat()
        state = {"size": stat.st_size, "mtime_ns": stat.st_mtime_ns}
        match self._known.get(str(file)):
            case {"state": known, "sha256": str(checksum)} if known == state:
                return checksum, False
        checksum = sha256(path)
        self._known[str(file)] = {"state": state, "sha256": checksum}
        return checksum, True
