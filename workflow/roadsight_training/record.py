"""The record of how each network was trained and how well it does."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any


def read_entry(path: str | os.PathLike[str], file: str) -> dict[str, Any]:
    """What the record says about ``file``; nothing if there is no record."""
    entry: dict[str, Any] = {}
    if Path(path).exists():
        entry = json.loads(Path(path).read_text()).get(file, {})
    return entry


def update_record(path: str | os.PathLike[str], file: str, entry: dict[str, Any]) -> None:
    """Put the keys of ``entry`` into the record's part about ``file``, keeping its others."""
    record = json.loads(Path(path).read_text()) if Path(path).exists() else {}
    record[file] = record.get(file, {}) | entry
    unfinished = Path(path).with_name(f".{Path(path).name}")
    unfinished.write_text(json.dumps(record, indent=2, sort_keys=True) + "\n")
    unfinished.replace(path)
