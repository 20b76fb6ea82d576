import ast
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numba import njit
from numba.core.lowering import BaseLower

from roadsight.base.kernels import compiled, compiled_part
from tests.conftest import PROJECT
from tests.helpers.kernels import from_python

WORKFLOW = PROJECT / "workflow"
DECORATORS = {"compiled": False, "compiled_kernel": False, "kernel": True, "compiled_part": True}
"""Whether what they decorate is a part."""
READERS = ("workflow/roadsight", "tests", "benchmarks", "scripts")


@compiled_part()
def _twice(x):
    return 2 * x


@compiled()
def _twice_all(values):
    for i in range(len(values)):
        values[i] = _twice(values[i])


def test_a_part_works_within_a_kernel_and_behind_the_helper():
    values = np.arange(3.0)
    _twice_all(values)
    assert values.tolist() == [0.0, 2.0, 4.0]
    assert from_python(_twice)(4.0) == 8.0


def test_functions_of_numpy_have_no_wrapper_within_kernels(monkeypatch):
    names = []
    monkeypatch.setattr(
        BaseLower, "create_cfunc_wrapper", lambda lower: names.append(lower.fndesc.qualname)
    )

    @njit()
    def zeros_taken(values):
        return np.take(np.zeros(len(values)), values)

    assert zeros_taken(np.arange(3)).tolist() == [0.0, 0.0, 0.0]
    assert [name.rpartition(".")[2] for name in names] == ["zeros_taken"]


def is_part(function: ast.AST) -> bool | None:
    """Whether a function is a part of kernels; None where it is not compiled."""
    for decorator in getattr(function, "decorator_list", []):
        called = decorator.func if isinstance(decorator, ast.Call) else decorator
        if isinstance(called, ast.Name) and called.id in DECORATORS:
            return DECORATORS[called.id]
    return None


def uncompiled(node: ast.AST) -> Iterator[ast.AST]:
    """Everything below a node but what is compiled or handed to `from_python`."""
    for child in ast.iter_child_nodes(node):
        if is_part(child) is not None:
            continue
        yield child
        helper = isinstance(child, ast.Call) and getattr(child.func, "id", "") == "from_python"
        yield from () if helper else uncompiled(child)


def parts_by_module(paths: list[Path]) -> dict[str, set[str]]:
    found = {}
    for path in paths:
        module = ".".join(path.relative_to(WORKFLOW).with_suffix("").parts)
        body = ast.parse(path.read_text(encoding="utf-8")).body
        found[module] = {each.name for each in body if is_part(each)}
    return found


def called_parts(text: str, own: set[str], parts: dict[str, set[str]]) -> Iterator[str]:
    """Parts that uncompiled code of a file names, as names or as attributes of a module."""
    tree = ast.parse(text)
    named, modules = set(own), {}
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom):
            for alias in node.names:
                name = alias.asname or alias.name
                modules[name] = parts.get(f"{node.module}.{alias.name}", set())
                if alias.name in parts.get(node.module or "", ()):
                    named.add(name)
    for node in uncompiled(tree):
        if isinstance(node, ast.Name) and node.id in named:
            yield node.id
        elif isinstance(node, ast.Attribute):
            holder = getattr(node.value, "id", "")
            if node.attr in modules.get(holder, ()):
                yield node.attr


def test_parts_are_called_by_kernels_alone():
    package = sorted(WORKFLOW.rglob("*.py"))
    parts = parts_by_module(package)
    assert sum(map(len, parts.values())) > 100
    wrong = []
    for path in (path for root in READERS for path in sorted((PROJECT / root).rglob("*.py"))):
        inside = path.is_relative_to(WORKFLOW)
        module = ".".join(path.relative_to(WORKFLOW).with_suffix("").parts) if inside else ""
        text = path.read_text(encoding="utf-8")
        wrong += [f"{path}: {name}" for name in called_parts(text, parts.get(module, set()), parts)]
    assert not wrong, "\n".join(wrong)


def test_a_call_from_python_is_noticed():
    parts = {"roadsight.a": {"f"}}
    texts = ("from roadsight.a import f as g\ng(1)", "from roadsight import a\nb = [a.f]")
    assert [list(called_parts(text, set(), parts)) for text in texts] == [["g"], ["f"]]
    compiled_one = "from roadsight.a import f\n@compiled()\ndef h(x):\n    return f(x)"
    assert not list(called_parts(compiled_one, set(), parts))
