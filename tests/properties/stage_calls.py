"""Stages called in this process on files of one folder, and called again with other options."""

import importlib
from pathlib import Path

from roadsight.io.records.sources import stage_module


class StageCalls:
    """Calls stages by options and the files of a folder.

    Parameters
    ----------
    folder : made here.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._calls: dict[str, tuple[tuple[str, ...], dict[str, str]]] = {}
        folder.mkdir(parents=True)

    def path(self, name: str) -> str:
        """Path of an artifact."""
        return str(self.folder / name)

    def _stage(self, stage: str, *options: str, **files: str) -> None:
        self._calls[stage] = options, files
        assert self._run(stage, options, files) == 0

    def again(self, stage: str, *options: str, code: int = 0, **files: str) -> None:
        """The last call of a stage with other options and files; name its outputs anew."""
        before, named = self._calls[stage]
        assert self._run(stage, (*before, *options), named | files) == code

    def _run(self, stage: str, options: tuple[str, ...], files: dict[str, str]) -> int:
        named = [
            part
            for key, name in files.items()
            for part in (f"--{key.replace('_', '-')}", self.path(name))
        ]
        return importlib.import_module(stage_module(stage)).main([*named, *options])
