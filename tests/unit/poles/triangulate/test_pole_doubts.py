import numpy as np
import pandas as pd
import pytest

from roadsight.poles.sightings.metric_depth import NetworkScale
from roadsight.poles.triangulate.pole_doubts import (
    FAR_M,
    FAR_SIGMA_M,
    STANDING,
    UNDER_CROWN,
    UNTURNED,
    crown_doubts,
    far_reaching,
    network_doubts,
    pole_doubts,
)
from roadsight.poles.triangulate.rays import UNAIDED
from roadsight.poles.triangulate.site import site_poles


def sightings(anchored, others=10, lost=0):
    kept = pd.DataFrame({"kept": True, "anchored": [True] * anchored + [False] * others})
    left = pd.DataFrame({"kept": False, "anchored": False, "reason": [UNTURNED] * lost})
    return pd.concat([kept.assign(reason=""), left], ignore_index=True).assign(kind="pole")


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


@pytest.mark.parametrize(("kind", "kept"), [("sign", True), ("pole", False)])
def test_each_kind_reaches_as_far_as_its_own_sightings_ask(kind, kept):
    """Seen from 35 to 56 m and known to metres: a panel is a sign, a stem may be anything."""
    x = np.arange(0.0, 21.0, 4.0)
    bearing = np.degrees(np.arctan2(55.0 - x, 12.0))
    table = pd.DataFrame({"x": x, "bearing_grid_deg": bearing, "sequence": range(len(x))})
    table["image"], table["depth_m"] = [f"i{n}" for n in range(len(x))], 50.0
    table = table.assign(route="r", kind=kind, y=0.0, sigma_bearing_deg=0.3, sigma_depth_m=25.0)
    table = table.assign(kept=True, anchored=False)
    settings = UNAIDED.model_copy(update={"sigma_position_m": 0.2})
    (found,) = site_poles(table, settings)[0].to_dict("records")
    assert np.hypot(found["x"] - 55.0, found["y"] - 12.0) < 1.0
    assert FAR_SIGMA_M < found["sigma_major_m"] < settings.max_sigma_m
    assert found["kept"] == kept


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


def test_side_views_that_are_left_out_are_told_of_every_kind():
    signs = sightings(0, lost=4).assign(kind="sign")
    assert [doubt.code for doubt in pole_doubts(signs, [], UNAIDED)] == ["side_views_left_out"]


def test_own_networks_on_photographs_are_a_doubt():
    assert network_doubts([]) == []
    (found,) = network_doubts(["classes", "depth"])
    assert (found.code, found.severity) == ("networks_saw_no_photograph", "doubt")
    assert found.measured == "classes and depth"
    assert "poles.masks" in found.message


def test_poles_withheld_under_crowns_are_a_note():
    poles = pd.DataFrame({"reason": ["", UNDER_CROWN, STANDING, UNDER_CROWN]})
    (found,) = crown_doubts(poles)
    assert (found.code, found.severity, found.measured) == ("under_crowns", "note", 2)
    assert crown_doubts(poles.iloc[[0, 2]]) == []
