"""Changes to Snakemake that are made only where it is what they were written for."""

from __future__ import annotations

import inspect
import sys
from collections.abc import Callable
from typing import Any

import snakemake


def replace_method(
    owner: type, name: str, expected: str, replacement: Callable[..., Any], without: str
) -> None:
    """Replace a method of Snakemake, or say on stderr that it stays as it is.

    Parameters
    ----------
    expected : source of the method, without its docstring. without : what the change would do.
    """
    method = getattr(owner, name, None)
    if method is replacement:
        return
    if method is None or _code(method) != _code(expected):
        version = snakemake.__version__
        print(
            f"Snakemake {version} has another {owner.__name__}.{name}: {without}", file=sys.stderr
        )
        return
    setattr(owner, name, replacement)


def _code(source: Any) -> list[str]:
    """Lines of a function without indentation and docstring of one line."""
    text = source if isinstance(source, str) else inspect.getsource(source)
    lines = [line.strip() for line in text.splitlines()]
    return [line for line in lines if line and not line.startswith('"""')]
