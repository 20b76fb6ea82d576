"""Depths, bearings and the places where rays meet."""

from __future__ import annotations

import numpy as np
import pandas as pd
from pyproj import Geod
from scipy.optimize import curve_fit

from roadsight.base.arrays import Numbers
from roadsight.poles.sightings.distances import ground_distance_m
from roadsight.poles.sightings.metric_depth import fit_metric_depth, fuse_depths
from roadsight.poles.triangulate.explain import error_ellipse, triangulate
from roadsight.poles.triangulate.geographic import triangulate_geographic
from roadsight.poles.triangulate.rays import UNAIDED, cross_rays, make_rays, pair_rays
from roadsight_hardcases.case import Errors, fails, hard_case

_GEOD = Geod(ellps="WGS84")
# Settings for places and angles that are known well, without the calibration of depths.
_FINE = UNAIDED.model_copy(
    update={
        "sigma_position_m": 0.1,
        "sigma_bearing_deg": 0.3,
        "sigma_depth_ratio": 0.15,
        "calibrate_depth": False,
    }
)


@hard_case("measure_poles", bound=0.35, unit="share of the depth")
def depth_near_the_pole_of_its_fit(rng: np.random.Generator) -> Errors:
    """Depth is c1 / (d - c2): near c2 a last digit gives a hundredfold or a negative depth."""
    true_m = np.geomspace(5, 60, 300)
    relative = 6.0 / true_m + 0.1 + rng.normal(0, 0.004, 300)
    fit = fit_metric_depth(relative, true_m)
    far_m = np.geomspace(20, 2000, 400)
    seen = 6.0 / far_m + 0.1 + rng.normal(0, 0.004, 400)
    naive, (ours, _) = fit.c1 / (seen - fit.c2), fit.depth_m(seen)
    reach_m = 60.0  # what lies farther is not kept either way
    off = [np.abs(part / far_m - 1)[part <= reach_m].max() for part in (naive, ours)]
    # Noise leaves depths of less than 25 m known to a tenth: those may not be withheld.
    return off[0], off[1] if np.isfinite(ours[far_m < 25]).all() else np.inf


@hard_case("measure_poles", bound=0.03, unit="share of the coefficient")
def depth_fitted_as_depth(rng: np.random.Generator) -> Errors:
    """Fitting D = c1 / (d - c2) in D lets the farthest points, where D runs off, decide alone."""
    true_m = rng.uniform(5, 60, 400)
    relative = 6.0 / true_m + 0.1 + rng.normal(0, 0.012, 400)

    def depth(d: Numbers, c1: float, c2: float) -> Numbers:
        return c1 / (d - c2)

    (c1, _), _ = curve_fit(depth, relative, true_m, p0=(5.0, 0.0), maxfev=20_000)
    return abs(c1 / 6 - 1), abs(fit_metric_depth(relative, true_m).c1 / 6 - 1)


@hard_case("measure_poles", bound=0.5, unit="distances that are none")
def foot_at_the_horizon(rng: np.random.Generator) -> Errors:
    """Camera height over the tangent of pitch is infinite at the horizon and negative above it."""
    pitch = np.radians([-0.0, -0.001, -0.2, 0.3, 1.0, -2.0])
    rays = np.column_stack([np.zeros(6), np.cos(pitch), np.sin(pitch)])
    naive = 2.2 / np.tan(-pitch)
    ours = ground_distance_m([0, 0, 2.2], rays, lambda x, y: np.zeros(len(x)), farthest_m=80.0)
    good = (naive > 0) & (naive <= 80)
    wrong = np.isfinite(ours) & (np.abs(ours - naive) > 0.01)
    return np.count_nonzero(~good), np.count_nonzero(wrong) + np.isnan(ours[5])


@hard_case("measure_poles", bound=2.5, unit="m")
def one_depth_that_disagrees(rng: np.random.Generator) -> Errors:
    """The mean of three distances follows the one that is of something else."""
    depth = np.array([20.0, 20.6, 48.0])
    fused, _, _ = fuse_depths(depth, np.array([1.0, 1.5, 2.0]))
    return abs(depth.mean() - 20.0), abs(fused - 20.0)


@hard_case("triangulate_poles", bound=3.0, unit="m")
def rays_a_fifth_of_a_degree_apart(rng: np.random.Generator) -> Errors:
    """Two rays 0.2 degrees apart cross anywhere along their line for a pixel of noise."""
    naive, ours = [], []
    for _ in range(60):
        camera = np.array([[0.0, 0.0], [30 * np.sin(np.radians(0.2)), 0.5]])
        pole = np.array([0.5, 30.0]) + rng.normal(0, 0.05, 2)
        gap = pole - camera
        bearing = np.degrees(np.arctan2(gap[:, 0], gap[:, 1])) + rng.normal(0, 0.03, 2)
        depth = np.hypot(*gap.T) * np.exp(rng.normal(0, 0.05, 2))
        rays = make_rays(camera, bearing, depth, np.full(2, 0.03), 0.05 * depth)
        _, place = cross_rays(rays, np.array([[0, 1]]))
        naive.append(np.hypot(*(place[0] - pole)))
        poles, _, _ = triangulate(rays, _FINE)
        kept = poles[poles["kept"].to_numpy(bool)][["x", "y"]].to_numpy()
        ours += [float(np.hypot(*(one - pole))) for one in kept]
    # Their depths give the position to 1.5 m, so that a withheld pole is a lost one.
    return np.median(naive), np.median(ours) if len(ours) >= 50 else np.inf


@hard_case("triangulate_poles", bound=0.5, unit="pairs without a crossing")
def cameras_at_one_place(rng: np.random.Generator) -> Errors:
    """Two images from one place, or two parallel rays, have no crossing: a division by zero."""
    camera = np.array([[0.0, 0.0], [0.0, 0.0], [3.0, 0.0], [6.0, 0.0]])
    bearing = np.array([10.0, 10.0, 10.0, 350.0])
    rays = make_rays(camera, bearing, np.full(4, 15.0), image=np.arange(4))
    naive = 0
    for i in range(4):
        for j in range(i):
            a, b = rays.direction[i], rays.direction[j]
            naive += abs(a[0] * b[1] - a[1] * b[0]) < 1e-15
    used = pair_rays(rays, _FINE)
    poles, _, _ = triangulate(rays, _FINE)
    apart = np.hypot(*(rays.camera_m[used[:, 0]] - rays.camera_m[used[:, 1]]).T)
    return naive, np.count_nonzero(apart < 0.5) + poles[["x", "y"]].isna().to_numpy().sum()


@hard_case("triangulate_poles", bound=0.5, unit="poles that are none")
def crossings_behind_a_camera(rng: np.random.Generator) -> Errors:
    """Lines cross also behind the cameras that look along them."""
    camera = np.array([[0.0, 0.0], [10.0, 0.0]])
    bearing = np.array([-20.0, 20.0])  # the rays part; their lines meet behind
    rays = make_rays(camera, bearing, np.full(2, 15.0), image=np.arange(2))
    along, _ = cross_rays(rays, np.array([[0, 1]]))
    poles, _, _ = triangulate(rays, _FINE)
    behind = poles["y"].to_numpy(float) < 0
    return np.isfinite(along).all(axis=1).sum(), behind.sum()


@hard_case("triangulate_poles", bound=0.05, unit="share of the sigma")
def sightings_listed_twice(rng: np.random.Generator) -> Errors:
    """A table with every row twice makes errors look smaller by the square root of two."""
    camera = np.column_stack([np.zeros(4), 6.0 * np.arange(4)])
    pole = np.array([7.0, 30.0])
    gap = pole - camera
    bearing, depth = np.degrees(np.arctan2(gap[:, 0], gap[:, 1])), np.hypot(*gap.T)

    def sigma(rows: Numbers, image: Numbers) -> float:
        rays = make_rays(camera[rows], bearing[rows], depth[rows], image=image)
        return float(triangulate(rays, _FINE)[0]["sigma_major_m"].iloc[0])

    once, rows = np.arange(4), np.repeat(np.arange(4), 2)
    naive = sigma(rows, np.arange(8)), sigma(rows, rows), sigma(once, once)
    return abs(naive[0] / naive[2] - 1), abs(naive[1] / naive[2] - 1)


def _geographic(lat: float, lon: float) -> tuple[float, float]:
    """Errors (m) of a pole seen by four cameras around a place on the Earth."""
    pole_lon, pole_lat, _ = _GEOD.fwd(lon, lat, 35.0, 20.0)
    around = [_GEOD.fwd(lon, lat, azimuth, 8.0)[:2] for azimuth in (0.0, 80.0, 190.0, 280.0)]
    camera = np.array(around)
    bearing, _, depth = _GEOD.inv(
        camera[:, 0], camera[:, 1], np.full(4, pole_lon), np.full(4, pole_lat)
    )
    table = pd.DataFrame(
        {"lat": camera[:, 1], "lon": camera[:, 0], "bearing": bearing, "depth": depth}
    )
    ours = triangulate_geographic(table, _FINE).iloc[0]
    off_m = _GEOD.inv(ours["lon"], ours["lat"], pole_lon, pole_lat)[2]
    # The flat map around the mean of the degrees.
    scale = 111_320.0 * np.array([np.cos(np.radians(table["lat"].mean())), 1.0])
    middle = camera.mean(axis=0)
    local = (camera - middle) * scale
    ways = np.column_stack([np.sin(np.radians(bearing)), np.cos(np.radians(bearing))])
    side = np.column_stack([ways[:, 1], -ways[:, 0]])
    place = np.linalg.lstsq(side, (side * local).sum(axis=1), rcond=None)[0]
    there = place / scale + middle
    there[1] = np.clip(there[1], -90, 90)
    return _GEOD.inv(there[0], there[1], pole_lon, pole_lat)[2], off_m


@hard_case("triangulate_poles", bound=0.1, unit="m")
def street_across_the_antimeridian(rng: np.random.Generator) -> Errors:
    """The mean of longitudes 179.9999 and -179.9999 is 0: cameras 40,000 km apart."""
    return _geographic(-16.8, 180.0)


@hard_case("triangulate_poles", bound=0.1, unit="m")
def street_near_the_pole_of_the_earth(rng: np.random.Generator) -> Errors:
    """Near a pole of the Earth, degrees of longitude and north itself change within a street."""
    return _geographic(89.9995, 20.0)


@hard_case("triangulate_poles", bound=1e-6, unit="m")
def covariance_without_width(rng: np.random.Generator) -> Errors:
    """Rounding makes the smaller variance of a needle-thin error ellipse negative: no root."""
    turn = rng.uniform(0, np.pi, 400)
    way = np.column_stack([np.sin(turn), np.cos(turn)])
    covariance = 25.0 * way[:, :, None] * way[:, None]
    half, root = covariance[:, [0, 1], [0, 1]].sum(axis=1) / 2, np.linalg.det(covariance)
    naive = np.sqrt(half - np.sqrt(half**2 - root)), np.sqrt(half + np.sqrt(half**2 - root))
    major, minor, _ = error_ellipse(covariance)
    off = np.hypot(naive[1] - 5.0, naive[0])
    return np.nan_to_num(off, nan=5.0).max(), np.hypot(major - 5.0, minor).max()


@hard_case("triangulate_poles", bound=0.5, unit="tables that break it")
def tables_of_no_and_one_sighting(rng: np.random.Generator) -> Errors:
    """A street may have no sighting of a kind, or one."""
    naive = ours = 0.0
    for count in (0, 1):
        camera, bearing = rng.uniform(0, 9, (count, 2)), np.full(count, 40.0)
        rays = make_rays(camera, bearing, np.full(count, 12.0))
        side = np.column_stack([rays.direction[:, 1], -rays.direction[:, 0]])
        right = side.T @ (side * rays.camera_m).sum(axis=1)
        naive += fails(np.linalg.solve, side.T @ side, right)
        ours += fails(triangulate, rays, _FINE)
    return naive, ours
