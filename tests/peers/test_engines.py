"""Each step gives the same by Open3D as by ourselves, up to rounding."""

import numpy as np
import pytest

import roadsight
from roadsight.base.engines import ENGINES
from roadsight.placement.depth.surfel_lidar import SurfelLidar
from roadsight.placement.sensors.sensors import Sensor
from roadsight.scene.pavement.fpfh import describe_ground
from roadsight.scene.pavement.open3d_engine import open3d_fpfh, open3d_normals
from roadsight.scene.pavement.outline import euclidean_clusters
from roadsight.scene.surfels import build_surfels, in_company
from roadsight.scene.voxel_planes import sum_moments

pytestmark = pytest.mark.usefixtures("o3d")
FAR = np.array([4.5e5, 5.6e6, 300.0])


@pytest.fixture
def ground(rng):
    """A smooth road between rough verges, 20 m by 12 m, far from the origin."""
    x, y = rng.uniform(0, 20, 40_000), rng.uniform(0, 12, 40_000)
    rough = np.where(np.abs(y - 6) < 3, 0.004, 0.05)
    z = 0.05 * np.sin(x / 3) + rough * rng.normal(size=len(x))
    return np.column_stack([x, y, z])


def test_ground_is_described_alike(ground, rng):
    intensity = rng.uniform(0, 100, len(ground))
    own = describe_ground(ground, intensity, 0.1, 10)
    peer = describe_ground(ground, intensity, 0.1, 10, "open3d")
    np.testing.assert_array_equal(own.xyz_m, peer.xyz_m)
    np.testing.assert_array_equal(own.intensity, peer.intensity)
    np.testing.assert_allclose(own.variation, peer.variation, atol=1e-9)
    common = np.minimum(own.histograms, peer.histograms).sum(axis=1)
    assert (common / own.histograms.sum(axis=1)).mean() > 0.99
    np.testing.assert_allclose(own.histograms[:, :22], peer.histograms[:, :22], atol=0.1)


def test_normals_are_the_same_far_from_the_origin(ground):
    near, _ = open3d_normals(ground, 10)
    far, _ = open3d_normals(ground + FAR, 10)
    assert np.abs(near - far).max() < 1e-3  # what coordinates of 5.6e6 m leave of a normal


def test_points_on_a_line_have_no_normal_and_no_histogram():
    line = np.column_stack([np.arange(20.0), np.zeros(20), np.zeros(20)])
    normals, variation = open3d_normals(line, 5)
    assert np.isnan(normals).all() and np.isnan(variation).all()
    assert (open3d_fpfh(line, normals, 5) == 0).all()


def test_nothing_is_described_as_nothing():
    nothing = np.empty((0, 3))
    normals, variation = open3d_normals(nothing, 5)
    assert normals.shape == (0, 3) and variation.shape == (0,)
    assert open3d_fpfh(nothing, normals, 5).shape == (0, 33)


@pytest.mark.parametrize("distance_m", [0.1, 0.3, 1.0])
def test_clusters_are_the_same(rng, distance_m):
    xyz = rng.uniform(0, 6, (2000, 3)) + FAR
    own = euclidean_clusters(xyz, distance_m)
    assert (euclidean_clusters(xyz, distance_m, "open3d") == own).all()


def test_rays_end_at_the_same_place(ground):
    wall = ground[:, [0, 2, 1]] * (1, 1, 0.5) + (0, 6, 0)
    surfels = build_surfels(sum_moments(np.concatenate([ground, wall]), 0.1))
    sensor = Sensor(
        azimuth_step_deg=1, elevation_min_deg=-30, elevation_max_deg=20, channels=32, range_m=100
    )
    at = (10.0, 3.0, 4.0)
    own = SurfelLidar(surfels).depth_map(sensor, at, 20.0)
    peer = SurfelLidar(surfels, engine="open3d").depth_map(sensor, at, 20.0)
    assert (own > 0).mean() > 0.2
    assert ((own > 0) == (peer > 0)).mean() > 0.999
    both = (own > 0) & (peer > 0)
    assert (np.abs(own - peer)[both] < 1e-3).mean() > 0.999


def test_rays_stop_at_the_range_by_both(ground):
    surfels = build_surfels(sum_moments(ground, 0.1))
    down = np.array([[0.0, 0.0, -1.0]])
    for engine in ("own", "open3d"):
        lidar = SurfelLidar(surfels, engine=engine)
        assert np.isfinite(lidar.cast((10.0, 6.0, 5.0), down, 6.0)).all()
        assert np.isinf(lidar.cast((10.0, 6.0, 5.0), down, 4.0)).all()


@pytest.mark.parametrize("others", [1, 2, 5])
def test_the_same_points_stand_alone(rng, others):
    xyz = rng.uniform(0, 5, (800, 3)).astype(np.float32)
    own = in_company(xyz[:500], xyz[500:], 0.5, others)
    assert 0 < own.sum() < len(own)
    assert (in_company(xyz[:500], xyz[500:], 0.5, others, "open3d") == own).all()


def test_the_api_gives_the_same_by_both(ground):
    ranges = [roadsight.depth_map(ground, "OS1-64", [10, 6, 3], engine=e) for e in ENGINES]
    assert np.abs(ranges[0] - ranges[1]).max() < 1e-3
    longer = np.concatenate([ground, ground + np.array([20, 0, 0])])
    roads = [
        roadsight.pavement(
            longer, method="published", ground=np.ones(len(longer), bool), engine=engine
        ).outline
        for engine in ENGINES
    ]
    assert roads[0].symmetric_difference(roads[1]).area < 0.01 * roads[0].area
