"""Settings follow the cloud: nothing finer than the points can resolve (paper 1, Table 2 note)."""

from __future__ import annotations

COARSE_SPACING_M = 0.15
"""Above this spacing K1 neighbours reach over the roughness that tells a lawn from asphalt."""


def plan_spacing_m(points_per_m2: float) -> float:
    """Spacing of evenly spread points of a density; scan lines make the nearest ones closer."""
    return points_per_m2**-0.5


def uses_intensity(choice: str, spacing_m: float) -> bool:
    """Whether intensity is a cue: "use", "ignore", or "auto" by the spacing."""
    return choice == "use" or (choice == "auto" and spacing_m > COARSE_SPACING_M)
