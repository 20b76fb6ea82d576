import numpy as np
import pytest
from scipy.optimize import linear_sum_assignment

from roadsight.poles.sightings.trees import SIGMA_M, canopy_cell_m, find_crowns, measure_density


def tree(rng, x, y, height=10.0, per_m2=50.0):
    """Returns in a crown 3 m in radius, of which the lower half hides, and none on its trunk."""
    returns = int(9 * np.pi * per_m2)
    turn, out = rng.uniform(0, 2 * np.pi, returns), 3.0 * np.sqrt(rng.uniform(0, 1, returns))
    top = height * (0.6 + 0.4 * np.sqrt(1 - (out / 3.0) ** 2))
    z = top - rng.exponential(0.1 * height, returns).clip(max=0.4 * height)
    return np.column_stack([x + out * np.cos(turn), y + out * np.sin(turn), z])


def ground(rng, half=40.0, per_m2=20.0):
    count = int((2 * half) ** 2 * per_m2)
    return np.column_stack([rng.uniform(-half, half, (count, 2)), np.zeros(count)])


def found(*parts, cls=5):
    xyz = np.concatenate(parts)
    classes = np.where(xyz[:, 2] > 0.5, cls, 2).astype(np.uint8)
    return find_crowns(xyz, xyz[:, 2], classes, canopy_cell_m([measure_density(xyz[:, :2])]))


def wire(rng, y, z):
    x = np.arange(-40, 40, 0.1)
    return np.column_stack([x, np.full(len(x), y), np.full(len(x), z)]) + rng.normal(
        0, 0.03, (len(x), 3)
    )


@pytest.mark.parametrize("apart_m", [5.0, 8.0])
def test_trees_whose_crowns_touch_are_told_apart(rng, apart_m):
    places = apart_m * np.array([[0, 0], [1, 0], [0, 1], [-2, 0]])
    heights = [10.0, 8.0, 12.0, 6.0]
    crowns = found(ground(rng), *(tree(rng, *p, h) for p, h in zip(places, heights, strict=True)))
    assert len(crowns) == len(places)
    apart = np.hypot(*(crowns.xy_m[:, None] - places[None]).transpose(2, 0, 1))
    rows, columns = linear_sum_assignment(apart)
    assert apart[rows, columns].max() < 2 * SIGMA_M
    assert crowns.top_m[rows] == pytest.approx(np.array(heights)[columns], abs=0.6)
    assert (crowns.width_m[rows] > 3.0).all()


def test_wires_poles_bushes_and_buildings_are_no_trees(rng):
    z = np.arange(0.6, 9.0, 0.05)
    pole = np.column_stack([np.zeros(len(z)), np.zeros(len(z)), z]) + rng.normal(
        0, 0.1, (len(z), 3)
    )
    wires = [wire(rng, y, 8.0) for y in (-1.0, 0.0, 1.0)]
    bush = rng.normal([15, 15, 1.0], [1.0, 1.0, 0.2], (800, 3))
    assert len(found(ground(rng), pole, *wires, bush)) == 0
    roof = np.column_stack([rng.uniform(-5, 5, (3000, 2)), np.full(3000, 5.0)])
    assert len(found(ground(rng), roof, cls=6)) == 0


def test_a_sparse_cloud_has_the_same_trees(rng):
    crowns = found(
        ground(rng, per_m2=4.0), tree(rng, 0, 0, per_m2=4.0), tree(rng, 12, 0, per_m2=4.0)
    )
    assert len(crowns) == 2
    assert np.sort(crowns.xy_m[:, 0]) == pytest.approx([0, 12], abs=2.0)


def test_cells_suit_the_sparser_part_of_a_cloud_and_no_margin():
    edge = [canopy_cell_m([(20.0, 1000), (per_m2, area)]) for per_m2, area in ((4, 500), (4, 100))]
    assert edge == [1.0, 0.5]
    assert canopy_cell_m([(0.5, 10)]) == 1.2


def test_the_order_of_returns_and_the_origin_do_not_matter(rng):
    xyz = np.concatenate([ground(rng), tree(rng, 3, 4), tree(rng, -6, 1)])
    cls = np.where(xyz[:, 2] > 0.5, 5, 2).astype(np.uint8)
    here = find_crowns(xyz, xyz[:, 2], cls, 0.5)
    order = rng.permutation(len(xyz))
    mixed = find_crowns(xyz[order], xyz[order, 2], cls[order], 0.5)
    assert np.array_equal(here.xy_m, mixed.xy_m) and np.array_equal(here.top_m, mixed.top_m)
    there = find_crowns(np.add(xyz, (100.0, -50.0, 0.0)), xyz[:, 2], cls, 0.5)
    assert there.xy_m == pytest.approx(np.add(here.xy_m, (100.0, -50.0)), abs=SIGMA_M)


def test_nothing_gives_nothing():
    assert len(find_crowns(np.empty((0, 3)), np.empty(0), np.empty(0, np.uint8), 0.5)) == 0
