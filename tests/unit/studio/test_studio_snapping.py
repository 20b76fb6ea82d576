import numpy as np
import pytest

from roadsight.studio.cloud_tiles import REACH_M, snap_to_cloud


def ground(rng, density=400, rough_m=0.005):
    xy = rng.uniform(-3, 3, (36 * density, 2))
    z = 20 + 0.02 * xy[:, 0] + rng.normal(0, rough_m, len(xy))
    return np.column_stack([xy, z]), 100 + rng.normal(0, 8, len(xy))


@pytest.mark.parametrize("angle", [0.0, 0.7, 2.0])
@pytest.mark.parametrize("density", [100, 400])
def test_a_kerb_is_found(rng, angle, density):
    xyz, light = ground(rng, density)
    side = xyz[:, 0] * np.cos(angle) + xyz[:, 1] * np.sin(angle)
    xyz[side > 0.2, 2] += 0.12
    found = snap_to_cloud(xyz.astype(np.float32), light, (0.5 * np.cos(angle), 0.5 * np.sin(angle)))
    assert found[0] * np.cos(angle) + found[1] * np.sin(angle) == pytest.approx(0.2, abs=0.08)


def test_the_edge_of_paint_is_found(rng):
    xyz, light = ground(rng)
    light[xyz[:, 1] < -0.3] += 150
    found = snap_to_cloud(xyz.astype(np.float32), light, (1.0, 0.1))
    assert found[1] == pytest.approx(-0.3, abs=0.08)
    assert abs(found[0] - 1.0) < 0.4


def test_plain_ground_and_empty_places_leave_the_click(rng):
    xyz, light = ground(rng)
    assert snap_to_cloud(xyz.astype(np.float32), light, (0.0, 0.0)) is None
    assert snap_to_cloud(xyz[:20].astype(np.float32), light[:20], (0.0, 0.0)) is None
    assert snap_to_cloud(xyz.astype(np.float32), light, (50.0, 0.0)) is None
    assert snap_to_cloud(np.empty((0, 3), np.float32), np.empty(0), (0.0, 0.0)) is None


def test_what_hangs_above_the_road_does_not_count(rng):
    xyz, light = ground(rng)
    leaves = rng.uniform([-3, 0, 23], [3, 3, 26], (20_000, 3))
    found = snap_to_cloud(
        np.vstack([xyz, leaves]).astype(np.float32),
        np.append(light, np.full(20_000, 100.0)),
        (0, 0),
    )
    assert found is None


def test_an_edge_out_of_reach_is_left_alone(rng):
    xyz, light = ground(rng)
    xyz[xyz[:, 0] > REACH_M + 0.4, 2] += 0.15
    assert snap_to_cloud(xyz.astype(np.float32), light, (0.0, 0.0)) is None
