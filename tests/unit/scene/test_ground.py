from __future__ import annotations

import numpy as np
import pytest

from roadsight.scene.grids import Grid, lowest_per_cell
from roadsight.scene.terrain.ground import GroundSettings, coarse_at, coarse_ground, ground_mask

SETTINGS = GroundSettings()


def label(scene, settings=SETTINGS):
    x, y, z = scene.xyz_m.T
    grid = Grid.around(x, y, settings.coarse_cell_m)
    surface, slope = coarse_ground(lowest_per_cell(grid, x, y, z), settings)
    return ground_mask(x, y, z, *coarse_at(grid, surface, slope, x, y), settings)


def published_label(scene, width_m=0.2, threshold_m=0.1):
    """The paper's filter: the lowest point of a pillar is its ground."""
    x, y, z = scene.xyz_m.T
    grid = Grid.around(x, y, width_m)
    return z - lowest_per_cell(grid, x, y, z).ravel()[grid.flat(x, y)] <= threshold_m


def errors(scene, mask):
    """Share of ground missed, share of objects taken for ground."""
    missed = 1 - mask[scene.ground].mean()
    objects = ~scene.ground
    return missed, mask[objects].mean() if objects.any() else 0.0


@pytest.mark.parametrize("slopes", [(0, 0), (0.1, 0.05), (0.2, 0), (0, -0.4), (0.3, 0.3)])
def test_slopes_are_ground(plane_scene, slopes):
    scene = plane_scene(slope_x=slopes[0], slope_y=slopes[1])
    steepest = max(0.2, 1.1 * np.hypot(*slopes))
    assert errors(scene, label(scene, GroundSettings(slope=steepest)))[0] < 0.001


def test_steeper_ground_than_set_is_lost_at_the_high_border_only(plane_scene):
    scene = plane_scene(slope_x=0.4)
    mask = label(scene)
    assert mask[scene.xyz_m[:, 0] < 38].all()
    assert errors(scene, mask)[0] < 0.03


def test_rolling_ground_is_ground(plane_scene):
    scene = plane_scene(side_m=60)
    x, y, z = scene.xyz_m.T
    z = z + 1.5 * np.sin(x / 8) + 0.8 * np.cos(y / 6)  # slopes up to 0.23
    scene = type(scene)(np.column_stack([x, y, z]), scene.ground, scene.surface)
    assert errors(scene, label(scene))[0] < 0.01


def test_a_car_without_ground_below_is_no_ground(plane_scene, box_shell):
    car = box_shell((15.3, 17.1), (12.2, 16.6), (3.3, 4.5), 60)
    scene = plane_scene(slope_x=0.03).with_objects(
        car + np.array([0, 0, 0.03 * 16]),
        hidden=lambda x, y: (x > 15.3) & (x < 17.1) & (y > 12.2) & (y < 16.6),
    )
    missed, taken = errors(scene, label(scene))
    assert missed < 0.005
    assert taken == 0
    assert errors(scene, published_label(scene))[1] > 0.3


@pytest.mark.parametrize("clearance_m", [0.4, 0.8, 3.0])
def test_a_slab_hovering_over_unseen_ground_is_no_ground(plane_scene, rng, clearance_m):
    slab = np.column_stack(
        [rng.uniform(15, 17, 500), rng.uniform(12, 16.5, 500), np.full(500, 3.0)]
    )
    scene = plane_scene().with_objects(
        slab + np.array([0, 0, clearance_m]),
        hidden=lambda x, y: (x > 15) & (x < 17) & (y > 12) & (y < 16.5),
    )
    missed, taken = errors(scene, label(scene))
    assert missed < 0.001
    assert taken == 0


def test_a_building_20_m_wide_is_no_ground(plane_scene, box_shell):
    house = box_shell((10.0, 30.0), (10.0, 30.0), (3.0, 9.0))
    scene = plane_scene(slope_y=0.05)
    above = house[:, 2] - scene.surface(house[:, 0], house[:, 1])
    scene = scene.with_objects(
        house[above > 0.2],  # the foot of a wall is as good as ground
        hidden=lambda x, y: (x > 10) & (x < 30) & (y > 10) & (y < 30),
    )
    missed, taken = errors(scene, label(scene))
    assert missed < 0.01
    assert taken < 0.001
    assert errors(scene, published_label(scene))[1] > 0.2


def test_a_wide_low_roof_is_found_wherever_the_grid_lies(plane_scene, box_shell):
    """A slope of 0.2 over half of 29 m allows 2.9 m, more than the roof's height."""
    for shift in (0.0, 0.3, 0.7):
        roof = box_shell((15, 44), (10, 50), (5.5, 5.5), 15)
        scene = plane_scene(side_m=60, density_m2=15).with_objects(
            roof, hidden=lambda x, y: (x > 15) & (x < 44) & (y > 10) & (y < 50)
        )
        moved = type(scene)(scene.xyz_m + np.array([shift, shift, 0]), scene.ground, scene.surface)
        missed, taken = errors(moved, label(moved))
        assert missed < 0.01
        assert taken == 0


@pytest.mark.parametrize("crest_m", [8, 14, 25])
def test_a_dam_with_banks_of_1_to_1_5_is_ground(plane_scene, crest_m):
    scene = plane_scene(side_m=60)
    x, y, z = scene.xyz_m.T
    z = z + np.clip((crest_m / 2 + 7.5 - np.abs(x - 30)) / 1.5, 0, 5.0)
    scene = type(scene)(np.column_stack([x, y, z]), scene.ground, scene.surface)
    assert errors(scene, label(scene))[0] < 0.02


def test_a_bridge_deck_is_no_ground_and_the_road_below_is(plane_scene, rng):
    deck = np.column_stack(
        [rng.uniform(0, 40, 13_000), rng.uniform(16, 24, 13_000), rng.normal(9, 0.01, 13_000)]
    )
    scene = plane_scene().with_objects(
        deck, hidden=lambda x, y: (np.abs(y - 20) < 4) & (np.floor(3 * x) % 3 > 0)
    )
    missed, taken = errors(scene, label(scene))
    assert missed < 0.005
    assert taken == 0


def test_multipath_below_the_road_neither_is_ground_nor_hides_it(plane_scene, rng):
    scene = plane_scene(slope_x=0.05)
    low = scene.xyz_m[rng.choice(len(scene.xyz_m), 200, replace=False)]
    low = low - np.column_stack([np.zeros((200, 2)), rng.uniform(0.25, 8, 200)])
    scene = scene.with_objects(low)
    missed, taken = errors(scene, label(scene))
    assert missed < 0.01
    assert taken < 0.03
    published_missed, published_taken = errors(scene, published_label(scene))
    assert published_missed > 2 * missed
    assert published_taken == 1


def test_a_canopy_without_ground_return_is_no_ground(plane_scene, rng):
    n = 4000
    radius, angle = 4.5 * np.sqrt(rng.random(n)), rng.uniform(0, 2 * np.pi, n)
    crown = np.column_stack([20 + radius * np.cos(angle), 20 + radius * np.sin(angle)])
    crown = np.column_stack([crown, 3 + rng.uniform(3, 7, n)])
    scene = plane_scene().with_objects(crown, hidden=lambda x, y: np.hypot(x - 20, y - 20) < 4.5)
    missed, taken = errors(scene, label(scene))
    assert missed < 0.005
    assert taken == 0
    assert errors(scene, published_label(scene))[1] > 0.05


def test_kerbs_stay_ground_on_both_levels(plane_scene):
    scene = plane_scene()
    x, y, z = scene.xyz_m.T
    scene = type(scene)(np.column_stack([x, y, z + 0.12 * (x > 20.1)]), scene.ground, scene.surface)
    assert errors(scene, label(scene))[0] < 0.01


def test_sparse_ground_with_mostly_empty_pillars(plane_scene):
    scene = plane_scene(density_m2=3, slope_x=0.1)
    assert errors(scene, label(scene))[0] < 0.01


@pytest.mark.parametrize("n", [0, 1, 2])
def test_next_to_nothing_is_decided_without_failing(n):
    xyz = np.array([[5.0, 5.0, 1.0], [5.0, 5.0, 1.0]])[:n]
    x, y, z = xyz.T
    grid = Grid.around(x, y, 1.0)
    surface, slope = coarse_ground(lowest_per_cell(grid, x, y, z), SETTINGS)
    assert surface.shape == slope.shape == grid.shape
    mask = ground_mask(x, y, z, *coarse_at(grid, surface, slope, x, y), SETTINGS)
    assert mask.tolist() == [True] * n


def test_a_single_row_of_cells_is_decided(rng):
    x = rng.uniform(0, 30, 2000)
    z = 0.1 * x
    y = np.full(2000, 0.5)
    grid = Grid.around(x, y, 1.0)
    surface, slope = coarse_ground(lowest_per_cell(grid, x, y, z), SETTINGS)
    mask = ground_mask(x, y, z, *coarse_at(grid, surface, slope, x, y), SETTINGS)
    assert slope[0, 15] == pytest.approx(0.1, abs=0.02)
    assert mask.mean() > 0.99


def test_coarse_surface_of_cells_without_points_has_no_height():
    surface, _ = coarse_ground(np.full((4, 5), np.nan), SETTINGS)
    assert np.isnan(surface).all()


def test_coarse_surface_passes_through_a_gap_and_below_an_object():
    lowest = np.full((40, 40), 2.0)
    lowest[10:20, 10:20] = 9.0
    lowest[25:30, 25:30] = np.nan
    lowest[5, 5] = -7.0
    surface, slope = coarse_ground(lowest, SETTINGS)
    assert (surface == 2.0).all()
    assert (slope == 0.0).all()
