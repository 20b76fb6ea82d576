"""SHA-256 of input files, remembered so that an unchanged file is read once."""

from __future__ import annotations

import hashlib
import os
from pathlib import Path

from roadsight.io.atomic import read_json, write_json


def sha256(path: str | os.PathLike[str]) -> str:
    """SHA-256 of a file's content."""
    with Path(path).open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


class CachedChecksums:
    """Checksums remembered in a JSON file by path, size and modification time.

    Parameters
    ----------
    path : the JSON file; a damaged or missing one is started anew.
    """

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self._path = Path(path)
        try:
            self._known: dict[str, str] = read_json(self._path)
        except (OSError, ValueError):
            self._known = {}

    def of(self, path: str | os.PathLike[str]) -> str:
        """Checksum of a file, "missing" if there is none."""
        try:
            stat = os.stat(path)
        except OSError:
            return "missing"
        key = f"{os.path.abspath(path)}|{stat.st_size}|{stat.st_mtime_ns}"
        if key not in self._known:
            self._known[key] = sha256(path)
            write_json(self._path, self._known)
        return self._known[key]
