"""The commented default configuration, generated from the schema.

``python -m roadsight.config.render`` rewrites ``config/config.yaml``; a test compares the two.
"""

from __future__ import annotations

from pydantic import BaseModel
from pydantic.fields import FieldInfo

from roadsight.config.schema import Config
from roadsight.io.records.atomic import atomic_path

_HEAD = """\
# Settings of roadsight. Generated from the schema by `make config`: a site file may override any of
# them under `settings:`, and `snakemake --configfile my.yaml` any of them for all sites.
"""
# Settings that come first, before the sections; the rest keeps the order of the schema.
_FIRST = (
    "sites",
    "sensors_file",
    "plans_file",
    "effects_file",
    "tradeoffs_file",
    "plans",
    "overrides",
)


def render_config() -> str:
    """Text of ``config/config.yaml``."""
    fields = Config.model_fields
    order = [*_FIRST, *(name for name in fields if name not in _FIRST)]
    return _HEAD + "".join(_entry(name, fields[name]) for name in order)


def _entry(name: str, field: FieldInfo, indent: str = "") -> str:
    default = field.get_default()
    if isinstance(default, BaseModel) and indent:
        values = ", ".join(f"{key}: {_value(value)}" for key, value in default)
        return f"{indent}# {field.description}\n{indent}{name}: {{{values}}}\n"
    if isinstance(default, BaseModel):
        lines = [_entry(key, part, "  ") for key, part in type(default).model_fields.items()]
        about = (type(default).__doc__ or "").rstrip(".")
        return f"\n# {about}\n{name}:\n" + "".join(lines)
    allowed = _range(field)
    return f"{indent}# {field.description}{allowed}\n{indent}{name}: {_value(default)}\n"


def _value(value: object) -> str:
    if isinstance(value, list):
        return f"[{', '.join(map(_value, value))}]"
    if value is None:
        return "null"
    return f"{value:g}" if isinstance(value, float) and value < 1e5 else str(value)


def _range(field: FieldInfo) -> str:
    """Allowed range or choices, for the comment."""
    choices = getattr(field.annotation, "__args__", ())
    if choices and all(isinstance(choice, str) for choice in choices):
        return f" [{' | '.join(choices)}]"
    signs = {"gt": ">", "ge": ">=", "lt": "<", "le": "<="}
    bounds = [
        f"{sign} {getattr(part, name):g}"
        for part in field.metadata
        for name, sign in signs.items()
        if getattr(part, name, None) is not None
    ]
    return f" [{', '.join(bounds)}]" if bounds else ""


if __name__ == "__main__":
    with atomic_path("config/config.yaml") as temporary:
        temporary.write_text(render_config(), encoding="utf-8")
