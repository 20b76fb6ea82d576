"""Normals, FPFH and classes of ground points."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree
from sklearn.cluster import KMeans

from roadsight.base.arrays import Numbers
from roadsight.base.sections.scene import Pavement
from roadsight.scene.pavement.fpfh import (
    describe_ground,
    fit_smoothness,
    fpfh,
    is_smooth,
    nearest_neighbours,
    upward_normals,
)
from roadsight_hardcases.case import Errors, fails, hard_case

# Easting, northing and height of a place in UTM, m: there, single precision has steps of 0.5 m.
_FAR = np.array([500_000.0, 6_543_000.0, 200.0])


def _road(
    rng: np.random.Generator, points: int = 3000, rough_m: float = 0.004, side_m: float = 12.0
) -> Numbers:
    """A square of road with grade and crossfall."""
    x, y = rng.uniform(0, side_m, (2, points))
    z = 0.03 * x - 0.02 * y + rng.normal(0, rough_m, points)
    return np.column_stack([x, y, z])


def _tilt_deg(normals: Numbers) -> float:
    """95th percentile of the angle to the road's normal, whatever the sign."""
    true = np.array([-0.03, 0.02, 1.0]) / np.linalg.norm([-0.03, 0.02, 1.0])
    cosine = np.clip(np.abs(np.nan_to_num(normals) @ true), 0, 1)
    return float(np.percentile(np.degrees(np.arccos(cosine)), 95))


def _textbook_normals(xyz: Numbers, neighbours: Numbers) -> Numbers:
    """Covariance as mean of squares less square of mean, in the numbers' own precision."""
    group = xyz[np.column_stack([np.arange(len(xyz)), neighbours])]
    mean = group.mean(axis=1, dtype=xyz.dtype)
    squares = np.einsum("nki,nkj->nij", group, group) / xyz.dtype.type(group.shape[1])
    covariance = squares - mean[:, :, None] * mean[:, None]
    return np.linalg.eigh(covariance)[1][:, :, 0]


@hard_case("cluster_fpfh", bound=5.0, unit="deg")
def normals_at_map_size(rng: np.random.Generator) -> Errors:
    """Mean of squares less square of mean cancels at map coordinates even in double precision."""
    xyz = _road(rng, rough_m=0.002, side_m=4.0)
    near = nearest_neighbours(xyz, 10)[1]
    naive = _textbook_normals(xyz + _FAR, near)
    return _tilt_deg(naive), _tilt_deg(upward_normals(xyz + _FAR, near)[0])


def _of_two_scans(apart_m: float, rng: np.random.Generator) -> Errors:
    """Tilts of normals at the points of two scans, and at the thinned ones."""
    upper = np.add(_road(rng, side_m=6.0), [0.0, 0.0, apart_m])
    xyz = np.concatenate([_road(rng, side_m=6.0), upper])
    thin = describe_ground(xyz, np.zeros(len(xyz)), Pavement().voxel_size_m, 10).xyz_m
    tilts = (_tilt_deg(upward_normals(p, nearest_neighbours(p, 10)[1])[0]) for p in (xyz, thin))
    naive, ours = tilts
    return naive, ours


@hard_case("cluster_fpfh", bound=5.0, unit="deg")
def scans_2_cm_apart(rng: np.random.Generator) -> Errors:
    """Of two scans that do not fit the ten nearest points span both, and their plane tilts."""
    return _of_two_scans(0.02, rng)


@hard_case(
    "cluster_fpfh",
    bound=5.0,
    unit="deg",
    known="a column of 0.1 m holds points of either scan or of both: its middle is up or down",
)
def scans_10_cm_apart(rng: np.random.Generator) -> Errors:
    """Where two scans lie as far apart as their points, the plane of the ten nearest stands up."""
    return _of_two_scans(0.1, rng)


@hard_case("cluster_fpfh", bound=0.02, unit="share of the histogram")
def fpfh_with_flipped_normals(rng: np.random.Generator) -> Errors:
    """Normals as the eigenvectors come point up or down, which changes FPFH by a third."""
    xyz = _road(rng, 1500, rough_m=0.05)
    distance, near = nearest_neighbours(xyz, 10)
    normals, _ = upward_normals(xyz, near)
    angle = rng.uniform(0, 2 * np.pi)
    cosine, sine = np.cos(angle), np.sin(angle)
    turn = np.array([[cosine, -sine, 0], [sine, cosine, 0], [0, 0, 1]])
    turned = xyz @ turn.T
    again = nearest_neighbours(turned, 10)

    def change(first: Numbers, second: Numbers) -> float:
        here, there = fpfh(xyz, first, distance, near), fpfh(turned, second, *again)
        return float(np.abs(here - there).sum(axis=1).mean() / 600)

    naive = change(_textbook_normals(xyz, near), _textbook_normals(turned, again[1]))
    return naive, change(normals, upward_normals(turned, again[1])[0])


@hard_case("cluster_fpfh", bound=0.05, unit="share of lone points")
def lone_points_as_road(rng: np.random.Generator) -> Errors:
    """A point without neighbours has no roughness and, by default, a vertical normal: flat road."""
    road = _road(rng, 2000)
    grass = np.add(_road(rng, 2000, rough_m=0.08), [0, 14, 0])
    lone = np.column_stack([rng.uniform(0, 12, 40), 60 + 5.0 * np.arange(40), np.zeros(40)])
    xyz = np.concatenate([road, grass, lone])
    distance, near = nearest_neighbours(xyz, 10, max_distance_m=1.5)
    normals, variation = upward_normals(xyz, near)
    upright = np.where(np.isnan(normals[:, 2]), 1.0, normals[:, 2])
    features = np.column_stack([np.nan_to_num(variation), 1 - upright])
    groups = KMeans(2, n_init=4, random_state=1).fit_predict(features / features.std(axis=0))
    naive = groups[4000:] == np.bincount(groups[:2000]).argmax()
    histograms = fpfh(xyz, normals, distance, near)
    model = fit_smoothness(histograms, variation, None, 1.0, 1)
    ours = is_smooth(model, histograms, variation, np.zeros(len(xyz)))[4000:]
    return naive.mean(), ours.mean()


@hard_case("cluster_fpfh", bound=1e-3, unit="share of points without a histogram")
def fpfh_of_repeated_points(rng: np.random.Generator) -> Errors:
    """Overlapping scans repeat points: weights of one over distance squared become infinite."""
    xyz = np.repeat(_road(rng, 800), 2, axis=0)
    distance, near = nearest_neighbours(xyz, 10)
    normals, _ = upward_normals(xyz, near)
    histograms = fpfh(xyz, normals, distance, near)
    simple = histograms.astype(np.float64)
    naive = (simple[near] / distance[..., None] ** 2).mean(axis=1)
    return (~np.isfinite(naive)).any(axis=1).mean(), (~np.isfinite(histograms)).any(axis=1).mean()


@hard_case("cluster_fpfh", bound=0.01, unit="share of points with a made-up plane")
def collinear_neighbours(rng: np.random.Generator) -> Errors:
    """Points along a wire span no plane, yet the least eigenvector always gives one."""
    along = np.sort(rng.uniform(0, 60, 300))
    xyz = along[:, None] * [0.8, 0.6, 0.001] + [0, 0, 7.0]
    near = nearest_neighbours(xyz, 10)[1]
    naive = np.isfinite(_textbook_normals(xyz, near)).all(axis=1)
    return naive.mean(), np.isfinite(upward_normals(xyz, near)[0]).all(axis=1).mean()


@hard_case("cluster_fpfh", bound=0.5, unit="clouds that break it")
def clouds_of_no_and_one_point(rng: np.random.Generator) -> Errors:
    """A tile may hold no ground point, or a single one."""
    naive = ours = 0.0
    for points in (0, 1):
        xyz = rng.uniform(0, 1, (points, 3))
        naive += fails(_with_ten_neighbours, xyz)
        ours += fails(describe_ground, xyz, np.zeros(len(xyz)), 0.1, 10)
    return naive, ours


def _with_ten_neighbours(xyz: Numbers) -> Numbers:
    return _textbook_normals(xyz, cKDTree(xyz).query(xyz, 11)[1][:, 1:])
