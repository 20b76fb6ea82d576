"""Poles from rays: calibrate depths, build groups, choose among them, merge, state errors."""

from __future__ import annotations

import numpy as np
import pandas as pd
from scipy.spatial import cKDTree

from roadsight.base.arrays import Bools, Floats, Ints
from roadsight.poles.triangulate.groups import Points, build_groups, gains, locate_points
from roadsight.poles.triangulate.merging import merge_groups, weighted_mean
from roadsight.poles.triangulate.packing import choose_groups
from roadsight.poles.triangulate.rays import Rays, TriangulationSettings

_ROUNDS = 10
"""Rounds of grouping and scaling at most, should the factor go to and fro."""
_SETTLED = 0.01
"""The factor is found when it changes by less than this share."""
_FEWEST_DEPTHS = 30
"""Depths that the factor needs, as the median of their ratios."""
_SCALES = (0.5, 2.0)
"""Bounds of the factor: beyond, groups rather than depths are wrong."""
_WELL_CROSSED = 0.1
"""Least eigenvalue of the rays' normal matrix, a sum of squared sines: below, rays are so parallel
that bearings alone do not tell the distance."""

POLE_COLUMNS = [
    "x",
    "y",
    "score",
    "sigma_major_m",
    "sigma_minor_m",
    "sigma_azimuth_deg",
    "condition",
    "kept",
    "reason",
]


def group_rays(rays: Rays, settings: TriangulationSettings) -> list[Ints]:
    """Ray numbers of each pole, poles from west to east and south to north."""
    levels = build_groups(rays, settings)
    members = [row for level in levels for row in level.members]
    if not members:
        return []
    gain = np.concatenate([gains(level, settings) for level in levels])
    chosen = [members[number] for number in choose_groups(members, gain, len(rays))]
    points = locate_points(rays, settings)
    merged = merge_groups(rays, points, chosen, settings)
    return sorted(merged, key=lambda group: tuple(weighted_mean(points, group)[0]))


def triangulate(rays: Rays, settings: TriangulationSettings) -> tuple[pd.DataFrame, Ints, float]:
    """Poles with their errors.

    Returns
    -------
    poles : one row each, columns `POLE_COLUMNS`, local metres; ``score`` is the number of views,
        ``condition`` the ratio of the error ellipse's variances; poles too weak to use have
        ``kept`` False and a reason.
    pole of each ray : row in ``poles``, -1 for none; shape (n,).
    scale : what depths were multiplied by; 1 if not calibrated.
    """
    scale = calibrate_depths(rays, settings) if settings.calibrate_depth else 1.0
    scaled = rays.scaled(scale)
    groups = group_rays(scaled, settings)
    points = locate_points(scaled, settings)
    pole = np.full(len(rays), -1, np.int64)
    for number, members in enumerate(groups):
        pole[members] = number
    return describe_groups(points, groups, settings), pole, scale


def calibrate_depths(rays: Rays, settings: TriangulationSettings) -> float:
    """Factor that brings the monocular depths to the distances of the crossings.

    Depth networks err by a common factor. Poles with three and more well-crossed views are located
    by bearings alone, the factor is the median of distance over depth, and poles are grouped anew
    with it until it settles. Without enough such views it is 1.
    """
    scale = 1.0
    for _ in range(_ROUNDS):
        scaled = rays.scaled(scale)
        ratios = [_depth_ratios(rays, members) for members in group_rays(scaled, settings)]
        found = np.concatenate([*ratios, np.empty(0)])
        if len(found) < _FEWEST_DEPTHS:
            return 1.0
        latest = float(np.clip(np.median(found), *_SCALES))
        if abs(latest / scale - 1) < _SETTLED:
            return latest
        scale = latest
    return scale


def _depth_ratios(rays: Rays, members: Ints) -> Floats:
    """Distance by bearings alone over depth, of each ray of a well-crossed group."""
    if len(members) < 3:
        return np.empty(0)
    ahead = rays.direction[members]
    side = np.column_stack([ahead[:, 1], -ahead[:, 0]])
    normal = side.T @ side
    if np.linalg.eigvalsh(normal)[0] < _WELL_CROSSED:
        return np.empty(0)
    camera = rays.camera_m[members] - rays.camera_m[members[0]]
    place = np.linalg.solve(normal, side.T @ (side * camera).sum(axis=1))
    distance = ((place - camera) * ahead).sum(axis=1)
    ratio = distance / rays.depth_m[members]
    return ratio[np.isfinite(ratio) & (ratio > 0)]


def error_ellipse(covariance: Floats) -> tuple[Floats, Floats, Floats]:
    """Semi-axes of the 1-sigma ellipse and the bearing of the longer one.

    Parameters
    ----------
    covariance : of x and y, m2, shape (n, 2, 2).

    Returns
    -------
    longer and shorter semi-axis, m; bearing clockwise from grid north, degrees in [0, 180)
    """
    variances, axes = np.linalg.eigh(covariance)
    minor, major = np.sqrt(np.maximum(variances, 0.0)).T
    azimuth = np.degrees(np.arctan2(axes[:, 0, 1], axes[:, 1, 1])) % 180.0
    return major, minor, np.where(azimuth >= 180.0, 0.0, azimuth)


def describe_groups(
    points: Points, groups: list[Ints], settings: TriangulationSettings
) -> pd.DataFrame:
    """Poles of groups of rays with their errors; columns `POLE_COLUMNS`."""
    found = [weighted_mean(points, members) for members in groups]
    places = np.array([place for place, _ in found]).reshape(-1, 2)
    covariances = np.array([covariance for _, covariance in found]).reshape(-1, 2, 2)
    major, minor, azimuth = error_ellipse(covariances)
    weak = major > settings.max_sigma_m
    columns = [
        *places.T,
        np.array([len(members) for members in groups], np.int64),
        major,
        minor,
        azimuth,
        (major / minor) ** 2,
        ~weak,
        np.where(weak, f"error ellipse longer than {settings.max_sigma_m:g} m", "").astype(object),
    ]
    return pd.DataFrame(dict(zip(POLE_COLUMNS, columns, strict=True)))


def withhold_thin(
    poles: pd.DataFrame, pole_of: Ints, in_cloud: Bools, min_views: int
) -> pd.DataFrame:
    """Poles with those withheld that too few images show and the cloud does not confirm.

    Two rays cross by chance far more often than three; a trunk or a post that one image takes for
    a pole is rarely taken for one again from elsewhere.

    Parameters
    ----------
    pole_of : (n,) row in ``poles`` of each sighting, -1 for none.
    in_cloud : (n,) whether a pole-like column of the cloud stands where the sighting points.
    min_views : how many views a pole needs that no sighting of it finds in the cloud.
    """
    confirmed = np.bincount(pole_of[(pole_of >= 0) & in_cloud], minlength=len(poles)) > 0
    thin = (poles["score"].to_numpy() < min_views) & ~confirmed & poles["kept"].to_numpy(bool)
    reason = f"seen in fewer than {min_views} images and not in the cloud"
    return poles.assign(
        kept=poles["kept"] & ~thin, reason=np.where(thin, reason, poles["reason"]).astype(object)
    )


def drop_near_structures(
    poles: pd.DataFrame, structures: cKDTree | None, distance_m: float = 1.524
) -> pd.DataFrame:
    """Poles with those near a road, bridge or building point withheld.

    Parameters
    ----------
    structures : tree of such points, (n, 2) local metres; None switches the filter off.
    distance_m : 5 ft by default; a pole exactly that far is withheld.
    """
    if structures is None or structures.n == 0 or len(poles) == 0:
        return poles
    gap_m, _ = structures.query(poles[["x", "y"]].to_numpy(np.float64))
    near = (gap_m <= distance_m) & poles["kept"].to_numpy(bool)
    reason = f"within {distance_m:.3g} m of a road, bridge or building"
    return poles.assign(
        kept=poles["kept"] & ~near, reason=np.where(near, reason, poles["reason"]).astype(object)
    )
