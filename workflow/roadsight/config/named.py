"""Settings as parameters of rules, each told apart from any other."""

from __future__ import annotations

from typing import Any


class NamedValue(str):
    """Text of a setting for a command line that is represented together with its name.

    Snakemake compares the *set* of a rule's represented parameters with the recorded one. Without
    their names, a spacing of 8 m and a height step of 2 m would be the same as 2 m and 8 m, and a
    value that another parameter also has could change unseen.
    """

    name: str

    def __new__(cls, name: str, value: Any) -> NamedValue:
        """Value of ``name``; lists become their entries with blanks between."""
        text = " ".join(map(str, value)) if isinstance(value, list | tuple) else str(value)
        named = super().__new__(cls, text)
        named.name = name
        return named

    def __repr__(self) -> str:
        return f"{self.name}={super().__repr__()}"
