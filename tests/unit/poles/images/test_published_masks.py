import numpy as np
import pytest

from roadsight.base.errors import InputError
from roadsight.geometry.cameras import Intrinsics
from roadsight.poles.images.kinds import PixelClass
from roadsight.poles.images.pole_masks import published_instances
from roadsight.poles.images.views import beside


def mask_of(*boxes, height_px=1200, kind=PixelClass.POLE):
    """Mask with boxes of left, top, width, height."""
    mask = np.zeros((height_px, 2356), np.uint8)
    for left, top, width, height in boxes:
        mask[top : top + height, left : left + width] = int(kind)
    return mask


@pytest.mark.parametrize(
    ("width", "height", "reason"),
    [
        (10, 400, "too small"), (11, 400, ""), (11, 20, "too small"), (40, 399, "not slender"),
        (40, 400, ""),
    ],
)  # fmt: skip
def test_sizes_and_aspect(width, height, reason):
    (one,) = published_instances(mask_of((500, 100, width, height)))
    assert one.reason == reason
    assert one.u_foot == pytest.approx(500 + (width - 1) / 2)
    assert one.v_foot == 100 + height - 0.5
    assert (one.u_min, one.v_min) == (499.5, 99.5)


def test_numbers_are_scaled_with_the_height():
    half = [published_instances(mask_of((500, 50, w, 200), height_px=600))[0] for w in (5, 6)]
    assert [one.reason for one in half] == ["too small", ""]


def leaning(thickness):
    """A pole that leans so far that its box is no pole's."""
    mask = mask_of()
    for row in range(100, 900):
        left = 500 + (row - 100) // 4
        mask[row, left : left + thickness] = int(PixelClass.POLE)
    return mask


def test_what_is_long_along_its_own_axes_is_a_pole_if_more_than_wires_are_left():
    (thick,) = published_instances(leaning(20))
    assert thick.reason == ""
    (thin,) = published_instances(leaning(5))
    assert thin.reason == "wires alone"
    # A short wire pulls the column of the foot aside, until it is removed.
    wired = leaning(20)
    wired[150:153, 520:640] = int(PixelClass.POLE)
    (one,) = published_instances(wired)
    assert one.reason == ""
    assert one.u_foot == pytest.approx(thick.u_foot, abs=1.5)


def test_a_sign_that_touches():
    mask = mask_of((500, 100, 20, 400))
    mask[200:240, 521:560] = int(PixelClass.SIGN)
    assert not published_instances(mask)[0].touches_sign
    mask[200:240, 520:560] = int(PixelClass.SIGN)
    assert published_instances(mask)[0].touches_sign


def test_more_than_255_poles_keep_their_places():
    mask = mask_of(*((4 + 13 * k, 200 * j, 11, 150) for k in range(180) for j in range(2)))
    found = published_instances(mask)
    assert len(found) == 360
    assert all(one.reason == "" for one in found)


def test_stitched_side_views_go_on_in_the_front_view_s_plane():
    front = Intrinsics.from_field_of_view(640, 416, 22.0)
    left, right = (beside(front, view, 640, 416) for view in ("left", "right"))
    # The last column of the left image is the one before the front image's first.
    assert left.cx_px - 639.0 == front.cx_px + 1.0
    assert right.cx_px == front.cx_px - 640.0
    assert beside(front, "front", 640, 416) == front
    with pytest.raises(InputError, match="as large as the front view"):
        beside(front, "left", 800, 416)
