import numpy as np
import pytest

from roadsight.geometry.cameras import cam_from_world
from roadsight.poles.images.image_matches import Votes, agreed_turn, turn_votes
from roadsight.poles.images.views import turned


def matches(rng, turn_deg, count=60, wrong=0.4, noise_deg=0.03, places=6):
    """Votes of points beside a road that a front view and, 8 m on, a side view show."""
    turns, weights = [], []
    for _ in range(places):
        heading, pitch, roll = rng.uniform(0, 360), rng.normal(0, 1), rng.normal(0, 0.5)
        front = cam_from_world(heading, pitch, roll)
        ahead = np.array([np.sin(np.radians(heading)), np.cos(np.radians(heading)), 0.0])
        way = 8.0 * ahead
        beside = np.radians(heading + 0.6 * turn_deg + rng.uniform(-6, 6, count))
        far = rng.uniform(15, 60, count)
        points = np.column_stack(
            [far * np.sin(beside), far * np.cos(beside), rng.uniform(-2, 8, count)]
        )
        sides = (points - way) @ turned(front, turn_deg).T
        sides /= np.linalg.norm(sides, axis=1, keepdims=True)
        sides += rng.normal(0, np.radians(noise_deg), sides.shape)
        mixed = rng.random(count) < wrong
        sides[mixed] = sides[rng.permutation(np.flatnonzero(mixed))]
        votes = turn_votes(points, way, sides, front)
        turns.append(votes.turn_deg)
        weights.append(votes.weight)
    return Votes(np.concatenate(turns), np.concatenate(weights))


@pytest.mark.parametrize("turn_deg", [-60.0, -20.3, 19.9, 35.0])
def test_right_matches_agree_on_the_yaw(rng, turn_deg):
    found, sigma = agreed_turn(matches(rng, turn_deg))
    assert found == pytest.approx(turn_deg, abs=0.15)
    assert sigma < 0.1


def test_a_match_without_error_speaks_for_the_yaw_itself(rng):
    votes = matches(rng, 25.0, wrong=0.0, noise_deg=0.0, places=1)
    half = len(votes.turn_deg) // 2
    nearest = np.minimum(np.abs(votes.turn_deg[:half] - 25.0), np.abs(votes.turn_deg[half:] - 25.0))
    assert nearest.max() < 1e-6


def test_wrong_matches_agree_on_nothing(rng):
    votes = Votes(rng.uniform(-90, 90, 800), rng.uniform(0, 0.09, 800))
    assert agreed_turn(votes) == pytest.approx((np.nan, np.inf), nan_ok=True)
    few = Votes(np.full(5, 20.0), np.full(5, 0.09))
    assert np.isinf(agreed_turn(few)[1])


def test_the_stated_sigma_holds_the_yaw(rng):
    off = []
    for _ in range(40):
        found, sigma = agreed_turn(matches(rng, 21.0, places=3))
        off.append(abs(found - 21.0) / sigma)
    assert np.mean(np.array(off) < 2.0) > 0.85
