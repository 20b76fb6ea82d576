import tracemalloc

import numpy as np
import pytest

from roadsight.poles.sightings.lidar_poles import PoleColumns
from roadsight.poles.sightings.stems import stem_shapes

_TOP_M = 10.0


def column(xy_m=(0.0, 0.0)):
    one = np.ones(1)
    return PoleColumns(np.array([xy_m], np.float64), _TOP_M * one, 0.02 * one)


def stem(rng, count, lean_deg=0.0, azimuth_deg=0.0, radius_m=0.13):
    """Returns on the surface of a stem, with 2 cm of noise, its middle above the origin."""
    height = rng.uniform(1.2, _TOP_M - 0.1, count)
    turn = rng.uniform(0, 2 * np.pi, count)
    around = radius_m * np.column_stack([np.sin(turn), np.cos(turn)])
    azimuth = np.radians(azimuth_deg)
    way = np.tan(np.radians(lean_deg)) * np.array([np.sin(azimuth), np.cos(azimuth)])
    xy = around + (height - _TOP_M / 2)[:, None] * way + rng.normal(0, 0.02, (count, 2))
    return np.column_stack([xy, height])


def shapes_of(points):
    return stem_shapes(column(), points, points[:, 2], np.ones(len(points), np.uint8))


def test_excluded_classes_are_of_no_stem(rng):
    points = stem(rng, 60)
    for cls, excluded, told in ((9, [2], True), (5, [5], False)):
        classes = np.full(len(points), cls, np.uint8)
        found = stem_shapes(column(), points, points[:, 2], classes, excluded)
        assert np.isfinite(found.lean_deg[0]) == told


def test_columns_are_looked_at_one_by_one(rng):
    """The returns around all of them at once would take 20 MB."""
    points = rng.uniform([-2, -2, 1.2], [2, 2, _TOP_M], (6000, 3))
    axes = rng.uniform(-1, 1, (80, 2))
    many = PoleColumns(axes, np.full(80, _TOP_M), np.full(80, 0.02))
    tracemalloc.start()
    try:
        stem_shapes(many, points, points[:, 2], np.ones(len(points), np.uint8))
        assert tracemalloc.get_traced_memory()[1] < 12e6
    finally:
        tracemalloc.stop()


def arm(rng, reaches_m, azimuth_deg, count=12):
    along = rng.uniform(min(reaches_m), max(reaches_m), count)
    azimuth = np.radians(azimuth_deg)
    xy = along[:, None] * [np.sin(azimuth), np.cos(azimuth)] + rng.normal(0, 0.03, (count, 2))
    return np.column_stack([xy, np.full(count, _TOP_M - 0.4)])


def test_a_lean_is_found_with_its_direction(rng):
    found = shapes_of(stem(rng, 200, 4.0, 60.0))
    assert found.lean_deg[0] == pytest.approx(4.0, abs=0.4)
    assert found.lean_azimuth_deg[0] == pytest.approx(60.0, abs=6.0)
    assert found.sigma_lean_deg[0] < 0.4


@pytest.mark.parametrize("count", [10, 20, 60])
def test_errors_are_as_large_as_their_sigma(rng, count):
    off = []
    for _ in range(150):
        found = shapes_of(stem(rng, count, 3.0, 90.0))
        turn = np.radians(found.lean_azimuth_deg[0])
        slope = np.tan(np.radians(found.lean_deg[0])) * np.array([np.sin(turn), np.cos(turn)])
        error = np.degrees(slope - [np.tan(np.radians(3.0)), 0.0])
        off.append((error**2).sum() / found.sigma_lean_deg[0] ** 2)
    off = np.array(off)[np.isfinite(off)]
    assert len(off) > 50
    assert 0.5 < np.sqrt(off.mean() / 2) < 1.2


def test_a_transformer_and_a_wire_below_the_top_do_not_lean_a_stem(rng):
    can = np.array([0.4, 0.0, 8.0]) + rng.uniform(-0.2, 0.2, (8, 3))
    wire = np.column_stack([np.zeros(30), np.linspace(-3, 3, 30), np.full(30, 6.0)])
    found = shapes_of(np.concatenate([stem(rng, 60), can, wire]))
    assert found.lean_deg[0] < 2.5 * found.sigma_lean_deg[0]
    assert found.sigma_lean_deg[0] < 1.0


def test_too_few_returns_tell_nothing(rng):
    points = stem(rng, 60)
    assert np.isnan(shapes_of(points[:5]).lean_deg[0])
    low = points[points[:, 2] < 2.5]
    assert np.isnan(shapes_of(low).lean_deg[0])


def test_a_crossarm_has_two_sides_a_lamp_one_and_a_bare_stem_none(rng):
    crossarm = shapes_of(np.concatenate([stem(rng, 60), arm(rng, (-1.15, 1.15), 40.0, 20)]))
    assert crossarm.arm_sides[0] == 2 and crossarm.arm_m[0] == pytest.approx(1.15, abs=0.2)
    lamp = shapes_of(np.concatenate([stem(rng, 60), arm(rng, (0.2, 1.9), 200.0, 14)]))
    assert lamp.arm_sides[0] == 1 and lamp.arm_m[0] == pytest.approx(1.9, abs=0.25)
    bare = shapes_of(stem(rng, 60))
    assert bare.arm_sides[0] == 0 and np.isnan(bare.arm_m[0])


def test_a_wire_over_the_top_is_no_arm_and_hides_none_across_it(rng):
    wire = np.column_stack(
        [np.zeros(80), np.linspace(-6, 6, 80), np.full(80, _TOP_M - 0.1)]
    ) + rng.normal(0, 0.02, (80, 3))
    points = np.concatenate([stem(rng, 60), wire])
    assert shapes_of(points).arm_sides[0] == 0
    with_arm = shapes_of(np.concatenate([points, arm(rng, (-1.15, 1.15), 90.0, 20)]))
    assert with_arm.arm_sides[0] == 2 and with_arm.arm_m[0] == pytest.approx(1.15, abs=0.2)


def test_nothing_in_gives_nothing_out():
    none = PoleColumns(np.empty((0, 2)), np.empty(0), np.empty(0))
    found = stem_shapes(none, np.empty((0, 3)), np.empty(0), np.empty(0, np.uint8))
    assert len(found.lean_deg) == 0
    empty = stem_shapes(column(), np.empty((0, 3)), np.empty(0), np.empty(0, np.uint8))
    assert np.isnan(empty.lean_deg[0]) and np.isnan(empty.arm_m[0])
