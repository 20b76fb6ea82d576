import numpy as np
import pytest
import shapely

from roadsight.base.errors import InputError
from roadsight.stages.evidence.measure_paper import radius_of, site_facts


def arc(radius_m, angle, offset_m=0.0):
    turn = np.linspace(0, angle, 200)
    return (radius_m + offset_m) * np.column_stack([np.cos(turn), np.sin(turn)])


@pytest.mark.parametrize("radius_m", [120.0, 1670.0])
def test_a_curve_of_two_lanes_is_measured(radius_m, rng):
    half_m, length_m = 4.2, 240.0
    angle = length_m / radius_m
    outer, inner = (arc(radius_m, angle, side * half_m) for side in (1, -1))
    pavement = shapely.MultiPolygon([shapely.Polygon([*outer, *inner[::-1]])])
    edges = [shapely.LineString(outer), shapely.LineString(inner)]
    turn = rng.uniform(0, angle, 40_000)
    across = rng.uniform(-60, 60, 40_000)
    xy = (radius_m + across)[:, None] * np.column_stack([np.cos(turn), np.sin(turn)])
    xyz = np.column_stack([xy, np.zeros(len(xy))])
    facts = site_facts(xyz, edges, pavement, 3.5, reach_m=20.0)
    assert facts.points == pytest.approx((np.abs(across) <= half_m + 20).sum(), abs=60)
    assert facts.length_m == pytest.approx((radius_m + half_m) * angle, rel=1e-3)
    assert facts.width_m == pytest.approx(8.4, rel=0.05)
    assert facts.lanes == 2
    assert facts.radius_m == pytest.approx(radius_m + half_m, rel=0.01)
    density = 40_000 / (length_m * 120)
    assert facts.spacing_m == pytest.approx(0.5 / np.sqrt(density), rel=0.15)


def test_straight_lines_have_no_radius():
    line = np.column_stack([np.arange(50.0), 3 + 0.1 * np.arange(50.0)])
    assert radius_of(line) == float("inf")
    assert radius_of(line[:2]) == float("inf")
    assert radius_of(arc(30.0, 6.2) + np.array([4e5, 5e6])) == pytest.approx(30.0, rel=1e-4)


def test_a_site_without_edges_or_points_is_told():
    with pytest.raises(InputError, match="no road edge"):
        site_facts(np.zeros((3, 3)), [], shapely.MultiPolygon(), 3.5)
    edge = shapely.LineString([(0, 0), (50, 0)])
    with pytest.raises(InputError, match="no point of the cloud"):
        site_facts(np.full((3, 3), 900.0), [edge], shapely.MultiPolygon(), 3.5)
