import numpy as np
import pandas as pd
import pytest

from roadsight.poles.risk.marked_lanes import LANE_COLUMNS, marked_lanes, with_inventory

NAN = float("nan")
AT = np.arange(30.0, 171, 5)
TWO = ((-3.2, "solid"), (-0.11, "solid"), (0.11, "solid"), (3.2, "solid"))
FOUR = (
    *((-6.6, "solid"), (-3.3, "dashed"), (-0.11, "solid"), (0.11, "solid"), (3.3, "dashed")),
    (6.6, "solid"),
)


def seen(lines, seed=0, arrows=(), camera_m=0.05, own_m=0.03):
    """Points of images every 8 m, of the road 17 to 40 m before them, each moved by its camera."""
    rng = np.random.default_rng(seed)
    rows = []
    for image, place in enumerate(np.arange(-40.0, 200.0, 8.0)):
        moved = rng.normal(0, camera_m)
        along = place + np.arange(17.0, 40.0, 0.25)
        for offset, kind in lines:
            there = along[along % 12 <= 3] if kind == "dashed" else along
            rows += [(s, offset + moved + rng.normal(0, own_m), image) for s in there]
        for offset, start in arrows:
            there = along[(along >= start) & (along <= start + 6)]
            rows += [(s, offset + moved + rng.normal(0, 0.2), image) for s in there]
    return np.array(rows).T


def paved(*edges_m):
    """The pavement's edges at all stations, as far from the centreline."""
    return np.tile(edges_m, (len(AT), 1))


def lanes(lines, *given, beyond_m=0.4, **more):
    """Lanes of a pavement that ends beyond its outermost lines."""
    offsets = [offset for offset, _ in lines]
    edges = beyond_m - min(offsets), max(offsets) + beyond_m
    return marked_lanes(*seen(lines, *given, **more), AT, paved(*edges))


@pytest.mark.parametrize("seed", range(4))
def test_two_lanes_and_their_errors(seed):
    found = lanes(TWO, seed)
    assert list(found.columns) == list(LANE_COLUMNS)
    assert (found["lanes"] == 2).all()
    for name, true in (("left_m", 3.2), ("right_m", 3.2), ("lane_width_m", 3.2)):
        error = found[name] - true
        assert error.abs().max() < 0.1
        assert np.sqrt(((error / found[f"sigma_{name}"]) ** 2).mean()) < 1.5


def test_dashed_lines_part_lanes_and_arrows_and_hatching_do_not():
    arrows = [(-4.95, 60.0), (-4.95, 100.0), (1.65, 70.0), (1.65, 110.0)]
    hatched = (*FOUR, (-5.8, "solid"), (5.8, "solid"))
    for found in (lanes(FOUR, arrows=arrows), lanes(hatched)):
        assert (found["lanes"] == 4).all()
        assert found["lane_width_m"].to_numpy() == pytest.approx(3.3, abs=0.05)
        assert found["left_m"].to_numpy() == pytest.approx(6.6, abs=0.1)


def test_what_begins_and_ends_beside_an_edge_line_is_none():
    """Hatching inside of it, the foot of a bridge's parapet outside."""
    station, offset, image = seen(TWO)
    for beside in (2.4, 3.9):
        extra = (station > 80) & (station < 120) & (np.abs(offset - 3.2) < 0.5)
        own = [np.r_[all_, all_[extra]] for all_ in (station, offset, image)]
        own[1][len(station) :] += beside - 3.2
        found = marked_lanes(*own, AT, paved(3.6, 3.6))
        assert found["right_m"].to_numpy() == pytest.approx(3.2, abs=0.1)
        assert (found["lanes"] == 2).all()


def test_only_a_solid_line_is_the_edge_of_the_travelled_way():
    middle, dashed = TWO[1:3], (FOUR[1], FOUR[4])
    for lines in (middle, FOUR[1:-1], dashed, dashed[:1]):
        assert lanes(lines).isna().all(axis=None)
    left = lanes(TWO[:3])
    assert left["left_m"].notna().all() and left["right_m"].isna().all()
    assert left["lanes"].isna().all()


def test_dashes_that_begin_abreast_are_not_solid():
    """What images look at between the dashes counts, whether or not a solid line is painted."""
    x = np.arange(0.0, 200, 0.2)
    dashes = x[x % 12 <= 4]
    station = np.concatenate([dashes, dashes] * 4)
    offset = np.tile(np.repeat([-1.75, 1.75], len(dashes)), 4)
    image = np.repeat(np.arange(4), 2 * len(dashes))
    assert marked_lanes(station, offset, image, AT, paved(2.1, 2.1)).isna().all(axis=None)
    solid = np.tile(x, 4), np.full(4 * len(x), 1.75), np.repeat(np.arange(4), len(x))
    found = marked_lanes(*solid, AT, paved(2.1, 2.1))
    assert found["right_m"].to_numpy() == pytest.approx(1.75)


def test_a_solid_line_far_from_the_pavement_s_edge_is_none_of_the_travelled_way():
    """A climbing lane whose outer edge line is worn off; a wide shoulder."""
    climbing = ((-1.75, "solid"), (1.75, "dashed"), (5.25, "solid"))
    for left_m in (5.65, NAN):
        found = marked_lanes(*seen(climbing), AT, paved(left_m, 5.65))
        assert found[["left_m", "lanes"]].isna().all(axis=None)
        assert found["right_m"].to_numpy() == pytest.approx(5.25, abs=0.1)
    assert (lanes(TWO, beyond_m=3.0)["lanes"] == 2).all()


@pytest.mark.parametrize("apart_m", [0.5, 0.6, 0.8, 1.2, 1.8])
def test_lanes_beside_a_narrow_median_are_not_told(apart_m):
    half = apart_m / 2
    lines = [(side * away, "solid") for side in (-1, 1) for away in (half, half + 3.5)]
    found = lanes(lines)
    assert found[["lanes", "lane_width_m"]].isna().all(axis=None)
    assert found["left_m"].to_numpy() == pytest.approx(half + 3.5, abs=0.1)


def test_a_gap_too_wide_for_a_lane_tells_no_lanes_but_the_travelled_way():
    found = lanes((TWO[0], TWO[-1]))
    assert found[["left_m", "right_m"]].notna().all(axis=None)
    assert found["lanes"].isna().all()


def test_few_points_and_none_tell_nothing():
    station, offset, image = seen(TWO)
    few = image < 2
    found = marked_lanes(station[few], offset[few], image[few], AT, paved(4, 4))
    assert found.isna().all(axis=None)
    none = np.empty(0)
    assert marked_lanes(none, none, none, AT, paved(4, 4)).shape == (len(AT), len(LANE_COLUMNS))


def test_markings_come_before_the_inventory_and_its_source_is_told():
    nothing = dict.fromkeys(LANE_COLUMNS, NAN)
    whole = nothing | {"left_m": 3.1, "right_m": 3.3, "lanes": 2, "lane_width_m": 3.2}
    marked = pd.DataFrame(
        [whole, nothing, nothing, nothing, nothing | {"left_m": 3.1}, nothing, nothing]
    )
    known = pd.DataFrame(
        {"lanes": [4, 2, 2, NAN, 2, NAN, 2], "lane_width_m": [3.0, 3.5, NAN, NAN, 3.5, 3.5, NAN]},
        dtype=float,
    )
    found = with_inventory(marked, known, np.array([8.0] * 6 + [NAN]))
    assert found["lanes_from"].tolist() == [
        "markings", "inventory", "paved width", "", "inventory", "", "inventory",
    ]  # fmt: skip
    assert (found["lanes_from"] == "").tolist() == found["lanes"].isna().tolist()
    assert found["lanes"].tolist()[:3] == [2, 2, 2]
    assert found["lane_width_m"].tolist()[:3] == [3.2, 3.5, 4.0]
    assert found["travelled_from"].tolist() == [
        "markings", "inventory", "", "", "markings and inventory", "", "",
    ]  # fmt: skip
    assert found.loc[4, ["left_from", "right_from"]].tolist() == ["markings", "inventory"]
    assert found["left_m"].iloc[[0, 1, 4]].tolist() == [3.1, 3.5, 3.1]
    assert found["right_m"].iloc[[0, 1, 4]].tolist() == [3.3, 3.5, 3.5]
    assert found[["left_m", "right_m"]].iloc[2:4].isna().all(axis=None)
