"""Every level that the schema offers: of each `Literal` and each switch, by section and field."""

import types
from typing import Annotated, Any, Literal, Union, get_args, get_origin

from pydantic import BaseModel

from roadsight.config.plans import Plan
from roadsight.config.schema import Settings
from roadsight.config.sites import Site
from roadsight.placement.sensors.sensors import Camera, Radar, Rosette, Sensor

Level = tuple[str, str]
"""Path of a field, ``section.field``, and one of its levels as text."""


def all_levels() -> set[Level]:
    """Levels of the settings, of site files, plans and kinds of sensors."""
    kinds = {("sensor", level) for kind in (Sensor, Camera, Radar, Rosette)
             for path, level in levels_of(kind) if path == "kind"}  # fmt: skip
    plans = {(f"plan.{path}", level) for path, level in levels_of(Plan)}
    site = {level for level in levels_of(Site) if not level[0].startswith("placement.own_plans")}
    return levels_of(Settings) | site | plans | kinds


def levels_of(model: type[BaseModel], path: str = "") -> set[Level]:
    """Levels of a section and of the sections in it."""
    found: set[Level] = set()
    for name, field in model.model_fields.items():
        own = f"{path}.{name}" if path else name
        found |= {(own, level) for level in _levels(field.annotation)}
        for section in _sections(field.annotation):
            found |= levels_of(section, own)
    return found


def _levels(kind: Any) -> list[str]:
    if get_origin(kind) is Literal:
        return [str(level) for level in get_args(kind)]
    if kind is bool:
        return ["True", "False"]
    if get_origin(kind) is Annotated:
        return _levels(get_args(kind)[0])
    if get_origin(kind) in (Union, types.UnionType, list, tuple, dict):
        return [level for part in get_args(kind) for level in _levels(part)]
    return []


def _sections(kind: Any) -> list[type[BaseModel]]:
    if isinstance(kind, type) and issubclass(kind, BaseModel):
        return [kind]
    return [section for part in get_args(kind) for section in _sections(part)]
