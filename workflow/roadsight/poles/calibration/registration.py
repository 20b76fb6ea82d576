"""Camera pose and lens from pairs of a pixel and a place that a person clicked (paper 2, 3.2.3)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import OptimizeResult, least_squares
from scipy.spatial.transform import Rotation

from roadsight.base.arrays import Floats
from roadsight.base.errors import InputError
from roadsight.geometry.cameras import attitude_deg, wrap_deg
from roadsight.poles.alignment.drift import axes
from roadsight.poles.alignment.pose import FOCAL, UNKNOWNS, Start

FEWEST_PAIRS = 4  # Seven unknowns, two numbers of each pair
_HFOVS_DEG = (8.0, 120.0)  # Horizontal fields of view from which starts are made
# One standard deviation of the log focal length about that of 60 degrees: it decides only where
# the pairs do not
_LOG_FOCAL_SIGMA = 1.0
_PIXEL_PX = 2.0  # One standard deviation of a click
# Starts that are refined, those that fit best: the best one may lead to a worse minimum
_STARTS = 5


@dataclass(frozen=True)
class Registration:
    """Pose and focal length from clicked pairs.

    Attributes
    ----------
    position_m : (3,) local metres. heading_deg, pitch_deg, roll_deg : as `geometry.cameras`.
    residuals_px : (n,) distance of each clicked pixel from its place's projection.
    covariance : (7, 7) of position (m), turn about camera x, y, z (radians), log focal length.
    """

    position_m: Floats
    heading_deg: float
    pitch_deg: float
    roll_deg: float
    focal_px: float
    residuals_px: Floats
    covariance: Floats

    @property
    def sigma(self) -> Floats:
        """One standard deviation of what ``covariance`` is of."""
        return np.sqrt(np.diag(self.covariance))


def register_camera(
    uv_px: ArrayLike,
    xyz_m: ArrayLike,
    width_px: int,
    height_px: int,
    centre_px: ArrayLike | None = None,
) -> Registration:
    """Pose and focal length that project places onto the clicked pixels.

    Starts from perspective-n-point solutions over a grid of focal lengths, then least squares
    over all seven unknowns.

    Parameters
    ----------
    uv_px : (n, 2). xyz_m : (n, 3) local metres, n >= 4 and better 6 or more, at several depths.
    centre_px : (2,) principal point, or None: the image's middle.

    Raises
    ------
    InputError : too few, equal or collinear pairs, or pairs that no camera can see together.
    """
    uv = np.asarray(uv_px, np.float64).reshape(-1, 2)
    xyz = np.asarray(xyz_m, np.float64).reshape(-1, 3)
    _check(uv, xyz)
    middle = (width_px - 1) / 2, (height_px - 1) / 2
    centre = np.asarray(middle if centre_px is None else centre_px, np.float64)
    origin = xyz.mean(axis=0)
    best, usual = None, np.log(0.5 * width_px / np.tan(np.radians(30.0)))
    far, near = np.log(0.5 * width_px / np.tan(np.radians(_HFOVS_DEG) / 2))
    starts = [
        (log_focal, start)
        for log_focal in np.linspace(far, near, 14)
        for start in _poses(uv - centre, xyz - origin, np.exp(log_focal))
    ]
    starts.sort(key=lambda one: _misfit(uv - centre, xyz - origin, *one))
    for log_focal, start in starts[:_STARTS]:
        fit = _refined(uv - centre, xyz - origin, start, log_focal, usual)
        # Better by more than rounding, so that of equal fits the first one stays.
        if fit is not None and (best is None or fit.cost < best.cost * (1 - 1e-9)):
            best = fit
    if best is None:
        raise InputError(
            "no camera sees all the clicked places",
            where="registration",
            hint="check that pixels and places are paired rightly",
        )
    return _result(best, origin, len(uv))


def _check(uv: Floats, xyz: Floats) -> None:
    where = "registration"
    if len(uv) != len(xyz) or len(uv) < FEWEST_PAIRS:
        raise InputError("too few clicked pairs", where=where, found=len(uv), allowed=">= 4")
    if not (np.isfinite(uv).all() and np.isfinite(xyz).all()):
        raise InputError("a clicked pair is not finite", where=where)
    for points, what in ((xyz, "places"), (uv, "pixels")):
        extent = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
        if extent[1] < 0.01 * extent[0] or extent[0] == 0:
            raise InputError(
                f"the clicked {what} lie on one line, which leaves the camera free to turn",
                where=where,
                hint="click places on both sides of the road and off the ground",
            )
    if len(np.unique(xyz.round(6), axis=0)) < FEWEST_PAIRS:
        raise InputError("fewer than 4 different places", where=where, allowed=">= 4")


def is_flat(xyz_m: ArrayLike) -> bool:
    """Whether places (n, 3) are within 1 % of a plane: the focal length then rests on little."""
    xyz = np.asarray(xyz_m, np.float64)
    extent = np.linalg.svd(xyz - xyz.mean(axis=0), compute_uv=False)
    return bool(extent[-1] < 0.01 * extent[0])


def _poses(uv: Floats, xyz: Floats, focal: float) -> list[Floats]:
    """Rotation vector and translation (6,) of each perspective-n-point solution."""
    matrix = np.diag([focal, focal, 1.0])
    ways = [cv2.SOLVEPNP_EPNP, cv2.SOLVEPNP_SQPNP]
    if is_flat(xyz):
        ways = [cv2.SOLVEPNP_IPPE, cv2.SOLVEPNP_SQPNP]
    found = []
    for way in ways:
        try:
            _, turns, shifts, _ = cv2.solvePnPGeneric(xyz, uv, matrix, None, flags=way)
        except cv2.error:
            continue
        pairs = zip(turns, shifts, strict=True)
        found += [np.concatenate([turn.ravel(), shift.ravel()]) for turn, shift in pairs]
    return [pose for pose in found if np.isfinite(pose).all()]


def _misfit(uv: Floats, xyz: Floats, log_focal: float, start: Floats) -> float:
    """Sum of squared distances of a start, in pixels; infinite if a place is behind."""
    camera = _seen_from(start, xyz)
    if (camera[:, 2] <= 0).any():
        return np.inf
    gap = np.exp(log_focal) * camera[:, :2] / camera[:, 2:] - uv
    return float((gap**2).sum())


def _refined(
    uv: Floats, xyz: Floats, start: Floats, log_focal: float, usual: float
) -> OptimizeResult | None:
    """Least squares over turn, shift and log focal length; None if a place is behind."""

    def misfit(unknowns: Floats) -> Floats:
        camera = _seen_from(unknowns, xyz)
        depth = np.maximum(camera[:, 2], 1e-3)
        gap = np.exp(unknowns[6]) * camera[:, :2] / depth[:, None] - uv
        # A place behind the camera pulls it back, the more, the further behind.
        gap += 1e3 * np.maximum(1e-3 - camera[:, 2:], 0.0)
        lens = _PIXEL_PX * (unknowns[6] - usual) / _LOG_FOCAL_SIGMA
        return np.append(gap.ravel(), lens)

    if (_seen_from(start, xyz)[:, 2] <= 0).any():
        return None
    # Radians, metres, and the log of the focal length.
    scale = [0.1, 0.1, 0.1, 1.0, 1.0, 1.0, 0.1]
    fit = least_squares(misfit, np.append(start, log_focal), method="lm", x_scale=scale)
    well = np.isfinite(fit.x).all() and (_seen_from(fit.x, xyz)[:, 2] > 0).all()
    return fit if well else None


def _seen_from(unknowns: Floats, xyz: Floats) -> Floats:
    return Rotation.from_rotvec(unknowns[:3]).apply(xyz) + unknowns[3:6]


def _result(fit: OptimizeResult, origin: Floats, pairs: int) -> Registration:
    turn = Rotation.from_rotvec(fit.x[:3])
    position = -turn.inv().apply(fit.x[3:6])
    residuals = np.hypot(*fit.fun[: 2 * pairs].reshape(-1, 2).T)
    # With few pairs the residuals say little: a click is good to two pixels, at best.
    freedom = 2 * pairs - 7
    scale_px = max(_PIXEL_PX, np.sqrt((residuals**2).sum() / freedom) if freedom > 0 else 0.0)
    jacobian = fit.jac
    covariance = np.linalg.pinv(jacobian.T @ jacobian) * scale_px**2
    # From rotation vector and shift to turn about the camera's axes and position.
    change = np.zeros((7, 7))
    # Turn about fixed axes for a small change of the rotation vector (left Jacobian).
    step, back = 1e-6, turn.inv()
    columns = [
        (Rotation.from_rotvec(fit.x[:3] + step * axis) * back).as_rotvec() / step
        for axis in np.eye(3)
    ]
    to_turn = np.column_stack(columns)
    matrix = turn.as_matrix()
    change[:3, 3:6] = -matrix.T
    moved = np.cross(np.eye(3), fit.x[3:6])
    change[:3, :3] = matrix.T @ moved.T @ to_turn
    change[3:6, :3] = to_turn
    change[6, 6] = 1.0
    heading, pitch, roll = attitude_deg(matrix)
    return Registration(
        position + origin,
        float(heading),
        float(pitch),
        float(roll),
        float(np.exp(fit.x[6])),
        residuals,
        change @ covariance @ change.T,
    )


# The camera of a vehicle from registered images: what calibration takes as a baseline.

# An image differs from the drive by the track's error and the vehicle's sway: a baseline of few
# images is no better than that.
# Along, lateral, height (m), yaw, pitch, roll (degrees) and log focal length: the spread of a
# drive's images (`Spread`), but for the lens, which does not change
_SWAY = np.array([1.0, 1.0, 0.07, 0.5, 0.5, 0.3, 0.0])
# Least standard deviations of a baseline in the same order
_LEAST = np.array([0.05, 0.05, 0.02, 0.05, 0.05, 0.05, 0.002])


def mounted(found: Registration, start: Start) -> tuple[Floats, Floats]:
    """Unknowns (7,) of `pose.UNKNOWNS` before the insets, and their standard deviations.

    The inverse of `pose.pose_of` for a camera that was registered.

    Parameters
    ----------
    start : where the track says that the vehicle was, in the frame of the registration.
    """
    turn = axes(start.heading_deg)
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
