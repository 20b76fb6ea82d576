import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

from roadsight.geometry.cameras import Intrinsics, attitude_deg, cam_from_world, wrap_deg
from roadsight.poles.images.views import merge_views, side_intrinsics, turned
from roadsight.poles.sightings.sighting_bearing import ViewCamera, image_bearings


@given(st.floats(0, 360), st.floats(-150, 150))
def test_a_level_camera_turns_by_its_yaw(heading, yaw):
    found, pitch, roll = attitude_deg(turned(cam_from_world(heading, 0.0, 0.0), yaw))
    assert float(wrap_deg(found - heading - yaw)) == pytest.approx(0.0, abs=1e-6)
    assert (float(pitch), float(roll)) == pytest.approx((0, 0), abs=1e-9)


def test_a_seam_pixel_has_one_bearing_in_both_views():
    camera = Intrinsics.from_field_of_view(800, 400, 60.0)
    pose = {"position_m": (0.0, 0.0, 2.0), "heading_deg": 350.0}
    front, right = ViewCamera(camera, **pose), ViewCamera(camera, **pose, yaw_deg=60.0)
    at_edge, _ = image_bearings(front, [[799.5, 199.5]], 1.0)
    at_start, _ = image_bearings(right, [[-0.5, 199.5]], 1.0)
    assert float(at_edge[0]) == pytest.approx(20.0, abs=1e-6)
    assert float(at_start[0]) == pytest.approx(20.0, abs=1e-6)


def sighting(view: str, bearing: float, **changes) -> dict:
    return {
        "image": "a", "view": view, "kind": "pole", "bearing_grid_deg": bearing,
        "sigma_bearing_deg": 0.1, "width_deg": 0.2, "depth_m": 20.0, "sigma_depth_m": 1.0,
        "cut_side": False, "kept": True, "reason": "",
    } | changes  # fmt: skip


def kept(*rows: dict) -> pd.DataFrame:
    merged = merge_views(pd.DataFrame(list(rows)))
    return merged[merged["kept"]]


def test_one_pole_in_two_views_counts_once():
    found = kept(sighting("front", 359.95), sighting("right", 0.05))
    assert found["view"].tolist() == ["front"]
    found = kept(sighting("front", 359.95, cut_side=True), sighting("right", 0.05))
    assert found["view"].tolist() == ["right"]


@pytest.mark.parametrize(("place_m", "count"), [(0.6, 1), (0.05, 2)])
def test_a_view_that_ends_at_a_column_has_no_error_of_the_place(place_m, count):
    at_column = {"depth_m": 12.0, "sigma_depth_m": 0.03, "depth_lidar_m": 12.0}
    front = sighting("front", 359.95, sigma_place_m=place_m, **at_column)
    side = {"depth_m": 13.6, "sigma_depth_m": 0.45, "depth_lidar_m": np.nan}
    assert len(kept(front, sighting("right", 0.05, sigma_place_m=place_m, **side))) == count
    both = sighting("right", 0.05, sigma_place_m=place_m, **at_column | {"depth_m": 13.6})
    assert len(kept(front, both)) == 2


def test_halves_at_a_seam_become_one_in_the_middle():
    found = kept(
        sighting("front", 359.9, cut_side=True, width_deg=0.2),
        sighting("right", 0.3, cut_side=True, width_deg=0.6),
    )
    assert len(found) == 1
    assert float(wrap_deg(found["bearing_grid_deg"].iloc[0])) == pytest.approx(0.2)


def test_two_poles_stay_two():
    assert len(kept(sighting("front", 10.0), sighting("right", 12.0))) == 2
    assert len(kept(sighting("front", 10.0), sighting("front", 10.0))) == 2
    assert len(kept(sighting("front", 10.0), sighting("right", 10.0, depth_m=40.0))) == 2
    assert len(kept(sighting("front", 10.0), sighting("right", 10.0, kind="sign"))) == 2
    assert len(kept(sighting("front", 10.0), sighting("right", 10.0, image="b"))) == 2
    assert len(kept(sighting("front", 10.0), sighting("right", 10.05), sighting("right", 9.6))) == 2


def test_side_views_of_another_size_keep_the_field_of_view_down():
    front = Intrinsics(800, 400, 700.0, 390.0, 190.0)
    assert side_intrinsics(front, 800, 400) is front
    assert side_intrinsics(front, 1000, 200).focal_px == 350.0
