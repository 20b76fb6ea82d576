"""Source files behind a stage, found by walking its imports without importing anything."""

from __future__ import annotations

import ast
import hashlib
import os
import time
from collections.abc import Iterator
from functools import cache
from importlib import import_module
from pathlib import Path

from roadsight.io.records.atomic import atomic_path

_PACKAGE_ROOT = Path(__file__).resolve().parents[3]
_DECLARED = "roadsight.base.sections"
"""Settings are declared there; their values reach a stage as its rule's params or are defaults, so
that a sentence about one makes no result stale."""
_CHAPTERS = ("scene", "placement", "poles", "evidence", "truth")


def stage_module(stage: str) -> str:
    """Dotted name of the module of a stage, whose chapter its stem alone does not say.

    Raises
    ------
    ValueError : no chapter has such a stage.
    """
    for chapter in _CHAPTERS:
        module = f"roadsight.stages.{chapter}.{stage}"
        if stage.isidentifier() and _file(module) is not None:
            return module
    raise ValueError(f"there is no stage {stage!r}")


def stage_sources(stage: str) -> list[str]:
    """First-party files that the module of a stage pulls in, relative to the work folder."""
    found: dict[str, Path] = {}
    pending = [stage_module(stage)]
    while pending:
        module = pending.pop()
        if module in found or (path := _file(module)) is None:
            continue
        found[module] = path
        pending += _imports(path)
        if "." in module:
            pending.append(module.rpartition(".")[0])
    root = _shown_root()
    return sorted(str(root / path.relative_to(_PACKAGE_ROOT)) for path in found.values())


def stage_stamp(stage: str, folder: Path, *others: str) -> str:
    """File that stands for the sources of a stage: it lists their checksums.

    Its content changes with theirs and it is as old as the newest of them, or as their change where
    an earlier stamp was of other content. One file instead of a hundred is what makes a list of
    20,000 jobs short.

    Parameters
    ----------
    folder : of the stamps. others : further files that the stage rests on.
    """
    files = [Path(name) for name in (*stage_sources(stage), *others)]
    content = "".join(f"{_checksum(path)}  {path}\n" for path in files)
    sources = [path.resolve() for path in files if path.suffix == ".py"]
    sections = {name for path in sources for name in _imported(path) if _is_section(name)}
    content += "".join(f"{_defaults(name)}  {name}\n" for name in sorted(sections))
    date_ns = max(path.stat().st_mtime_ns for path in files)
    stamp = folder / stage
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


def _is_section(name: str) -> bool:
    """Whether a dotted name is that of something that a module of settings declares."""
    return name.startswith(f"{_DECLARED}.") and _file(name) is None


@cache
def _defaults(section: str) -> str:
    """Checksum of what a section holds where no rule hands on another value; of a type, of none."""
    module, _, name = section.rpartition(".")
    fields = getattr(getattr(import_module(module), name), "model_fields", {})
    values = {key: field.get_default(call_default_factory=True) for key, field in fields.items()}
    return hashlib.sha256(repr(values).encode()).hexdigest()


@cache
def _checksum(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def _shown_root() -> Path:
    """Relative to the work folder, or its link to the package where it has one."""
    link = Path(_PACKAGE_ROOT.name)
    if link.exists() and link.samefile(_PACKAGE_ROOT):
        return link
    return Path(os.path.relpath(_PACKAGE_ROOT))


def _file(module: str) -> Path | None:
    base = _PACKAGE_ROOT.joinpath(*module.split("."))
    path = base / "__init__.py" if base.is_dir() else base.with_suffix(".py")
    return path if path.exists() else None


def _imports(path: Path) -> list[str]:
    """Modules that a file imports and that make its results stale."""
    return [name for name in _imported(path) if _file(name) and not name.startswith(_DECLARED)]


@cache
def _imported(path: Path) -> list[str]:
    """Names that a file imports of the package, anywhere in it, with the modules they come from."""
    names = []
    for statement in _statements(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(statement, ast.Import):
            names += [alias.name for alias in statement.names]
        elif isinstance(statement, ast.ImportFrom) and statement.module and not statement.level:
            module = statement.module
            names += [module, *(f"{module}.{alias.name}" for alias in statement.names)]
    return [name for name in dict.fromkeys(names) if name.partition(".")[0] == "roadsight"]


def _statements(block: ast.AST) -> Iterator[ast.AST]:
    """Everything in a block that may hold statements, which are a tenth of a file's nodes."""
    for part in ("body", "orelse", "finalbody", "handlers", "cases"):
        for statement in getattr(block, part, ()):
            yield statement
            yield from _statements(statement)


def package_digest() -> str:
    """Short digest of all the package's sources, by content."""
    digest = hashlib.sha256()
    for path in sorted((_PACKAGE_ROOT / "roadsight").rglob("*.py")):
        digest.update(path.relative_to(_PACKAGE_ROOT).as_posix().encode() + b"\0")
        digest.update(path.read_bytes())
    return digest.hexdigest()[:16]
