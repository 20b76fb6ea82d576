"""Settings follow the cloud: nothing finer than the points can resolve (paper 1, Table 2 note)."""

from __future__ import annotations

from dataclasses import replace

from roadsight.scene.ground import GroundSettings
from roadsight.scene.pavement import PavementSettings

COARSE_SPACING_M = 0.15
"""Above this spacing K1 neighbours reach over the roughness that tells a lawn from asphalt."""


def plan_spacing_m(points_per_m2: float) -> float:
    """Spacing of evenly spread points of a density; scan lines make the nearest ones closer."""
    return points_per_m2**-0.5


def ground_settings_for(spacing_m: float, settings: GroundSettings) -> GroundSettings:
    """Pillars and coarse cells at least two point spacings wide."""
    return replace(
        settings,
        pillar_width_m=max(settings.pillar_width_m, 2 * spacing_m),
        coarse_cell_m=max(settings.coarse_cell_m, 2 * spacing_m),
    )


def pavement_settings_for(column_m: float, settings: PavementSettings) -> PavementSettings:
    """Distances of the outline at least a few thinned columns wide."""
    return replace(
        settings,
        cluster_distance_m=max(settings.cluster_distance_m, 2.5 * column_m),
        vote_radius_m=max(settings.vote_radius_m, 3 * column_m),
        outline_cell_m=max(settings.outline_cell_m, column_m),
        closing_m=max(settings.closing_m, 4 * column_m),
    )


def uses_intensity(choice: str, spacing_m: float) -> bool:
    """Whether intensity is a cue: "use", "ignore", or "auto" by the spacing."""
    return choice == "use" or (choice == "auto" and spacing_m > COARSE_SPACING_M)
