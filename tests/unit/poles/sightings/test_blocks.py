from dataclasses import replace

import laspy
import numpy as np
import pytest
import shapely
from scipy.spatial import cKDTree

from roadsight.poles.images.kinds import KINDS
from roadsight.poles.sightings.buildings import (
    ROOF_AREA_M2,
    block_cells,
    join_blocks,
    roof_cells,
    steady_roofs,
)


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


def roofs_of(xyz, cls):
    """Buildings of a cloud on level ground at 0 in two tiles, as the stage joins them."""
    west = xyz[:, 0] < 8.0
    parts = [roof_cells(xyz, xyz[:, 2], cls, own) for own in (west, ~west)]
    limits = replace(KINDS["building"], area_m2=ROOF_AREA_M2)
    return join_blocks(steady_roofs(parts), limits)


def gable(rng, per_m2=12.0, noise_m=0.02):
    """Roof of 14 m by 9 m with a ridge at 7 m and eaves at 4 m."""
    xy = rng.uniform((1.0, 2.0), (15.0, 11.0), (rng.poisson(per_m2 * 14 * 9), 2))
    z = 7.0 - np.abs(xy[:, 1] - 6.5) * 3.0 / 4.5
    return np.column_stack([xy, z + rng.normal(0.0, noise_m, len(xy))])


@pytest.mark.parametrize(("per_m2", "alike"), [(6.0, 0.6), (12.0, 0.8), (40.0, 0.8)])
def test_a_roof_is_found_where_no_class_tells_it_and_a_crown_is_none(rng, per_m2, alike):
    ground = np.column_stack([rng.uniform(0, 40, (4000, 2)), np.zeros(4000)])
    crown = rng.uniform((22, 3, 3), (30, 11, 8), (int(4 * per_m2 * 64), 3))
    car = np.column_stack([rng.uniform((33, 3), (35, 7), (160, 2)), np.full(160, 2.4)])
    xyz = np.concatenate([ground, gable(rng, per_m2), crown, car])
    (found,) = roofs_of(xyz, np.zeros(len(xyz), np.uint8))
    truth, ours = shapely.box(1, 2, 15, 11), shapely.Polygon(found.outline_m)
    assert ours.intersection(truth).area / ours.union(truth).area > alike
    assert found.top_m == pytest.approx(7.0, abs=0.15)
    assert roofs_of(xyz, np.full(len(xyz), 5, np.uint8)) == []


@pytest.mark.parametrize("per_m3", [30, 300, 1000])
@pytest.mark.parametrize("semi_axes_m", [(4.0, 4.0, 4.0), (6.0, 6.0, 3.0)])
def test_crowns_of_dense_clouds_are_no_roofs(rng, per_m3, semi_axes_m):
    axes_m = np.array(semi_axes_m)
    way = rng.normal(size=(int(4.19 * axes_m.prod() * per_m3), 3))
    way /= np.linalg.norm(way, axis=1, keepdims=True)
    crown = way * rng.random((len(way), 1)) ** (1 / 3) * axes_m + [7.0, 8.0, 2.5 + axes_m[2]]
    assert roofs_of(crown, np.ones(len(crown), np.uint8)) == []


def test_walls_and_noise_are_no_roofs(rng):
    wall = np.column_stack([rng.uniform(0, 20, 3000), np.full(3000, 5.0), rng.uniform(0, 9, 3000)])
    wall[:, 1] += rng.normal(0.0, 0.02, 3000)
    assert roofs_of(wall, np.ones(3000, np.uint8)) == []
    rough = gable(rng, noise_m=0.3)
    assert roofs_of(rough, np.ones(len(rough), np.uint8)) == []
    assert roofs_of(np.empty((0, 3)), np.empty(0, np.uint8)) == []


@pytest.mark.real
@pytest.mark.parametrize(
    ("file", "found", "right"),
    [("delft/cloud.laz", 0.55, 0.97), ("montpellier_street.laz", 0.85, 0.85)],
)
def test_real_buildings_are_found_where_their_class_is_hidden(data, file, found, right):
    cloud = laspy.read(data / "clouds" / file)
    xyz = np.asarray(cloud.xyz) - np.min(cloud.xyz, axis=0)
    cls = np.asarray(cloud.classification)
    ground = cKDTree(xyz[cls == 2, :2])
    above = xyz[:, 2] - xyz[cls == 2, 2][ground.query(xyz[:, :2])[1]]
    hidden = np.where(cls == 2, 2, 1).astype(np.uint8)
    (cells,) = steady_roofs([roof_cells(xyz, above, hidden, np.ones(len(xyz), bool))])
    truth = block_cells(xyz[(cls == 6) & (above > 2.0)]).index
    near = cKDTree(truth).query(cells.index)[0] < 1.5
    seen = cKDTree(cells.index).query(truth)[0] < 0.5
    assert np.mean(near) > right and np.mean(seen) > found
