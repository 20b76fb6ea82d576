import numpy as np
import pandas as pd
import pytest

from roadsight.base.errors import InputError
from roadsight.geometry.lens import RadialLens
from roadsight.poles.drive import drive_profile
from roadsight.poles.drive.drive_lenses import lens_content, lens_of, with_given
from roadsight.poles.drive.drive_profile import (
    EYE_M,
    beside_track,
    evenly,
    front_view_gap,
    hidden_share,
    keys_of,
    left_out_share,
    measured_lens,
    views_of_places,
)
from roadsight.scene.terrain.tin import (
    TerrainSight,
    hidden_by_heights,
    hidden_road_share,
    triangulate,
    visible,
)

KEY = ("a", 640, 416)


def crest(radius_m):
    """Road over the top of a parabola with this radius; x runs along it."""
    return lambda x, y: -np.square(x) / (2 * radius_m) + 0 * y


def frames(count=40, step_m=8.0, height=lambda x, y: 0 * x, sides=True):
    x = step_m * np.arange(count) - 0.5 * step_m * count
    nothing = np.zeros(count)
    side = "s.jpg" if sides else ""
    return pd.DataFrame(
        {
            "image": [f"{i}.jpg" for i in range(count)], "route": "a",
            "sequence": np.arange(count), "x": x, "y": nothing, "z_road": height(x, nothing),
            "heading_deg": 90.0, "width_px": 640, "height_px": 416,
            "path": [f"{i}.jpg" for i in range(count)], "left_path": side, "right_path": side,
        }
    )  # fmt: skip


class TestSightLines:
    def test_horizon_over_a_crest(self):
        # From a height h over a parabola of radius R the road is seen up to sqrt(2 R h), and a
        # point t above it up to sqrt(2 R t) further.
        radius, eye, lift = 1500.0, 2.0, 0.15
        horizon = np.sqrt(2 * radius * eye) + np.sqrt(2 * radius * lift)
        x = np.arange(2.0, 200.0, 1.0)
        points = np.column_stack([x, 0 * x, crest(radius)(x, 0 * x)])
        hidden = hidden_by_heights(crest(radius), [0.0, 0.0, eye], points)
        assert x[hidden].min() == pytest.approx(horizon, abs=2.0)
        assert hidden[x > horizon + 2].all()

    def test_level_ground_hides_nothing_and_a_wall_everything(self):
        points = np.array([[50.0, 0.0, 0.0], [150.0, 5.0, 0.0]])
        assert not hidden_by_heights(lambda x, y: 0 * x, [0, 0, 2.0], points).any()

        def wall(x, y):
            return np.where(np.abs(x - 30) < 2, 5.0, 0.0)

        assert hidden_by_heights(wall, [0, 0, 2.0], points).all()
        nothing = hidden_by_heights(lambda x, y: np.full(len(x), np.nan), [0, 0, 2.0], points)
        assert not nothing.any()
        assert hidden_by_heights(wall, [0, 0, 2.0], np.empty((0, 3))).shape == (0,)

    def test_agrees_with_rays_at_triangles(self, rng):
        xy = rng.uniform(-20, 220, (9000, 2))

        def hills(x, y):
            return 3 * np.sin(x / 25) + 1.0 * np.cos(y / 30)

        terrain = TerrainSight(triangulate(np.column_stack([xy, hills(*xy.T)]), 1000.0))
        eye = np.array([5.0, 100.0, hills(5.0, 100.0) + 2.2])
        points = rng.uniform([10, 50], [200, 150], (400, 2))
        points = np.column_stack([points, hills(*points.T)])
        exact = ~visible(terrain, eye, points)
        found = hidden_by_heights(hills, eye, points)
        assert 0.2 < exact.mean() < 0.95
        assert np.mean(found == exact) > 0.95

    def test_shares(self):
        edges = np.array([[100.0, 3.0, 0.0], [-100.0, 3.0, 0.0], [500.0, 0.0, 0.0]])
        share = hidden_road_share(crest(1e12), [[0, 0, 2.0]], [90.0], edges, 240.0)
        assert share == 0.0
        assert np.isnan(hidden_road_share(crest(1e12), [[0, 0, 2.0]], [0.0], edges, 240.0))

    def test_of_a_drive(self):
        assert hidden_share(frames(), lambda x, y: 0 * x) == 0.0
        over = crest(1500.0)
        assert 0.2 < hidden_share(frames(height=over), over) < 0.8
        assert hidden_share(frames(count=0), over) is None
        assert hidden_share(frames(), lambda x, y: np.full(len(x), np.nan)) is None
        assert EYE_M == 2.2


class TestFrontView:
    def test_a_place_enters_the_frame_where_the_formula_says(self):
        # o / tan(hfov / 2)
        offset, half = 8.0, 20.0
        enters = offset / np.tan(np.radians(half))
        cameras = np.column_stack([np.arange(-60.0, 0.0, 0.5), np.zeros(120)])
        count = views_of_places([[0.0, offset]], cameras, np.full(120, 90.0), half, 40.0)[0]
        from_m = np.sqrt(40.0**2 - offset**2)
        assert count == pytest.approx((from_m - enters) / 0.5, abs=1.0)

    def test_wide_views_leave_nothing_out_and_narrow_ones_nearly_all(self):
        drive = frames()
        gaps = [front_view_gap(drive, fov) for fov in (10.0, 20.0, 40.0, 60.0, 90.0, 110.0)]
        assert gaps == sorted(gaps, reverse=True)
        assert gaps[0] > 0.8
        assert gaps[-1] < 0.1

    def test_needs_side_images(self):
        assert front_view_gap(frames(sides=False), 20.0) is None
        assert np.isnan(left_out_share(np.empty((0, 2)), [[0, 0]], [0.0], 60.0, 40.0, 3))

    def test_headings_across_north(self):
        cameras, headings = [[0.0, 0.0], [0.0, 1.0]], [359.9, 0.1]
        assert views_of_places([[0.0, 20.0]], cameras, headings, 1.0, 40.0).tolist() == [2]

    def test_places_beside_a_track(self):
        places = beside_track(frames(), (3.0, 6.0))
        assert sorted(set(np.round(places[:, 1], 6))) == [-6.0, -3.0, 3.0, 6.0]
        standing = frames().assign(x=0.0)
        assert beside_track(standing, (3.0,)).shape == (0, 2)
        assert beside_track(frames(count=1), (3.0,)).shape == (0, 2)


class TestLenses:
    def content(self):
        return lens_content(KEY, RadialLens.centred(-0.1, 0.0, 640, 416), -40.0, 3.0, "plumb lines")

    def test_a_given_lens_replaces_the_measured_one(self):
        given = [{"route": "b", "k1": 0.3, "k2": 0.0, "focal_px": 500.0}]
        assert with_given([self.content()], given)[0]["source"] == "plumb lines"
        given.append({"route": None, "k1": -0.2, "k2": 0.05, "focal_px": 500.0})
        found = with_given([self.content()], given)[0]
        assert (found["source"], found["k1"], found["sigma_px"]) == ("given", -0.2, 0.0)
        lens = RadialLens.centred(-0.2, 0.05, 640, 416, 500.0)
        assert found["corner_px"] == pytest.approx(lens.corner_px(640, 416))

    def test_a_given_lens_that_folds_the_image_is_refused(self):
        with pytest.raises(InputError, match="folds them"):
            with_given([self.content()], [{"k1": -2.0, "k2": 0.0, "focal_px": 300.0}])

    def test_a_side_view_of_another_size_has_the_same_lens(self):
        front = lens_of([self.content()], KEY, (416, 640))
        side = lens_of([self.content()], KEY, (208, 320))
        np.testing.assert_allclose(
            (side.undistort([[0.0, 0.0]]) + 0.5) * 2 - 0.5, front.undistort([[0.5, 0.5]]), atol=1e-6
        )
        with pytest.raises(InputError, match="no lens"):
            lens_of([self.content()], ("b", 640, 416), (416, 640))

    def test_images_without_upright_outlines_say_nothing(self):
        grey = np.full((416, 640, 3), 90, np.uint8)
        found = measured_lens(KEY, ["x"] * 3, lambda path: grey)
        assert (found["source"], found["corner_px"], found["sigma_px"]) == ("unknown", 0.0, None)
        assert measured_lens(KEY, [], lambda path: grey)["source"] == "unknown"

    @pytest.mark.parametrize("images", [3, 24])
    def test_a_lens_from_too_little_is_withheld_with_its_reason(self, images, monkeypatch):
        """Its numbers are told, its coefficients are a pinhole's."""
        lens, rng = RadialLens.centred(-0.1, 0.0, 640, 416), np.random.default_rng(1)

        def outlines(_):
            v = np.linspace(20, 396, 60)
            straight = [np.column_stack([np.full(60, u), v]) for u in rng.uniform(20, 620, 6)]
            return [lens.distort(s) + rng.normal(0, 0.1, (60, 1)) * [1, 0] for s in straight]

        monkeypatch.setattr(drive_profile, "upright_curves", outlines)
        found = measured_lens(KEY, ["x"] * images, lambda path: np.zeros((416, 640, 3), np.uint8))
        assert bool(found["withheld"]) == (images == 3)
        assert (found["k1"] == 0.0) == (images == 3)
        assert found["corner_px"] == pytest.approx(lens.corner_px(640, 416), rel=0.2)


def test_keys_and_even_choices():
    both = pd.concat([frames(3), frames(3).assign(route="b", width_px=800)])
    assert keys_of(both) == [("a", 640, 416), ("b", 800, 416)]
    assert evenly(10, 3).tolist() == [0, 4, 9]
    assert evenly(2, 9).tolist() == [0, 1]
    assert evenly(0, 9).tolist() == []
