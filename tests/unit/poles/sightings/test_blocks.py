"""Buildings and headwalls of classified clouds: outlines, size limits, tiles."""

from __future__ import annotations

import numpy as np
import pytest
import shapely

from roadsight.poles.images.kinds import KINDS
from roadsight.poles.sightings.blocks import block_cells, join_blocks


def roof(rng, low, high, height_m=6.0, per_m2=12.0, walls=True):
    """Returns of a flat roof and, below its eaves, of its walls."""
    low, high = np.array(low, float), np.array(high, float)
    count = rng.poisson(per_m2 * np.prod(high - low))
    top = np.column_stack([rng.uniform(low, high, (count, 2)), np.full(count, height_m)])
    if not walls:
        return top
    side = np.column_stack([rng.uniform(low, high, (40, 2)), rng.uniform(0.3, height_m, 40)])
    side[:, 1] = low[1] + 0.05
    return np.concatenate([top, side])


def building(*parts):
    return join_blocks([block_cells(part) for part in parts], KINDS["building"])


def test_an_outline_is_that_of_the_building(rng):
    (found,) = building(roof(rng, (2.2, 3.3), (14.1, 11.2)))
    truth, ours = shapely.box(2.2, 3.3, 14.1, 11.2), shapely.Polygon(found.outline_m)
    assert ours.intersection(truth).area / ours.union(truth).area > 0.9
    assert found.area_m2 == pytest.approx(94.0, rel=0.08)
    assert found.top_m == pytest.approx(6.0, abs=0.01)
    steps = np.hypot(*np.diff(found.outline_m, axis=0).T)
    assert steps.max() <= 1.0 + 1e-9


def test_tiles_that_cut_a_building_do_not_show(rng):
    points = roof(rng, (2.2, 3.3), (14.1, 11.2))
    west = points[:, 0] < 7.3
    whole, cut = building(points), building(points[~west], points[west])
    assert len(cut) == 1
    assert (cut[0].outline_m == whole[0].outline_m).all()


def test_buildings_apart_are_two_and_what_is_too_small_or_flat_is_none(rng):
    houses = roof(rng, (0.0, 0.0), (9.0, 8.0)), roof(rng, (11.0, 0.0), (20.0, 8.0))
    assert len(building(*houses)) == 2
    assert building(roof(rng, (0.0, 0.0), (1.5, 1.5))) == []
    assert building(roof(rng, (0.0, 0.0), (9.0, 8.0), walls=False)) == []


def test_buildings_that_touch_at_a_corner_are_two_with_heights_of_their_own(rng):
    first = roof(rng, (0.0, 0.0), (10.0, 10.0), height_m=9.0, per_m2=60.0)
    found = building(first, roof(rng, (10.0, 10.0), (18.0, 18.0), height_m=5.0, per_m2=60.0))
    assert [block.top_m for block in found] == pytest.approx([9.0, 5.0], abs=0.01)
    assert [block.area_m2 for block in found] == pytest.approx([90.0, 56.0], rel=0.08)
    flat = roof(rng, (10.0, 10.0), (18.0, 18.0), per_m2=60.0, walls=False)
    assert len(building(first, flat)) == 1


def test_a_headwall_has_limits_of_its_own(rng):
    wall = roof(rng, (0.0, 0.0), (4.0, 0.3), height_m=0.9, per_m2=40.0)
    (found,) = join_blocks([block_cells(wall)], KINDS["headwall"])
    assert found.top_m == pytest.approx(0.9, abs=0.01)
    assert building(wall) == []
    house = block_cells(roof(rng, (0.0, 0.0), (14.0, 8.0)))
    assert join_blocks([house], KINDS["headwall"]) == []


def test_no_returns_are_no_building():
    assert building() == []
    assert building(np.empty((0, 3))) == []
