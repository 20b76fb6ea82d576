"""Reference of the settings: key, type, default, range, unit and sentence, from the schema."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin

from pydantic import BaseModel
from pydantic.fields import FieldInfo
from pydantic_core import PydanticUndefined

from roadsight.config.plans import Plan
from roadsight.config.schema import Config, Settings
from roadsight.config.sites import Site
from scripts.pages.markdown import code, escaped, table

_UNITS = {
    "deg": "degrees",
    "hz": "Hz",
    "kmh": "km/h",
    "lux": "lx",
    "m": "m",
    "m2": "m²",
    "mib": "MiB",
    "mm": "mm",
    "mm_h": "mm/h",
    "mps": "m/s",
    "mrad": "mrad",
    "nm": "nm",
    "per_km": "1/km",
    "per_m": "1/m",
    "per_m2": "1/m²",
    "px": "px",
    "s": "s",
    "share": "share",
}
"""Unit by the last words of a key; the longest that fits counts."""
_TAILS = ("m", "m2", "px", "px2", "s", "degrees", "px an image", "1/m2", "km/h", "mm/h", "cells")
"""Units that end a description, which the column of units says already."""
_SIGNS = {"gt": ">", "ge": "≥", "lt": "<", "le": "≤"}
_KINDS = {float: "number", int: "whole number", str: "text", bool: "true or false", Any: "anything"}
_HEAD = ("Key", "Type", "Default", "Range", "Unit", "What it is")


@dataclass(frozen=True)
class Setting:
    """A setting as people read it; ``key`` with dots where it lies in a group."""

    key: str
    kind: str
    default: str
    allowed: str
    unit: str
    sentence: str


def settings_of(section: type[BaseModel], prefix: str = "") -> Iterator[Setting]:
    """Settings of a section, those of groups within it behind them."""
    for name, field in section.model_fields.items():
        key = prefix + name
        yield _setting(key, field)
        for inner in _groups(field.annotation):
            if inner is not section:
                yield from settings_of(inner, f"{key}{_step(field.annotation)}.")


def _setting(key: str, field: FieldInfo) -> Setting:
    unit = unit_of(key, field.description or "")
    return Setting(
        key=key,
        kind=kind_of(field.annotation),
        default=_default(field),
        allowed=_allowed(field),
        unit=unit,
        sentence=_sentence(field.description or _about(field.annotation)),
    )


def unit_of(key: str, description: str) -> str:
    """Unit of a setting, by the end of its name or of its description; may be empty."""
    words = key.rpartition(".")[2].split("_")
    for first in range(1, len(words)):
        unit = _UNITS.get("_".join(words[first:]))
        if unit:
            return unit
    tail = description.partition(";")[0].rpartition(", ")[2]
    return tail.replace("2", "²") if tail in _TAILS else ""


def _sentence(description: str) -> str:
    head, _, tail = description.rpartition(", ")
    return head if head and tail in _TAILS else description


def _about(annotation: Any) -> str:
    groups = list(_groups(annotation))
    return (groups[0].__doc__ or "").split("\n")[0].rstrip(".") if groups else ""


def kind_of(annotation: Any) -> str:
    """Type of a setting in words."""
    origin, parts = get_origin(annotation), get_args(annotation)
    if origin is Annotated:
        return kind_of(parts[0])
    if origin in (Union, UnionType):
        kinds = dict.fromkeys(kind_of(part) for part in parts if part is not NoneType)
        return " or ".join(kinds)
    if origin is not None:
        return _kind_of_many(origin, parts)
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return "group"
    return _KINDS.get(annotation, getattr(annotation, "__name__", str(annotation)))


def _kind_of_many(origin: Any, parts: tuple[Any, ...]) -> str:
    """Type of a choice, a list or a mapping."""
    if origin is Literal:
        return "choice" if all(isinstance(part, str) for part in parts) else "number"
    if origin is dict:
        return f"mapping to {kind_of(parts[1])}"
    return f"list of {kind_of(parts[0])}"


def _default(field: FieldInfo) -> str:
    value = field.get_default(call_default_factory=True)
    if value is PydanticUndefined:
        return "required"
    if isinstance(value, BaseModel):
        return ""
    return code(shown(value))


def shown(value: Any) -> str:
    """Value as YAML has it."""
    if value is None or isinstance(value, bool):
        return {None: "null", True: "true", False: "false"}[value]
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(shown, value))}]"
    if isinstance(value, float):
        return f"{value:g}" if abs(value) < 1e5 else f"{value:.6g}"
    return '""' if value == "" else str(value)


def _allowed(field: FieldInfo) -> str:
    choices = list(_choices(field.annotation))
    if choices:
        return ", ".join(map(code, choices))
    parts = [*field.metadata, *_constraints(field.annotation)]
    bounds = [
        f"{sign} {getattr(part, name):g}"
        for part in parts
        for name, sign in _SIGNS.items()
        if getattr(part, name, None) is not None
    ]
    least, most = _size(parts, "min_length"), _size(parts, "max_length")
    sizes = _entries(least, most)
    return ", ".join(dict.fromkeys(escaped(text) for text in [*bounds, *sizes]))


def _size(parts: list[Any], name: str) -> int | None:
    sizes = [getattr(part, name, None) for part in parts]
    return next((size for size in sizes if size is not None), None)


def _entries(least: int | None, most: int | None) -> list[str]:
    """How many entries a list may have."""
    if least is not None and least == most:
        return [f"{least} entries"]
    lower = [] if least is None else [f"at least {least}"]
    return [*lower, *([] if most is None else [f"at most {most}"])]


def _constraints(annotation: Any) -> Iterator[Any]:
    """What `Annotated` says within a union or a list."""
    if get_origin(annotation) is Annotated:
        for part in get_args(annotation)[1:]:
            yield from part.metadata if isinstance(part, FieldInfo) else (part,)
    for inner in get_args(annotation):
        if inner is not annotation and get_origin(inner) is not None:
            yield from _constraints(inner)


def _choices(annotation: Any) -> Iterator[str]:
    if get_origin(annotation) is Literal:
        yield from map(str, get_args(annotation))
        return
    for inner in get_args(annotation):
        yield from _choices(inner)


def _groups(annotation: Any) -> Iterator[type[BaseModel]]:
    """Sections that a type holds."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield annotation
        return
    for inner in get_args(annotation):
        yield from _groups(inner)


def _step(annotation: Any) -> str:
    """What stands between the name of a list or a mapping and the keys of its entries."""
    return {list: "[]", dict: ".<name>"}.get(get_origin(annotation) or object, "")


def settings_page() -> str:
    """Markdown of the whole reference."""
    alone = [name for name in Config.model_fields if not _section(name)]
    parts = [_INTRODUCTION, "## For the whole run\n\n"]
    parts.append(_table([_setting(name, Config.model_fields[name]) for name in alone]))
    for name in Settings.model_fields:
        section = _section(name)
        if section is not None:
            parts += [f"## {name}\n\n", _paragraph(section), _table(list(settings_of(section)))]
    parts += ["## Site file\n\n", _SITE, _table(list(_outside_plans(Site)))]
    parts += ["## Plan\n\n", _PLAN, _table(list(settings_of(Plan)))]
    return "".join(parts)


def _outside_plans(section: type[BaseModel]) -> Iterator[Setting]:
    plans = "placement.own_plans."
    return (setting for setting in settings_of(section) if not setting.key.startswith(plans))


def _section(name: str) -> type[BaseModel] | None:
    groups = list(_groups(Config.model_fields[name].annotation))
    return groups[0] if groups else None


def _paragraph(section: type[BaseModel]) -> str:
    return escaped((section.__doc__ or "").split("\n\n")[0]) + "\n\n"


def _table(settings: list[Setting]) -> str:
    rows = [
        (
            code(setting.key),
            setting.kind,
            setting.default,
            setting.allowed,
            setting.unit,
            escaped(setting.sentence),
        )
        for setting in settings
    ]
    return table(_HEAD, rows)


_INTRODUCTION = """\
# Settings

Every setting of `config/config.yaml`, from the schema that checks it. A site file overrides any of
them under `settings:`, and `snakemake --configfile my.yaml` for all sites. An unknown key, a value
out of range and a wrong type are refused with the nearest known name.

"""
_SITE = """\
One file in `config/sites` a site; `roadsight init CLOUD` writes it. Paths are relative to the file,
absolute, or begin with a `${VARIABLE}` of the environment.

"""
_PLAN = """\
An entry of `config/plans.yaml`, or of `placement.own_plans` of a site file.
[Plans](../placement/plans.md) explains each option.

"""
