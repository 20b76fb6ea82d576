import itertools

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from roadsight.poles.risk.scenarios import (
    RouteTracks,
    ScenarioSettings,
    classify_places,
    track_radius_m,
)
from roadsight.poles.risk.validation import (
    RoadEdges,
    cautions,
    describe,
    describe_scenarios,
    geodesic_m,
    match_points,
    score_lines,
    score_near,
    score_thresholds,
    split_errors,
    within_reach,
)
from tests.helpers.rated_poles import track


def best_by_trial(found, truth, threshold, power):
    """Most matches and least sum of distances to a power, over all assignments."""
    gaps = np.hypot(*(found[:, None] - truth).transpose(2, 0, 1))
    if len(found) > len(truth):
        gaps = gaps.T
    best = (0, 0.0)
    for columns in itertools.permutations(range(gaps.shape[1]), gaps.shape[0]):
        chosen = gaps[range(len(gaps)), columns]
        near = chosen[chosen <= threshold]
        best = min(best, (-len(near), (near**power).sum()))
    return -best[0], best[1]


@given(st.integers(0, 10_000), st.integers(1, 5), st.integers(1, 5), st.floats(0.5, 6))
@settings(max_examples=40, deadline=None)
@pytest.mark.parametrize("power", [1, 2])
def test_matches_are_the_best_of_all(power, seed, founds, truths, threshold):
    rng = np.random.default_rng(seed)
    found, truth = rng.uniform(0, 8, (founds, 2)), rng.uniform(0, 8, (truths, 2))
    matches = match_points(found, truth, threshold, power)
    count, total = best_by_trial(found, truth, threshold, power)
    assert len(matches) == count
    gaps = np.hypot(*(found[matches[:, 0]] - truth[matches[:, 1]]).T)
    assert (gaps**power).sum() == pytest.approx(total)
    assert len(set(matches[:, 0].tolist())) == len(set(matches[:, 1].tolist())) == count


def test_one_known_pole_matches_once_and_ends_count():
    found, truth = np.array([[0.0, 0], [0, 1]]), np.array([[0.0, 3]])
    assert match_points(found, truth, 2).tolist() == [[1, 0]]
    row = score_thresholds(found, truth, (1, 2))[1]
    assert (row["tp"], row["fp"], row["fn"]) == (1, 1, 0)
    assert row["precision"] == 0.5
    assert row["f1"] == pytest.approx(2 / 3)


def test_nothing_found_or_known():
    none, one = np.empty((0, 2)), np.zeros((1, 2))
    assert score_thresholds(none, one, (5,))[0]["precision"] is None
    assert score_thresholds(none, one, (5,))[0]["recall"] == 0
    assert score_thresholds(none, none, (5,))[0]["f1"] is None
    assert describe(np.array([np.nan]))["count"] == 0
    assert not within_reach(one, none, 25).any()


def test_errors_across_and_along_a_slanting_edge():
    t = np.arange(0, 40, 0.3)
    edges = RoadEdges(np.column_stack([t, t]))
    place = np.array([[20.0, 22.0]])
    across, along = split_errors(np.array([[1.0, 1.0]]), edges.normals(place))
    assert across == pytest.approx([0], abs=1e-9)
    assert along == pytest.approx([2**0.5])
    assert edges.offset_m(place)[0] == pytest.approx([2**0.5], abs=0.2)


def test_a_lone_edge_point_gives_the_way_to_it():
    edges = RoadEdges(np.array([[0.0, 0.0]]))
    assert np.abs(edges.normals(np.array([[3.0, 0.0]]))[0]) == pytest.approx([1, 0])
    assert np.isnan(edges.normals(np.zeros((1, 2)))).all()


def test_geodesic_degree():
    gap = geodesic_m(np.array([0.0]), np.array([179.5]), np.array([0.0]), np.array([-179.5]))
    assert gap == pytest.approx([111_319.49], abs=0.01)


def test_cautions():
    assert cautions(5, 0) == []
    assert len(cautions(4, 2)) == 2


def arc(radius_m, n=60, step_m=5.0):
    turn = np.arange(n) * step_m / radius_m
    return np.column_stack([radius_m * np.sin(turn), radius_m * (1 - np.cos(turn))])


@pytest.mark.parametrize("radius_m", [80.0, 250.0])
def test_radius_of_a_bend(radius_m):
    tracks = RouteTracks(track(arc(radius_m)))
    assert track_radius_m(tracks, 0, 100.0, 25.0) == pytest.approx(radius_m, rel=0.02)


def test_straight_curved_and_crossing():
    straight = np.column_stack([np.arange(0, 300, 8.0), np.zeros(38)])
    across = np.column_stack([np.full(20, 150.0), np.arange(-80, 80, 8.0)])
    tracks = RouteTracks(pd.concat([track(straight), track(across, "b")]))
    classes = classify_places(np.array([[40.0, 5], [155, 6]]), tracks, None, ScenarioSettings())
    assert classes["straight"].all()
    assert classes["intersection"].tolist() == [False, True]
    assert classes["extraneous"].isna().all()
    bend = classify_places(
        np.array([[20.0, 9]]), RouteTracks(track(arc(90))), None, ScenarioSettings()
    )
    assert bend["curved"].all()
    errors = describe_scenarios(np.array([1.0, 3.0]), classes)
    assert errors["straight"]["mean"] == 2
    assert errors["intersection"]["count"] == 1
    assert errors["extraneous"] is None


def test_tracks_stand_still_and_jump_routes():
    xy = np.array([[0.0, 0], [10, 0], [10, 0], [20, 0]])
    tracks = RouteTracks(pd.concat([track(xy), track(xy + np.array([0, 100.0]), "b")]))
    piece, station_m, foot = tracks.locate(np.array([[15.0, 4], [15, 95]]))
    assert tracks.route[piece].tolist() == [0, 1]
    assert station_m == pytest.approx([15, 15])
    assert foot[0] == pytest.approx([15, 0])
    nowhere = RouteTracks(track(xy[:1]))
    assert len(nowhere) == 0


def test_an_error_across_the_limit_is_not_counted_twice():
    """A tree at 9.5 m, found at 10.5, is found; one at 10.5 m, found at 9.5, is not false."""
    truth, found = np.array([[0.0, 9.5], [50.0, 10.5]]), np.array([[0.0, 10.5], [50.0, 9.5]])
    near = [places[:, 1] <= 10.0 for places in (found, truth)]
    scores = score_near(found, truth, *near)
    assert (scores["tp"], scores["fp"], scores["fn"]) == (1, 0, 0)
    nothing = score_near(np.empty((0, 2)), truth, np.zeros(0, bool), near[1])
    assert (nothing["recall"], nothing["precision"], nothing["f1"]) == (0.0, None, 0.0)


@settings(max_examples=25, deadline=None)
@given(st.floats(0.0, 30.0), st.floats(1.0, 40.0), st.floats(0.0, 0.9))
def test_lines_are_scored_by_length(start_m, length_m, aside_m):
    truth = [np.array([[0.0, 0.0], [40.0, 0.0]])]
    found = [np.array([[start_m, aside_m], [start_m + length_m, aside_m]])]
    scores = score_lines(found, truth)
    slack = np.sqrt(1 - aside_m**2)  # a line's end reaches a metre further
    shared = min(start_m + length_m, 40.0) - start_m
    assert shared - 1e-6 <= scores["tp"] <= min(shared + 2 * slack, 40.0) + 0.02
    assert scores["tp"] + scores["fn"] == pytest.approx(40.0)
    assert (
        max(start_m + length_m - 41.0, 0.0) - 0.02
        <= scores["fp"]
        <= max(start_m + length_m - 40.0, 0.0) + 1e-6
    )
    assert score_lines([], truth)["recall"] == 0.0
