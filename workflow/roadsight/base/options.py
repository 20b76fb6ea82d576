"""Command lines made from typed functions and sections of settings: nothing is said twice."""

from __future__ import annotations

import argparse
import inspect
import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, is_dataclass
from pathlib import Path
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin, get_type_hints

from roadsight.base.section import Section, validated


def add_settings(
    parser: argparse.ArgumentParser, section: type[Section], *names: str, may_lack: bool = True
) -> None:
    """Add an option for settings of a section, with type, choices, default and meaning.

    Parameters
    ----------
    names : of the settings; none: all. A setting ``cell_size_m`` becomes ``--cell-size-m``.
    may_lack : as `add_options` takes it.

    Raises
    ------
    TypeError : a setting is of a kind that no option can say.
    """
    for name in names or section.model_fields:
        field = section.model_fields[name]
        said = field.annotation, field.get_default(), field.description
        _add(parser, name, *said, may_lack)


def add_options(
    parser: argparse.ArgumentParser, function: Callable[..., Any], may_lack: bool = True
) -> None:
    """Add an option for each parameter of a typed function.

    A parameter ``road_edges`` is the option ``--road-edges``, and so is ``road_edges_path``, which
    leaves the name to what is read from there (also ``_paths``, ``_json``, and ``_`` alone); one
    before ``/`` goes by its place; ``out`` is also ``-o``. One without a default must be given.
    ``bool`` is a switch, ``X | None`` may stand without its value, a sequence takes several, and a
    tuple of any length may be repeated. ``Annotated[X, "..."]`` says what it means,
    ``Annotated[X, Targets]`` that it is a setting of this section. A section becomes the options
    of all its settings, a dataclass those of its fields.

    Parameters
    ----------
    may_lack : options may stand without their values, as rules write them; people who forget a
        value are told.
    """
    for parameter in _parameters(function):
        kind = parameter.kind
        if parameter.section:
            add_settings(parser, parameter.section, parameter.option, may_lack=may_lack)
        elif _is(kind, Section):
            add_settings(parser, kind, may_lack=may_lack)
        elif is_dataclass(kind) and isinstance(kind, type):
            add_options(parser, kind, may_lack)
        elif parameter.by_place:
            told = _kind(kind, parameter.name) | {"metavar": parameter.option.upper()}
            if "nargs" in told and parameter.default is inspect.Parameter.empty:
                told["nargs"] = "+"
            parser.add_argument(parameter.option, help=parameter.meaning, **told)
        elif kind is bool:
            flags, meaning = _flags(parameter.option), parameter.meaning
            parser.add_argument(*flags, action="store_true", help=meaning)
        else:
            said = kind, parameter.default, parameter.meaning
            _add(parser, parameter.option, *said, may_lack)


def called(function: Callable[..., Any], arguments: argparse.Namespace) -> Any:
    """What a typed function returns for values of the options that `add_options` made.

    Raises
    ------
    InputError : a setting lies outside its range.
    """
    by_place: list[Any] = []
    named: dict[str, Any] = {}
    for parameter in _parameters(function):
        kind = parameter.kind
        if _is(kind, Section):
            content = {setting: getattr(arguments, setting) for setting in kind.model_fields}
            value = validated(kind, content, "options")
        elif is_dataclass(kind) and isinstance(kind, type):
            value = called(kind, arguments)
        else:
            value = getattr(arguments, parameter.option)
            value = tuple(value) if isinstance(value, list) else value
        if parameter.by_place:
            by_place.append(value)
        else:
            named[parameter.name] = value
    return function(*by_place, **named)


@dataclass(frozen=True)
class _Parameter:
    """A parameter of a function: its type without what is annotated, and that."""

    name: str
    kind: Any
    default: Any
    by_place: bool
    meaning: str | None
    section: type[Section] | None

    @property
    def option(self) -> str:
        return re.sub("_(paths?|json)?$", "", self.name)


def _parameters(function: Callable[..., Any]) -> Iterator[_Parameter]:
    """Parameters of a function, or fields of a dataclass."""
    kinds = get_type_hints(function, include_extras=True)
    for name, parameter in inspect.signature(function).parameters.items():
        kind, told = kinds[name], list[Any]()
        if get_origin(kind) is Annotated:
            kind, *told = get_args(kind)
        meaning = next((part for part in told if isinstance(part, str)), None)
        section = next((part for part in told if _is(part, Section)), None)
        by_place = parameter.kind is inspect.Parameter.POSITIONAL_ONLY
        yield _Parameter(name, kind, parameter.default, by_place, meaning, section)


def _add(
    parser: argparse.ArgumentParser,
    name: str,
    kind: Any,
    default: Any,
    meaning: str | None,
    may_lack: bool,
) -> None:
    """Add an option, which must be given if it has no default."""
    told = _kind(kind, name) | {"help": meaning and meaning.replace("%", "%%")}
    needed = default is inspect.Parameter.empty
    if told.get("nargs") == "*" and (needed or not may_lack):
        told["nargs"] = "+"
    if told.get("nargs") == "?" and not may_lack:
        del told["nargs"]
    if told.get("action") == "append" and default == ():
        default = []  # argparse appends to it
    told |= {"required": True} if needed else {"default": default}
    parser.add_argument(*_flags(name), **told)


def _flags(name: str) -> tuple[str, ...]:
    return (*(("-o",) if name == "out" else ()), f"--{name.replace('_', '-')}")


def _is(kind: Any, base: type) -> bool:
    return inspect.isclass(kind) and issubclass(kind, base)


def _kind(annotation: Any, name: str) -> dict[str, Any]:
    """What `argparse` needs to read values of a type."""
    origin, inside = get_origin(annotation), get_args(annotation)
    if origin is Annotated:
        return _kind(inside[0], name)
    if origin is Literal:
        return {"choices": inside}
    if origin is tuple:
        one = _kind(inside[0], name)
        return one | ({"action": "append"} if Ellipsis in inside else {"nargs": len(inside)})
    if origin in (list, Sequence) and inside:
        return {**_kind(inside[0], name), "nargs": "*"}
    if origin in (Union, UnionType):
        return _kind_of_some([kind for kind in inside if kind is not NoneType], name)
    if annotation in _READERS:
        return {"type": _READERS[annotation]}
    raise TypeError(f"{name}: no option for {annotation}")


def _kind_of_some(kinds: list[Any], name: str) -> dict[str, Any]:
    """The same for one of several types, or for one that may be absent."""
    if len(kinds) > 1:
        return {"type": _reader_of(kinds, name)}
    one = _kind(kinds[0], name)
    read = {} if "choices" in one else {"type": _or_none(one["type"])}
    return {"nargs": "?"} | one | read


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


def _or_none(read: Callable[[str], Any]) -> Callable[[str], Any]:
    """Reads a value that may be absent: rules write nothing for it, or an empty text."""

    def optional(text: str) -> Any:
        return read(text) if text else None

    optional.__name__ = getattr(read, "__name__", "value")  # messages call it so
    return optional


def _switch(text: str) -> bool:
    """True or False, as rules write them."""
    if text not in ("True", "False"):
        raise argparse.ArgumentTypeError(f"{text!r} is neither True nor False")
    return text == "True"


_READERS: dict[type, Callable[[str], Any]] = {
    int: int,
    float: float,
    str: str,
    bool: _switch,
    Path: Path,
}
