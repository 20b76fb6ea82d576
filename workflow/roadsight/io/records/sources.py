"""Source files behind a stage, found by walking its imports without importing anything."""

from __future__ import annotations

import ast
import hashlib
import os
import time
from collections.abc import Iterable, Iterator
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Any

from roadsight.base.arrays import AnyPath
from roadsight.base.errors import InputError
from roadsight.io.records.atomic import atomic_path, read_json, write_json

_PACKAGE_ROOT = Path(__file__).resolve().parents[3]
_PACKAGES = ("roadsight", "roadsight_worlds", "roadsight_hardcases", "roadsight_training")
# Settings are declared there; their values reach a stage as its rule's params or are defaults, so
# that a sentence about one makes no result stale.
_DECLARED = "roadsight.base.sections"
_CHAPTERS = ("scene", "placement", "poles", "evidence", "truth")


def stage_module(stage: str) -> str:
    """Dotted name of the module of a stage, whose chapter its stem alone does not say.

    Raises
    ------
    ValueError : no chapter has such a stage.
    """
    for chapter in _CHAPTERS:
        module = f"roadsight.stages.{chapter}.{stage}"
        path = _PACKAGE_ROOT.joinpath(*module.split(".")).with_suffix(".py")
        if stage.isidentifier() and path.exists():
            return module
    raise ValueError(f"there is no stage {stage!r}")


def _package_files() -> list[Path]:
    """Python files of the product and of the packages beside it."""
    return sorted(path for name in _PACKAGES for path in (_PACKAGE_ROOT / name).rglob("*.py"))


class _Sources:
    """The files of the package as they are now, and what each imports of it.

    Parameters
    ----------
    memory : JSON file that keeps what files import by their checksums: reading 700 of them takes
        0.1 s, parsing them 2 s.
    """

    def __init__(self, memory: Path | None = None) -> None:
        # Relative to the work folder, or its link to the package where it has one.
        link = Path(_PACKAGE_ROOT.name)
        linked = link.exists() and link.samefile(_PACKAGE_ROOT)
        self._root = link if linked else Path(os.path.relpath(_PACKAGE_ROOT))
        self._files: dict[str, Path] = {}
        for path in _package_files():
            if not path.is_file():
                continue  # a link that an editor left
            parts = path.relative_to(_PACKAGE_ROOT).with_suffix("").parts
            self._files[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
        self._names: dict[Path, list[str]] = {}
        self._checksums: dict[Path, str] = {}
        if memory is not None:
            self._remember(memory)

    def of(self, stage: str) -> list[Path]:
        """Files behind a stage, relative to the work folder."""
        return sorted(self._shown(self._files[module]) for module in self._modules(stage))

    def sections_of(self, stage: str) -> set[str]:
        """Dotted names of what modules of settings declare and these files name."""
        names = {
            name for module in self._modules(stage) for name in self._imported(self._files[module])
        }
        return {
            name for name in names if name.startswith(f"{_DECLARED}.") and name not in self._files
        }

    def checksum(self, shown: Path) -> str:
        """Of a file, whether it is one of the package or not."""
        if shown not in self._checksums:
            self._checksums[shown] = hashlib.sha256(shown.read_bytes()).hexdigest()
        return self._checksums[shown]

    def _modules(self, stage: str) -> set[str]:
        found: set[str] = set()
        pending = [stage_module(stage)]
        while pending:
            module = pending.pop()
            if module in found or module not in self._files:
                continue
            found.add(module)
            # Sections are declared, see `_DECLARED`.
            names = self._imported(self._files[module])
            pending += [name for name in names if not name.startswith(_DECLARED)]
            if "." in module:
                pending.append(module.rpartition(".")[0])
        return found

    def _shown(self, path: Path) -> Path:
        return self._root / path.relative_to(_PACKAGE_ROOT)

    def _imported(self, path: Path) -> list[str]:
        if path not in self._names:
            self._names[path] = _imports(path.read_bytes())
        return self._names[path]

    def _remember(self, memory: Path) -> None:
        # Another way to look for imports finds others.
        parser = hashlib.sha256(Path(__file__).read_bytes()).hexdigest()
        try:
            kept: Any = read_json(memory)
        except InputError:
            kept = None
        same = isinstance(kept, dict) and kept.get("parser") == parser
        listed = kept.get("imports") if same else None
        before: dict[str, list[str]] = {
            checksum: names
            for checksum, names in (listed.items() if isinstance(listed, dict) else ())
            if isinstance(names, list) and all(isinstance(name, str) for name in names)
        }
        found: dict[str, list[str]] = {}
        for path in self._files.values():
            content = path.read_bytes()
            checksum = hashlib.sha256(content).hexdigest()
            self._checksums[self._shown(path)] = checksum
            names = before.get(checksum)
            if names is None:
                try:
                    names = _imports(content)
                except SyntaxError:
                    continue  # told where a stage needs the file
            self._names[path] = found[checksum] = names
        if found != before:
            write_json(memory, {"parser": parser, "imports": found})


class Stamps:
    """Files that stand for the sources of stages: each lists their checksums.

    Their content changes with that of the sources, and they are as old as the newest of them, or as
    their change where an earlier stamp was of other content. One file instead of a hundred is what
    makes a list of 20,000 jobs short.

    Parameters
    ----------
    folder : of the stamps. others : further files that each stage rests on.
    """

    def __init__(self, folder: Path, *others: str) -> None:
        self._folder, self._others = folder, [Path(name) for name in others]
        self._sources = _Sources(folder.parent / "imports.json")

    def of(self, stage: str) -> str:
        """The stamp of a stage, brought up to date."""
        files = [*self._sources.of(stage), *self._others]
        content = "".join(f"{self._sources.checksum(path)}  {path}\n" for path in files)
        sections = sorted(self._sources.sections_of(stage))
        content += "".join(f"{_defaults(name)}  {name}\n" for name in sections)
        date_ns = max(path.stat().st_mtime_ns for path in files)
        stamp = self._folder / stage
        try:
            before, before_ns = stamp.read_text(encoding="utf-8"), stamp.stat().st_mtime_ns
        except OSError:
            before, before_ns = None, 0
        if before == content and before_ns >= date_ns:
            return str(stamp)
        if before not in (None, content):
            date_ns = max(date_ns, time.time_ns())
        with atomic_path(stamp) as temporary:
            temporary.write_text(content, encoding="utf-8")
            os.utime(temporary, ns=(date_ns, date_ns))
        return str(stamp)


@cache
def _defaults(section: str) -> str:
    """Checksum of what a section holds where no rule hands on another value; of a type, of none."""
    module, _, name = section.rpartition(".")
    fields = getattr(getattr(import_module(module), name), "model_fields", {})
    values = {key: field.get_default(call_default_factory=True) for key, field in fields.items()}
    return hashlib.sha256(repr(values).encode()).hexdigest()


def _imports(content: bytes) -> list[str]:
    """Names that a file imports of the package, anywhere in it, with the modules they come from."""
    names = []
    for statement in _statements(ast.parse(content)):
        if isinstance(statement, ast.Import):
            names += [alias.name for alias in statement.names]
        elif isinstance(statement, ast.ImportFrom) and statement.module and not statement.level:
            module = statement.module
            names += [module, *(f"{module}.{alias.name}" for alias in statement.names)]
    return [name for name in dict.fromkeys(names) if name.partition(".")[0] in _PACKAGES]


def _statements(block: ast.AST) -> Iterator[ast.AST]:
    """Everything in a block that may hold statements, which are a tenth of a file's nodes."""
    for part in ("body", "orelse", "finalbody", "handlers", "cases"):
        for statement in getattr(block, part, ()):
            yield statement
            yield from _statements(statement)


def package_digest() -> str:
    """Short digest of all the package's sources, by content."""
    digest = hashlib.sha256()
    for path in _package_files():
        digest.update(path.relative_to(_PACKAGE_ROOT).as_posix().encode() + b"\0")
        digest.update(path.read_bytes())
    return digest.hexdigest()[:16]


# SHA-256 of input files, remembered so that an unchanged file is read once.


def sha256(path: AnyPath) -> str:
    """SHA-256 of a file's content."""
    with Path(path).open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


class CachedChecksums:
    """Checksums remembered in a JSON file by path, with size and modification time.

    Parameters
    ----------
    path : the JSON file; a damaged or missing one is started anew.
    """

    def __init__(self, path: AnyPath) -> None:
        self._path = Path(path)
        try:
            known = read_json(self._path)
        except InputError:
            known = None
        self._known: dict[str, Any] = known if isinstance(known, dict) else {}

    def of(self, path: AnyPath) -> str:
        """Checksum of a file, "missing" if there is none."""
        checksum, is_new = self._look_up(path)
        if is_new:
            write_json(self._path, self._known)
        return checksum

    def of_all(self, paths: Iterable[AnyPath]) -> str:
        """One checksum of several files and their names, in any order; remembered one by one."""
        found = {str(path): self._look_up(path) for path in paths}
        if any(is_new for _, is_new in found.values()):
            write_json(self._path, self._known)
        lines = [f"{checksum}  {path}\n" for path, (checksum, _) in sorted(found.items())]
        return hashlib.sha256("".join(lines).encode()).hexdigest()

    def _look_up(self, path: AnyPath) -> tuple[str, bool]:
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
