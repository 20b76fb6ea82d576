import base64

import geopandas as gpd
import numpy as np
import pandas as pd
import pytest
from shapely import LineString, MultiPolygon, Point, Polygon, box

from roadsight.report.packing import pack, pack_points, sample_mask, thin, to_byte
from roadsight.report.site.layers import (
    NO_DATA,
    UNKNOWN_HEIGHT,
    CloudSample,
    block_mean,
    candidate_layer,
    cloud_layer,
    edge_layer,
    hillshade,
    near_measured,
    polygon_layer,
    relief_layer,
    target_layer,
)


def unpack(packed):
    return np.frombuffer(base64.b64decode(packed["data"]), f"<{packed['dtype']}")


def unpack_points(packed):
    return np.array(packed["offset_m"]) + unpack(packed["xyz"]).reshape(-1, 3) * packed["step_m"]


class TestPacking:
    @pytest.mark.parametrize("dtype", ["u1", "u2", "u4", "f4"])
    def test_values_come_back(self, dtype):
        assert unpack(pack([0, 1, 200], dtype)).tolist() == [0, 1, 200]
        assert unpack(pack([], dtype)).size == 0
        assert pack(np.zeros((4, 2)), dtype)["count"] == 8

    @pytest.mark.parametrize(
        ("values", "dtype"),
        [([256], "u1"), ([-1], "u2"), ([0.5], "u4"), ([np.nan], "f4"), ([1e39], "f4")],
    )
    def test_what_does_not_fit_is_refused(self, values, dtype):
        with pytest.raises(ValueError, match=r"fit|finite"):
            pack(values, dtype)

    def test_points_are_off_by_half_a_step_at_most(self, rng):
        xyz = rng.uniform([-40, 3, 100], [900, 80, 130], (500, 3))
        packed = pack_points(xyz)
        error = np.abs(unpack_points(packed) - xyz).max(axis=0)
        assert np.all(error <= np.array(packed["step_m"]) / 2 + 1e-9)
        assert np.all(error < 0.008)

    @pytest.mark.parametrize("xyz", [np.empty((0, 3)), [[5.0, 6.0, 7.0]], [[1, 2, 3]] * 4])
    def test_points_without_extent(self, xyz):
        assert unpack_points(pack_points(np.array(xyz))).tolist() == np.array(xyz).tolist()

    def test_stretch_uses_the_whole_byte(self, rng):
        stretched = to_byte(rng.normal(900, 100, 5000))
        assert stretched.min() == 0
        assert stretched.max() == 255

    def test_stretch_of_two_values_although_percentiles_agree(self):
        values = np.array([0] * 999 + [7])
        assert to_byte(values).tolist() == [0] * 999 + [255]

    @pytest.mark.parametrize("values", [np.empty(0), np.full(9, 4)])
    def test_no_stretch_without_range(self, values):
        assert to_byte(values) is None


class TestThinning:
    def test_sample_does_not_depend_on_the_tiles(self):
        whole = sample_mask(0, 10_000, 0.3)
        parts = [sample_mask(start, 2500, 0.3) for start in range(0, 10_000, 2500)]
        assert np.array_equal(whole, np.concatenate(parts))

    def test_sample_keeps_its_share_without_a_pattern(self):
        mask = sample_mask(0, 100_000, 0.2)
        assert abs(mask.mean() - 0.2) < 0.005
        for period in (2, 3, 16, 100):
            shares = mask[: 100_000 // period * period].reshape(-1, period).mean(axis=0)
            assert np.abs(shares - 0.2).max() < 0.07

    @pytest.mark.parametrize(("share", "kept"), [(1.0, 50), (3.0, 50), (0.0, 0)])
    def test_all_or_nothing(self, share, kept):
        assert sample_mask(7, 50, share).sum() == kept

    def test_few_points_all_stay(self, rng):
        assert thin(rng.uniform(size=(20, 3)), 20).tolist() == list(range(20))

    def test_dense_and_sparse_parts_are_drawn_alike(self, rng):
        dense = rng.uniform([0, 0, 0], [50, 50, 0.01], (200_000, 3))
        sparse = rng.uniform([50, 0, 0], [100, 50, 0.01], (20_000, 3))
        kept = thin(np.vstack([dense, sparse]), 5000)
        assert 4500 < len(kept) <= 5000
        assert 0.45 < np.mean(kept < len(dense)) < 0.6

    def test_each_cube_is_stood_for_by_its_first_point(self, rng):
        xyz = np.repeat(rng.uniform(0, 100, (500, 3)), 20, axis=0)
        kept = thin(xyz, 600)
        assert np.all(kept % 20 == 0)
        assert np.all(np.diff(kept) > 0)

    @pytest.mark.parametrize("axis", [0, 2])
    def test_points_on_a_line(self, rng, axis):
        xyz = np.zeros((5000, 3))
        xyz[:, axis] = rng.uniform(0, 1000, 5000)
        assert 90 <= len(thin(xyz, 100)) <= 100

    def test_one_place_is_one_point(self):
        assert thin(np.ones((50, 3)), 10).tolist() == [0]

    def test_far_outlier_costs_no_more_than_resolution(self, rng):
        xyz = rng.uniform(0, 10, (50_000, 3))
        xyz[7] = (1e6, 1e6, 1e6)
        kept = thin(xyz, 1000)
        assert 7 in kept
        assert len(kept) <= 1000

    @pytest.mark.parametrize("at_most", [7, 300_000])
    def test_limits(self, at_most):
        with pytest.raises(ValueError, match="at_most"):
            thin(np.zeros((3, 3)), at_most)


class TestShading:
    def test_flat_ground_has_the_light_of_its_altitude(self):
        assert np.all(hillshade(np.full((5, 6), 3.0), 0.5) == 1 + round(254 * np.sin(np.pi / 4)))

    @pytest.mark.parametrize(
        ("east", "north", "brighter"), [(1, -1, True), (-1, 1, False), (0.5, 0, True)]
    )
    def test_slopes_that_face_the_north_west_are_bright(self, east, north, brighter):
        """``east`` and ``north``: how the surface rises; one that falls to the sun is lit."""
        row, column = np.mgrid[0:9, 0:9]
        heights = 0.3 * (east * column - north * row)
        flat = hillshade(np.zeros((9, 9)), 1.0)[4, 4]
        assert (hillshade(heights, 1.0)[4, 4] > flat) == brighter

    def test_missing_cells_stay_missing_and_their_neighbours_stay_known(self):
        heights = np.ones((6, 6))
        heights[2, 3] = np.nan
        shade = hillshade(heights, 1.0)
        assert shade[2, 3] == NO_DATA
        assert np.count_nonzero(shade == NO_DATA) == 1

    @pytest.mark.parametrize("shape", [(1, 1), (2, 5), (5, 1)])
    def test_rasters_too_narrow_for_a_slope(self, shape):
        assert np.all(hillshade(np.ones(shape), 1.0) > NO_DATA)

    def test_block_mean_of_known_cells(self):
        heights = np.array([[1.0, 3.0, np.nan], [np.nan, 5.0, np.nan], [2.0, 2.0, 8.0]])
        coarse, cell = block_mean(heights, 0.5, 2)
        assert cell == 1.0
        assert coarse[0].tolist()[0] == 3.0
        assert np.isnan(coarse[0, 1])
        assert coarse[1].tolist() == [2.0, 8.0]

    def test_small_raster_keeps_its_cells(self, rng):
        heights = rng.uniform(size=(4, 7))
        coarse, cell = block_mean(heights, 0.5, 7)
        assert cell == 0.5
        assert np.array_equal(coarse, heights)


class TestLayers:
    def sample(self, **changes):
        given = {
            "total": 900,
            "xyz_m": np.array([[0.0, 0, 0], [10, 0, 5], [20, 5, 30], [5, 5, 1]]),
            "above_ground_m": np.array([-0.3, 5.04, 99.0, np.nan]),
            "intensity": np.array([1, 2, 3, 4], np.uint16),
            "colour": None,
        }
        return CloudSample(**given | changes)

    def test_heights_above_ground(self):
        heights = unpack(cloud_layer(self.sample())["height"])
        assert heights.tolist() == [0, 50, 254, UNKNOWN_HEIGHT]

    def test_intensity_that_says_nothing_is_left_out(self):
        layer = cloud_layer(self.sample(intensity=np.zeros(4, np.uint16)))
        assert layer["intensity"] is None
        assert layer["colour"] is None

    def test_colours_are_kept(self, rng):
        colour = rng.integers(0, 256, (4, 3)).astype(np.uint8)
        layer = cloud_layer(self.sample(colour=colour))
        assert np.array_equal(unpack(layer["colour"]).reshape(4, 3), colour)

    def test_relief_covers_the_raster(self):
        layer = relief_layer(np.ones((1000, 2000)), 5.0, 700.0, 0.5)
        assert (layer["rows"], layer["columns"], layer["cell_size_m"]) == (334, 667, 1.5)
        assert layer["shade"]["count"] == 334 * 667

    def test_polygons_with_holes_and_parts(self):
        holed = Polygon(box(0, 0, 30, 30).exterior, [box(10, 10, 12, 12).exterior])
        parts = MultiPolygon([box(40, 0, 50, 10), box(60, 0, 70, 10)])
        layer = polygon_layer(gpd.GeoDataFrame(geometry=[holed, parts]))
        assert [len(rings) for rings in layer] == [2, 1, 1]
        assert unpack(layer[0][1]).max() == 12.0
        assert polygon_layer(gpd.GeoDataFrame(geometry=[])) == []

    def test_polygons_are_drawn_with_few_vertices(self):
        circle = Point(0, 0).buffer(50, 500)
        assert polygon_layer(gpd.GeoDataFrame(geometry=[circle]))[0][0]["count"] < 300

    def test_edges_keep_their_true_length(self):
        line = LineString(np.column_stack([np.linspace(0, 90, 500), np.zeros(500)]))
        table = gpd.GeoDataFrame(
            {"edge": ["a"], "kind": ["edge"], "source": ["digitised"]}, geometry=[line]
        )
        (edge,) = edge_layer(table)
        assert edge["length_m"] == pytest.approx(90)
        assert unpack(edge["xy"]).tolist() == [0, 0, 90, 0]

    def test_candidates_stack_at_positions(self):
        first = pd.DataFrame(
            {"key": ["a", "a", "b"], "x": [1.0, 1, 2], "y": 0.0, "height_m": [4.0, 9.5, 6.0]}
        )
        second = pd.DataFrame({"key": ["c", "a"], "x": [3.0, 1], "y": 0.0, "height_m": [5.0, 4.25]})
        layer = candidate_layer([first, second])
        assert layer["total"] == 5
        assert unpack(layer["xy"]).reshape(-1, 2)[:, 0].tolist() == [1, 2, 3]
        assert unpack(layer["heights"]).tolist() == [3, 1, 1]
        assert unpack(layer["lowest_m"]).tolist() == [4, 6, 5]
        assert unpack(layer["highest_m"]).tolist() == [9.5, 6, 5]
        assert unpack(layer["round"]).tolist() == [0, 0, 1]
        assert candidate_layer([first, first.iloc[:0]])["total"] == 3

    def test_targets(self):
        table = pd.DataFrame(
            {"target": ["t1_2", "t2_2"], "x": [1.5, 2.5], "y": [2.5, 2.5], "z": 7.0}
        )
        layer = target_layer(table)
        assert layer["names"] == ["t1_2", "t2_2"]
        assert unpack(layer["xyz"]).tolist() == [1.5, 2.5, 7.0, 2.5, 2.5, 7.0]


def test_far_from_measured_cells_no_relief_is_shown():
    measured = np.zeros((9, 9), bool)
    measured[4, 4] = True
    shown = np.isfinite(near_measured(np.ones((9, 9)), measured, 1.0))
    rows, columns = np.indices(shown.shape)
    assert np.array_equal(shown, np.hypot(rows - 4, columns - 4) <= 2)
    assert np.isfinite(near_measured(np.ones((9, 9)), None, 1.0)).all()
