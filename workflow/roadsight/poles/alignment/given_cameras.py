"""Cameras that come with a videolog: poses nobody has to find, checked against the road."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from roadsight.poles.alignment.pose import FOCAL, HEIGHT, INSETS, PITCH, ROLL, SIZE, Start
from roadsight.poles.alignment.roadside import NearEdges
from roadsight.poles.alignment.solve import FINEST, ImageEdges, Noise, Task, descend
from roadsight.poles.alignment.verdict import Limits, too_little
from roadsight.poles.calibration.calibration import weak_mount

# Scale, in standard deviations, at which the descent starts. Only the insets are free, so that it
# need not reach as far as a search for a pose.
_COARSE = 12.0
_FIXED = 1e10  # Inverse variance of a number that must not move: a standard deviation of 1e-5


@dataclass(frozen=True)
class GivenSigma:
    """One standard deviation of given poses where their table states none.

    Defaults: a survey vehicle with inertial navigation.
    """

    heading_deg: float = 0.05
    pitch_deg: float = 0.05
    lateral_m: float = 0.1
    along_m: float = 0.1


def given_task(
    pose: pd.Series, size_px: tuple[int, int], image_edges: ImageEdges, map_edges: NearEdges
) -> Task:
    """The image as an alignment sees it, its pose fixed to the given one.

    Parameters
    ----------
    pose : x, y, z (local metres), heading_deg (grid), pitch_deg, roll_deg, focal_px, cx_px, cy_px.
    """
    x, y, z = (float(pose[name]) for name in ("x", "y", "z"))
    heading, cx, cy = (float(pose[name]) for name in ("heading_deg", "cx_px", "cy_px"))
    start = Start(x, y, z, heading, 0.0, 0.0, *size_px, cx, cy)
    unknowns = np.zeros(SIZE)
    unknowns[[HEIGHT, PITCH, ROLL, FOCAL]] = (
        0.0,
        float(pose["pitch_deg"]),
        float(pose["roll_deg"]),
        np.log(float(pose["focal_px"])),
    )
    weak = weak_mount(None, size_px[0])
    unknowns[INSETS:] = weak.mean[INSETS:]
    # The pose is fixed; how far paint and borders lie inside the road's edge is not.
    information = np.full(SIZE, _FIXED)
    information[INSETS:] = 1.0 / np.diag(weak.covariance)[INSETS:]
    return Task(start, image_edges, map_edges, Noise(), unknowns, np.diag(information))


def agreement(
    pose: pd.Series, size_px: tuple[int, int], image_edges: ImageEdges, map_edges: NearEdges
) -> tuple[float, float]:
    """How a given pose agrees with the road: median distance, share of edge pixels that agree.

    Pixels of the image's road edges against the projected edges of the cloud, each across its
    edge, in pixels; a pixel agrees within three standard deviations of the alignment. Road that the
    cloud does not reach does not agree. NaN where image or cloud show too little road.
    """
    task = given_task(pose, size_px, image_edges, map_edges)
    if too_little(task, Limits()):
        return float("nan"), float("nan")
    residuals = descend(task, task.prior_mean, _COARSE).residuals
    known = np.isfinite(residuals[:, 0])
    if not known.any():
        return float("inf"), 0.0
    agree = np.where(known, residuals[:, 1], np.inf) < FINEST
    return float(np.median(np.abs(residuals[known, 0]))), float(agree.mean())


def camera_row(
    pose: pd.Series,
    size_px: tuple[int, int],
    sigma: GivenSigma,
    agrees: tuple[float, float],
    edge_points: int,
) -> dict[str, Any]:
    """Row of the table of cameras for a given pose, accepted as it stands."""
    names = ("x", "y", "z", "heading_deg", "pitch_deg", "roll_deg", "focal_px", "cx_px", "cy_px")
    stated = {
        f"sigma_{name}": float(pose.get(f"sigma_{name}", default))
        for name, default in vars(sigma).items()
    }
    return {
        **{name: float(pose[name]) for name in names},
        "width_px": size_px[0],
        "height_px": size_px[1],
        **stated,
        "residual_px": agrees[0],
        "edge_points": edge_points,
        "landmarks": 0,
        "one_sided": False,
        "accepted": True,
        "reason": "",
    }
