"""Poles as the best set of groups of rays: every group is listed, the choice is exact.

The number of groups grows with the views of a pole and with how densely poles stand, so that 400
sightings take seconds; `explain` has replaced it. It is kept to compare with, as ``listing``.
"""

from __future__ import annotations

import numpy as np

from roadsight.base.arrays import Floats, Ints
from roadsight.poles.triangulate.explain import depth_scale
from roadsight.poles.triangulate.groups import build_groups, gains, locate_points
from roadsight.poles.triangulate.merging import merge_groups, places_of, weighted_mean
from roadsight.poles.triangulate.packing import choose_groups
from roadsight.poles.triangulate.rays import Rays, TriangulationSettings

_ROUNDS = 10
"""Rounds of grouping and scaling at most, should the factor go to and fro."""
_SETTLED = 0.01
"""The factor is found when it changes by less than this share."""


def choose_listed(
    rays: Rays, settings: TriangulationSettings
) -> tuple[list[Ints], Floats, Floats, float]:
    """Groups from west to east, their places (g, 2), covariances (g, 2, 2), and depth scale."""
    scale = _calibrated(rays, settings) if settings.calibrate_depth else 1.0
    scaled = rays.scaled(scale)
    groups = group_rays(scaled, settings)
    return groups, *places_of(locate_points(scaled, settings), groups), scale


def group_rays(rays: Rays, settings: TriangulationSettings) -> list[Ints]:
    """Ray numbers of each pole, poles from west to east and south to north."""
    levels = build_groups(rays, settings)
    members = [row for level in levels for row in level.members]
    if not members:
        return []
    gain = np.concatenate([gains(level, settings) for level in levels])
    chosen = [members[number] for number in choose_groups(members, gain, len(rays))]
    points = locate_points(rays, settings)
    merged = merge_groups(rays, points, chosen, settings)
    return sorted(merged, key=lambda group: tuple(weighted_mean(points, group)[0]))


def _calibrated(rays: Rays, settings: TriangulationSettings) -> float:
    """Factor of the depths, by turns of grouping and scaling; 1 without enough views."""
    scale = 1.0
    for _ in range(_ROUNDS):
        groups = group_rays(rays.scaled(scale), settings)
        latest = depth_scale(rays, groups, 1.0)
        if abs(latest / scale - 1) < _SETTLED:
            return latest
        scale = latest
    return scale
