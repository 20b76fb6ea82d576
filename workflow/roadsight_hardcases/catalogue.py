"""All hard cases."""

from __future__ import annotations

from roadsight_hardcases import (
    cameras,
    cover,
    edges,
    effects,
    geodesy,
    ground,
    images,
    lidar,
    normals,
    raster,
    rays,
    scores,
    track,
    walls,
)
from roadsight_hardcases.case import HardCase, cases_of

_MODULES = (
    geodesy,
    ground,
    normals,
    edges,
    lidar,
    walls,
    effects,
    cover,
    raster,
    track,
    images,
    cameras,
    rays,
    scores,
)


def all_cases() -> list[HardCase]:
    """Every case, in the order of the stages' work."""
    return [case for module in _MODULES for case in cases_of(module)]
