"""Ratings and scores of what was found."""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np
import pandas as pd

from roadsight.base.arrays import Numbers
from roadsight.evidence.scores import binary_scores
from roadsight.poles.risk.hazard import side_slopes
from roadsight.poles.risk.roads import RouteTracks
from roadsight.poles.risk.scenarios import track_radius_m
from roadsight.poles.risk.validation import describe, match_points
from roadsight_hardcases.case import Errors, hard_case


@hard_case("rate_hazard", bound=0.01, unit="rise over run")
def pole_on_the_road_edge(rng: np.random.Generator) -> Errors:
    """Rise over run from the edge to a pole that stands on it divides by nothing."""
    foot = np.array([[3.5, 10.0], [3.5, 20.0], [3.5, 30.0]])
    poles = np.add(foot, [[0.0, 0.0], [0.002, 0.0], [4.0, 0.0]])

    def height(x: Numbers, y: Numbers) -> Numbers:
        return -0.25 * (np.asarray(x) - 3.5) + 0.004 * np.sin(900 * np.asarray(x) + y)

    run = np.hypot(*(poles - foot).T)
    naive = (height(*poles.T) - height(*foot.T)) / run
    ours = side_slopes(foot, poles, height, 0.5)
    # On the edge itself there is no run: only there may a slope be withheld.
    given = np.isfinite(ours) | (run > 0.5)
    return np.abs(naive + 0.25).max(), np.abs(ours + 0.25)[given].max()


def _radius_m(xy_m: Numbers, rows: Numbers) -> float:
    """Radius of the circle through three places, as sides over four times the area."""
    a, b, c = xy_m[rows]
    area = abs((b - a)[0] * (c - b)[1] - (b - a)[1] * (c - b)[0]) / 2
    sides = np.hypot(*(b - a)) * np.hypot(*(c - b)) * np.hypot(*(c - a))
    return float(sides / (4 * area)) if area else math.inf


def _track(xy_m: Numbers) -> RouteTracks:
    frames = pd.DataFrame(xy_m, columns=["x", "y"])
    return RouteTracks(frames.assign(route="r", sequence=np.arange(len(xy_m))))


@hard_case("rate_hazard", bound=0.4, unit="share of the radius, median")
def radius_of_a_gentle_bend(rng: np.random.Generator) -> Errors:
    """Positions that are off by 5 cm bend three images of a track more than a bend of 900 m."""
    radius_m, naive, ours = 900.0, [], []
    turn = np.arange(-60.0, 61.0, 4.0) / radius_m
    true = radius_m * np.column_stack([1 - np.cos(turn), np.sin(turn)])
    for _ in range(60):
        xy = true + rng.normal(0, 0.05, true.shape)
        naive.append(abs(_radius_m(xy, np.array([14, 15, 16])) / radius_m - 1))
        ours.append(abs(track_radius_m(_track(xy), 0, 60.0, 25.0) / radius_m - 1))
    return np.median(naive), np.median(ours)


@hard_case("rate_hazard", bound=0.5, unit="straight roads called curves")
def radius_of_a_straight_road(rng: np.random.Generator) -> Errors:
    """Positions that are off by 10 cm make a curve of every straight road, image by image."""
    naive = ours = 0.0
    for angle in np.linspace(0.1, 3.0, 30):
        xy = 4.0 * np.arange(40)[:, None] * [np.sin(angle), np.cos(angle)]
        xy = xy + rng.normal(0, 0.1, xy.shape)
        naive += _radius_m(xy, np.array([14, 15, 16])) < 300
        ours += track_radius_m(_track(xy), 0, 60.0, 25.0) < 300
    return naive, ours


@hard_case("validate_poles", bound=0.5, unit="poles counted twice")
def two_found_for_one_known(rng: np.random.Generator) -> Errors:
    """Counting what has a known pole nearby counts one known pole for every double."""
    truth = 20.0 * np.arange(12)[:, None] * [1.0, 0.0]
    doubles = np.add(truth[:, None], [[0.4, 0.0], [-0.6, 0.2], [0.0, 0.9]])
    found = doubles.reshape(-1, 2)
    gaps = np.hypot(*(found[:, None] - truth).transpose(2, 0, 1))
    naive = np.count_nonzero(gaps.min(axis=1) <= 2.0)
    return naive - len(truth), abs(len(match_points(found, truth, 2.0)) - len(truth))


@hard_case("validate_poles", bound=0.5, unit="poles left without a match")
def nearest_first(rng: np.random.Generator) -> Errors:
    """Matching the nearest pair first takes the only partner of another pole away."""
    streets = 20.0 * np.arange(6)[:, None, None] * [1.0, 0.0]
    found = np.add(streets, [[0.0, 0.0], [1.9, 0.0]]).reshape(-1, 2)
    truth = np.add(streets, [[1.0, 0.0], [3.6, 0.0]]).reshape(-1, 2)
    gaps = np.hypot(*(found[:, None] - truth).transpose(2, 0, 1))
    greedy, gaps = 0, np.where(gaps <= 2.0, gaps, np.inf)
    while np.isfinite(gaps).any():
        i, j = np.unravel_index(np.argmin(gaps), gaps.shape)
        gaps[i], gaps[:, j], greedy = np.inf, np.inf, greedy + 1
    return 12 - greedy, 12 - len(match_points(found, truth, 2.0))


def _refused(values: Iterable[float | None]) -> int:
    """Values that JSON has no word for, so that a reader other than Python refuses the file."""
    return sum(value is not None and not math.isfinite(value) for value in values)


@hard_case("score_pavement", bound=0.5, unit="scores that JSON cannot hold")
def nothing_found_and_nothing_there(rng: np.random.Generator) -> Errors:
    """Precision of nothing found, and recall of nothing there, are zero over zero."""
    none = np.zeros(50, bool)
    hits, found, there = (np.float64(part.sum()) for part in (none & none, none, none))
    naive = np.array([hits / found, hits / there, 2 * hits / (found + there)])
    scores = binary_scores(none, none)
    return _refused(naive), _refused([scores.precision, scores.recall, scores.f1])


@hard_case("validate_poles", bound=0.5, unit="figures that JSON cannot hold")
def errors_of_nothing(rng: np.random.Generator) -> Errors:
    """Mean and spread of no match at all, or of one, are NaN, which JSON cannot hold."""
    naive = ours = 0
    for values in (np.empty(0), np.array([0.7])):
        naive += _refused([float(np.mean(values)), float(np.std(values, ddof=1))])
        ours += _refused(describe(values).values())
    return naive, ours
