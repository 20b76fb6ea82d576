import numpy as np
import pytest

from roadsight.geometry.cameras import wrap_deg
from roadsight.poles.drive.videolog import headings_deg, moving, steps_m


def curve(count=120, step=8.0, radius=400.0, noise=0.0, seed=0, start=0.3):
    """Track that swings left and right, and its true headings."""
    s = np.arange(count) * step
    turn = start + (100.0 / radius) * np.sin(s / 100.0)
    fine = np.arange(0, s[-1] + step, 0.05)
    angle = start + (100.0 / radius) * np.sin(fine / 100.0)
    path = np.cumsum(np.column_stack([np.sin(angle), np.cos(angle)]), axis=0) * 0.05
    xy = path[np.round(s / 0.05).astype(int)]
    return xy + np.random.default_rng(seed).normal(0, noise, xy.shape), np.degrees(turn) % 360


def test_without_noise_the_tangent_beats_the_direction_to_the_next():
    xy, truth = curve(radius=150.0)
    smooth, raw = headings_deg(xy)
    assert np.abs(wrap_deg(smooth - truth))[1:-1].max() < 0.6
    assert np.abs(wrap_deg(raw - truth)).max() > 1.4


def test_noise_is_smoothed():
    xy, truth = curve(noise=1.0)
    smooth, raw = headings_deg(xy)
    error, rough = (np.sqrt(np.mean(wrap_deg(h - truth) ** 2)) for h in (smooth, raw))
    assert rough > 7.0
    assert error < 0.4 * rough


def test_one_wild_position_does_not_turn_its_neighbours():
    xy, truth = curve(noise=0.05)
    xy[60] += [6.0, -4.0]
    smooth, _ = headings_deg(xy)
    error = np.abs(wrap_deg(smooth - truth))
    assert np.delete(error, 60).max() < 3.0


def test_headings_across_north_do_not_jump():
    xy, truth = curve(start=0.0, radius=300.0)
    smooth, _ = headings_deg(xy)
    assert smooth.min() < 10 and smooth.max() > 350
    assert np.abs(wrap_deg(smooth - truth)).max() < 1.0


def test_last_place_continues_and_two_places_give_their_chord():
    smooth, raw = headings_deg([[0, 0], [5, 5]])
    np.testing.assert_allclose([smooth, raw], 45.0)
    smooth, raw = headings_deg([[0, 0], [0, 8], [0, 16], [0, 24]])
    np.testing.assert_allclose([smooth, raw], 0.0, atol=1e-9)
    straight, _ = headings_deg(np.arange(10)[:, None] * [3.0, -4.0])
    np.testing.assert_allclose(straight, 143.13010235, atol=1e-6)


def test_standing_still_keeps_the_last_moving_heading():
    xy = np.array([[0, 0], [0, 10], [0, 20], [0.1, 20.2], [-0.2, 19.9], [10, 20], [20, 20.0]])
    smooth, raw = headings_deg(xy, 0)
    assert raw.tolist() == [0, 0, 90, 0, 0, 90, 90]
    assert smooth[3] == smooth[4] == smooth[2]
    waiting = headings_deg([[0, 0], [0.1, 0], [0, 0.2], [0, 9], [0, 18]])[0]
    np.testing.assert_allclose(waiting, 0.0, atol=1e-6)
    assert moving(xy).tolist() == [0, 1, 2, 5, 6]


@pytest.mark.parametrize("xy", [[], [[3, 4]], [[3, 4], [3, 4]], [[0, 0], [0.2, 0], [0, 0.3]]])
def test_never_moved(xy):
    smooth, raw = headings_deg(np.array(xy, float).reshape(-1, 2))
    assert np.isnan(smooth).all() and np.isnan(raw).all() and len(smooth) == len(xy)
    assert len(steps_m(np.array(xy, float).reshape(-1, 2))) == len(xy)
