import json
import subprocess
import sys
from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from roadsight.base.errors import InputError
from roadsight.io.images.models import DepthNetwork
from roadsight.io.records.depth_maps import stack_pairs
from roadsight.io.records.sources import sha256
from roadsight.placement.depth.hybrid import hybrid_depth, preliminary_depth
from roadsight.placement.depth.unet import (
    HALO_CELLS,
    MULTIPLE_CELLS,
    TILE_CELLS,
    fill_linearly,
    fine_sensor,
    grid_sensor,
    model_of_points,
    normalised,
    on_beams,
    refined,
    unet_depth,
    unet_mask_depth,
)
from roadsight.placement.sensors.sensors import Sensor, load_sensors
from roadsight_training.depth_scenes import simple_site
from roadsight_training.evaluate_depth_network import map_errors, pixel_errors
from tests.conftest import PROJECT

ROOT = PROJECT
MODELS = ROOT / "resources/models"
NETWORKS = ("depth_unet.onnx", "depth_unet_33.onnx")
SENSORS = {
    name: sensor
    for name, sensor in load_sensors(ROOT / "config/sensors.yaml").items()
    if isinstance(sensor, Sensor)
}


def identity(maps):
    """Network that gives what it gets, with a return where there is one."""
    return np.concatenate([maps, np.where(maps > 0, 1.0, -1.0)], axis=1).astype(np.float32)


def never(maps):
    raise AssertionError("the network was asked")


def far_sight(maps):
    """Network that looks as far as is allowed: least value of a cross of `HALO_CELLS` around."""
    found = maps.copy()
    for cells in (-HALO_CELLS, HALO_CELLS):
        shifted = np.zeros_like(maps)
        if cells < 0:
            shifted[..., -cells:] = maps[..., :cells]
        else:
            shifted[..., :-cells] = maps[..., cells:]
        found += shifted
    return np.concatenate([found / 3, np.ones_like(maps)], axis=1)


def random_map(rows, columns, seed=0, share=0.4):
    rng = np.random.default_rng(seed)
    depth = rng.uniform(1, 64, (rows, columns)).astype(np.float32)
    depth[rng.random(depth.shape) > share] = 0.0
    depth.flat[0], depth.flat[-1] = 64.0, 0.0
    return depth


@cache
def shipped(name="depth_unet.onnx", threads=1):
    return DepthNetwork(MODELS / name, threads)


class TestTiles:
    @settings(max_examples=30, deadline=None)
    @given(st.integers(1, 40), st.integers(2, 1700), st.booleans(), st.integers(0, 9))
    def test_an_identity_network_gives_every_map_back(self, rows, columns, wraps, seed):
        depth = random_map(rows, columns, seed)
        range_m, returns = refined(depth, identity, wraps=wraps)
        np.testing.assert_array_equal(range_m, depth)
        np.testing.assert_array_equal(returns, depth > 0)

    def test_a_regression_alone_returns_where_it_is_nearer_to_the_least_range_than_to_0(self):
        depth = np.array([[8.0, 0.0, 0.0, 0.0, 32.0, 64.0]], np.float32)
        wanted_m = np.array([[7.0, 3.9, 4.1, -2.0, 33.0, 60.0]], np.float32)

        def regress(maps):
            found = np.zeros_like(maps)
            found[0, 0, :1, HALO_CELLS : HALO_CELLS + 6] = wanted_m / 64.0
            return found

        range_m, returns = refined(depth, regress, wraps=False)
        assert returns.tolist() == [[True, False, True, False, True, True]]
        np.testing.assert_allclose(range_m[returns], wanted_m[returns], rtol=1e-6)

    def test_tiles_are_of_whole_cells_of_the_network(self):
        shapes = []

        def look(maps):
            shapes.append(maps.shape)
            return identity(maps)

        refined(random_map(13, 2 * TILE_CELLS + 5), look)
        assert len(shapes) == 3
        assert all(n % MULTIPLE_CELLS == 0 for shape in shapes for n in shape[2:])
        assert max(shape[3] for shape in shapes) == TILE_CELLS + 2 * HALO_CELLS

    @pytest.mark.parametrize("columns", [40, TILE_CELLS, 1600])
    def test_what_a_tile_sees_goes_on_across_its_border_and_the_seam(self, columns):
        depth = random_map(5, columns)
        range_m, _ = refined(depth, far_sight)
        around = [np.roll(depth, cells, axis=1) for cells in (-HALO_CELLS, 0, HALO_CELLS)]
        np.testing.assert_allclose(range_m, np.mean(around, axis=0), rtol=1e-5)

    def test_nothing_goes_on_where_a_map_does_not_wrap(self):
        depth = random_map(5, 1600)
        padded = np.pad(depth, ((0, 0), (HALO_CELLS, HALO_CELLS)))
        around = [padded[:, shift : shift + 1600] for shift in (0, HALO_CELLS, 2 * HALO_CELLS)]
        range_m, _ = refined(depth, far_sight, wraps=False)
        np.testing.assert_allclose(range_m, np.mean(around, axis=0), rtol=1e-5)


class TestNormalising:
    def test_values_go_from_0_to_1_and_back(self):
        depth = random_map(20, 30)
        values, low, high = normalised(depth)
        assert (values.min(), values.max(), low, high) == (0.0, 1.0, 0.0, 64.0)
        np.testing.assert_allclose(low + values * (high - low), depth, rtol=1e-6)

    def test_a_map_without_empty_cells_starts_at_its_least_range(self):
        depth = np.array([[5.0, 10.0, 15.0]], np.float32)
        values, low, high = normalised(depth)
        assert (low, high) == (5.0, 15.0)
        np.testing.assert_array_equal(values, [[0.0, 0.5, 1.0]])

    @pytest.mark.parametrize("value", [0.0, 7.0])
    def test_a_map_of_one_value_has_nothing_to_refine(self, value):
        depth = np.full((6, 9), value, np.float32)
        assert not normalised(depth)[0].any()
        range_m, returns = refined(depth, never)
        np.testing.assert_array_equal(range_m, depth)
        assert returns.all() == returns.any() == (value > 0)

    def test_an_empty_map_stays_empty(self):
        depth = np.zeros((0, 9), np.float32)
        assert refined(depth, never)[0].shape == (0, 9)

    def test_no_point_in_range_gives_a_map_without_returns(self):
        sensor, nowhere = SENSORS["VLP-16"], np.full((3, 3), 1e5)
        for way in (unet_depth, unet_mask_depth):
            depth = way(nowhere, sensor, [0, 0, 0], 0.0, run=never)
            assert depth.shape == sensor.shape
            assert not depth.any()
        assert not unet_depth(nowhere[:0], sensor, [0, 0, 0], 0.0, run=never).any()

    def test_a_network_that_tells_nonsense_gives_no_negative_range(self):
        def run(maps):
            return np.concatenate([maps - 2.0, np.ones_like(maps)], axis=1)

        range_m, returns = refined(random_map(9, 9), run)
        assert (range_m == 0).all()
        assert not returns.any()


class TestGrids:
    @pytest.mark.parametrize("name", sorted(SENSORS))
    def test_the_fine_grid_holds_every_beam_and_some_more(self, name):
        sensor, fine = SENSORS[name], fine_sensor(SENSORS[name])
        assert fine.columns == 3600
        assert fine.range_m == sensor.range_m
        below, above = fine.elevation_deg[[0, -1]] - sensor.elevation_deg[[0, -1]]
        assert -2.6 < below < -2.4 and 2.4 < above < 2.6
        steps = (fine.elevation_deg - 0.05) / 0.1
        np.testing.assert_allclose(steps, np.round(steps), atol=1e-6)

    def test_it_is_the_published_one_for_45_degrees(self):
        fine = fine_sensor(SENSORS["OS-64"])
        assert fine.shape == (500, 3600)
        np.testing.assert_allclose(fine.elevation_edges_deg[[0, -1]], [-25, 25], atol=1e-9)

    def test_it_ends_at_the_zenith(self):
        sensor = Sensor(azimuth_step_deg=1, elevations_deg=(-90.0, 0.0, 90.0), range_m=50)
        fine = fine_sensor(sensor)
        np.testing.assert_allclose(fine.elevation_edges_deg[[0, -1]], [-90, 90], atol=1e-9)
        assert on_beams(np.ones(fine.shape, np.float32), fine, sensor).all()

    @settings(max_examples=20, deadline=None)
    @given(
        st.integers(-100, 60), st.integers(1, 30), st.integers(1, 9), st.integers(-1800, 1700),
        st.sampled_from([1, 2, 5, 10]), st.integers(0, 9),
    )  # fmt: skip
    def test_beams_in_the_middle_of_cells_get_them_unchanged(
        self, low, rows, every, first, stride, seed
    ):
        fine = grid_sensor((-180.0, 180.0), (-120, 420), 100.0)
        depth = random_map(*fine.shape, seed)
        elevations = [(low + every * i + 0.5) * 0.1 for i in range(rows)]
        start = (first - (stride - 1) / 2) * 0.1
        sensor = Sensor(
            azimuth_min_deg=start, azimuth_max_deg=start + 10, azimuth_step_deg=stride * 0.1,
            elevations_deg=elevations, range_m=100,
        )  # fmt: skip
        row = low + every * np.arange(rows) + 120
        column = (first + 1800 + stride * np.arange(sensor.columns)) % 3600
        np.testing.assert_array_equal(on_beams(depth, fine, sensor), depth[row][:, column])

    def test_a_beam_between_two_cells_of_a_plane_gets_the_range_between(self):
        fine = grid_sensor((-180.0, 180.0), (-250, 250), 300.0)
        sensor = Sensor(azimuth_step_deg=0.1, elevations_deg=(-20.0, -9.97, -3.0), range_m=300)
        rows = np.broadcast_to(fine.elevation_deg[:, None], fine.shape)
        depth = np.where(rows < -1, -5.0 / np.sin(np.radians(rows)), 0).astype(np.float32)
        expected = -5.0 / np.sin(np.radians(sensor.elevation_deg))
        found = on_beams(depth, fine, sensor)
        np.testing.assert_allclose(
            found, np.broadcast_to(expected[:, None], found.shape), rtol=1e-3
        )

    def test_surfaces_are_not_mixed_and_the_sky_stays_empty(self):
        fine = grid_sensor((-180.0, 180.0), (-20, 20), 100.0)
        depth = np.full(fine.shape, 10.0, np.float32)
        depth[20:25], depth[25:] = 40.0, 0.0
        between = np.arange(-15, 15) * 0.1
        sensor = Sensor(azimuth_step_deg=0.4, elevations_deg=between, range_m=100)
        assert set(np.unique(on_beams(depth, fine, sensor))) == {0.0, 10.0, 40.0}

    def test_an_identity_network_gives_the_preliminary_map(self):
        rng = np.random.default_rng(1)
        ground = np.column_stack([rng.uniform(-30, 30, (40_000, 2)), np.zeros(40_000)])
        ground = np.concatenate([ground, [[0.0, 64.0, 6.0]]])  # a range of a power of 2
        sensor = grid_sensor((-180.0, 180.0), (-150, 50), 100.0)
        expected = preliminary_depth(ground, sensor, [0, 0, 6], 20.0)
        assert expected.max() == 64.0
        found = unet_depth(ground, sensor, [0, 0, 6], 20.0, run=identity)
        np.testing.assert_array_equal(found, expected)
        found = unet_mask_depth(ground, sensor, [0, 0, 6], 20.0, run=identity)
        np.testing.assert_array_equal(found, expected)


def slow_filling(depth, wanted, wraps):
    """Cell by cell: look left, right, down and up for the nearest known range."""
    rows, columns = depth.shape

    def look(row, column, down, right):
        for cells in range(1, max(rows, columns) + 1):
            r, c = row + cells * down, column + cells * right
            if right and wraps:
                c %= columns
            if not (0 <= r < rows and 0 <= c < columns) or cells > columns * abs(right) + rows:
                return None
            if right and wraps and cells >= columns:
                return None
            if depth[r, c] > 0:
                return cells, depth[r, c]
        return None

    def line(row, column, down, right):
        sides = [look(row, column, sign * down, sign * right) for sign in (-1, 1)]
        known = [side for side in sides if side]
        if len(known) == 2:
            (a, low), (b, high) = known
            return (low * b + high * a) / (a + b), 1 / min(a, b)
        return (known[0][1], 1 / known[0][0]) if known else (0.0, 0.0)

    found = np.zeros_like(depth)
    for row, column in zip(*np.nonzero(wanted), strict=True):
        parts = [line(row, column, 0, 1), line(row, column, 1, 0)]
        total = sum(weight for _, weight in parts)
        if depth[row, column] > 0:
            found[row, column] = depth[row, column]
        elif total:
            found[row, column] = sum(v * w for v, w in parts) / total
    return found


class TestFilling:
    @settings(max_examples=40, deadline=None)
    @given(
        st.integers(1, 7), st.integers(1, 9), st.booleans(), st.floats(0, 0.6), st.integers(0, 99)
    )
    def test_equals_the_slow_way(self, rows, columns, wraps, share, seed):
        rng = np.random.default_rng(seed)
        depth = rng.uniform(5, 50, (rows, columns)).astype(np.float32)
        depth[rng.random(depth.shape) >= share] = 0.0
        wanted = rng.random(depth.shape) < 0.7
        found = fill_linearly(depth, wanted, wraps=wraps)
        np.testing.assert_allclose(found, slow_filling(depth, wanted, wraps), rtol=1e-5)

    def test_a_linear_map_with_holes_is_restored(self):
        depth = np.broadcast_to(np.arange(10.0, 30.0), (12, 20)).astype(np.float32)
        holes = depth.copy()
        holes[2:9, 3:15] = 0.0
        found = fill_linearly(holes, np.ones_like(holes, bool), wraps=False)
        np.testing.assert_allclose(found, depth, rtol=1e-6)

    def test_nothing_known_stays_without_return(self):
        assert not fill_linearly(np.zeros((4, 5), np.float32), np.ones((4, 5), bool)).any()


class TestFiles:
    def test_a_missing_file_is_told(self, tmp_path):
        with pytest.raises(InputError, match=r"lidar.network: no such file; found .*none.onnx"):
            DepthNetwork(tmp_path / "none.onnx")

    def test_a_damaged_file_is_told(self, tmp_path):
        path = tmp_path / "damaged.onnx"
        path.write_bytes((MODELS / NETWORKS[0]).read_bytes()[:5000])
        with pytest.raises(InputError, match="cannot be opened as a network"):
            DepthNetwork(path)

    def test_another_network_is_refused(self):
        told = "found kind nothing, step_deg nothing, multiple_cells nothing; allowed: kind depth_"
        with pytest.raises(InputError, match=told):
            DepthNetwork(MODELS / "road_classes.onnx")

    def test_a_model_that_needs_a_network_says_so(self):
        with pytest.raises(InputError, match="unet: needs a network"):
            model_of_points("unet")

    @pytest.mark.parametrize("name", NETWORKS)
    def test_the_record_is_of_the_file(self, name):
        entry = json.loads((MODELS / "training_record.json").read_text())[name]
        assert entry["sha256"] == sha256(MODELS / name)
        assert entry["bytes"] == (MODELS / name).stat().st_size
        assert 50_000 < entry["parameters"] < 300_000
        assert not set(entry["data"]["scenes"]) & set(entry["held_out"]["scenes"])


@pytest.fixture(scope="module")
def fine_map():
    site = simple_site(7001, 1)
    fine = grid_sensor((-180.0, 180.0), (-120, 24), 80.0)
    return preliminary_depth(site.cloud_m, fine, site.positions_m[0], 0.0)


def test_depth_maps_without_a_network_do_not_wait_for_its_runtime():
    stage = "roadsight.stages.placement.render_depth_maps"
    code = f"import sys, {stage}; sys.exit('onnxruntime' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


class TestShipped:
    @pytest.mark.parametrize("name", NETWORKS)
    def test_it_is_deterministic_with_any_number_of_threads(self, fine_map, name):
        one, again, two = (
            refined(fine_map, DepthNetwork(MODELS / name, threads)) for threads in (1, 1, 2)
        )
        for other in (again, two):
            assert one[0].tobytes() == other[0].tobytes()
            assert one[1].tobytes() == other[1].tobytes()

    @pytest.mark.parametrize("name", NETWORKS)
    def test_tiles_change_nothing(self, fine_map, name, monkeypatch):
        tiled = refined(fine_map, shipped(name))
        monkeypatch.setattr("roadsight.placement.depth.unet.TILE_CELLS", fine_map.shape[1])
        whole = refined(fine_map, shipped(name))
        np.testing.assert_allclose(tiled[0], whole[0], rtol=1e-4, atol=1e-3)
        assert (tiled[1] != whole[1]).mean() < 1e-4

    def test_turning_the_sensor_turns_the_map(self, fine_map):
        cells = 100 * MULTIPLE_CELLS
        range_m, returns = refined(fine_map, shipped())
        turned = refined(np.roll(fine_map, cells, axis=1), shipped())
        np.testing.assert_allclose(turned[0], np.roll(range_m, cells, axis=1), rtol=1e-4, atol=1e-3)
        assert (turned[1] != np.roll(returns, cells, axis=1)).mean() < 1e-4

    def test_a_map_smaller_than_a_patch_is_refined(self):
        range_m, returns = refined(random_map(3, 5), shipped())
        assert range_m.shape == returns.shape == (3, 5)
        assert np.isfinite(range_m).all()

    def test_both_ways_are_nearer_to_the_truth_than_the_published_algorithm(self):
        site = simple_site(7002, 2)
        sensor = SENSORS["OS-32"].thinned(4)
        wrong = dict.fromkeys(("hybrid", "unet", "unet_mask"), 0.0)
        for number, (position, yaw_deg) in enumerate(
            zip(site.positions_m, site.yaws_deg, strict=True)
        ):
            exact = site.exact(sensor, number)
            for way in wrong:
                model = model_of_points(way, DepthNetwork(MODELS / NETWORKS[0]))
                depth = model(site.cloud_m, sensor, position, float(yaw_deg))
                wrong[way] += map_errors(depth, exact)["wrong"]
        assert max(wrong["unet"], wrong["unet_mask"]) < wrong["hybrid"]
        assert wrong["unet"] < 0.3

    def test_the_published_pairs_are_learnt(self):
        site = simple_site(7003, 1)
        fine = grid_sensor((-45.0, 45.0), (-250, 250), 120.0)
        seen = site.cloud_m, fine, site.positions_m[0], float(site.yaws_deg[0])
        given, target = preliminary_depth(*seen), hybrid_depth(*seen)
        pairs = stack_pairs([(given, target)])
        learnt = pixel_errors([pairs], shipped(NETWORKS[1]))["pixel_rmse_m"]
        assert learnt < 0.7 * np.sqrt(np.mean((given - target) ** 2))

    @pytest.mark.parametrize(("way", "bound_m"), [("unet", 3.0), ("unet_mask", 0.3)])
    def test_the_network_of_33_layers_sees_the_ground_both_ways(self, way, bound_m):
        rng = np.random.default_rng(2)
        ground = np.column_stack([rng.uniform(-30, 30, (200_000, 2)), np.zeros(200_000)])
        sensor = SENSORS["OS-32"].thinned(16)
        model = model_of_points(way, shipped(NETWORKS[1]))
        depth = model(ground.astype(np.float32), sensor, [0.0, 0.0, 5.0], 0.0)
        down = sensor.elevation_deg < -12
        expected = -5.0 / np.sin(np.radians(sensor.elevation_deg[down]))
        off_m = np.abs(depth[down] - expected[:, None])
        assert np.median(off_m) < bound_m  # a regression is decimetres to metres off
        assert (depth[sensor.elevation_deg > 10] > 0).mean() < 0.1
