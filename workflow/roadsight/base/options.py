"""Command-line options made from a section of settings, so that no default is written twice."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin

from roadsight.base.section import Section


def add_settings(
    parser: argparse.ArgumentParser, section: type[Section], *names: str, may_lack: bool = False
) -> None:
    """Add an option for settings of a section, with type, choices, default and meaning.

    Parameters
    ----------
    names : of the settings; none: all. A setting ``cell_size_m`` becomes ``--cell-size-m``.
    may_lack : whether an option may stand without its value, which is then None: rules that need
        it for some methods only.

    Raises
    ------
    TypeError : a setting is of a kind that no option can say.
    """
    for name in names or section.model_fields:
        field = section.model_fields[name]
        kind = _kind(field.annotation, name)
        parser.add_argument(
            f"--{name.replace('_', '-')}",
            default=field.get_default(),
            help=(field.description or "").replace("%", "%%"),
            **(kind | {"nargs": "?"} if may_lack else kind),
        )


def _kind(annotation: Any, name: str) -> dict[str, Any]:
    """What `argparse` needs to read values of a type."""
    origin, inside = get_origin(annotation), get_args(annotation)
    if origin is Annotated:
        return _kind(inside[0], name)
    if origin is Literal:
        return {"choices": inside}
    if origin in (list, tuple) and inside:
        return {**_kind(inside[0], name), "nargs": "*"}
    if origin in (Union, UnionType):
        known = [kind for kind in inside if kind is not NoneType]
        if len(known) == 1:
            return {**_kind(known[0], name), "nargs": "?"}
        return {"type": _reader_of(known, name)}
    if annotation in _READERS:
        return {"type": _READERS[annotation]}
    raise TypeError(f"{name}: no option for {annotation}")


def _reader_of(kinds: list[Any], name: str) -> Callable[[str], Any]:
    """Reads a value of the first of some types that takes it: a word, or a number."""
    told = [_kind(kind, name) for kind in kinds]

    def read(text: str) -> Any:
        for one in told:
            if text in one.get("choices", ()):
                return text
        for one in told:
            try:
                return one["type"](text)
            except (KeyError, ValueError):
                continue
        raise argparse.ArgumentTypeError(f"{text!r} is no value of {name}")

    return read


def _switch(text: str) -> bool:
    """True or False, as rules write them."""
    if text not in ("True", "False"):
        raise argparse.ArgumentTypeError(f"{text!r} is neither True nor False")
    return text == "True"


_READERS: dict[type, Callable[[str], Any]] = {int: int, float: float, str: str, bool: _switch}
