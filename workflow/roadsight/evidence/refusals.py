"""Settings at which a metric has no meaning, told before anything runs."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from roadsight.base.errors import InputError
from roadsight.evidence.metrics import METRICS
from roadsight.evidence.posed_truth import RCS_M2, TARGET
from roadsight.placement.sensors.poses import AS_MOUNTED, turns_of
from roadsight.placement.sensors.sensors import AnySensor, Sensor
from roadsight.placement.sight.detection import MIN_BEAMS

_SEEN_BY = {
    "kind": "cylinder",
    "radius_m": TARGET.radius_m,
    "height_m": TARGET.height_m,
    "min_beams": MIN_BEAMS,
    "rcs_m2": RCS_M2,
}
"""Settings of targets that exact ranges are judged by."""


def refuse_other_targets(metrics: Iterable[str], targets: Mapping[str, Any]) -> None:
    """Check that metrics are asked for whose truth holds for a site's targets.

    Parameters
    ----------
    metrics : names. targets : section ``targets`` of the settings.

    Raises
    ------
    InputError : the truth of one is of the default targets, and these are others.
    """
    judged = [name for name in metrics if METRICS[name].default_targets]
    others = {
        f"targets.{key}": targets[key]
        for key, usual in _SEEN_BY.items()
        if judged and targets[key] != usual
    }
    if others:
        raise InputError(
            "judges the default targets only",
            where=f"metric {', '.join(judged)}",
            found=", ".join(f"{key}: {value}" for key, value in others.items()),
            allowed=", ".join(f"{key}: {_SEEN_BY[key.removeprefix('targets.')]}" for key in others),
            hint="leave these settings out, or measure something else",
        )


def refuse_sensors_without_maps(
    metrics: Iterable[str], sensors: Mapping[str, AnySensor], spinning: Mapping[str, list[float]]
) -> None:
    """Check that a plan has the depth maps that metrics read.

    Parameters
    ----------
    metrics : names. sensors : of the plan. spinning : setting ``poses.spinning``: yaw_deg,
        pitch_deg, roll_deg.

    Raises
    ------
    InputError : no sensor of the plan has depth maps of its own, since all are judged in poses.
    """
    readers = [name for name in metrics if METRICS[name].depth_maps]
    spin = any(isinstance(sensor, Sensor) for sensor in sensors.values())
    if readers and not (spin and turns_of(**spinning) == [AS_MOUNTED]):
        raise InputError(
            "reads depth maps of spinning LiDARs as mounted, and the plan places none",
            where=f"metric {', '.join(readers)}",
            found=", ".join(sensors) + (f" in the poses {dict(spinning)}" if spin else ""),
            hint="name a plan with such a sensor, or measure targets_lost or sensors",
        )
