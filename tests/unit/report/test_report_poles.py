import base64

import cv2
import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

from roadsight.io.raster.top_rasters import TopRaster
from roadsight.report.poles_layers import (
    ACCEPTED,
    LEVELS,
    REJECTED,
    UNUSED,
    cameras_of,
    class_layer,
    match_sightings,
    names_in,
    sighting_layer,
)
from roadsight.report.poles_page import choose_images, overlay, picture, plain, pole_cautions
from roadsight.report.poles_view import _hazard as hazard_view

KINDS = ("nothing", "other", "ground", "vegetation", "building", "road", "bridge")


def unpacked(packed):
    dtype = f"<{packed['dtype']}"
    return np.frombuffer(base64.b64decode(packed["data"]), dtype)


def frames(count, heading_deg=0.0):
    return pd.DataFrame(
        {
            "image": [f"{n}.jpg" for n in range(count)], "route": "r", "sequence": range(count),
            "x": 0.0, "y": 10.0 * np.arange(count), "heading_deg": heading_deg, "step_m": 10.0,
            "status": "ok",
        }
    )  # fmt: skip


def cameras(count, **columns):
    base = {
        "image": [f"{n}.jpg" for n in range(count)], "x": 0.0, "y": 10.0 * np.arange(count),
        "z": 2.0, "heading_deg": 0.0, "sigma_heading_deg": 0.1, "sigma_lateral_m": 0.2,
        "residual_px": 1.0, "accepted": True, "reason": "",
    }  # fmt: skip
    return pd.DataFrame(base | columns)


class TestCameras:
    @pytest.mark.parametrize("heading_deg", [0.0, 90.0, 180.0, 359.9])
    def test_correction_is_positive_to_the_right(self, heading_deg):
        right = np.radians(heading_deg)
        poses = cameras(
            2,
            x=0.5 * np.cos(right),
            y=10.0 * np.arange(2) - 0.5 * np.sin(right),
            heading_deg=(heading_deg + 0.4) % 360,
        )
        found = cameras_of(frames(2, heading_deg), poses)
        assert found["lateral_m"].to_numpy() == pytest.approx(0.5)
        assert found["yaw_deg"].to_numpy() == pytest.approx(0.4)

    def test_states_and_reasons(self):
        given = frames(4)
        given.loc[2, "status"] = "stands still"
        poses = cameras(2, accepted=[True, False], reason=["", "ambiguous"])
        found = cameras_of(given, poses)
        assert found["state"].tolist() == [ACCEPTED, REJECTED, UNUSED, UNUSED]
        assert found["reason"].tolist() == ["", "ambiguous", "stands still", "not aligned"]
        assert found["y"].tolist() == [0.0, 10.0, 20.0, 30.0]

    def test_pose_that_is_missing_falls_back_to_the_track(self):
        poses = cameras(1, x=np.nan, heading_deg=np.nan, accepted=False, reason="no edges")
        found = cameras_of(frames(1, 45.0), poses).iloc[0]
        assert (found["x"], found["heading_deg"]) == (0.0, 45.0)
        assert np.isnan(found["lateral_m"])

    def test_stations_start_anew_with_each_route(self):
        given = frames(4).assign(route=["a", "a", "b", "b"])
        assert cameras_of(given, cameras(4))["station_m"].tolist() == [0.0, 10.0, 0.0, 10.0]


class TestSightings:
    SIGHTINGS = pd.DataFrame(
        {
            "image": ["a", "a", "a", "b"], "kind": ["pole", "pole", "pole", "sign"], "x": 0.0,
            "y": 0.0, "bearing_grid_deg": [44.0, 359.5, 46.5, 45.0],
            "depth_m": [14.0, np.nan, 14.0, 14.0], "kept": [True, True, False, True],
        }
    )  # fmt: skip

    def poles(self, **columns):
        base = {"x": [10.0], "y": [10.0], "kind": "pole", "images": [["a", "b"]]}
        return pd.DataFrame(base | columns)

    def test_pole_owns_the_kept_sighting_that_points_at_it_best(self):
        assert match_sightings(self.SIGHTINGS, self.poles()).tolist() == [0, -1, -1, -1]

    def test_sighting_goes_to_the_pole_it_points_at_best(self):
        poles = self.poles(x=[10.0, 9.7], y=[10.0, 10.0], kind="pole", images=["a", "a"])
        assert match_sightings(self.SIGHTINGS, poles).tolist() == [1, -1, -1, -1]

    def test_bearings_wrap_at_north(self):
        poles = self.poles(x=[0.05], y=[10.0], images=["a"])
        assert match_sightings(self.SIGHTINGS, poles).tolist() == [-1, 0, -1, -1]

    def test_rays_run_along_their_bearing(self):
        layer = sighting_layer(self.SIGHTINGS, np.array([0, -1, -1, -1]), ["a", "b"])
        rays = unpacked(layer["rays"]).reshape(-1, 4)
        assert rays[0] == pytest.approx(
            [0, 0, 14 * np.sin(np.radians(44)), 14 * np.cos(np.radians(44))], abs=1e-4
        )
        assert np.hypot(*rays[1, 2:]) == pytest.approx(30.0)
        assert unpacked(layer["pole"]).tolist() == [1, 0, 0, 0]
        assert unpacked(layer["camera"]).tolist() == [0, 0, 0, 1]

    def test_rays_of_unknown_bearing_or_image_are_left_out(self):
        broken = self.SIGHTINGS.assign(bearing_grid_deg=[np.nan, 1.0, 1.0, 1.0])
        layer = sighting_layer(broken, np.full(4, -1), ["a"])
        assert layer["rays"]["count"] == 8

    @pytest.mark.parametrize(
        ("cell", "names"),
        [
            (["a", "b"], ["a", "b"]), (np.array(["a"]), ["a"]), ("a;b", ["a", "b"]),
            ('["a", "b"]', ["a", "b"]), ("a, b.jpg | c", ["a, b.jpg", "c"]), ("", []), (None, []),
            (float("nan"), []),
        ],
    )  # fmt: skip
    def test_names_of_images(self, cell, names):
        assert names_in(cell) == names


class TestImages:
    @given(st.lists(st.sampled_from([ACCEPTED, REJECTED, UNUSED]), max_size=80), st.integers(3, 30))
    def test_choice_is_ordered_limited_and_never_unused(self, states, most):
        residual = np.linspace(0, 1, len(states))
        table = pd.DataFrame({"state": np.array(states, int), "residual_px": residual})
        rows = choose_images(table, most)
        usable = [n for n, state in enumerate(states) if state != UNUSED]
        assert rows == sorted(set(rows))
        assert set(rows) <= set(usable)
        assert len(rows) <= most
        if len(usable) <= most:
            assert rows == usable

    def test_choice_has_the_worst_and_rejected_ones(self):
        residual = np.ones(100)
        residual[[17, 43]] = 9.0
        state = np.zeros(100, int)
        state[[5, 60]] = REJECTED
        rows = choose_images(pd.DataFrame({"state": state, "residual_px": residual}), 12)
        assert {5, 17, 43, 60} <= set(rows)
        assert len(rows) == 12

    def test_picture_is_small_and_of_the_same_shape(self):
        image = np.full((1200, 2356, 3), 90, np.uint8)
        jpeg = base64.b64decode(picture(image)["jpeg"])
        assert cv2.imdecode(np.frombuffer(jpeg, np.uint8), 1).shape == (326, 640, 3)
        assert len(base64.b64decode(picture(image[:20, :30])["jpeg"])) < 2000

    def overlay(self, pose):
        edges = pd.DataFrame({"u": [0.0, 1279.0, np.nan], "v": [0.0, 639.0, 3.0]})
        names = ("u_min", "u_max", "v_min", "u_foot", "v_foot", "kept", "reason", "depth_m")
        values = [[100.0, 120.0, 10.0, 102.0, 400.0, True, "", np.nan]]
        sightings = pd.DataFrame(values, columns=names)
        points = np.array([[0.0, 20.0, 0.0], [0.0, -20.0, 0.0], [0.0, 500.0, 0.0], [0.0, 1.0, 0.0]])
        return overlay(pose, (1280, 640), points, edges, sightings, [3])

    def test_overlay_is_in_pixels_of_the_copy(self):
        numbers = {"x": 0.0, "y": 0.0, "z": 2.0, "heading_deg": 0.0, "pitch_deg": 0.0}
        numbers |= {"roll_deg": 0.0, "focal_px": 1000.0, "cx_px": 639.5, "cy_px": 319.5}
        made = self.overlay(pd.Series(numbers | {"width_px": 1280, "height_px": 640}))
        assert (made["width_px"], made["height_px"]) == (640, 320)
        # Only the point 20 m ahead: 100 px below the horizon of the full image.
        lidar = unpacked(made["lidar"]) / made["steps_per_px"]
        assert lidar == pytest.approx([639.5 / 2, 419.5 / 2], abs=0.1)
        assert unpacked(made["edges"]).tolist() == [0, 0, 5116, 2556]
        [axis] = made["axes"]
        assert axis["line"] == [51.0, 200.0, 59.0, 5.0]
        assert (axis["pole"], axis["depth_m"]) == (3, None)

    def test_image_without_pose_shows_no_lidar(self):
        assert self.overlay(None)["lidar"]["count"] == 0


class TestRaster:
    def raster(self, values, cell=1.0):
        cls = np.asarray(values, np.uint8)
        nothing = np.zeros(cls.shape, np.float32)
        return TopRaster(cls, nothing, nothing, 0.0, float(len(cls)), cell)

    def kinds(self, layer):
        png = np.frombuffer(base64.b64decode(layer["png"]), np.uint8)
        return cv2.imdecode(png, cv2.IMREAD_UNCHANGED) // LEVELS

    def test_kinds_of_classes(self):
        classes = [[2, 3, 5], [6, 11, 17], [1, 0, 0]]
        layer = class_layer(self.raster(classes), [[1.5, 1.5]])
        names = np.array(KINDS)[self.kinds(layer)]
        assert names.tolist() == [
            ["ground", "vegetation", "vegetation"],
            ["building", "road", "bridge"],
            ["other", "nothing", "nothing"],
        ]

    def test_only_what_lies_near_a_camera(self):
        layer = class_layer(self.raster(np.full((400, 600), 2)), [[100.5, 100.5]])
        kinds = self.kinds(layer)
        assert kinds.shape == (layer["rows"], layer["columns"])
        assert kinds.sum() == pytest.approx(2 * np.pi * 80**2, rel=0.03)
        assert layer["west_m"] == pytest.approx(20.0)
        assert layer["north_m"] == pytest.approx(181.0)

    def test_road_survives_coarsening(self):
        values = np.full((3, 5000), 2)
        values[1, 2500] = 11
        layer = class_layer(self.raster(values), np.column_stack([np.arange(5000), np.ones(5000)]))
        assert layer["columns"] <= 2200
        assert (self.kinds(layer) == KINDS.index("road")).sum() == 1

    @pytest.mark.parametrize("places", [np.empty((0, 2)), [[np.nan, 1.0]], [[900.0, 900.0]]])
    def test_no_raster_without_cameras_on_it(self, places):
        assert class_layer(self.raster([[2]]), places) is None


class TestCautions:
    def texts(self, state, kept=50, poles=1, sigma=1.0, validation=None):
        table = pd.DataFrame({"state": state})
        sightings = pd.DataFrame({"kept": [True] * kept})
        located = [{"sigma_major_m": sigma}] * poles
        warnings, notes = pole_cautions(table, sightings, located, validation)
        return " ".join(warnings), " ".join(notes)

    def test_good_site_has_no_warning(self):
        validation = {"errors": [{}] * 12, "warnings": []}
        assert self.texts([ACCEPTED] * 40, validation=validation)[0] == ""

    def test_warnings(self):
        warnings, notes = self.texts([ACCEPTED, REJECTED, UNUSED], kept=3, poles=0)
        assert "Only 2 images" in warnings
        assert "Only 1 of 2 images" in warnings
        assert "Only 3 sightings" in warnings
        assert "No pole was located" in warnings
        assert "No known poles" in notes
        assert "1 image not used" in notes

    def test_validation_speaks_for_itself(self):
        validation = {"errors": [{}], "warnings": ["half of the route is covered"]}
        warnings, _ = self.texts([ACCEPTED] * 40, sigma=9.0, validation=validation)
        assert "Half of the route is covered." in warnings
        assert "Only 1 pole could be checked" in warnings
        assert "may be off by more than 5 m" in warnings


def test_json_content_is_plain():
    given = {1: np.float64(2.0), "a": [np.nan, (np.int8(3), None)], "b": {"c": np.inf}}
    assert plain(given) == {"1": 2.0, "a": [None, [3, None]], "b": {"c": None}}


RANGE = ("clear_zone_least_m", "clear_zone_greatest_m")


def test_a_range_is_written_as_one():
    page = {"columns": ["id", "offset_m", "clear_zone_m", "inside_clear_zone", *RANGE]}
    page["rows"] = [["a", 4.0, 8.0, True, 3.0, 8.0], ["b", 2.0, 8.0, True, 8.0, 8.0]]
    page["rows"] += [["c", 2.5, 8.0, True, 3.0, 8.0], ["d", None, 8.0, False, 3.0, 8.0]]
    texts = [[cell["text"] for cell in row["cells"]] for row in hazard_view(page, {})["rows"]]
    assert [row[2] for row in texts] == ["3.0 to 8.0 m", "8\u202fm", "3.0 to 8.0 m", "3.0 to 8.0 m"]
    assert [row[3] for row in texts] == ["perhaps", "yes", "yes", "no"]
