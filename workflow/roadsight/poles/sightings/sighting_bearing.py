"""Bearings of pixels with their uncertainty, and what LiDAR says about them (paper 2, 3.3.2)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import cKDTree

from roadsight.base.arrays import Bools, Bytes, Floats, Ints
from roadsight.geometry.cameras import (
    Intrinsics,
    azimuth_deg,
    cam_from_world,
    compass_deg,
    pixel_directions,
    project,
    wrap_deg,
)
from roadsight.poles.images.kinds import PixelClass
from roadsight.poles.images.pole_masks import Instance
from roadsight.poles.images.views import turned
from roadsight.poles.sightings.lidar_poles import PoleColumns
from roadsight.poles.sightings.metric_depth import (
    DepthFit,
    HeightAt,
    balancing_weights,
    fit_metric_depth,
    fit_published_depth,
    ground_distance_m,
)

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


# Distances of objects in one view: by the network, by the ground, by LiDAR (paper 2, 3.3.1).

# Classes where a mask shows the terrain's own surface.
_ROAD = (PixelClass.ROAD, PixelClass.MARKING, PixelClass.KERB)
_FAN_RAYS = 61  # rays in plan over the field of view
_FAN_STEPS = 80  # places on each ray, their distances in equal ratios
# Nearest place: road nearer to the camera is below the image or under the vehicle.
_FAN_NEAR_M = 4.0
_FAN_FAR_M = 80.0  # farthest place: beyond, a pixel of road is metres long
_AXIS_SAMPLES = 60  # places on an object's axis at which depth is read
_FOOT_PART = 6  # the lowest of so many parts of an object gives its depth
# Plants hide a foot if they are nearer than this share of the ground's distance.
_PLANTS_NEARER = 0.75


def sample_depth(depth: NDArray[np.uint16], uv_px: ArrayLike, shape: tuple[int, int]) -> Floats:
    """Relative depth (n,) in 0 to 1 at pixels (n, 2) of an image; NaN where unknown.

    Parameters
    ----------
    depth : map of any size, 0 = unknown. shape : rows and columns of the image.
    """
    uv = np.asarray(uv_px, np.float64).reshape(-1, 2)
    scale = np.array([depth.shape[1] / shape[1], depth.shape[0] / shape[0]])
    place = np.floor(np.where(np.isfinite(uv), uv + 0.5, -1.0) * scale).astype(np.int64)
    inside = ((place >= 0) & (place < [depth.shape[1], depth.shape[0]])).all(axis=1)
    column, row = np.where(inside[:, None], place, 0).T
    value = depth[row, column].astype(np.float64)
    return np.where(inside & (value > 0), value / 65535.0, np.nan)


def road_points(camera: ViewCamera, mask: Bytes, height_at: HeightAt) -> tuple[Floats, Floats]:
    """Pixels (n, 2) and depth along the axis (n,) of the terrain where the mask shows road.

    The terrain is sampled on a fan of rays in plan, at steps that grow with distance; what lies
    below the horizon of nearer terrain is hidden.
    """
    half = 0.5 * camera.intrinsics.hfov_deg
    heading = camera.heading_deg + camera.yaw_deg
    azimuth = np.radians(np.linspace(heading - half, heading + half, _FAN_RAYS))[:, None]
    distance = np.geomspace(_FAN_NEAR_M, _FAN_FAR_M, _FAN_STEPS)
    x = camera.position_m[0] + np.sin(azimuth) * distance
    y = camera.position_m[1] + np.cos(azimuth) * distance
    z = np.asarray(height_at(x.ravel(), y.ravel())).reshape(x.shape)
    rise = np.where(np.isfinite(z), (z - camera.position_m[2]) / distance, -np.inf)
    visible = np.isfinite(z) & (rise >= np.maximum.accumulate(rise, axis=1) - 1e-9)
    points = np.column_stack([x[visible], y[visible], z[visible]])
    uv, depth = project(camera.intrinsics, camera.rotation(), camera.position_m, points)
    good = camera.intrinsics.contains(uv)
    uv, depth = uv[good], depth[good]
    column, row = np.round(uv).astype(np.int64).T
    row, column = np.minimum(row, mask.shape[0] - 1), np.minimum(column, mask.shape[1] - 1)
    on_road = np.isin(mask[row, column], [int(c) for c in _ROAD])
    return uv[on_road], depth[on_road]


def fit_view_depth(
    camera: ViewCamera, mask: Bytes, depth: NDArray[np.uint16], height_at: HeightAt
) -> DepthFit:
    """Fit of a view's relative depth to the road that it shows."""
    uv, z = road_points(camera, mask, height_at)
    relative = sample_depth(depth, uv, mask.shape)
    known = np.isfinite(relative)
    relative, z = relative[known], z[known]
    return fit_metric_depth(relative, z, balancing_weights(z))


def fit_front_depth(
    camera: ViewCamera, depth: NDArray[np.uint16], road_m: Floats, farthest_m: float
) -> DepthFit:
    """The study's fit of a front view's relative depth to the cloud's road in it (section 3.3.1).

    Parameters
    ----------
    road_m : (n, 3) points of road and bridge, local metres. farthest_m : farther ones do not count.
    """
    lens = camera.intrinsics
    uv, z = project(lens, camera.rotation(), camera.position_m, road_m)
    good = lens.contains(uv) & (z < farthest_m)
    relative = sample_depth(depth, uv[good], (lens.height_px, lens.width_px))
    return fit_published_depth(relative, z[good])


def foot_distances(
    camera: ViewCamera,
    instances: Sequence[Instance],
    depth: NDArray[np.uint16],
    fit: DepthFit,
    shape: tuple[int, int],
) -> Floats:
    """Horizontal distance (n,) of objects by the network's depth at the pixel of the foot."""
    feet = _feet(instances)
    z, _ = fit.depth_m(sample_depth(depth, feet - [0.0, 0.5], shape))
    return z * _stretch(camera, feet)


def network_distances(
    camera: ViewCamera,
    instances: Sequence[Instance],
    depth: NDArray[np.uint16],
    fit: DepthFit,
    shape: tuple[int, int],
) -> tuple[Floats, Floats]:
    """Horizontal distance and sigma (n,) of objects by the network's depth, NaN if unknown.

    The depth of an object is that of its lowest sixth. Networks lose thin things against what is
    behind them, but not their foot, where the ground is as near; an upright object has one depth,
    so that half of the difference to the whole axis counts as error.
    """
    relative, spread = np.full(len(instances), np.nan), np.full(len(instances), np.nan)
    for i, one in enumerate(instances):
        v = np.linspace(one.v_min + 0.5, one.v_foot - 0.5, _AXIS_SAMPLES)
        along = sample_depth(depth, np.column_stack([one.axis_u(v), v]), shape)
        low = along[-_AXIS_SAMPLES // _FOOT_PART :]
        low, along = low[np.isfinite(low)], along[np.isfinite(along)]
        if len(low):
            relative[i] = np.median(low)
            own = 1.4826 * np.median(np.abs(low - relative[i]))
            spread[i] = np.hypot(own, 0.5 * (np.median(along) - relative[i]))
    z, sigma = fit.depth_m(relative, spread)
    stretch = _stretch(camera, _feet(instances))
    return z * stretch, sigma * stretch


def ground_distances(
    camera: ViewCamera,
    instances: Sequence[Instance],
    height_at: HeightAt,
    sigma_v_px: float,
    sigma_height_m: float,
    farthest_m: float,
) -> tuple[Floats, Floats]:
    """Horizontal distance and sigma (n,) where the ray of a foot meets the terrain.

    NaN where the foot is hidden: what is seen of such an object stands above the ground, and its
    ray meets it too far away. Sigma has the pixel, the pitch and the camera's height above ground.
    """
    feet = _feet(instances)
    sigma_pitch_px = np.radians(camera.sigma_pitch_deg) * camera.intrinsics.focal_px
    reach_px = float(np.hypot(sigma_v_px, sigma_pitch_px))

    def at(shift_px: float, lift_m: float = 0.0) -> Floats:
        rays = camera.rays(np.add(feet, (0.0, shift_px)))
        origin = np.add(camera.position_m, (0.0, 0.0, lift_m))
        return ground_distance_m(origin, rays, height_at, farthest_m=farthest_m)

    here = at(0.0)
    nearer, farther = here - at(reach_px), at(-reach_px) - here
    # A ray that misses the ground altogether says that the distance is open towards the far side.
    farther = np.where(np.isfinite(farther), farther, 2.0 * nearer)
    sigma = np.hypot(np.fmax(nearer, farther), np.nan_to_num(at(0.0, sigma_height_m) - here))
    hidden = np.array([one.foot == "hidden" for one in instances], bool)
    good = ~hidden & np.isfinite(here) & np.isfinite(sigma) & (sigma > 0)
    return np.where(good, here, np.nan), np.where(good, sigma, np.nan)


def behind_plants(
    camera: ViewCamera,
    instances: Sequence[Instance],
    depth: NDArray[np.uint16],
    fit: DepthFit,
    height_at: HeightAt,
    shape: tuple[int, int],
) -> Bools:
    """Whether plants below a foot (n,) rise above the ground, so that they hide it.

    Grass has the distance of the ground behind the same pixel; a bush is clearly nearer.
    """
    answer = np.zeros(len(instances), bool)
    doubtful = [i for i, one in enumerate(instances) if one.foot == "plants"]
    below = np.linspace(0.02, 0.08, 4) * shape[0]
    for i in doubtful:
        uv = _feet(instances)[i] + np.column_stack([np.zeros(len(below)), below])
        rays = camera.rays(uv)
        ground = ground_distance_m(camera.position_m, rays, height_at)
        z, _ = fit.depth_m(sample_depth(depth, uv, shape))
        seen = z * np.hypot(rays[:, 0], rays[:, 1]) / (rays @ camera.rotation()[2])
        share = (seen / ground)[np.isfinite(seen / ground)]
        answer[i] = len(share) > 0 and np.median(share) < _PLANTS_NEARER
    return answer


def _stretch(camera: ViewCamera, uv_px: Floats) -> Floats:
    """Horizontal distance (n,) over the depth along the optical axis, of pixels (n, 2)."""
    rays = camera.rays(uv_px)
    return np.asarray(np.hypot(rays[:, 0], rays[:, 1]) / (rays @ camera.rotation()[2]), np.float64)


def _feet(instances: Sequence[Instance]) -> Floats:
    return np.array([[one.u_foot, one.v_foot] for one in instances]).reshape(-1, 2)
