"""Distances of objects in one view: by the network, by the ground (paper 2, 3.3.1)."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from roadsight.base.arrays import Bools, Bytes, Floats
from roadsight.geometry.cameras import project
from roadsight.poles.images.kinds import PixelClass
from roadsight.poles.images.pole_masks import Instance
from roadsight.poles.sightings.metric_depth import (
    DepthFit,
    balancing_weights,
    fit_metric_depth,
    fit_published_depth,
)
from roadsight.poles.sightings.sighting_bearing import ViewCamera

HeightAt = Callable[[Floats, Floats], Floats]  # ground height (n,) at local x, y, NaN unknown
# Classes where a mask shows the terrain's own surface.
_ROAD = (PixelClass.ROAD, PixelClass.MARKING, PixelClass.KERB)
_FAN_RAYS = 61  # rays in plan over the field of view
_FAN_STEPS = 80  # places on each ray, their distances in equal ratios
# Nearest place: road nearer to the camera is below the image or under the vehicle.
_FAN_NEAR_M = 4.0
_FAN_FAR_M = 80.0  # farthest place: beyond, a pixel of road is metres long


def fit_view_depth(
    camera: ViewCamera, mask: Bytes, depth: NDArray[np.uint16], height_at: HeightAt
) -> DepthFit:
    """Fit of a view's relative depth to the road that it shows."""
    uv, z = road_points(camera, mask, height_at)
    relative = sample_depth(depth, uv, mask.shape)
    known = np.isfinite(relative)
    relative, z = relative[known], z[known]
    return fit_metric_depth(relative, z, balancing_weights(z))


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


_AXIS_SAMPLES = 60  # places on an object's axis at which depth is read
_FOOT_PART = 6  # the lowest of so many parts of an object gives its depth


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


_MARCH_FROM_M, _MARCH_M = 1.0, 0.25  # start and step of the march of a ray along the ground


def ground_distance_m(
    origin_m: ArrayLike, rays: Floats, height_at: HeightAt, farthest_m: float = 120.0
) -> Floats:
    """Horizontal distance (n,) at which rays first go below the ground; NaN if they do not.

    Parameters
    ----------
    origin_m : camera centre (3,), local metres. rays : directions (n, 3) in the local frame.
    height_at : the terrain. farthest_m : of the march along the ground.
    """
    origin = np.asarray(origin_m, np.float64)
    rays = np.asarray(rays, np.float64)
    level = np.hypot(rays[:, 0], rays[:, 1])
    with np.errstate(divide="ignore", invalid="ignore"):
        unit = rays / level[:, None]
    steps = np.arange(_MARCH_FROM_M, farthest_m + _MARCH_M, _MARCH_M)
    x = origin[0] + unit[:, :1] * steps
    y = origin[1] + unit[:, 1:2] * steps
    flat = np.isfinite(x) & np.isfinite(y)
    ground = height_at(np.where(flat, x, np.nan).ravel(), np.where(flat, y, np.nan).ravel())
    above = origin[2] + unit[:, 2:] * steps - ground.reshape(x.shape)
    crossed = (above[:, :-1] > 0) & (above[:, 1:] <= 0)
    first = np.argmax(crossed, axis=1)
    lines = np.arange(len(rays))
    before, after = above[lines, first], above[lines, first + 1]
    with np.errstate(divide="ignore", invalid="ignore"):
        distance = steps[first] + _MARCH_M * before / (before - after)
    return np.where(crossed.any(axis=1), distance, np.nan)


# Plants hide a foot if they are nearer than this share of the ground's distance.
_PLANTS_NEARER = 0.75


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
