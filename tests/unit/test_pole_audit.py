"""How far two answers of the pole job differ."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from roadsight.evidence.pole_audit import (
    PoleAnswer,
    answer_change,
    bearing_change,
    matches,
    pole_change,
    rating_change,
)

POLES = np.array([[0.0, 0.0], [10.0, 0.0], [20.0, 0.0], [30.0, 0.0]])


def test_poles_that_appear_vanish_or_move():
    assert pole_change(POLES, POLES) == 0.0
    assert pole_change(POLES, POLES[::-1] + 0.3) == 0.0
    assert pole_change(POLES, POLES[:3]) == pole_change(POLES[:3], POLES) == 0.25
    assert pole_change(POLES, np.add(POLES, [[0, 0], [0, 0], [0, 0.6], [0, 0]])) == 0.25
    assert pole_change(POLES, POLES[:0]) == 1.0
    assert pole_change(POLES[:0], POLES[:0]) == 0.0


def test_each_pole_is_matched_once_and_as_many_as_can_be():
    one, other = np.array([[0.0, 0.0], [0.45, 0.0]]), np.array([[0.4, 0.0], [0.8, 0.0]])
    assert sorted(map(tuple, matches(one, other).tolist())) == [(0, 0), (1, 1)]


def sightings(turn=0.0, kept=True):
    return pd.DataFrame(
        {
            "image": ["a", "a", "b", "c"], "view": "front", "u_foot": [1.0, 2.0, 1.0, 5.0],
            "v_foot": 3.0, "bearing_deg": (np.array([359.9, 10.0, 0.05, 90.0]) + turn) % 360,
            "sigma_bearing_deg": [0.1, 0.5, 0.1, 0.1], "kept": kept,
        }
    )  # fmt: skip


def test_bearings_beyond_their_sigma():
    assert bearing_change(sightings(), sightings()) == 0.0
    assert bearing_change(sightings(), sightings(0.2)) == 0.75
    assert bearing_change(sightings(), sightings(0.05)) == 0.0
    assert bearing_change(sightings(), sightings(0.2, kept=False)) == 0.0


def hazard(*ratings):
    return pd.DataFrame(POLES[: len(ratings)], columns=["x", "y"]).assign(rating=list(ratings))


def test_ratings_of_the_same_poles():
    one = hazard("high", "low", "low", "low")
    assert rating_change(one, one) == 0.0
    assert rating_change(one, hazard("high", "low", "medium", "low")) == 0.25
    assert rating_change(one, hazard()) == 0.0


def test_the_largest_change_counts():
    poles = pd.DataFrame(POLES, columns=["x", "y"]).assign(kept=[True, True, True, False])
    one = PoleAnswer(poles, sightings(), hazard("low", "low"))
    assert answer_change(one, one) == 0.0
    fewer = PoleAnswer(poles.iloc[:2], sightings(), hazard("low", "low"))
    assert answer_change(one, fewer) == pytest.approx(1 / 3)
    turned = PoleAnswer(poles, sightings(0.2), hazard("low", "low"))
    assert answer_change(one, turned) == 0.75
