"""Open3D computes the same descriptors: another team's implementation of the same definition."""

import numpy as np
import pytest

from roadsight.scene.pavement.fpfh import fpfh, nearest_neighbours, upward_normals

K = 10


@pytest.fixture
def rolling_ground(rng):
    x, y = rng.uniform(0, 10, (2, 1500))
    z = 0.3 * np.sin(x) + 0.1 * np.cos(2 * y) + rng.normal(0, 0.02, 1500)
    return np.column_stack([x, y, z])


def cloud_of(o3d, xyz):
    cloud = o3d.geometry.PointCloud()
    cloud.points = o3d.utility.Vector3dVector(xyz)
    return cloud


def test_normals_agree_up_to_their_sign(o3d, rolling_ground):
    cloud = cloud_of(o3d, rolling_ground)
    cloud.estimate_normals(o3d.geometry.KDTreeSearchParamKNN(K + 1))
    ours, _ = upward_normals(rolling_ground, nearest_neighbours(rolling_ground, K)[1])
    cosine = np.abs((ours * np.asarray(cloud.normals)).sum(axis=1))
    assert np.degrees(np.arccos(np.clip(cosine, 0, 1))).max() < 0.01
    assert (np.asarray(cloud.normals)[:, 2] < 0).any()  # theirs are not oriented


def features_of(o3d, xyz, normals):
    cloud = cloud_of(o3d, xyz)
    cloud.normals = o3d.utility.Vector3dVector(normals)
    search = o3d.geometry.KDTreeSearchParamKNN(K + 1)
    return np.asarray(o3d.pipelines.registration.compute_fpfh_feature(cloud, search).data).T


def test_features_agree_on_the_surface_s_own_normals(o3d, rolling_ground):
    x, y, _ = rolling_ground.T
    normals = np.column_stack([-0.3 * np.cos(x), 0.2 * np.sin(2 * y), np.ones(len(x))])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    ours = fpfh(rolling_ground, normals, *nearest_neighbours(rolling_ground, K))
    theirs = features_of(o3d, rolling_ground, normals)
    np.testing.assert_allclose(ours, theirs, rtol=1e-4, atol=1e-3)


def test_features_agree_on_estimated_normals_but_for_a_sign_that_is_rounding_noise(
    o3d, rolling_ground
):
    """Points that share all their neighbours share their normal; then the third angle has no sign.

    We fix it, Open3D leaves it to rounding.
    """
    distance, near = nearest_neighbours(rolling_ground, K)
    normals, _ = upward_normals(rolling_ground, near)
    ours = fpfh(rolling_ground, normals, distance, near)
    theirs = features_of(o3d, rolling_ground, normals)
    np.testing.assert_allclose(ours[:, :22], theirs[:, :22], rtol=1e-4, atol=1e-3)
    ours, theirs = ours[:, 22:], theirs[:, 22:]
    without_sign = [part + part[:, ::-1] for part in (ours, theirs)]
    np.testing.assert_allclose(*without_sign, rtol=1e-4, atol=1e-3)
    assert (np.abs(ours - theirs) > 1e-3).mean() < 0.1
