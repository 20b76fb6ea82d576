"""Table of the sensors of ``config/sensors.yaml``."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import groupby
from pathlib import Path
from typing import Any

import yaml

from scripts.pages.markdown import escaped, table

_TITLES = {
    "spinning": "Spinning LiDARs",
    "rosette": "Solid-state LiDARs",
    "camera": "Cameras",
    "radar": "Radars",
}
_LEFT_OUT = ("kind", "like", "source")
_INTRODUCTION = """\
# Sensors

What `config/sensors.yaml` defines. A value that a sensor takes over from another one (`like`) is
shown as its own. [Sensors](../placement/sensors.md) explains the kinds and their keys, and how to
add one.

"""


def sensors_page(file: Path) -> str:
    """Markdown of all sensors by kind, one table a kind."""
    entries: Mapping[str, Mapping[str, Any]] = yaml.safe_load(file.read_text("utf-8"))["sensors"]
    full = {name: _resolved(name, entries) for name in entries}
    kinds = list(_TITLES)
    order = sorted(full, key=lambda name: kinds.index(_kind(full[name])))
    parts = [_INTRODUCTION]
    for kind, names in groupby(order, key=lambda name: _kind(full[name])):
        parts += [f"## {_TITLES[kind]}\n\n", *(_sensor(name, full[name]) for name in names)]
    return "".join(parts)


def _kind(sensor: Mapping[str, Any]) -> str:
    return str(sensor.get("kind", "spinning"))


def _resolved(name: str, entries: Mapping[str, Mapping[str, Any]]) -> dict[str, Any]:
    own = dict(entries[name])
    parent = own.get("like")
    return {**(_resolved(str(parent), entries) if parent else {}), **own}


def _sensor(name: str, sensor: Mapping[str, Any]) -> str:
    rows = [(f"`{key}`", _shown(value)) for key, value in sensor.items() if key not in _LEFT_OUT]
    like = f" Like `{sensor['like']}` in what is not stated." if sensor.get("like") else ""
    source = f"Source: {escaped(str(sensor['source']))}." if sensor.get("source") else ""
    about = f"{source}{like}".strip()
    return f"### {name}\n\n" + (f"{about}\n\n" if about else "") + table(("Key", "Value"), rows)


def _shown(value: Any) -> str:
    if isinstance(value, list):
        return ", ".join(map(_shown, value))
    return escaped(f"{value:g}" if isinstance(value, float) else str(value))
