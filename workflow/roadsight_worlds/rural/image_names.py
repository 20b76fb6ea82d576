"""Names of a rural road's images, which are known before any is taken.

Rules read them each time that they are listed: nothing slow is imported here.
"""

from __future__ import annotations

# Metres between two images of each route of a rural road: ahead and back.
STEPS_M = {"sr1427e": 8.0, "sr1427w": 16.0}


def image_names(length_m: float, every: int) -> list[str]:
    """Names of the front images on a rural road, every ``every``-th of each route."""
    return [
        f"{place_name(route, number + 1)}.jpg"
        for route, step_m in STEPS_M.items()
        for number in range(0, places_along(length_m, step_m), every)
    ]


def place_name(route: str, sequence: int) -> str:
    """Name of a place where images are taken, from 1 on."""
    return f"{route}_{sequence:04d}"


def places_along(length_m: float, step_m: float) -> int:
    """Number of places on a road of that length."""
    return int(length_m / step_m + 1e-9) + 1
