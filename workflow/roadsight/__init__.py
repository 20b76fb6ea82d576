"""Roadside LiDAR placement and utility-pole mapping on one road scene."""

from __future__ import annotations

import importlib
from typing import Any

__version__ = "0.1.0"

_HOMES = {
    "read_cloud": "clouds",
    "ground": "scene",
    "pavement": "scene",
    "edges": "scene",
    "depth_map": "sight",
    "detection_matrix": "sight",
    "cover": "covers",
    "align": "alignment",
    "triangulate": "sightings",
    "estimate": "costs",
    "Cloud": "clouds",
    "Cover": "covers",
    "FoundRoad": "scene",
    "GroundFilter": "scene",
    "InputError": "clouds",
    "Sensor": "sight",
    "Targets": "sight",
    "TriangulationSettings": "sightings",
}
"""Module of `roadsight.api` that holds each function, and the types that they take, give and raise;
it is imported when it is first asked for, so that parts of the package work, and start, without
the rest. Types are in `__init__.pyi`."""

__all__ = [
    "Cloud",
    "Cover",
    "FoundRoad",
    "GroundFilter",
    "InputError",
    "Sensor",
    "Targets",
    "TriangulationSettings",
    "align",
    "cover",
    "depth_map",
    "detection_matrix",
    "edges",
    "estimate",
    "ground",
    "pavement",
    "read_cloud",
    "triangulate",
]


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(f"roadsight.api.{_HOMES[name]}"), name)


def __dir__() -> list[str]:
    return sorted([*globals(), *_HOMES])
