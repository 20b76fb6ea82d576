import numpy as np
import pytest

from roadsight.base.sections.scene import GroundFilter
from roadsight.scene import whole
from roadsight.scene.grids import Grid, lowest_per_cell, sample_bilinear
from roadsight.scene.terrain import coarse as lowest
from roadsight.scene.terrain import coarse as surface
from roadsight.scene.terrain import ground
from roadsight.scene.terrain.coarse import (
    coarse_ground,
    fill_smoothly,
    flat_cells,
    low_outliers,
    lowest_supported,
    pits_of,
    recovered,
    sample_three,
)
from roadsight.scene.terrain.ground import ground_mask, window_percentile
from roadsight.scene.terrain.ground_settings import ground_settings_for, pillar_widths_m

SETTINGS = GroundFilter()


def label(scene, settings=SETTINGS):
    return label_xyz(scene.xyz_m, settings)


def label_xyz(xyz, settings=SETTINGS):
    x, y, z = xyz.T
    grid = Grid.around(x, y, settings.coarse_cell_m)
    coarse = coarse_ground(grid, lowest_supported(grid, x, y, z), settings)
    return ground_mask(x, y, z, coarse, settings)


def published_label(scene):
    """The paper's filter: the lowest point of a pillar is its ground."""
    return ground.published_ground(*scene.xyz_m.T, GroundFilter(method="pillars"))


class TestPublishedRule:
    """0.2 m pillars, 0.1 m above the lowest point (paper 1, section 2.2, Table 3)."""

    def slow(self, xyz, width_m, height_m):
        """The rule, pillar by pillar and point by point."""
        lowest = {}
        keys = [tuple(np.floor(point[:2] / width_m).astype(int)) for point in xyz]
        for key, point in zip(keys, xyz, strict=True):
            lowest[key] = min(lowest.get(key, np.inf), point[2])
        return np.array([xyz[k, 2] - lowest[key] <= height_m for k, key in enumerate(keys)])

    @pytest.mark.parametrize(("width_m", "height_m"), [(0.2, 0.1), (0.5, 0.3)])
    def test_it_is_that_of_a_literal_loop(self, rng, width_m, height_m):
        xyz = rng.uniform((-3, 4, 0), (3, 9, 0.6), (4000, 3))
        settings = GroundFilter(
            method="pillars", pillar_width_m=width_m, height_threshold_m=height_m
        )
        found = ground.published_ground(*xyz.T, settings)
        np.testing.assert_array_equal(found, self.slow(xyz, width_m, height_m))
        assert 0.1 < found.mean() < 0.9

    def test_unknown_heights_are_no_ground_and_hide_none(self):
        xyz = np.array([[0.1, 0.1, np.nan], [0.1, 0.1, 2.0], [0.1, 0.12, 2.05], [0.15, 0.1, 2.2]])
        found = ground.published_ground(*xyz.T, GroundFilter(method="pillars"))
        assert found.tolist() == [False, True, True, False]

    def test_tiles_give_what_the_whole_cloud_gives(self, rng, monkeypatch):
        xyz = rng.uniform((0, 0, 0), (61, 17, 0.5), (30_000, 3))
        settings = GroundFilter(method="pillars", pillar_width_m=0.3)
        once = whole.ground_of(xyz, settings)
        monkeypatch.setattr(whole, "_LARGEST_TILE_M", 10.0)  # borders that cut pillars
        np.testing.assert_array_equal(whole.ground_of(xyz, settings), once)
        np.testing.assert_array_equal(once, self.slow(xyz, 0.3, 0.1))

    def test_pillars_are_no_narrower_than_points_are_apart(self):
        published = GroundFilter(method="pillars")
        assert ground_settings_for(0.5, published).pillar_width_m == 0.5
        assert ground_settings_for(0.1, published).pillar_width_m == 0.2
        assert ground_settings_for(0.5, GroundFilter()).pillar_width_m == 0.2


def errors(scene, mask):
    """Share of ground missed, share of objects taken for ground."""
    missed = 1 - mask[scene.ground].mean()
    objects = ~scene.ground
    return missed, mask[objects].mean() if objects.any() else 0.0


@pytest.mark.parametrize("slopes", [(0, 0), (0.1, 0.05), (0.2, 0), (0, -0.4), (0.3, 0.3)])
def test_slopes_are_ground(plane_scene, slopes):
    scene = plane_scene(slope_x=slopes[0], slope_y=slopes[1])
    steepest = max(0.2, 1.1 * np.hypot(*slopes))
    assert errors(scene, label(scene, GroundFilter(slope=steepest)))[0] < 0.001


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
    assert taken < 0.006
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
    coarse = coarse_ground(grid, lowest_per_cell(grid, x, y, z), SETTINGS)
    assert coarse.surface_m.shape == coarse.slope.shape == grid.shape
    mask = ground_mask(x, y, z, coarse, SETTINGS)
    assert mask.tolist() == [True] * n


def test_a_single_row_of_cells_is_decided(rng):
    x = rng.uniform(0, 30, 2000)
    z = 0.1 * x
    y = np.full(2000, 0.5)
    grid = Grid.around(x, y, 1.0)
    coarse = coarse_ground(grid, lowest_per_cell(grid, x, y, z), SETTINGS)
    mask = ground_mask(x, y, z, coarse, SETTINGS)
    assert coarse.slope[0, 15] == pytest.approx(0.1, abs=0.02)
    assert mask.mean() > 0.99


def test_coarse_surface_of_cells_without_points_has_no_height():
    coarse = coarse_ground(Grid(0, 0, 5, 4, 1.0), np.full((4, 5), np.nan), SETTINGS)
    assert np.isnan(coarse.surface_m).all()


def test_coarse_surface_passes_through_a_gap_and_below_an_object():
    lowest = np.full((40, 40), 2.0)
    lowest[10:20, 10:20] = 9.0
    lowest[25:30, 25:30] = np.nan
    lowest[5, 5] = -7.0
    coarse = coarse_ground(Grid(0, 0, 40, 40, 1.0), lowest, SETTINGS)
    assert (coarse.surface_m == 2.0).all()
    assert (coarse.slope == 0.0).all()


@pytest.mark.parametrize(
    ("sigma_m", "lost"), [(0.01, 0.001), (0.03, 0.005), (0.05, 0.02), (0.08, 0.03)]
)
def test_a_thick_layer_of_registration_noise_is_ground(plane_scene, sigma_m, lost):
    scene = plane_scene(noise_m=sigma_m, density_m2=300)
    assert errors(scene, label(scene))[0] < lost


def test_the_bottom_of_a_hedge_that_hides_the_ground_is_none(plane_scene, rng):
    """Nothing is seen below a hedge 3 m wide: its rough bottom lies 5 to 55 cm above the lawn."""
    xy = rng.uniform((18, 5), (21, 35), (18_000, 2))
    bottom = 3.05 + 0.25 * (1 + np.sin(2 * xy[:, 0]) * np.sin(1.3 * xy[:, 1]))
    hedge = np.column_stack([xy, bottom + 1.2 * rng.uniform(0, 1, len(xy)) ** 2])
    scene = plane_scene(density_m2=300).with_objects(
        hedge, hidden=lambda x, y: (x > 18) & (x < 21) & (y > 5) & (y < 35)
    )
    missed, taken = errors(scene, label(scene))
    assert missed < 0.002
    assert taken < 0.1


@pytest.mark.parametrize("radius_m", [0.12, 0.25])
def test_the_ground_around_a_post_on_rough_grass_is_ground(rng, radius_m):
    """Grass of 3 cm from 1 m before the posts, beside a smooth road: no post is a hedge."""
    xy = rng.uniform((0, 0), (30, 20), (180_000, 2))
    z = rng.normal(0, np.where(xy[:, 1] < 11, 0.005, 0.03))
    posts = np.column_stack([np.arange(3.0, 28.0, 4.0), np.full(7, 12.0)])
    away = np.hypot(*(xy[:, None] - posts).transpose(2, 0, 1)).min(axis=1)
    open_ = away > radius_m
    turn, height = rng.uniform(0, 2 * np.pi, (7, 600)), rng.uniform(0, 4, (7, 600))
    around = radius_m * np.stack([np.cos(turn), np.sin(turn)], axis=-1) + posts[:, None]
    stems = np.column_stack([around.reshape(-1, 2), height.ravel()])
    mask = label_xyz(np.vstack([np.column_stack([xy, z])[open_], stems]))[: open_.sum()]
    near = away[open_] < radius_m + 0.4
    assert mask[near].mean() > 0.92


@pytest.mark.parametrize("density_m2", [0.3, 1, 4, 15, 60])
@pytest.mark.parametrize("slope", [0.0, 0.3, 0.6])
def test_slopes_are_ground_at_any_spacing(plane_scene, density_m2, slope):
    scene = plane_scene(side_m=80, density_m2=density_m2, slope_x=slope)
    assert errors(scene, label(scene))[0] < 0.03


def test_terrace_edges_and_faces_are_ground(plane_scene):
    scene = plane_scene(side_m=80, density_m2=2)
    x, y, z = scene.xyz_m.T
    z = z + 8 * np.clip((x - 40) / 8, 0, 1)
    scene = type(scene)(np.column_stack([x, y, z]), scene.ground, scene.surface)
    assert errors(scene, label(scene))[0] < 0.01


def test_a_wall_with_a_hidden_yard_behind_leaves_no_ground_on_top(plane_scene, box_shell, rng):
    yard = np.column_stack(
        [rng.uniform(24, 36, 60), rng.uniform(27, 39, 60), rng.uniform(4.2, 5.0, 60)]
    )
    wall = box_shell((5, 35), (22.0, 22.2), (3.1, 5.0), 200)
    scene = plane_scene(density_m2=100).with_objects(
        wall[wall[:, 2] > 3.3], yard, hidden=lambda x, y: y > 22
    )
    assert errors(scene, label(scene))[1] < 0.1


@pytest.mark.parametrize("kind", ["rough", "sparse", "smooth"])
def test_far_points_change_nothing_near(plane_scene, box_shell, rng, kind):
    """Further than an object is wide from the cloud's border, labels are the same to the last."""
    house = box_shell((12.0, 20.0), (10.0, 18.0), (3.0, 7.0), 30)
    near = plane_scene(side_m=90, density_m2=40, slope_x=0.02).with_objects(house).xyz_m
    n = 3000 if kind == "sparse" else 300_000
    x, y = rng.uniform(200, 450, n), rng.uniform(0, 250, n)
    far = np.column_stack([x, y, rng.normal(4.5, 3 if kind == "rough" else 0.02, n)])
    alone, both = label_xyz(near), label_xyz(np.vstack([near, far]))[: len(near)]
    inside = near[:, 0] < 90 - SETTINGS.max_object_width_m
    assert (alone[inside] == both[inside]).all()
    assert (alone == both).mean() > 0.999


def test_mirror_images_in_a_patch_do_not_take_the_road_away(plane_scene, rng):
    scene = plane_scene(density_m2=200)
    images = np.column_stack(
        [rng.uniform(15, 25, 400), rng.uniform(15, 22, 400), rng.uniform(-7, -2, 400)]
    )
    scene = scene.with_objects(images)
    missed, taken = errors(scene, label(scene))
    assert missed < 0.01
    assert taken == 0


def slow_lowest(z):
    z = np.sort(z)
    for k in range(int(lowest._SUPPORT * len(z)), 0, -1):
        if len(z) >= lowest._LEAST_POINTS and z[k] - z[k - 1] > lowest._GAP_M:
            return z[k]
    return z[0]


def test_lowest_supported_heights_equal_slow_ones(rng):
    xyz = rng.uniform(0, 4, (1500, 3)) * [1, 1, 0.05]
    xyz[rng.random(1500) < 0.03, 2] -= 5
    xyz[::100, 2] = np.nan
    grid = Grid.over(0, 0, 3.9, 3.9, 1.0)
    cell = grid.flat(xyz[:, 0], xyz[:, 1])
    slow = [slow_lowest(xyz[(cell == c) & np.isfinite(xyz[:, 2]), 2]) for c in range(16)]
    found = lowest_supported(grid, *xyz.T)
    np.testing.assert_array_equal(found.ravel(), slow)
    assert (found.ravel() > lowest_per_cell(grid, *xyz[np.isfinite(xyz[:, 2])].T).ravel()).any()


def test_heights_and_places_without_origin(plane_scene):
    scene = plane_scene(slope_x=0.1, density_m2=20)
    moved = type(scene)(scene.xyz_m + np.array([4096.0, -512.0, 2048.0]), scene.ground, None)
    assert (label(scene) == label(moved)).mean() > 0.9999


def test_points_without_a_height_are_no_ground(plane_scene):
    scene = plane_scene()
    xyz = scene.xyz_m.copy()
    xyz[::50, 2] = np.nan
    lowered = xyz.copy()
    lowered[::50, 2] = 3.0
    x, y, z = xyz.T
    grid = Grid.around(x, y, 1.0)
    coarse = coarse_ground(grid, lowest_per_cell(grid, *lowered.T), SETTINGS)
    mask = ground_mask(x, y, z, coarse, SETTINGS)
    assert not mask[::50].any()
    assert mask[np.isfinite(z)].mean() > 0.99


def test_pillars_double_up_to_a_coarse_cell():
    assert pillar_widths_m(SETTINGS) == (0.2, 0.4, 0.8)
    assert pillar_widths_m(GroundFilter(pillar_width_m=1.0)) == (1.0,)


def holes(rng, shape, share=0.3):
    values = rng.normal(size=shape)
    values[rng.random(shape) < share] = np.nan
    return values


def slow_line_percentile(values, half, share):
    out = np.full(values.shape, np.nan)
    for i, j in np.ndindex(*values.shape):
        near = values[i, max(0, j - half) : j + half + 1]
        near = np.sort(near[~np.isnan(near)])
        if len(near):
            out[i, j] = near[int(share * (len(near) - 1) + 0.5)]
    return out


@pytest.mark.parametrize("share", [0.0, 0.3, 1.0])
def test_window_percentile_equals_a_slow_one(rng, share):
    values = holes(rng, (13, 17), share)
    slow = slow_line_percentile(slow_line_percentile(values.T, 3, 0.25).T, 3, 0.25)
    np.testing.assert_array_equal(window_percentile(values, 3, 25), slow)


def middle_half(values):
    order, n = np.sort(values), len(values)
    return order[3 * n // 4] - order[n // 4]


def off_plane(row, column, z):
    """The tenth that is added keeps cells in a line from a cross slope: a ridge regression."""
    place = np.column_stack([column - column.mean(), row - row.mean()])
    spread = place.T @ place + 0.1 * len(z) * np.eye(2)
    return z - place @ np.linalg.solve(spread, place.T @ (z - z.mean()))


@pytest.mark.parametrize("slope", [0.0, 0.9])
def test_pits_equal_slow_ones(rng, slope):
    values = holes(rng, (20, 15), 0.5) * (0.5 if slope else 1.0)
    values += slope * np.arange(15)
    values[rng.random(values.shape) < 0.1] -= 5
    values[5:8, 6:9] -= 18
    deep = np.full(values.shape, 1.0)
    slow = np.zeros(values.shape, bool)
    for i, j in np.argwhere(~np.isnan(values)):
        slow[i, j] = True
        for half in (2, 4):
            window = np.full(values.shape, np.nan)
            at = slice(max(0, i - half), i + half + 1), slice(max(0, j - half), j + half + 1)
            window[at] = values[at]
            row, column = np.nonzero(~np.isnan(window))
            near = window[row, column]
            if len(near) < 8:
                continue
            low = near <= values[i, j] + 1.0
            depth = np.median(near[~low]) - values[i, j] if (~low).any() else 0.0
            rough = max(1.0, surface._PIT_ROUGH * depth)
            slow[i, j] = low.sum() < 0.2 * len(near) and (
                middle_half(near[~low]) <= rough
                or middle_half(off_plane(row[~low], column[~low], near[~low])) <= rough
            )
            if slow[i, j] or depth < surface._PIT_ABYSS_M:
                break
    found = pits_of(values, deep, np.array([2, 4]), 8, 0.2)
    np.testing.assert_array_equal(found, slow)
    assert 0 < found.sum() < np.isfinite(values).sum()


def test_pits_below_a_road_are_found_and_a_ditch_is_not(rng):
    lowest = np.full((30, 30), 5.0)
    lowest[:, 20] = 3.5
    row, column = rng.integers(0, 30, 25), rng.integers(0, 18, 25)
    lowest[row, column] = 4.0
    found = low_outliers(lowest, np.full(lowest.shape, 0.3))
    assert found[row, column].mean() > 0.9
    assert found.sum() <= 25


def test_pits_on_a_slope_are_found_and_ground_between_crowns_is_not(rng):
    row, column = np.indices((30, 30)).astype(float)
    lowest = 0.5 * row - 0.3 * column + rng.normal(0, 0.03, row.shape)
    at = rng.integers(0, 30, (2, 25))
    pits = lowest.copy()
    pits[tuple(at)] -= 9
    assert low_outliers(pits, np.full(pits.shape, 0.3))[tuple(at)].mean() > 0.8
    crowns = lowest + rng.uniform(4, 9, row.shape)
    crowns[::4, ::3] = lowest[::4, ::3]
    assert not low_outliers(crowns, np.full(pits.shape, 0.3))[::4, ::3].any()


def test_cells_and_samples_equal_those_of_grids(rng):
    grid = Grid(-3, 4, 9, 6, 0.4)
    x, y = rng.uniform(-3, 4, (2, 500))
    np.testing.assert_array_equal(flat_cells(grid, x, y), grid.flat(x, y))
    values = tuple(rng.normal(size=(3, *grid.shape)))
    for value, found in zip(values, sample_three(grid, values, x, y), strict=True):
        np.testing.assert_allclose(found, sample_bilinear(grid, value, x, y), atol=1e-12)


def slow_recovered(height, ground, known, reach, cell):
    out = ground.copy()
    place = np.argwhere(known)
    for i, j in np.argwhere(known & ~ground):
        away = place - (i, j)
        distance = np.hypot(*away.T)
        for angle in np.arange(8) * np.pi / 4:
            ahead = away[:, 1] * np.cos(angle) + away[:, 0] * np.sin(angle)
            side = (distance > 0) & (distance <= reach[i, j]) & (ahead >= 0.38 * distance)
            chosen = away[side & ground[tuple(place.T)]].astype(float)
            if len(chosen) < 6 or len(chosen) < 0.7 * side.sum():
                continue
            place_of = (chosen + np.array([i, j])).astype(int)
            z = height[tuple(place_of.T)] - height[i, j]
            centred = chosen[:, ::-1] - chosen[:, ::-1].mean(axis=0)
            spread = centred.T @ centred / len(z) + 0.3 * np.eye(2)
            g = np.linalg.solve(spread, centred.T @ (z - z.mean()) / len(z))
            steep = np.hypot(*g) / cell
            if steep > 1:
                g, steep = g / steep, 1.0
            if abs(z.mean() - g @ chosen[:, ::-1].mean(axis=0)) <= 0.3 + 0.3 * steep:
                out[i, j] = True
    return out


def test_recovered_cells_equal_slow_ones(rng):
    rows, columns = np.indices((18, 21)).astype(float)
    height = 0.3 * rows - 0.1 * columns + rng.normal(0, 0.3, rows.shape)
    known = rng.random(rows.shape) < 0.8
    ground = known & (rng.random(rows.shape) < 0.75)
    reach = rng.integers(2, 5, rows.shape)
    found = recovered(height, ground, known, reach, 1.0)
    np.testing.assert_array_equal(found, slow_recovered(height, ground, known, reach, 1.0))
    assert found.sum() > ground.sum()


def test_smooth_fill_keeps_what_is_known_and_stays_between(rng):
    values = rng.uniform(3, 4, (25, 30))
    known = rng.random(values.shape) < 0.05
    filled = fill_smoothly(np.where(known, values, np.nan), known)
    np.testing.assert_allclose(filled[known], values[known], atol=1e-12)
    assert values[known].min() - 1e-9 <= filled.min()
    assert filled.max() <= values[known].max() + 1e-9


@pytest.mark.parametrize(("kind", "depth_m"), [("smooth", 4), ("smooth", 14), ("rough", 14)])
def test_clusters_of_deep_pits_are_found_and_a_hill_slope_is_none(rng, kind, depth_m):
    row = np.indices((40, 40))[0].astype(float)
    lowest_m = 0.2 * row + (rng.normal(0, 0.3, row.shape) if kind == "rough" else 0.0)
    pits = np.zeros(row.shape, bool)
    for i, j in rng.integers(3, 37, (4, 2)):
        pits[i - 1 : i + 2, j - 1 : j + 1] = True
    found = low_outliers(lowest_m - depth_m * pits, np.full(row.shape, 0.3))
    assert found[pits].all()
    assert found[~pits].mean() < 0.005


@pytest.fixture
def pillars(rng):
    """Points in pillars, some of them empty: pillar, height, tilt, shape, a value of each."""
    shape, n = (7, 9), 600
    flat = rng.integers(0, 50, n)
    rise = rng.normal(0, 0.3, n)
    rise[::37] = np.inf
    return flat, rise, rng.uniform(0, 0.05, n), shape, rng.uniform(0, 0.3, shape)


def points_of(pillars):
    """Numbers of the points of each pillar."""
    flat, _, _, shape, _ = pillars
    return [np.flatnonzero(flat == cell) for cell in range(shape[0] * shape[1])]


def test_lowest_near_points_equal_slow_ones(pillars):
    flat, rise, tilt, shape, _ = pillars
    near = np.full(len(flat), 0.2)
    low, largest = ground._lowest_and_tilt(flat, rise, near, tilt, *shape)
    for cell, own in enumerate(points_of(pillars)):
        close = rise[own][np.abs(rise[own]) <= 0.2]
        assert largest.flat[cell] == tilt[own].max(initial=0.0)
        np.testing.assert_equal(low.flat[cell], close.min() if len(close) else np.nan)


def test_moments_and_counts_of_pillars_equal_slow_ones(pillars):
    flat, rise, tilt, shape, thick = pillars
    level = np.full(shape, -0.2)
    level[0, 0] = thick[0, 1] = np.nan
    moments = ground._layer_moments(flat, rise, tilt, level, thick)
    low, high = ground._low_and_high(flat, rise, level, tilt, thick, 0.15, 0.75)
    count, total = ground._layer_mean(flat, rise, tilt, level, thick)
    between = ground._between(flat, rise, tilt, level, level + thick)
    for cell, own in enumerate(points_of(pillars)):
        above, wide = rise[own] - level.flat[cell], thick.flat[cell] + tilt[own]
        inside = above[(above >= 0) & (above <= wide)]
        powers = [np.sum(inside**power) for power in (0, 1, 2)]
        np.testing.assert_allclose([m.flat[cell] for m in moments], powers, atol=1e-12)
        near = above[np.abs(above) <= wide]
        np.testing.assert_allclose((count.flat[cell], total.flat[cell]), (len(near), near.sum()))
        assert low.flat[cell] == len(near)
        if np.isfinite(thick.flat[cell]):
            kerb = np.maximum(0.15, thick.flat[cell]) + tilt[own]
            assert high.flat[cell] == np.sum((above > kerb) & (above <= 0.75))
        np.testing.assert_array_equal(between[own], (above >= -tilt[own]) & (above <= wide))


def test_relaxed_gaps_equal_slow_ones(rng):
    values, known = rng.normal(size=(6, 7)), rng.random((6, 7)) < 0.4
    slow = values.copy()
    for _ in range(3):
        padded = np.pad(slow, 1, mode="edge")
        mean = padded[:-2, 1:-1] + padded[2:, 1:-1] + padded[1:-1, :-2] + padded[1:-1, 2:]
        slow = np.where(known, slow, mean / 4)
    surface._relax(values, known, 3)
    np.testing.assert_allclose(values, slow, atol=1e-12)


@pytest.mark.parametrize("density_m2", [50, 100, 300, 1000])
@pytest.mark.parametrize("sigma_m", [0.05, 0.08])
def test_noise_is_ground_at_any_density(plane_scene, sigma_m, density_m2):
    scene = plane_scene(side_m=20, noise_m=sigma_m, density_m2=density_m2)
    assert errors(scene, label(scene))[0] < 0.035
