"""Ratings and scores of what was found."""

from __future__ import annotations

import numpy as np
import pandas as pd

from roadsight.base.arrays import Numbers
from roadsight.evidence.hardcases.case import Errors, hard_case
from roadsight.evidence.pavement_scores import binary_scores
from roadsight.poles.risk.hazard import side_slopes
from roadsight.poles.risk.scenarios import track_radius_m
from roadsight.poles.risk.tracks import RouteTracks
from roadsight.poles.risk.validation import describe, match_points

_FAR = np.array([632_000.0, 4_123_000.0])
"""Easting and northing of a place in UTM, m."""


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
    wrong = np.nan_to_num(np.abs(naive + 0.25), nan=1e9)
    return wrong.max(), np.nan_to_num(np.abs(ours + 0.25)).max()


@hard_case("rate_hazard", bound=0.01, unit="share of the radius")
def radius_of_a_gentle_bend(rng: np.random.Generator) -> Errors:
    """The circle through three places at map coordinates loses its radius in the determinant."""
    radius = 900.0
    turn = np.arange(-60.0, 61.0, 4.0) / radius
    xy = radius * np.column_stack([1 - np.cos(turn), np.sin(turn)]) + _FAR
    frames = pd.DataFrame(xy, columns=["x", "y"]).assign(route="r", sequence=np.arange(len(xy)))
    (ax, ay), (bx, by), (cx, cy) = xy[[9, 15, 21]].astype(np.float32)
    double = 2 * (ax * (by - cy) + bx * (cy - ay) + cx * (ay - by))
    px = (ax**2 + ay**2) * (by - cy) + (bx**2 + by**2) * (cy - ay) + (cx**2 + cy**2) * (ay - by)
    naive = abs(float(px / double) - float(ax)) if double else 1e9
    ours = track_radius_m(RouteTracks(frames), 0, 60.0, 25.0)
    return abs(naive / radius - 1), abs(ours / radius - 1)


@hard_case("rate_hazard", bound=0.5, unit="straight roads called bends")
def radius_of_a_straight_road(rng: np.random.Generator) -> Errors:
    """Three places in line have no circle: the radius is a division by a rounding error."""
    naive = ours = 0.0
    for angle in np.linspace(0.1, 3.0, 30):
        way = np.array([np.sin(angle), np.cos(angle)])
        xy = 4.0 * np.arange(40)[:, None] * way + _FAR
        a, b, c = xy[[5, 8, 11]].astype(np.float32).astype(np.float64)
        area = abs((b - a)[0] * (c - b)[1] - (b - a)[1] * (c - b)[0]) / 2
        sides = np.hypot(*(b - a)) * np.hypot(*(c - b)) * np.hypot(*(c - a))
        naive += sides / (4 * area) < 2000 if area else 0
        frames = pd.DataFrame(xy - _FAR, columns=["x", "y"]).assign(route="r", sequence=range(40))
        ours += track_radius_m(RouteTracks(frames), 0, 60.0, 25.0) < 2000
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


@hard_case("score_pavement", bound=0.5, unit="scores that are no number")
def nothing_found_and_nothing_there(rng: np.random.Generator) -> Errors:
    """Precision of nothing found, and recall of nothing there, are zero over zero."""
    none = np.zeros(50, bool)
    hits, found, there = (np.float64(part.sum()) for part in (none & none, none, none))
    naive = np.array([hits / found, hits / there, 2 * hits / (found + there)])
    scores = binary_scores(none, none)
    ours = np.array([scores.precision, scores.recall, scores.f1])
    return np.isnan(naive).sum(), np.isnan(ours).sum()


@hard_case("validate_poles", bound=0.5, unit="figures that are no number")
def errors_of_nothing(rng: np.random.Generator) -> Errors:
    """Mean and quartiles of no match at all, or of one, are no numbers."""
    naive = ours = 0
    for values in (np.empty(0), np.array([0.7])):
        naive += int(np.isnan(np.mean(values))) + int(np.isnan(np.std(values, ddof=1)))
        ours += sum(v is not None and np.isnan(v) for v in describe(values).values())
    return naive, ours
