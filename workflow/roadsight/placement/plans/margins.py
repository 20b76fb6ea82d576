"""What a plan would lose if its sensors reached less far: dark targets, a weaker sensor."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from roadsight.base.arrays import Bools, Floats
from roadsight.placement.sensors.aimed import Rosette
from roadsight.placement.sensors.light import reflectivity_range_m
from roadsight.placement.sensors.sensors import AnySensor, Sensor

DARK = 0.1
"""Reflectivity of dark targets: the second one at which data sheets state a range."""
SHORTER = 2 / 3
"""Of the range, what is left of it: ranges on data sheets hold for half of the pulses or more, in
good air, of a new sensor behind a clean window."""


def dark_range_m(sensor: AnySensor, range_m: float) -> float:
    """Range to dark targets; radars and cameras, which no reflectivity limits, keep theirs.

    Parameters
    ----------
    range_m : to the targets of the plan.
    """
    if not isinstance(sensor, Sensor | Rosette):
        return range_m
    return min(range_m, float(reflectivity_range_m(sensor, DARK)))


def distances_m(sensors_xyz_m: Floats, feet_m: Floats, height_m: float) -> Floats:
    """Distance of each sensor (s, 3) from the middle of each target (t, 3 or 4), (s, t)."""
    middle = feet_m[:, :3] + np.array([0.0, 0.0, height_m / 2])
    return np.asarray(np.linalg.norm(sensors_xyz_m[:, None] - middle[None], axis=2))


def margins(
    seen: Bools, distance_m: Floats, range_m: Floats, dark_m: Floats
) -> tuple[dict[str, Any], Bools, Bools]:
    """Targets that a plan sees and would not: if they were dark, or with a third less range.

    A sensor keeps the targets that it sees within the shorter range: beams beyond it are lost and
    no others. One at the very limit may lose some of its beams first; that is not looked at.

    Parameters
    ----------
    seen : (sensors, targets). distance_m : the same shape. range_m, dark_m : (sensors,).

    Returns
    -------
    ``dark`` and ``shorter``, each with the number and share of the seen targets that are lost; and
    (targets,) whether each is still seen then.
    """
    before = seen.any(axis=0)
    kept = [
        np.asarray((seen & (distance_m <= reach[:, None])).any(axis=0))
        for reach in (dark_m, SHORTER * range_m)
    ]
    count = max(int(before.sum()), 1)
    lost = [int((before & ~after).sum()) for after in kept]
    return (
        {
            "dark": {"reflectivity": DARK, "lost": lost[0], "share": lost[0] / count},
            "shorter": {"range_share": SHORTER, "lost": lost[1], "share": lost[1] / count},
        },
        kept[0],
        kept[1],
    )


def ranges_m(sensors: Sequence[AnySensor], reach_m: Sequence[float]) -> tuple[Floats, Floats]:
    """Ranges to the targets of the plan and to dark ones, (sensors,) each."""
    pairs = zip(sensors, reach_m, strict=True)
    dark = [dark_range_m(sensor, reach) for sensor, reach in pairs]
    return np.array(reach_m, np.float64), np.array(dark, np.float64)
