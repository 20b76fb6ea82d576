"""The camera of a vehicle from registered images: what calibration takes as a baseline."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from roadsight.base.arrays import Floats
from roadsight.geometry.cameras import wrap_deg
from roadsight.poles.alignment.pose import FOCAL, UNKNOWNS, Start
from roadsight.poles.calibration.registration import Registration

# An image differs from the drive by the track's error and the vehicle's sway: a baseline of few
# images is no better than that.
_SWAY = np.array([1.0, 1.0, 0.07, 0.5, 0.5, 0.3, 0.0])
"""Along, lateral, height (m), yaw, pitch, roll (degrees) and log focal length: the spread of a
drive's images (`Spread`), but for the lens, which does not change."""
_LEAST = np.array([0.05, 0.05, 0.02, 0.05, 0.05, 0.05, 0.002])
"""Least standard deviations of a baseline in the same order."""


def mounted(found: Registration, start: Start) -> tuple[Floats, Floats]:
    """Unknowns (7,) of `pose.UNKNOWNS` before the insets, and their standard deviations.

    The inverse of `pose.pose_of` for a camera that was registered.

    Parameters
    ----------
    start : where the track says that the vehicle was, in the frame of the registration.
    """
    heading = np.radians(start.heading_deg)
    turn = np.array([[np.sin(heading), np.cos(heading)], [np.cos(heading), -np.sin(heading)]])
    along, lateral = turn @ (found.position_m[:2] - [start.x_m, start.y_m])
    height = found.position_m[2] - start.z_road_m - start.grade * along - start.bank * lateral
    road_heading = start.heading_deg + np.degrees(start.bend * along)
    road_pitch = np.degrees(np.arctan(start.grade) + start.hump * along)
    values = [
        along,
        lateral,
        height,
        float(wrap_deg(found.heading_deg - road_heading)),
        found.pitch_deg - road_pitch,
        found.roll_deg - np.degrees(np.arctan(start.bank)),
        np.log(found.focal_px),
    ]
    place = np.sqrt(np.diag(turn @ found.covariance[:2, :2] @ turn.T))
    # Turns about the camera's axes x, y, z are pitch, yaw and roll of a level camera.
    pitch, yaw, roll = np.degrees(found.sigma[3:6])
    return np.array(values), np.array([*place, found.sigma[2], yaw, pitch, roll, found.sigma[6]])


def baseline(images: Sequence[tuple[Registration, Start]]) -> dict[str, Any]:
    """Baseline of images of one size, each weighed by how well it was registered.

    Returns
    -------
    what `calibration_table.baseline_mount` takes, further how many images and clicked pairs it
    rests on and their root mean square distance
    """
    parts = [mounted(*image) for image in images]
    value = np.array([part[0] for part in parts])
    sigma = np.hypot(np.array([part[1] for part in parts]), _SWAY)
    weight = 1.0 / sigma**2
    mean = (weight * value).sum(axis=0) / weight.sum(axis=0)
    own = np.maximum(1.0 / np.sqrt(weight.sum(axis=0)), _LEAST)
    apart = np.concatenate([found.residuals_px for found, _ in images])
    names = UNKNOWNS[: FOCAL + 1]
    return {
        "focal_px": float(np.exp(mean[FOCAL])),
        **{name: float(v) for name, v in zip(names[:FOCAL], mean, strict=False)},
        "sigma": {name: float(v) for name, v in zip(names, own, strict=True)},
        "images": len(images),
        "pairs": len(apart),
        "rms_px": float(np.sqrt((apart**2).mean())),
    }
