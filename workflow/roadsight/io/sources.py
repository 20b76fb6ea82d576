"""Source files behind a stage, found by walking its imports without importing anything."""

from __future__ import annotations

import ast
import hashlib
import os
from functools import cache
from pathlib import Path

_PACKAGE_ROOT = Path(__file__).resolve().parents[2]


def stage_sources(stage: str) -> list[str]:
    """First-party files that ``roadsight.stages.<stage>`` pulls in, relative to the work folder."""
    found: dict[str, Path] = {}
    if _file(f"roadsight.stages.{stage}") is None:
        raise ValueError(f"there is no stage {stage!r}")
    pending = [f"roadsight.stages.{stage}"]
    while pending:
        module = pending.pop()
        path = _file(module)
        if path is None or module in found:
            continue
        found[module] = path
        pending += _imports(path)
        if "." in module:
            pending.append(module.rpartition(".")[0])
    return sorted(_shown(path) for path in found.values())


def _shown(path: Path) -> str:
    """Relative to the work folder, or through its link to the package where it has one."""
    link = Path(_PACKAGE_ROOT.name)
    if link.exists() and link.samefile(_PACKAGE_ROOT):
        return str(link / path.relative_to(_PACKAGE_ROOT))
    return os.path.relpath(path)


def _file(module: str) -> Path | None:
    base = _PACKAGE_ROOT.joinpath(*module.split("."))
    path = base / "__init__.py" if base.is_dir() else base.with_suffix(".py")
    return path if path.exists() else None


@cache
def _imports(path: Path) -> list[str]:
    """Names that a file imports, anywhere in it; ``from a import b`` may name a module a.b."""
    names = []
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            names += [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
            names += [node.module, *(f"{node.module}.{alias.name}" for alias in node.names)]
    return [name for name in names if name.partition(".")[0] == "roadsight"]


def package_digest() -> str:
    """Short digest of all the package's sources, by content."""
    digest = hashlib.sha256()
    for path in sorted((_PACKAGE_ROOT / "roadsight").rglob("*.py")):
        digest.update(path.relative_to(_PACKAGE_ROOT).as_posix().encode() + b"\0")
        digest.update(path.read_bytes())
    return digest.hexdigest()[:16]
