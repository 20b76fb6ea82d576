import numpy as np
import pandas as pd
import pytest

from roadsight.geometry.cameras import Intrinsics
from roadsight.poles.images.kinds import PixelClass
from roadsight.poles.images.pictures import best_views, cut_out, projected_box, unrecognisable
from roadsight.poles.sightings.sighting_bearing import ViewCamera


def seen(*rows):
    return pd.DataFrame(rows, columns=["v_min", "v_max", "foot_visible"])


def test_the_tallest_whole_view_is_taken():
    views = seen(
        (50, 100, True),
        (40, 110, True),  # taller
        (0, 130, True),  # taller, cut off at the top
        (30, 150, False),  # taller, without its foot
    )
    assert best_views(views, np.array([0, 0, 0, 0]), 2).tolist() == [1, -1]
    assert best_views(views, np.array([0, 1, 1, -1]), 2).tolist() == [0, 1]


def test_where_no_view_is_whole_the_tallest_is_taken():
    views = seen((0, 100, True), (0, 300, True), (10, 80, False))
    assert best_views(views, np.zeros(3, int), 1).tolist() == [1]
    assert best_views(seen(), np.zeros(0, int), 2).tolist() == [-1, -1]


@pytest.mark.parametrize("box", [(50, 20, 54, 120), (0, 0, 3, 159), (190, 60, 199, 159)])
def test_a_picture_holds_the_object(box):
    image = np.zeros((160, 200, 3), np.uint8)
    u_min, v_min, u_max, v_max = box
    image[v_min : v_max + 1, u_min : u_max + 1] = 200
    found = cut_out(image, box)
    assert (found == 200).sum() == (image == 200).sum()
    assert found.shape[0] <= 160
    assert found.shape[1] < 200


@pytest.mark.parametrize("box", [(-50, -50, -20, -10), (500, 500, 510, 520), (10, 10, 10, 10)])
def test_a_picture_is_never_empty(box):
    assert min(cut_out(np.zeros((160, 200, 3), np.uint8), box).shape) >= 1


def test_what_moves_is_in_blocks_and_the_rest_as_it_was(rng):
    image = rng.integers(0, 255, (120, 240, 3), np.uint8)
    mask = np.zeros((60, 120), np.uint8)  # half the size
    mask[20:40, 30:60] = PixelClass.VEHICLE
    found = unrecognisable(image, mask)
    inside, outside = found[40:80, 60:120], np.r_[0:30, 90:120]
    assert (found[outside] == image[outside]).all()
    assert (found[:, :50] == image[:, :50]).all()
    block = 240 // 60
    assert (inside[::block, ::block] == inside[1::block, 1::block]).all()
    assert len(np.unique(inside.reshape(-1, 3), axis=0)) <= inside[::block, ::block].size / 3
    assert inside.std() < 0.5 * image[40:80, 60:120].std()


def test_without_what_moves_an_image_stays():
    image = np.full((20, 30, 3), 7, np.uint8)
    assert unrecognisable(image, np.zeros((20, 30), np.uint8)) is image


def camera_at(position_m=(0.0, 0.0, 1.5), heading_deg=0.0):
    lens = Intrinsics(640, 480, 500.0, 320.0, 240.0)
    return ViewCamera(lens, position_m, heading_deg, 0.0, 0.0)


def test_a_box_holds_an_object_of_the_cloud():
    found = projected_box(camera_at(), np.array([4.0, 30.0, 0.0]), 8.0, 3.0)
    u_min, v_min, u_max, v_max = found
    # The nearest and the farthest corner of a box 3 m wide, 28.5 and 31.5 m ahead.
    assert u_min == pytest.approx(320 + 500 * 2.5 / 31.5)
    assert u_max == pytest.approx(320 + 500 * 5.5 / 28.5)
    assert v_min == pytest.approx(240 - 500 * 6.5 / 28.5)
    assert v_max == pytest.approx(240 + 500 * 1.5 / 28.5)


def test_what_is_behind_beside_or_mostly_outside_has_no_box():
    size = 8.0, 3.0
    assert projected_box(camera_at(heading_deg=180.0), np.array([4.0, 30.0, 0.0]), *size) is None
    assert projected_box(camera_at(), np.array([3.0, 0.5, 0.0]), *size) is None
    assert projected_box(camera_at(), np.array([24.0, 30.0, 0.0]), *size) is None
    cut = projected_box(camera_at(), np.array([0.0, 15.0, 0.0]), *size)
    assert cut is not None and cut[1] == 0.0
