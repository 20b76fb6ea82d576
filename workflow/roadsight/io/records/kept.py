"""What an earlier run of a step made of each candidate, kept so that a small change is a small run.

A step's output is linked under another name, beside a list of keys: of everything that all its
rows rest on, and of each row's own. The next run of the step takes over the rows whose keys are the
same.
Snakemake knows nothing of these files; without them everything is made again, with the same bytes.
"""

from __future__ import annotations

import hashlib
import os
import shutil
import sys
from collections.abc import Iterable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from roadsight.base.arrays import AnyPath
from roadsight.base.errors import InputError
from roadsight.io.records.atomic import atomic_path, read_json, write_json
from roadsight.io.records.sources import sha256

# Versions of the libraries: other ones may give other last digits.
_LOCK = Path("envs/requirements.lock")


def key_of(*parts: Any) -> str:
    """Key of values that have a representation, or of bytes."""
    digest = hashlib.sha256()
    for part in parts:
        content = part if isinstance(part, bytes) else repr(part).encode()
        digest.update(len(content).to_bytes(8, "little") + content)
    return digest.hexdigest()[:32]


def key_of_step(files: Iterable[AnyPath], *settings: Any) -> str:
    """Key of all that a step's rows share: inputs by content, settings, source code, libraries."""
    known = [sha256(path) for path in files]
    own = {
        str(module.__file__)
        for name, module in list(sys.modules.items())
        if name.startswith("roadsight") and getattr(module, "__file__", None)
    }
    code = sorted(sha256(file) for file in own)
    return key_of(known, settings, code, sha256(_LOCK) if _LOCK.is_file() else "")


class Kept:
    """Rows of an earlier run.

    Parameters
    ----------
    path : where the earlier output is kept; None: nothing is, and nothing will be.
    step : key of all that rows share.
    """

    def __init__(self, path: AnyPath | None, step: str) -> None:
        self._path = None if path is None else Path(path)
        self._step = step
        self._rows: dict[str, str] = {}
        if self._path is not None and self._path.is_file():
            with suppress(InputError, AttributeError, TypeError):
                about = read_json(self._list)
                # A damaged file is made again, and not taken over because it is known.
                if about.get("step") == step and about.get("sha256") == sha256(self._path):
                    self._rows = dict(about["rows"])

    @property
    def _list(self) -> Path:
        assert self._path is not None
        return self._path.with_suffix(".keys.json")

    def names(self, keys: Mapping[str, str]) -> set[str]:
        """Of rows by their keys, those that can be taken over."""
        return {name for name, key in keys.items() if self._rows.get(name) == key}

    @property
    def path(self) -> Path:
        """The earlier output; only to be read if `names` gave any."""
        assert self._path is not None
        return self._path

    def keep(self, output: AnyPath, keys: Mapping[str, str]) -> None:
        """Keep an output that is complete, with the keys of its rows: a link, no second copy."""
        if self._path is None:
            return
        self._list.unlink(missing_ok=True)
        with atomic_path(self._path) as temporary:
            try:
                os.link(output, temporary)
            except OSError:
                shutil.copyfile(output, temporary)
        about = {"step": self._step, "sha256": sha256(self._path), "rows": dict(keys)}
        write_json(self._list, about)
