"""Lanes and edges of the travelled way from points on markings."""

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


def lanes(*given, **more):
    station, offset, image = seen(*given, **more)
    return marked_lanes(station, offset, image, AT)


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
        found = marked_lanes(*own, AT)
        assert found["right_m"].to_numpy() == pytest.approx(3.2, abs=0.1)
        assert (found["lanes"] == 2).all()


def test_only_a_solid_line_is_the_edge_of_the_travelled_way():
    alone = lanes(TWO[1:3])
    assert alone.isna().all(axis=None)
    without_edges = lanes(FOUR[1:-1])
    assert without_edges.isna().all(axis=None)
    left = lanes(TWO[:3])
    assert left["left_m"].notna().all() and left["right_m"].isna().all()
    assert left["lanes"].isna().all()


def test_a_gap_too_wide_for_a_lane_tells_no_lanes_but_the_travelled_way():
    found = lanes((TWO[0], TWO[-1]))
    assert found[["left_m", "right_m"]].notna().all(axis=None)
    assert found["lanes"].isna().all()


def test_few_points_and_none_tell_nothing():
    station, offset, image = seen(TWO)
    few = image < 2
    assert marked_lanes(station[few], offset[few], image[few], AT).isna().all(axis=None)
    none = np.empty(0)
    assert marked_lanes(none, none, none, AT).shape == (len(AT), len(LANE_COLUMNS))


def test_markings_come_before_the_inventory_and_its_source_is_told():
    nothing = dict.fromkeys(LANE_COLUMNS, NAN)
    whole = nothing | {"left_m": 3.1, "right_m": 3.3, "lanes": 2, "lane_width_m": 3.2}
    marked = pd.DataFrame([whole, nothing, nothing, nothing, nothing | {"left_m": 3.1}])
    known = pd.DataFrame(
        {"lanes": [4, 2, 2, NAN, 2], "lane_width_m": [3.0, 3.5, NAN, NAN, 3.5]}, dtype=float
    )
    found = with_inventory(marked, known, np.full(5, 8.0))
    assert found["lanes_from"].tolist() == [
        "markings", "inventory", "paved width", "", "inventory",
    ]  # fmt: skip
    assert found["lanes"].tolist()[:3] == [2, 2, 2]
    assert found["lane_width_m"].tolist()[:3] == [3.2, 3.5, 4.0]
    assert found["travelled_from"].tolist() == [
        "markings", "inventory", "", "", "markings and inventory",
    ]  # fmt: skip
    assert found["left_m"].iloc[[0, 1, 4]].tolist() == [3.1, 3.5, 3.1]
    assert found["right_m"].iloc[[0, 1, 4]].tolist() == [3.3, 3.5, 3.5]
    assert found[["left_m", "right_m"]].iloc[2:4].isna().all(axis=None)
