import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from roadsight.poles.risk.roadside_rating import (
    Encroachments,
    curve_encroachments,
    exposure,
    fixed_objects,
    grade_encroachments,
    hazard_rating,
    leaving,
    offset_factor,
    rank_of,
    rating_factor,
)

NAN = np.nan


@pytest.mark.parametrize(
    ("clear_m", "slope", "rail_m", "rating"),
    [
        (9.0, -0.1, NAN, 1), (7.0, -0.25, NAN, 2), (8.0, -0.1, NAN, 2), (3.0, -0.33, NAN, 3),
        (2.5, -0.25, NAN, 4), (2.5, -0.33, NAN, 5), (1.2, -0.43, NAN, 6), (4.0, -0.45, NAN, 6),
        (1.0, -0.6, NAN, 7), (1.0, -0.6, 1.8, 4), (1.0, -0.6, 0.6, 5), (9.5, 0.0, 1.0, 1),
        (NAN, NAN, NAN, 0), (np.inf, 0.0, NAN, 1), (2.0, NAN, NAN, 4),
    ],
)  # fmt: skip
def test_the_seven_ratings(clear_m, slope, rail_m, rating):
    assert hazard_rating([clear_m], [slope], [rail_m]).tolist() == [rating]


@given(st.floats(0, 15), st.floats(0, 1), st.floats(0, 3), st.floats(0, 0.3))
def test_nearer_and_steeper_is_never_better(clear_m, steep, nearer, steeper):
    base = hazard_rating([clear_m], [-steep])
    assert hazard_rating([clear_m - nearer], [-steep]) >= base
    assert hazard_rating([clear_m], [-steep - steeper]) >= base


def test_factors_of_the_manual():
    assert rating_factor([3, 7, 1]) == pytest.approx([1.0, 1.306, 0.875], abs=1e-3)
    assert np.isnan(rating_factor([0]))[0]
    feet = np.array([2, 5, 10, 15, 20, 25, 30.0])
    values = [0.232, 0.133, 0.087, 0.068, 0.057, 0.049, 0.044]
    assert offset_factor(0.3048 * feet) == pytest.approx(values)
    # Fit of the manual's own spreadsheet.
    assert offset_factor(0.3048 * feet) == pytest.approx(0.3566 * feet**-0.614, abs=0.001)
    assert offset_factor(0.0) == pytest.approx(0.232)
    assert offset_factor(15.0) < 0.044


def test_encroachments_on_bends_and_grades():
    radii = [200, 290, 435, 580, np.inf, NAN]
    assert curve_encroachments(radii, [True] * 6) == pytest.approx([4, 4, 2.5, 1, 1, 1])
    assert curve_encroachments([200], [False]) == pytest.approx([2])
    assert grade_encroachments([0.06, -0.02, -0.04, -0.1, NAN]) == pytest.approx([1, 1, 1.5, 2, 1])
    straight = exposure(2000, leaving(3.048, np.inf, False, 0.0))
    assert straight == pytest.approx(1000 * 0.087)
    assert exposure(2000, leaving(3.048, 200, True, -0.08)) == pytest.approx(8 * straight)
    own = leaving(3.048, 200, True, -0.08, Encroachments(1.0, 1.0, 1.0))
    assert own == pytest.approx(0.087)


def test_objects_close_together_are_one():
    station = np.array([0.0, 10, 21, 25, 100, 400, np.nan])
    offset = np.array([2.0, 2, 2, 2, 4, 4, 4])
    found = fixed_objects(station, offset, np.ones(7, bool), 500.0)
    assert found["objects_per_km"] == pytest.approx(8)  # 0 to 21, 25, 100, 400
    assert found["objects_per_mile"] == pytest.approx(12.87, abs=0.01)
    assert found["mean_offset_m"] == pytest.approx(16 / 6)
    none = fixed_objects(station, offset, np.zeros(7, bool), 500.0)
    assert none["objects_per_km"] == 0
    assert np.isnan(none["offset_factor"])


def test_ranks():
    ratings = ["low", "high", "high", "unknown", "medium"]
    assert rank_of(ratings, [1, 6, 6, 0, 4], [90, 10, 20, NAN, 50]).tolist() == [4, 2, 1, 5, 3]


def test_objects_of_unknown_exposure_come_after_the_others_of_their_rating():
    ratings = ["high", "high", "high", "low"]
    ranks = rank_of(ratings, [6, 6, 6, 1], [NAN, 10, NAN, 99], [0.3, 0.1, 0.5, 0.1])
    assert ranks.tolist() == [3, 1, 2, 4]
