"""The rooms of the package: what each may import, what it does import, and a drawing of both.

``python scripts/rooms.py OUT.svg`` draws the imports between rooms as they are (needs graphviz).
"""

from __future__ import annotations

import ast
import subprocess
import sys
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

WORKFLOW = Path(__file__).resolve().parents[1] / "workflow"
PACKAGE = WORKFLOW / "roadsight"
BESIDE = ("roadsight_worlds", "roadsight_hardcases", "roadsight_training")
"""Packages beside the product; each is a room, named without what all of them begin with."""

FLOORS: tuple[tuple[str, ...], ...] = (
    ("base",),
    ("geometry", "setcover"),
    ("scene",),
    ("placement", "poles"),
    ("effects",),
    ("io",),
    ("worlds", "config"),
    ("evidence",),
    ("hardcases",),
    ("report",),
    ("stages",),
    ("training", "studio"),
    ("api",),
    ("commands",),
)
"""Rooms from the ground up: each may import those of the floors below, and itself."""

NARROWER = {"setcover": {"base"}}
"""Rooms that may import less than all that lies below."""


def floor_of(room: str) -> int:
    """Number of a room's floor, from the ground up.

    Raises
    ------
    KeyError : the package has a folder that is no room.
    """
    for number, rooms in enumerate(FLOORS):
        if room in rooms:
            return number
    raise KeyError(f"{room} is no room of scripts/rooms.py")


def allowed(room: str) -> set[str]:
    """Rooms that a room may import."""
    below = {name for rooms in FLOORS[: floor_of(room)] for name in rooms}
    return NARROWER.get(room, below) | {room}


def imports() -> Iterator[tuple[str, str, str]]:
    """File, its room, and a room that it imports, for every import of the package."""
    for path in (file for name in ("roadsight", *BESIDE) for file in _files(WORKFLOW / name)):
        inside = path.relative_to(WORKFLOW)
        room = _room(inside.parts)
        if room is None:
            continue
        for statement in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            for module in _modules(statement):
                other = _room(tuple(module.split(".")))
                if other is not None:
                    yield str(inside), room, other


def _files(folder: Path) -> list[Path]:
    return sorted(folder.rglob("*.py"))


def _room(parts: tuple[str, ...]) -> str | None:
    """Room of a file or module by the parts of its name; None for the package itself and others."""
    if parts[0] in BESIDE:
        return parts[0].removeprefix("roadsight_")
    if parts[0] == "roadsight" and len(parts) > 1 and (PACKAGE / parts[1]).is_dir():
        return parts[1]
    return None


def _modules(statement: ast.AST) -> list[str]:
    if isinstance(statement, ast.Import):
        return [alias.name for alias in statement.names]
    if isinstance(statement, ast.ImportFrom) and statement.module:
        return [f"{statement.module}.{alias.name}" for alias in statement.names]
    return []


def drawing() -> str:
    """Rooms and the imports between them, in the language of graphviz.

    Every room imports ``base``: those arrows would hide the others and are left out.
    """
    arrows = Counter((room, other) for _, room, other in imports() if other not in (room, "base"))
    heaviest = max(arrows.values())
    lines = [
        "digraph rooms {",
        '  rankdir=BT; ranksep=0.6; node [shape=box, style="rounded,filled", fontname=Helvetica,',
        '    color="#1d4ed8", fillcolor="#eff6ff"]; edge [color="#64748b", arrowsize=0.7];',
    ]
    for rooms in FLOORS:
        lines.append("  { rank=same; " + " ".join(f'"{room}";' for room in rooms) + " }")
    for (room, other), count in sorted(arrows.items()):
        width = 0.5 + 3 * count / heaviest
        lines.append(f'  "{other}" -> "{room}" [dir=back, penwidth={width:.2f}];')
    return "\n".join([*lines, "}"])


if __name__ == "__main__":
    svg = subprocess.run(
        ["dot", "-Tsvg"], input=drawing(), capture_output=True, check=True, text=True
    ).stdout
    Path(sys.argv[1]).write_text(svg, encoding="utf-8")
