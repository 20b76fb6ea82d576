"""Every parameter of a site as rows of tables, with its meaning from the schema."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from pydantic import BaseModel

from roadsight.base.sections import poles
from roadsight.config.schema import Settings
from roadsight.report.wording import label, lower_first, percent, quantity, seconds, short, unit
from roadsight.scene.classes import CLASS_NAMES


@dataclass(frozen=True)
class Row:
    """One line of a table.

    Parameters
    ----------
    key : dotted key. label : name for people. value : with unit. about : meaning, may be empty.
    """

    key: str
    label: str
    value: str
    about: str = ""


@dataclass(frozen=True)
class Group:
    """Rows under one heading."""

    title: str
    rows: list[Row]


def setting_groups(settings: dict[str, Any]) -> list[Group]:
    """Settings by section, in the order of the schema; what the schema lacks comes last."""
    order = _ordered(Settings, settings)
    general = [name for name in order if not isinstance(settings[name], dict)]
    groups = [
        Group("General", [_setting(Settings, name, settings[name], name) for name in general])
    ]
    for name in order:
        content = settings[name]
        if isinstance(content, dict):
            section = _section(name)
            about = None if section is BaseModel else section.__doc__
            keys = _ordered(section, content)
            rows = [_setting(section, key, content[key], f"{name}.{key}") for key in keys]
            groups.append(Group((about or label(name)).rstrip("."), rows))
    return [group for group in groups if group.rows]


def settings_asked_for(summary: dict[str, Any]) -> list[Group]:
    """Settings that have a say in what was asked for: those of poles only where there are any."""
    settings = summary["settings"]
    if "poles" not in summary:
        others = [name for name in settings if _section(name).__module__ != poles.__name__]
        settings = {name: settings[name] for name in others}
    return setting_groups(settings)


def figure_rows(figures: dict[str, Any], heading: str = "", unit_of: str = "") -> list[Row]:
    """Figures of any nesting as flat rows; None is left out.

    Parameters
    ----------
    heading, unit_of : name and unit of the enclosing figure, used where a key has no unit.
    """
    rows = []
    for key, value in figures.items():
        between = " " if key.isdigit() else ", "
        name = f"{heading}{between}{lower_first(label(key))}" if heading else label(key)
        if key.isdigit() and int(key) in CLASS_NAMES:
            name += f", {CLASS_NAMES[int(key)]}"
        if isinstance(value, dict):
            rows += figure_rows(value, name, unit(key) or unit_of)
        elif value is not None:
            rows.append(Row(key, name, quantity(key, value, unit_of)))
    return rows


def _setting(model: type[BaseModel], name: str, value: Any, key: str) -> Row:
    field = model.model_fields.get(name)
    about = "" if field is None else field.description or ""
    return Row(key, label(name), quantity(name, value), about)


def _ordered(model: type[BaseModel], content: dict[str, Any]) -> list[str]:
    """Keys in the order of the schema, then the others by name."""
    known = [name for name in model.model_fields if name in content]
    return known + sorted(set(content) - set(known))


def _section(name: str) -> type[BaseModel]:
    """Schema of a section; one without fields where the schema does not know it."""
    field = Settings.model_fields.get(name)
    annotation = None if field is None else field.annotation
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return annotation
    return BaseModel


# The table of physical effects: which were simulated, which were skipped, and why.

_UNITS = {"deg": "°", "m2": " m²"}  # Units as people write them, where plain text has others


def effect_rows(effects: dict[str, dict[str, Any]]) -> list[dict[str, Any]]:
    """Rows of the table, simulated effects first, each group in the order of its names.

    Parameters
    ----------
    effects : ``effects`` of summary.json, decisions by name.
    """
    rows = [_row(name, about) for name, about in sorted(effects.items())]
    return sorted(rows, key=lambda row: not row["simulated"])


def _row(name: str, about: dict[str, Any]) -> dict[str, Any]:
    unit = _UNITS.get(about["unit"], f" {about['unit']}" if about["unit"] else "")
    quantity = str(about["quantity"])
    return {
        "effect": label(name),
        "job": about["job"],
        "simulated": about["decision"] == "simulate",
        "quantity": quantity[:1].upper() + quantity[1:],
        "value": f"{short(about['value'])}{unit}",
        "threshold": f"{short(about['threshold'])}{unit}",
        "reason": about["reason"],
        "change": percent(about["expected_change"]),
        "seconds": seconds(about["expected_seconds"]),
    }
