import numpy as np
import pytest

from roadsight.poles.sightings.lidar_poles import PoleColumns
from roadsight.poles.sightings.stems import find_stems, with_stems

RADIUS_M = 0.1


def post(rng, x, y, low=0.0, high=2.4, per_m=150):
    """Returns on the side of a post that faces the road, with noise of a centimetre."""
    count = int((high - low) * per_m)
    turn = rng.uniform(0, np.pi, count)
    xyz = np.column_stack([x + RADIUS_M * np.cos(turn), y - RADIUS_M * np.sin(turn)])
    return np.column_stack([xyz + rng.normal(0, 0.01, xyz.shape), rng.uniform(low, high, count)])


def wall(rng, y, count=30_000):
    x, z = rng.uniform(-10, 10, count), rng.uniform(0, 3, count)
    return np.column_stack([x, y + rng.normal(0, 0.01, count), z])


def hedge(rng, x, y, height=0.9, count=40_000):
    low, high = [x - 4, y - 0.6, 0.0], [x + 4, y + 0.6, height]
    return rng.uniform(low, high, (count, 3))


def stems(*parts):
    xyz = np.concatenate(parts)
    return find_stems(xyz, xyz[:, 2], np.ones(len(xyz), np.uint8))


def test_a_low_piece_of_a_post_is_found_where_it_stands(rng):
    found = stems(post(rng, 3.0, 4.0), post(rng, -5.0, 2.0))
    assert found.xy_m == pytest.approx(np.array([[-5.0, 2.0], [3.0, 4.0]]), abs=0.05)
    assert found.top_m == pytest.approx([2.4, 2.4], abs=0.1)
    assert (found.open_top == 1.0).all()
    assert (found.sigma_m < 0.15).all()


def test_a_post_between_hedge_and_crown_is_found(rng):
    crown = rng.uniform([-2, 2, 2.4], [4, 8, 5.0], (40_000, 3))
    found = stems(post(rng, 1.0, 5.0), hedge(rng, 1.0, 5.0), crown)
    assert len(found) == 1
    assert found.xy_m[0] == pytest.approx([1.0, 5.0], abs=0.08)


def test_walls_hedges_and_low_things_are_no_stems(rng):
    assert len(stems(wall(rng, 0.0))) == 0
    assert len(stems(hedge(rng, 0.0, 0.0, height=3.0))) == 0
    assert len(stems(post(rng, 0.0, 0.0, high=1.5))) == 0


def test_a_smeared_post_is_found_and_known_the_worse(rng):
    sharp = post(rng, 0.0, 0.0)
    smear = sharp.copy()
    smear[::2, 1] += rng.uniform(0, 0.6, len(smear[::2]))
    (one,), (other,) = stems(sharp).sigma_m, stems(smear).sigma_m
    assert other > 2 * one
    assert np.hypot(*stems(smear).xy_m[0]) < 3 * other


def test_sparse_clouds_have_no_stems(rng):
    assert len(stems(post(rng, 0.0, 0.0, high=8.0, per_m=4))) == 0
    assert len(find_stems(np.empty((0, 3)), np.empty(0), np.empty(0, np.uint8))) == 0


def test_excluded_classes_are_of_no_stem(rng):
    xyz = post(rng, 0.0, 0.0)
    for cls, excluded, count in ((9, [2], 1), (5, [5], 0)):
        classes = np.full(len(xyz), cls, np.uint8)
        assert len(find_stems(xyz, xyz[:, 2], classes, excluded)) == count


def test_the_order_of_returns_and_large_coordinates_do_not_matter(rng):
    xyz = np.concatenate([post(rng, 3.0, 4.0), hedge(rng, 1.0, 5.0)])
    ones = np.ones(len(xyz), np.uint8)
    a = find_stems(xyz, xyz[:, 2], ones)
    order = rng.permutation(len(xyz))
    b = find_stems(xyz[order], xyz[order, 2], ones)
    assert np.array_equal(a.xy_m, b.xy_m)
    moved = find_stems(xyz + np.array([1000.0, -2000.0, 50.0]), xyz[:, 2], ones)
    assert moved.xy_m - [1000.0, -2000.0] == pytest.approx(a.xy_m, abs=1e-6)


def test_a_stem_that_is_a_column_counts_once(rng):
    def columns(*xy, open_top):
        n = len(xy)
        parts = [np.full(n, v) for v in (8.0, 0.03, 0.0, 20.0, open_top)]
        return PoleColumns(np.array(xy, float).reshape(-1, 2), *parts)

    tall = columns((0.0, 0.0), open_top=0.0)
    both = with_stems(tall, columns((0.2, 0.1), (5.0, 0.0), open_top=1.0))
    assert both.xy_m.tolist() == [[0.0, 0.0], [5.0, 0.0]]
    assert both.open_top.tolist() == [0.0, 1.0]
    assert len(with_stems(columns(open_top=0.0), tall)) == 1
    assert len(with_stems(tall, columns(open_top=0.0))) == 1
