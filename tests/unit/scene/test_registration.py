"""Scans that lie apart: the distance told is the true one, and noise is no distance."""

from __future__ import annotations

import numpy as np
import pytest

from roadsight.base.sections.scene import GroundFilter
from roadsight.scene.terrain.ground import published_ground
from roadsight.scene.terrain.registration import Registration, file_borders

SIDE_M, DENSITY_M2 = (40.0, 20.0), 40
HEIGHTS = {
    "flat": lambda x, y: 5.0 + 0 * x,
    "sloping": lambda x, y: 5 + 0.08 * x - 0.03 * y,
    "crowned": lambda x, y: 7 + 0.02 * x - 0.025 * abs(y - 10) + 0.12 * (abs(y - 10) > 6),
    "hilly": lambda x, y: 9 + 1.5 * np.sin(x / 9) + np.cos(y / 7),
}


def two_scans(surface, shift_m, noise_m, seed, grass=False, density_m2=DENSITY_M2):
    """Points of scans 3 and 7, the latter moved by (east, north, up) on ground with a kerb."""
    rng = np.random.default_rng(seed)
    parts = []
    for moved in np.array([[0, 0, 0], shift_m]):
        x, y = rng.uniform(0, SIDE_M, (int(density_m2 * SIDE_M[0] * SIDE_M[1]), 2)).T
        z = HEIGHTS[surface](x - moved[0], y - moved[1]) + moved[2] + rng.normal(0, noise_m, len(x))
        if grass:
            z += np.where(y < 8, rng.gamma(1.5, 0.03, len(x)), 0)
        parts.append(np.column_stack([x, y, z]))
    return np.concatenate(parts), np.repeat([3, 7], len(parts[0]))


def told(xyz_m, scan, tile_m=20.0):
    """Doubts by their code."""
    found = Registration()
    for tile in np.unique(xyz_m[:, 0] // tile_m):
        own = xyz_m[:, 0] // tile_m == tile
        ground = published_ground(*xyz_m[own].T, GroundFilter(method="pillars"))
        found.add(xyz_m[own], ground, scan[own])
    return {doubt.code: doubt for doubt in found.doubts()}


@pytest.mark.parametrize("seed", [1, 2, 3])
@pytest.mark.parametrize("noise_m", [0.0, 0.01, 0.03])
@pytest.mark.parametrize("grass", [False, True])
@pytest.mark.parametrize("surface", HEIGHTS)
def test_numbered_scans_apart(surface, grass, noise_m, seed):
    for up_m in (0.0, 0.02, -0.05, 0.1):
        doubts = told(*two_scans(surface, (0, 0, up_m), noise_m, seed, grass))
        assert set(doubts) == ({"scans_apart"} if up_m else set())
        if up_m:
            high, low = (7, 3) if up_m > 0 else (3, 7)
            assert doubts["scans_apart"].measured == pytest.approx(abs(up_m), abs=0.005)
            assert f"scan {high} lies above scan {low} (" in doubts["scans_apart"].message


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_slopes_of_all_directions_tell_a_shift_to_the_side(seed):
    hilly = told(*two_scans("hilly", (0.1, -0.06, 0.05), 0.01, seed))["scans_apart"]
    assert hilly.measured == pytest.approx(0.05, abs=0.005)
    assert "0.12 m beside it" in hilly.message or "0.11 m beside it" in hilly.message
    flat = told(*two_scans("sloping", (0.1, -0.06, 0.05), 0.01, seed))["scans_apart"]
    assert "beside" not in flat.message


def test_no_ground_and_few_points_say_nothing():
    xyz, scan = two_scans("flat", (0, 0, 0.1), 0.01, 1)
    found = Registration()
    found.add(xyz, np.zeros(len(xyz), bool), scan)
    found.add(xyz[::5000], np.ones(len(xyz[::5000]), bool), scan[::5000])
    assert found.doubts() == []


@pytest.mark.parametrize("seed", [1, 2, 3])
@pytest.mark.parametrize("grass", [False, True])
@pytest.mark.parametrize("surface", HEIGHTS)
def test_layers_apart_without_numbers(surface, grass, seed):
    """Noise of a fifth of the distance leaves two peaks, of less where a third is grass."""
    for up_m, noise_m in [(0.02, 0.003), (0.05, 0.01), (-0.1, 0.01), (0.1, 0.015)]:
        noise_m *= 0.7 if grass else 1  # noqa: PLW2901
        xyz_m, scan = two_scans(surface, (0, 0, up_m), noise_m, seed, grass)
        mixed = np.random.default_rng(seed).permutation(len(xyz_m))
        for order in (slice(None), mixed):
            doubts = told(xyz_m[order], 0 * scan)
            assert set(doubts) == {"ground_doubled"}
            assert doubts["ground_doubled"].measured == pytest.approx(abs(up_m), abs=0.005)


@pytest.mark.parametrize("seed", [1, 2, 3])
@pytest.mark.parametrize("noise_m", [0.0, 0.003, 0.01, 0.03])
@pytest.mark.parametrize("grass", [False, True])
@pytest.mark.parametrize("surface", HEIGHTS)
def test_one_layer_is_not_two(surface, grass, noise_m, seed):
    xyz_m, scan = two_scans(surface, (0, 0, 0), noise_m, seed, grass)
    assert told(xyz_m, 0 * scan) == {}
    xyz_m[:, 2] = xyz_m[:, 2].round(2)  # a file with steps of 1 cm
    assert told(xyz_m, 0 * scan) == {}


@pytest.mark.parametrize("density_m2", [3, 6, 12, 40])
def test_kerbs_are_no_second_layer(density_m2, rng):
    found = Registration()
    for west in range(0, 600, 50):
        x, y = rng.uniform(0, 50, (density_m2 * 2500, 2)).T
        z = 5 + 0.12 * (x % 20 < 2.3) + 0.12 * (x % 20 > 10) + rng.normal(0, 0.004, len(x))
        points = np.column_stack([x + west, y, z])
        found.add(points, np.ones(len(x), bool), np.zeros(len(x), np.uint16))
    assert found.lags.sum() > 15_000 and found.doubts() == []


def two_files(surface, step_m, noise_m, rng, kerb_m=None, density_m2=80):
    """Doubts about files that meet at x = 30 m, where the eastern one is higher."""
    x, y = rng.uniform(0, (50, 60), (density_m2 * 3000, 2)).T
    z = HEIGHTS[surface](x, y) + rng.normal(0, noise_m, len(x)) + step_m * (x > 30)
    if kerb_m is not None:
        z += 0.12 * (x > 30 + kerb_m)
    found = Registration([[0, 0, 29.98, 60], [30.01, 0, 50, 60]], ["a.laz", "b.laz"])
    for tile in (0, 1):
        own = x // 25 == tile
        points = np.column_stack([x, y, z])[own]
        found.add(points, np.ones(len(points), bool), np.zeros(len(points), np.uint16))
    return found.doubts()


@pytest.mark.parametrize("seed", [1, 2, 3])
@pytest.mark.parametrize("noise_m", [0.0, 0.01, 0.03])
@pytest.mark.parametrize("surface", HEIGHTS)
def test_a_step_between_files(surface, noise_m, seed):
    rng = np.random.default_rng(seed)
    assert two_files(surface, 0.0, noise_m, rng) == []
    for step_m in (0.02, -0.05, 0.1):
        (doubt,) = two_files(surface, step_m, noise_m, rng)
        assert doubt.code == "files_apart"
        assert doubt.measured == pytest.approx(abs(step_m), abs=0.005)
        assert doubt.message.startswith("b.laz lies above" if step_m > 0 else "a.laz lies above")


@pytest.mark.parametrize("kerb_m", [-1.5, -0.7, 0.4, 1.3])
def test_a_kerb_along_a_border_is_no_step(kerb_m, rng):
    assert two_files("flat", 0.0, 0.01, rng, kerb_m) == []


def test_borders_of_files():
    boxes = np.array([[0, 0, 50, 50], [50.2, 10, 90, 60], [0, 50, 50, 80], [200, 0, 250, 50.0]])
    assert sorted(map(tuple, file_borders(boxes).round(1).tolist())) == [
        (0, 50.1, 10, 50, 0, 1),
        (0, 50.1, 50, 60, 2, 1),
        (1, 50, 0, 50, 0, 2),
    ]
