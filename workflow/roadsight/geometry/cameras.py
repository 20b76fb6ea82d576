"""Pinhole cameras: OpenCV axes (x right, y down, z forward), pixel centres at whole numbers.

A camera stands in the local frame (x east, y north, z up, metres). Its attitude is three angles in
degrees: **heading** clockwise from grid north, **pitch** upwards, **roll** with the right side up.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from roadsight.base.arrays import Bools, Floats


@dataclass(frozen=True)
class Intrinsics:
    """Square pixels, no distortion, principal point in the middle unless given.

    Parameters
    ----------
    width_px, height_px : size of the image.
    focal_px : focal length.
    cx_px, cy_px : principal point; pixel centres have whole coordinates.
    """

    width_px: int
    height_px: int
    focal_px: float
    cx_px: float
    cy_px: float

    @classmethod
    def centred(cls, width_px: int, height_px: int, focal_px: float) -> Intrinsics:
        """Intrinsics with the principal point in the middle of the image."""
        return cls(width_px, height_px, focal_px, (width_px - 1) / 2, (height_px - 1) / 2)

    @classmethod
    def from_field_of_view(cls, width_px: int, height_px: int, hfov_deg: float) -> Intrinsics:
        """Intrinsics from the horizontal field of view."""
        return cls.centred(width_px, height_px, 0.5 * width_px / np.tan(np.radians(hfov_deg) / 2))

    @property
    def hfov_deg(self) -> float:
        """Horizontal field of view of a centred camera with this focal length."""
        return float(np.degrees(2 * np.arctan2(0.5 * self.width_px, self.focal_px)))

    def contains(self, uv_px: ArrayLike, margin_px: float = 0.0) -> Bools:
        """Whether pixels (n, 2) lie in the image, or up to a margin outside it; NaN does not."""
        u, v = np.asarray(uv_px, np.float64).T
        low = -0.5 - margin_px  # pixel centres have whole coordinates: the image begins at -0.5
        return (
            (u >= low)
            & (u < self.width_px - 0.5 + margin_px)
            & (v >= low)
            & (v < self.height_px - 0.5 + margin_px)
        )


def wrap_deg(angle_deg: ArrayLike) -> Floats:
    """Angle in [-180, 180), for example of a difference of headings."""
    return (np.asarray(angle_deg, np.float64) + 180.0) % 360.0 - 180.0


def compass_deg(angle_deg: ArrayLike) -> Floats:
    """Angle in [0, 360)."""
    turned = np.asarray(angle_deg, np.float64) % 360.0
    # The remainder of a tiny negative angle rounds to 360 itself.
    return np.where(turned >= 360.0, 0.0, turned)


def azimuth_deg(from_xy_m: ArrayLike, to_xy_m: ArrayLike) -> Floats:
    """Direction (...) between places (..., 2), clockwise from grid north; NaN if equal."""
    east, north = np.moveaxis(np.asarray(to_xy_m, float) - np.asarray(from_xy_m, float), -1, 0)
    angle = compass_deg(np.degrees(np.arctan2(east, north)))
    return np.where((east == 0) & (north == 0), np.nan, angle)


def cam_from_world(heading_deg: ArrayLike, pitch_deg: ArrayLike, roll_deg: ArrayLike) -> Floats:
    """Rotations (..., 3, 3) whose rows are the camera's right, down and forward axes.

    Parameters
    ----------
    heading_deg, pitch_deg, roll_deg : attitude, any common shape.
    """
    h, p, r = (np.radians(np.asarray(a, np.float64)) for a in (heading_deg, pitch_deg, roll_deg))
    h, p, r = np.broadcast_arrays(h, p, r)
    zero = np.zeros_like(h)
    forward = np.stack([np.sin(h) * np.cos(p), np.cos(h) * np.cos(p), np.sin(p)], axis=-1)
    level_right = np.stack([np.cos(h), -np.sin(h), zero], axis=-1)
    level_down = np.cross(forward, level_right)
    cos_r, sin_r = np.cos(r)[..., None], np.sin(r)[..., None]
    right = cos_r * level_right - sin_r * level_down
    down = sin_r * level_right + cos_r * level_down
    return np.stack([right, down, forward], axis=-2)


def attitude_deg(rotation: ArrayLike) -> tuple[Floats, Floats, Floats]:
    """Heading in [0, 360), pitch and roll of rotations (..., 3, 3); inverse of `cam_from_world`."""
    axes = np.asarray(rotation, np.float64)
    right, forward = axes[..., 0, :], axes[..., 2, :]
    heading = np.degrees(np.arctan2(forward[..., 0], forward[..., 1]))
    # By the arc tangent: an arc sine of the rise loses half of the digits near the vertical.
    level = np.hypot(forward[..., 0], forward[..., 1])
    pitch = np.degrees(np.arctan2(forward[..., 2], level))
    roll = np.degrees(np.arctan2(right[..., 2], -axes[..., 1, 2]))
    return compass_deg(heading), pitch, roll


def project(
    intrinsics: Intrinsics, rotation: ArrayLike, position_m: ArrayLike, points_m: ArrayLike
) -> tuple[Floats, Floats]:
    """Pixels of points.

    Parameters
    ----------
    rotation : cam_from_world (3, 3). position_m : camera centre (3,), local metres.
    points_m : (n, 3), local metres.

    Returns
    -------
    uv_px : (n, 2), NaN for points that are not in front of the camera.
    depth_m : (n,) along the optical axis, negative behind the camera.
    """
    offset = np.asarray(points_m, np.float64) - np.asarray(position_m, np.float64)
    x, y, z = np.asarray(rotation, np.float64) @ offset.T
    in_front = z > 0.0
    safe = np.where(in_front, z, np.nan)
    u = intrinsics.cx_px + intrinsics.focal_px * x / safe
    v = intrinsics.cy_px + intrinsics.focal_px * y / safe
    return np.stack([u, v], axis=1), z


def pixel_directions(intrinsics: Intrinsics, rotation: ArrayLike, uv_px: ArrayLike) -> Floats:
    """Unit vectors (n, 3) in the local frame through pixels (n, 2)."""
    u, v = np.asarray(uv_px, np.float64).T
    x = (u - intrinsics.cx_px) / intrinsics.focal_px
    y = (v - intrinsics.cy_px) / intrinsics.focal_px
    rays = np.stack([x, y, np.ones_like(x)], axis=1) @ np.asarray(rotation, np.float64)
    return rays / np.linalg.norm(rays, axis=1, keepdims=True)
