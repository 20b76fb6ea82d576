"""Reference of the package from its docstrings: read from the sources, nothing is imported."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterable, Iterator
from pathlib import Path
from textwrap import dedent

from scripts.pages.markdown import escaped, table

ROOMS = (
    "base",
    "geometry",
    "setcover",
    "scene",
    "placement",
    "poles",
    "effects",
    "io",
    "config",
    "stages",
)
"""Rooms of the reference: the science, readers and writers, settings, and what the rules run."""

_WIDTH = 92
"""Longer signatures get a line for each parameter, characters."""
_HEADING = re.compile(r"^([A-Z][A-Za-z ]+)\n-{3,}$", re.MULTILINE)
_ENTRY = re.compile(r"^(?=[\w`*][\w`*, ]* :(?: |$))", re.MULTILINE)
_INTRODUCTION = """\
# API

What a notebook or another program may import, by room (the
[architecture](../../architecture.md#rooms) says what each room holds). The science takes and
returns arrays and opens no file; `io` opens files; a module of `stages` is what one rule runs.
Names that begin with an underscore are not for use from outside.
[From Python](../../howto/from-python.md) has examples.

"""

Definition = ast.FunctionDef | ast.ClassDef | ast.Assign | ast.AnnAssign


def packages(package: Path) -> list[Path]:
    """Folders of the package's public rooms that hold modules, in the order of `ROOMS`."""
    folders = []
    for room in ROOMS:
        files = sorted((package / room).rglob("*.py"))
        folders += sorted({file.parent for file in files if file.name != "__init__.py"})
    return folders


def name_of(folder: Path, package: Path) -> str:
    """Dotted name of a folder, without that of the package."""
    return ".".join(folder.relative_to(package).parts)


def index_page(package: Path) -> str:
    """Markdown of the list of all pages."""
    rows = [
        (f"[`{name_of(folder, package)}`]({name_of(folder, package)}.md)", _about(folder))
        for folder in packages(package)
    ]
    return _INTRODUCTION + table(("Package", "What it holds"), rows)


def _about(folder: Path) -> str:
    text = ast.get_docstring(_tree(folder / "__init__.py")) or ""
    return escaped(text.split("\n\n")[0])


def package_page(folder: Path, package: Path) -> str:
    """Markdown of the modules of one folder."""
    name = name_of(folder, package)
    parts = [f"# {name}\n\n", prose(ast.get_docstring(_tree(folder / "__init__.py")) or "")]
    for file in sorted(folder.glob("*.py")):
        if file.name != "__init__.py":
            parts += _module(file, f"roadsight.{name}.{file.stem}")
    return "".join(parts)


def _module(file: Path, name: str) -> Iterator[str]:
    source = file.read_text("utf-8")
    tree = ast.parse(source)
    yield f"## {name}\n\n"
    yield prose(ast.get_docstring(tree) or "")
    lines = source.splitlines()
    for definition, text in _public(tree.body, lines):
        yield _entry(definition, text, "###", lines)


def _tree(file: Path) -> ast.Module:
    return ast.parse(file.read_text("utf-8"))


def _public(body: Iterable[ast.stmt], lines: list[str]) -> Iterator[tuple[Definition, str]]:
    """Public definitions that have a docstring, or a comment if they are constants."""
    for statement in body:
        if isinstance(statement, ast.FunctionDef | ast.ClassDef):
            text = ast.get_docstring(statement) or ""
        elif isinstance(statement, ast.Assign | ast.AnnAssign):
            text = _comment(statement, lines)
        else:
            continue
        if text and not _label(statement).startswith("_"):
            yield statement, text


def _comment(statement: ast.Assign | ast.AnnAssign, lines: list[str]) -> str:
    """Comment behind a statement, or else above it."""
    assert statement.end_lineno and statement.end_col_offset
    last = lines[statement.end_lineno - 1].encode()[statement.end_col_offset :].decode().strip()
    if last.startswith("#"):
        return last.lstrip("# ")
    first = statement.lineno - 1
    while first and lines[first - 1].lstrip().startswith("#"):
        first -= 1
    return " ".join(line.strip().lstrip("# ") for line in lines[first : statement.lineno - 1])


def _label(definition: Definition) -> str:
    if isinstance(definition, ast.FunctionDef | ast.ClassDef):
        return definition.name
    target = definition.targets[0] if isinstance(definition, ast.Assign) else definition.target
    return ast.unparse(target)


def _entry(definition: Definition, text: str, level: str, lines: list[str]) -> str:
    parts = [f"{level} {_label(definition)}\n\n", f"```python\n{signature(definition)}\n```\n\n"]
    parts.append(prose(text))
    if isinstance(definition, ast.ClassDef):
        for inner, inner_text in _public(definition.body, lines):
            parts.append(_entry(inner, inner_text, level + "#", lines))
    return "".join(parts)


def signature(definition: Definition) -> str:
    """First line of a definition as it is written."""
    if isinstance(definition, ast.Assign | ast.AnnAssign):
        text = ast.unparse(definition)
        return text if len(text) <= _WIDTH else f"{text[: _WIDTH - 4]} ..."
    if isinstance(definition, ast.ClassDef):
        bases = ", ".join(map(ast.unparse, definition.bases))
        head = f"class {definition.name}" + (f"({bases})" if bases else "")
        fields = [line for line in map(_field, definition.body) if line]
        return "\n".join([f"{head}:", *fields]) if fields else head
    returns = f" -> {ast.unparse(definition.returns)}" if definition.returns else ""
    arguments = ast.unparse(definition.args)
    line = f"{definition.name}({arguments}){returns}"
    if len(line) <= _WIDTH:
        return line
    rows = ",\n    ".join(_parts(arguments))
    return f"{definition.name}(\n    {rows},\n){returns}"


def _field(statement: ast.stmt) -> str:
    """Field of a class with its type."""
    if not isinstance(statement, ast.AnnAssign) or ast.unparse(statement.target).startswith("_"):
        return ""
    return f"    {ast.unparse(statement.target)}: {ast.unparse(statement.annotation)}"


def _parts(arguments: str) -> list[str]:
    """Arguments one by one: commas within brackets and strings do not part them."""
    parts, depth, quote, begin = [], 0, "", 0
    for at, sign in enumerate(arguments):
        if quote:
            quote = "" if sign == quote else quote
        elif sign in "'\"":
            quote = sign
        elif sign in "([{":
            depth += 1
        elif sign in ")]}":
            depth -= 1
        elif sign == "," and depth == 0:
            parts.append(arguments[begin:at].strip())
            begin = at + 1
    return [*parts, arguments[begin:].strip()]


def prose(docstring: str) -> str:
    """Docstring of the house style as Markdown: sections in bold, their entries as lists."""
    blocks = _HEADING.split(dedent(docstring).strip())
    parts = [escaped(blocks[0])]
    for heading, body in zip(blocks[1::2], blocks[2::2], strict=True):
        parts += [f"**{heading}**", _listed(dedent(body.strip("\n")))]
    return "\n\n".join(part.strip() for part in parts if part.strip()) + "\n\n"


def _listed(body: str) -> str:
    entries = [entry.strip() for entry in _ENTRY.split(body) if entry.strip()]
    lines = ["- " + escaped(" ".join(entry.split())) for entry in entries]
    return "\n".join(lines)
