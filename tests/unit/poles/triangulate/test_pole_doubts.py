"""Doubts about located poles."""

from __future__ import annotations

import pandas as pd
import pytest

from roadsight.poles.sightings.network_scale import NetworkScale
from roadsight.poles.triangulate.pole_doubts import (
    FAR_M,
    FAR_SIGMA_M,
    UNTURNED,
    far_reaching,
    pole_doubts,
)
from roadsight.poles.triangulate.rays import UNAIDED


def sightings(anchored, others=10, lost=0):
    kept = pd.DataFrame({"kept": True, "anchored": [True] * anchored + [False] * others})
    left = pd.DataFrame({"kept": False, "anchored": False, "reason": [UNTURNED] * lost})
    return pd.concat([kept.assign(reason=""), left], ignore_index=True)


@pytest.mark.parametrize(
    ("anchored", "reach"), [(0, FAR_M), (1, FAR_M), (6, FAR_M), (7, 40.0), (10, 40.0)]
)
def test_far_rays_count_where_the_cloud_shows_no_poles(anchored, reach):
    table = sightings(anchored)
    settings = far_reaching(table, UNAIDED)
    assert settings.max_distance_m == reach
    assert settings.max_sigma_m == (FAR_SIGMA_M if reach == FAR_M else 5.0)
    codes = [doubt.code for doubt in pole_doubts(table, [], settings)]
    told = ["poles_not_in_cloud"] if anchored < 2 else []
    assert codes == told + (["sigmas_too_small"] if reach == FAR_M else [])


def test_doubts_name_the_limits_that_hold():
    own = UNAIDED.model_copy(update={"max_distance_m": 80.0, "max_sigma_m": 0.5})
    (found,) = pole_doubts(sightings(3), [], own)
    assert "up to 80 m" in found.message
    assert "known to 0.5 m" in found.message


def test_a_wider_reach_is_never_narrowed():
    wide = UNAIDED.model_copy(update={"max_distance_m": 80.0})
    assert far_reaching(sightings(0), wide) is wide
    usual = UNAIDED
    assert far_reaching(sightings(0, others=0), usual) is usual


def test_what_was_scaled_and_left_out_is_told():
    network = [NetworkScale("a", "front", 0.6, 0.2, 90), NetworkScale("b", "front", 1.1, 0.1, 40)]
    found = pole_doubts(sightings(9, lost=7), network, UNAIDED)
    told = [(doubt.code, doubt.severity, doubt.measured) for doubt in found]
    assert told == [
        ("network_scale", "doubt", 0.6),
        ("network_scale", "note", 1.1),
        ("side_views_left_out", "doubt", 7),
    ]
