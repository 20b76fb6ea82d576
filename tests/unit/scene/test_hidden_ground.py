"""Pavement up to a wall, a car or a crown that hides its edge, and no farther."""

from __future__ import annotations

import numpy as np
import pytest
import shapely
from shapely import MultiPolygon, box

from roadsight.scene.pavement.hidden_ground import HALO_M, REACH_M, to_what_stands

SPACING_M = 0.25
STREET = MultiPolygon([box(0, -4, 60, 4)])
"""The pavement that was found; its true edge lies at y = 5."""


def layer(rng, area, z_m):
    """Points (n, 3) evenly over an area."""
    west, south, east, north = area.bounds
    count = round((east - west) * (north - south) / SPACING_M**2)
    x, y = rng.uniform([west, south], [east, north], (count, 2)).T
    return np.column_stack([x, y, np.full(count, z_m)])


def grown(parts, outline=STREET, tiles=((-10.0, -20.0, 70.0, 20.0),)):
    """What the pavement becomes, by parts: points and whether they are ground."""
    xyz = np.concatenate([points for points, _ in parts])
    ground = np.concatenate([np.full(len(points), label) for points, label in parts])

    def around(bounds):
        west, south, east, north = bounds
        near = (xyz[:, 0] >= west) & (xyz[:, 0] < east) & (xyz[:, 1] >= south) & (xyz[:, 1] < north)
        return xyz[near], ground[near]

    return to_what_stands(outline, tiles, around, SPACING_M)


def street(rng, wall_y=4.7, height_m=6.0):
    """A street, a roof from `wall_y` on, and a verge that was seen on the other side."""
    return [
        (layer(rng, box(0, -4, 60, 4), 0.0), True),
        (layer(rng, box(0, -12, 60, -4), 0.05), True),
        (layer(rng, box(0, wall_y, 60, 14), height_m), False),
    ]


def edge_at(outline, x=30.0):
    """Southern and northern end of the pavement at x."""
    across = shapely.intersection(outline, shapely.LineString([(x, -30), (x, 30)]))
    return across.bounds[1], across.bounds[3]


class TestToWhatStands:
    def test_a_street_runs_under_the_eaves_and_stops_at_ground_that_was_seen(self, rng):
        outline, share = grown(street(rng))
        south, north = edge_at(outline)
        assert north == pytest.approx(5.0, abs=0.25)
        assert south == pytest.approx(-4.0, abs=0.15)
        assert share == pytest.approx(60 / 138, abs=0.06)

    def test_what_lies_low_or_far_away_hides_nothing(self, rng):
        for parts in (street(rng, height_m=0.5), street(rng, wall_y=4 + 2 * REACH_M + 0.5)):
            outline, share = grown(parts)
            assert outline.symmetric_difference(STREET).area < 0.02 * STREET.area
            assert share < 0.05

    def test_water_gives_no_returns_and_is_no_pavement(self, rng):
        parts = street(rng)[:1]
        outline, _ = grown(parts)
        assert outline.symmetric_difference(STREET).area < 0.02 * STREET.area

    def test_it_goes_no_farther_than_its_reach(self, rng):
        parts = [street(rng)[0], (layer(rng, box(0, 4, 60, 14), 6.0), False)]
        outline, _ = grown(parts)
        assert edge_at(outline)[1] == pytest.approx(4.3, abs=0.25)  # one overhang below the roof
        gone = outline.difference(STREET.buffer(REACH_M + 0.15))
        assert gone.area < 1e-6

    def test_tiles_do_not_show(self, rng):
        parts = street(rng)
        whole, _ = grown(parts)
        tiles = [(x, y, x + 20.0, y + 20.0) for x in (-10.0, 10, 30, 50) for y in (-20.0, 0)]
        pieces, _ = grown(parts, tiles=tiles)
        assert whole.symmetric_difference(pieces).area < 0.005 * whole.area
        assert HALO_M > 2 * REACH_M

    def test_without_ground_or_pavement_nothing_changes(self, rng):
        outline, _ = grown([(layer(rng, box(0, -10, 60, 10), 3.0), False)])
        assert outline.symmetric_difference(STREET).area < 0.01
        empty, share = grown(street(rng), outline=MultiPolygon())
        assert empty.is_empty
        assert share == 0
