"""Points that stand alone are told from those in company."""

from __future__ import annotations

import numpy as np
import pytest

from roadsight.scene.surfels.outliers import in_company


def by_definition(xyz, around, radius, others):
    both = np.concatenate([xyz, around])
    apart = np.linalg.norm(both[: len(xyz), None] - both[None], axis=2)
    return (apart < radius).sum(axis=1) - 1 >= others


@pytest.mark.parametrize("others", [1, 2, 5])
def test_as_by_definition(rng, others):
    xyz, around = rng.uniform(0, 5, (300, 3)), rng.uniform(4, 9, (200, 3))
    expected = by_definition(xyz, around, 0.6, others)
    assert (in_company(xyz, around, 0.6, others) == expected).all()


def test_points_around_count_but_are_not_judged():
    lone, beside = np.array([[0.0, 0, 0]]), np.array([[0.1, 0, 0], [0, 0.1, 0]])
    assert in_company(lone, beside, 0.5, 2).tolist() == [True]
    assert in_company(lone, beside, 0.5, 3).tolist() == [False]


def test_one_point_and_none():
    nothing = np.empty((0, 3))
    assert in_company(nothing, nothing, 0.5, 1).shape == (0,)
    assert in_company(np.zeros((1, 3)), nothing, 0.5, 1).tolist() == [False]


def test_points_at_one_place_are_company():
    assert in_company(np.zeros((3, 3)), np.empty((0, 3)), 0.5, 2).all()
