import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from roadsight.base.sections.poles import PoleMasks
from roadsight.poles.images.kinds import PixelClass
from roadsight.poles.images.pole_masks import find_instances

HEIGHT = 1200
WIDTH = 900


def scene() -> np.ndarray:
    mask = np.full((HEIGHT, WIDTH), PixelClass.OTHER, np.uint8)
    mask[:500] = PixelClass.SKY
    return mask


def draw(mask, u, top, bottom, width=12, lean=0.0, cls=PixelClass.POLE):
    for v in range(top, bottom):
        left = round(u + lean * (v - bottom) - width / 2)
        mask[v, max(left, 0) : left + width] = cls


def test_axis_and_foot_of_a_leaning_pole():
    mask = scene()
    draw(mask, 400, 200, 800, lean=0.05)
    (pole,) = find_instances(mask)
    assert pole.reason == ""
    assert pole.u_foot == pytest.approx(399.5, abs=0.6)
    assert pole.v_foot == 799.5
    assert pole.slope == pytest.approx(0.05, abs=0.002)
    assert pole.width_px == 12
    assert pole.foot == "visible"
    assert not pole.cut
    assert float(pole.axis_u(np.array([200.0]))[0]) == pytest.approx(369.5, abs=0.8)


def test_wires_and_arms_do_not_move_the_axis():
    plain, wired = scene(), scene()
    for mask in (plain, wired):
        draw(mask, 400, 200, 800)
    wired[230:240, 300:640] = PixelClass.POLE
    wired[205:209] = PixelClass.POLE
    (a,), (b,) = find_instances(plain), find_instances(wired)
    assert (b.u_foot, b.v_foot) == pytest.approx((a.u_foot, a.v_foot), abs=0.3)
    assert b.u_max - b.u_min < 40
    assert b.reason == ""


def test_two_poles_on_one_wire_are_two():
    mask = scene()
    draw(mask, 200, 200, 800)
    draw(mask, 600, 220, 780)
    mask[230:240, 200:600] = PixelClass.POLE
    assert [one.u_foot for one in find_instances(mask)] == pytest.approx([199.5, 599.5], abs=0.2)


def test_a_pole_cut_by_a_sign_is_one():
    mask = scene()
    draw(mask, 400, 200, 800)
    mask[400:480, 360:440] = PixelClass.SIGN
    (pole,) = find_instances(mask)
    assert pole.v_min == 199.5
    assert pole.touches_sign


def test_poles_above_one_another_but_aside_stay_two():
    mask = scene()
    draw(mask, 400, 200, 480)
    draw(mask, 430, 500, 800)
    assert len(find_instances(mask)) == 2


def test_more_than_255_components_are_told_apart():
    mask = np.zeros((240, 3000), np.uint8)
    for k in range(300):
        mask[40:200, 10 * k + 3 : 10 * k + 6] = PixelClass.POLE
    found = find_instances(mask, settings=PoleMasks(min_width_px=1.0))
    assert len(found) == 300
    assert [one.u_foot for one in found] == pytest.approx([10 * k + 4 for k in range(300)])


@pytest.mark.parametrize(
    ("cls", "foot"),
    [
        (PixelClass.VEHICLE, "hidden"),
        (PixelClass.BUILDING, "hidden"),
        (PixelClass.VEGETATION, "plants"),
        (PixelClass.ROAD, "visible"),
    ],
)
def test_what_lies_below_a_foot_says_whether_it_is_in_sight(cls, foot):
    mask = scene()
    draw(mask, 400, 200, 800)
    mask[800:900, 300:500] = cls
    assert find_instances(mask)[0].foot == foot


def test_what_the_frame_cuts_is_known():
    mask = scene()
    draw(mask, 3, 0, HEIGHT)
    (pole,) = find_instances(mask)
    assert pole.cut == {"left", "top", "bottom"}
    assert pole.foot == "hidden"


def test_small_and_stout_things_are_no_poles():
    mask = scene()
    draw(mask, 100, 700, 738)
    draw(mask, 300, 600, 700, width=60)
    draw(mask, 500, 400, 800, width=2)
    reasons = {float(np.round(one.u_foot, -2)): one.reason for one in find_instances(mask)}
    assert reasons == {100: "too small", 300: "not slender", 500: "too small"}


def test_empty_masks_have_no_instances():
    assert find_instances(scene()) == []
    assert find_instances(np.zeros((5, 5), np.uint8)) == []


def panel(mask, left, top, size=40, cls=PixelClass.SIGN):
    mask[top : top + size, left : left + size] = cls
    return mask


def test_a_panel_is_where_its_middle_is_and_has_no_foot():
    (sign,) = find_instances(panel(scene(), 200, 600), "sign")
    assert (sign.kind, sign.reason, sign.foot) == ("sign", "", "hidden")
    assert (sign.u_foot, sign.v_foot) == (219.5, 619.5)
    assert sign.pixels == 1600


def test_a_panel_may_be_smaller_than_a_pole():
    mask = panel(panel(scene(), 200, 600, size=36), 400, 600, size=10)
    assert [one.reason for one in find_instances(mask, "sign")] == ["", "too small"]
    mask[mask == PixelClass.SIGN] = PixelClass.POLE
    assert [one.reason for one in find_instances(mask, "pole")] == ["too small"]


def test_a_post_before_a_panel_does_not_part_it():
    mask = panel(scene(), 200, 600, size=80)
    draw(mask, 240, 590, 900, width=14)
    (sign,) = find_instances(mask, "sign")
    assert (sign.u_foot, sign.v_foot) == pytest.approx((239.5, 639.5), abs=0.5)
    assert sign.pixels == 6400
    apart = panel(panel(scene(), 200, 600), 300, 600)
    assert len(find_instances(apart, "sign")) == 2


def on_grass(cls, post=PixelClass.POLE, beside=False):
    mask = np.full((HEIGHT, WIDTH), PixelClass.VEGETATION, np.uint8)
    panel(mask, 300, 500, size=60, cls=cls)
    draw(mask, 330, 560, 760, width=8, cls=post)
    if beside:
        draw(mask, 305, 560, 760, width=30, cls=post)
    return mask


@pytest.mark.parametrize(
    "cls", [PixelClass.OTHER, PixelClass.VEHICLE, PixelClass.GUARDRAIL, PixelClass.SIGN]
)
def test_what_stands_on_a_post_is_a_panel_though_the_network_does_not_know_it(cls):
    (sign,) = find_instances(on_grass(cls), "sign")
    assert (sign.reason, sign.u_foot, sign.v_foot) == ("", 329.5, 529.5)


def test_what_stands_on_no_post_on_more_or_could_be_anything_is_none():
    assert find_instances(on_grass(PixelClass.OTHER, post=PixelClass.VEGETATION), "sign") == []
    assert find_instances(on_grass(PixelClass.OTHER, beside=True), "sign") == []
    assert find_instances(on_grass(PixelClass.TREE), "sign") == []
    wide = on_grass(PixelClass.OTHER)
    wide[500:560, 100:600] = PixelClass.OTHER
    assert find_instances(wide, "sign") == []


def test_what_hangs_on_a_pole_that_goes_on_above_it_is_none():
    """A transformer of 40 by 70 px on a utility pole; a post may end a little above its board."""
    for above, signs in ((0, 1), (50, 1), (90, 0), (300, 0)):
        mask = np.full((HEIGHT, WIDTH), PixelClass.VEGETATION, np.uint8)
        draw(mask, 400, 400 - above, 900)
        mask[400:470, 380:420] = PixelClass.OTHER
        assert len(find_instances(mask, "sign")) == signs


def test_a_pole_behind_that_begins_above_a_board_is_not_its_post():
    mask = np.full((HEIGHT, WIDTH), PixelClass.VEGETATION, np.uint8)
    draw(mask, 400, 260, 380)
    draw(mask, 400, 470, 900)
    mask[400:470, 380:420] = PixelClass.OTHER
    assert len(find_instances(mask, "sign")) == 1


def test_boards_above_one_another_on_a_post_are_two():
    mask = np.full((HEIGHT, WIDTH), PixelClass.VEGETATION, np.uint8)
    draw(mask, 400, 400, 900)
    for top in (400, 520):
        panel(mask, 370, top, size=60, cls=PixelClass.OTHER)
    assert len(find_instances(mask, "sign")) == 2


def test_the_middle_of_a_panel_that_the_frame_cuts_is_unknown():
    (sign,) = find_instances(panel(scene(), 0, 600), "sign")
    assert sign.reason == "cut by the frame"


@settings(max_examples=15, deadline=None)
@given(st.integers(-300, 300), st.integers(-150, 150))
def test_poles_move_with_the_image(du, dv):
    here = np.zeros((HEIGHT, WIDTH), np.uint8)
    draw(here, 450, 200, 800, lean=0.03)
    there = np.roll(here, (dv, du), axis=(0, 1))
    (a,), (b,) = find_instances(here), find_instances(there)
    assert b.u_foot - a.u_foot == pytest.approx(du, abs=1e-6)
    assert b.v_foot - a.v_foot == pytest.approx(dv)
    assert b.slope == pytest.approx(a.slope, abs=1e-9)


def test_thresholds_scale_with_the_image():
    large = scene()
    draw(large, 400, 200, 800)
    small = np.ascontiguousarray(large[::4, ::4])
    (a,), (b,) = find_instances(large), find_instances(small)
    assert (a.reason, b.reason) == ("", "")
    assert b.u_foot * 4 == pytest.approx(a.u_foot, abs=4)
