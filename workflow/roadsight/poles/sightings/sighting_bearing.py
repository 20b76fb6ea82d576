"""Bearings of pixels with their uncertainty, and what LiDAR says about them (paper 2, 3.3.2)."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial import cKDTree

from roadsight.base.arrays import Floats, Ints
from roadsight.geometry.cameras import (
    Intrinsics,
    azimuth_deg,
    cam_from_world,
    compass_deg,
    pixel_directions,
    project,
    wrap_deg,
)
from roadsight.poles.images.views import turned
from roadsight.poles.sightings.lidar_poles import PoleColumns

_STEP_DEG = 0.01  # step of the numeric derivative by pitch
_STEP_RATIO = 1e-4  # step of the numeric derivative by focal length
# Columns of sightings that hold what `turned_by_camera` gives.
TURNED_COLUMNS = ("bearing_by_cx_deg", "bearing_by_focal_deg", "bearing_by_heading_deg")
# Column of the part of a bearing's sigma that neither these nor the camera's place make up.
OWN_COLUMN = "sigma_own_bearing_deg"
# Standard deviations by which a bearing and a column may differ: with a wider gate more sightings
# meet two columns and snap to none.
SNAP_SIGMAS = 2.0
# Least height of what is seen of a pole whose foot is hidden: lower things are mostly pieces of
# masks (rural sample: 9 of 10 new matches are poles with this, 9 of 14 without).
_TALL_M = 3.0
SNAP_DEPTHS = 3.0  # standard deviations by which their distances may differ
# Share by which the distances of both may differ: sigma alone lets far ones match anything.
_DEPTH_SHARE = 0.3
# Height of grass and bushes that hide a foot, m. What is seen of such a pole ends above its foot,
# and the ray there meets the ground up to twice as far away: on a generated road five of 31 poles
# were lost so, with feet 0.4 to 1 m up.
_HIDDEN_M = 1.2
# Posts end this near to the upper edge of the panel that they hold: they seldom stand out by more,
# and the cloud may miss their last returns.
_PANEL_TOP_M = 0.5


@dataclass(frozen=True)
class ViewCamera:
    """Camera of one view with the uncertainty of its pose.

    Parameters
    ----------
    intrinsics : of this view. position_m : (3,), local metres. heading_deg, pitch_deg, roll_deg :
    of the front camera. yaw_deg : of this view from it. sigma_heading_deg, sigma_pitch_deg,
    sigma_lateral_m, sigma_along_m : 1 sigma; across and along the front camera's heading.
    sigma_cx_px : 1 sigma of the principal point. heading_by_cx_deg : the part of the heading's
    sigma that goes with it: another point turns the camera. sigma_focal_ratio : 1 sigma of the
    focal length as a share of it. heading_by_focal_deg : the part of the heading's that goes with
    it. sigma_yaw_deg : 1 sigma of this view's yaw.
    """

    intrinsics: Intrinsics
    position_m: tuple[float, float, float]
    heading_deg: float
    pitch_deg: float = 0.0
    roll_deg: float = 0.0
    yaw_deg: float = 0.0
    sigma_heading_deg: float = 0.0
    sigma_pitch_deg: float = 0.0
    sigma_lateral_m: float = 0.0
    sigma_along_m: float = 0.0
    sigma_cx_px: float = 0.0
    heading_by_cx_deg: float = 0.0
    sigma_focal_ratio: float = 0.0
    heading_by_focal_deg: float = 0.0
    sigma_yaw_deg: float = 0.0

    @property
    def own_heading_deg(self) -> float:
        """What is left of the heading's sigma without the lens' part."""
        by_lens2 = self.heading_by_cx_deg**2 + self.heading_by_focal_deg**2
        return float(np.sqrt(max(self.sigma_heading_deg**2 - by_lens2, 0.0)))

    def rotation(self, pitch_more_deg: float = 0.0) -> Floats:
        """cam_from_world (3, 3), pitched up by some more."""
        front = cam_from_world(self.heading_deg, self.pitch_deg + pitch_more_deg, self.roll_deg)
        return turned(front, self.yaw_deg)

    def rays(self, uv_px: ArrayLike, pitch_more_deg: float = 0.0) -> Floats:
        """Unit directions (n, 3) in the local frame of pixels (n, 2)."""
        return pixel_directions(self.intrinsics, self.rotation(pitch_more_deg), uv_px)

    def sigma_across_m(self, bearing_deg: ArrayLike) -> Floats:
        """Uncertainty (n,) of the camera's place across directions of grid bearing."""
        apart = np.radians(np.asarray(bearing_deg, np.float64) - self.heading_deg)
        return np.hypot(np.cos(apart) * self.sigma_lateral_m, np.sin(apart) * self.sigma_along_m)

    def sigma_towards_m(self, bearing_deg: ArrayLike) -> Floats:
        """Uncertainty (n,) of the camera's place along directions of grid bearing."""
        apart = np.radians(np.asarray(bearing_deg, np.float64) - self.heading_deg)
        return np.hypot(np.sin(apart) * self.sigma_lateral_m, np.cos(apart) * self.sigma_along_m)


def ray_bearing_deg(rays: Floats) -> Floats:
    """Grid bearing (n,) in [0, 360) of directions (n, 3)."""
    return compass_deg(np.degrees(np.arctan2(rays[:, 0], rays[:, 1])))


def image_bearings(
    camera: ViewCamera, uv_px: ArrayLike, sigma_u_px: ArrayLike
) -> tuple[Floats, Floats]:
    """Grid bearings of pixels (n, 2) and their sigma (n,), degrees.

    Sigma has the pixel's own error, the lens' and the heading's (`turned_by_camera`), the view's
    yaw and what an error of pitch turns the ray by; the camera's place is not in it, because that
    needs the distance (`with_place`).
    """
    uv = np.asarray(uv_px, np.float64).reshape(-1, 2)
    bearing = ray_bearing_deg(camera.rays(uv))
    tilted = ray_bearing_deg(camera.rays(uv, pitch_more_deg=_STEP_DEG))
    per_pitch = wrap_deg(tilted - bearing) / _STEP_DEG
    parts = np.array(
        [
            np.asarray(sigma_u_px, np.float64) * _per_px(camera, uv, bearing),
            *turned_by_camera(camera, uv).T,
            per_pitch * camera.sigma_pitch_deg,
            np.full(len(uv), camera.sigma_yaw_deg),
        ]
    )
    return bearing, np.sqrt((parts**2).sum(axis=0))


def turned_by_camera(camera: ViewCamera, uv_px: ArrayLike) -> Floats:
    """Degrees by which bearings of pixels are off (n, 3), signed, if the camera is off by 1 sigma.

    By the principal point, which the heading mostly undoes, and by the focal length, which turns
    what lies left of the middle one way and what lies right of it the other: all images of a drive
    share these. By what is left of the heading, which near images share.
    """
    uv = np.asarray(uv_px, np.float64).reshape(-1, 2)
    bearing = ray_bearing_deg(camera.rays(uv))
    longer = camera.intrinsics.focal_px * (1.0 + _STEP_RATIO)
    other = replace(camera, intrinsics=replace(camera.intrinsics, focal_px=longer))
    per_ratio = wrap_deg(ray_bearing_deg(other.rays(uv)) - bearing) / _STEP_RATIO
    by_cx = camera.heading_by_cx_deg - camera.sigma_cx_px * _per_px(camera, uv, bearing)
    by_focal = camera.heading_by_focal_deg + camera.sigma_focal_ratio * per_ratio
    return np.column_stack([by_cx, by_focal, np.full(len(uv), camera.own_heading_deg)])


def _per_px(camera: ViewCamera, uv: Floats, bearing_deg: Floats) -> Floats:
    """Degrees of bearing (n,) for a pixel to the right."""
    beside = ray_bearing_deg(camera.rays(np.add(uv, (0.5, 0.0))))
    return wrap_deg(beside - bearing_deg) * 2.0


def with_place(
    camera: ViewCamera, bearing_deg: ArrayLike, sigma_deg: ArrayLike, depth_m: ArrayLike
) -> Floats:
    """Sigma (n,) of bearings, with the camera's place as it shows at a distance."""
    across = camera.sigma_across_m(bearing_deg) / np.maximum(np.asarray(depth_m, float), 1.0)
    return np.hypot(sigma_deg, np.degrees(np.arctan(across)))


def nearest_projected(camera: ViewCamera, points_m: Floats, uv_px: Floats) -> Ints:
    """Number (n,) of the point whose projection is nearest to each foot, -1 where none is in view.

    The study's way to a bearing (section 3.3.2): nothing limits how near it is.

    Parameters
    ----------
    points_m : (m, 3), local metres. uv_px : feet (n, 2).
    """
    seen, _ = project(camera.intrinsics, camera.rotation(), camera.position_m, points_m)
    inside = np.flatnonzero(camera.intrinsics.contains(seen))
    if not len(inside):
        return np.full(len(uv_px), -1, np.int64)
    return np.asarray(inside[cKDTree(seen[inside]).query(uv_px)[1]], np.int64)


def matching_columns(
    camera: ViewCamera,
    columns: PoleColumns,
    bearing_deg: Floats,
    sigma_deg: Floats,
    depth_m: Floats,
    sigma_depth_m: Floats,
    farthest_m: float,
    rises: Floats | None = None,
    tops: Floats | None = None,
) -> Ints:
    """Number of the only pole-like column that agrees with each sighting, -1 if none or several.

    It agrees in bearing within two sigmas, its own and the camera's place included, and in distance
    within three sigmas and 30 % where a distance is known. A visible foot lies at or beyond the
    true one: where no column agrees so, the only one in the direction that is nearer does if what
    is seen would end less than 1.2 m above its ground and be 3 m tall. A panel has no foot: it is
    on the post that ends where it does.

    Parameters
    ----------
    rises : (n, 2) rise per metre of the rays of foot and top, NaN where the foot tells no distance.
    tops : (n,) rise per metre of the ray of a panel's upper edge, NaN for what is no panel.
    """
    matches = np.full(len(bearing_deg), -1, np.int64)
    offset = columns.xy_m - np.asarray(camera.position_m[:2])
    away = np.hypot(offset[:, 0], offset[:, 1])
    near = np.flatnonzero((away > 1.0) & (away <= farthest_m))
    if not len(near):
        return matches
    direction, away = azimuth_deg(np.zeros(2), offset[near]), away[near]
    for i in range(len(bearing_deg)):
        sigma = np.hypot(
            with_place(camera, direction, sigma_deg[i], away),
            np.degrees(np.arctan(columns.sigma_m[near] / away)),
        )
        agrees = np.abs(wrap_deg(direction - bearing_deg[i])) <= SNAP_SIGMAS * sigma
        if np.isfinite(depth_m[i]):
            spread = np.sqrt(
                sigma_depth_m[i] ** 2
                + columns.sigma_m[near] ** 2
                + camera.sigma_towards_m(direction) ** 2
            )
            apart = np.abs(away - depth_m[i])
            as_far = agrees & (apart <= SNAP_DEPTHS * spread) & (apart <= _DEPTH_SHARE * away)
            if rises is not None and len(columns.z_ground_m) and not as_far.any():
                ground_m = columns.z_ground_m[near] - camera.position_m[2]
                up_m, tall_m = rises[i, 0] * away - ground_m, (rises[i, 1] - rises[i, 0]) * away
                as_far = agrees & (away < depth_m[i]) & (up_m >= 0.0) & (up_m <= _HIDDEN_M)
                as_far &= tall_m >= _TALL_M
            agrees = as_far
        if tops is not None and np.isfinite(tops[i]):
            up_m = tops[i] * away + camera.position_m[2]
            post_m = columns.z_ground_m[near] + columns.top_m[near]
            agrees = agrees & (np.abs(up_m - post_m) <= _PANEL_TOP_M)
        found = np.flatnonzero(agrees)
        if len(found) == 1:
            matches[i] = near[found[0]]
    return matches
