"""What the paper on pole geolocation reports of its own route (paper 2, sections 3.4 and 4)."""

from __future__ import annotations

from statistics import fmean

POLES = 180
"""Poles that the paper located."""
CHECKED = 29
"""Of them, those whose places were known."""
ROUTE_KM = 10.1
"""Length of its route."""
MEAN_M = 6.3
"""Mean distance between located and known poles."""
STD_M = 5.7
"""Standard deviation of this distance."""
WITHIN_75_M = 8.4
"""Three quarters of the poles lie within this distance."""
ACROSS_75_M = 2.1
"""Three quarters of the poles lie within this distance across the road."""

F1 = {3: 0.35, 5: 0.56, 7: 0.72, 9: 0.79, 11: 0.86, 15: 0.90, 16: 0.93}
"""F1 score by threshold in metres (Table 2)."""

_STRAIGHT, _CURVED, _INTERSECTION, _EXTRANEOUS = SCENARIOS = (
    "straight road", "curved road", "intersection", "extraneous features",
)  # fmt: skip
# Distances in metres (Table 3).
_ERRORS_M = {
    _STRAIGHT: (0.64, 1.09, 1.16, 1.89, 2.14, 2.24, 2.49, 2.67, 3.44, 4.46, 5.47, 6.91, 8.80,
                10.74, 14.18, 22.97),
    _CURVED: (1.04, 2.79, 3.38, 3.87, 4.39, 4.60, 5.32, 5.38, 5.54, 8.44, 10.32, 15.53, 21.08),
    _INTERSECTION: (1.09, 1.16, 2.79, 4.46, 5.47, 5.54),
    _EXTRANEOUS: (10.32, 10.74, 14.18, 22.97),
}  # fmt: skip

COMPONENTS = {
    "lidar_bearing": (
        "LiDAR-guided bearing",
        "essential: without it accuracy consistently drops",
    ),
    "alignment": (
        "Road-edge alignment",
        "critical where the camera's parameters are unknown",
    ),
    "occlusion": (
        "Occlusion filtering by ray casting",
        "optional in flat terrain, essential on slopes",
    ),
    "side_views": (
        "Side-view stitching",
        "essential for objects that only side views show",
    ),
    "deterministic_mrf": (
        "Deterministic triangulation",
        "essential for the same result in every run",
    ),
}
"""Title and what the paper says of each component (Table 1); it gives no numbers."""


def scenario_mean_m(scenario: str) -> tuple[int, float] | None:
    """Number of poles and mean error in metres that the paper has for a scenario, if any."""
    errors = _ERRORS_M.get(scenario.replace("_", " ").lower())
    return None if errors is None else (len(errors), fmean(errors))
