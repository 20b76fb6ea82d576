import numpy as np
import pandas as pd
import pytest
from shapely import LineString, MultiPolygon, box

from roadsight.base.errors import InputError
from roadsight.placement.candidates.targets import (
    at_least_inside,
    examined_areas_m2,
    headings_along,
    place_targets,
    points_needed,
    road_within,
)


def block(x, y, n, z=0.0):
    """Points spread inside the 1 m cell whose corner is (x, y)."""
    step = (np.arange(n) + 0.5) / n
    return np.column_stack([x + step, y + (step * 7) % 1, np.full(n, z)])


def test_cells_with_enough_points_carry_targets():
    points = np.concatenate([block(0, 0, 25), block(1, 0, 24), block(0, 1, 30, z=2.0)])
    targets = place_targets(points)
    assert targets["target"].tolist() == ["t0_0", "t0_1"]
    assert targets[["x", "y", "z"]].to_numpy().tolist() == [[0.5, 0.5, 0], [0.5, 1.5, 2]]
    assert targets["points"].tolist() == [25, 30]


def test_names_and_places_do_not_depend_on_the_extent(rng):
    points = rng.uniform([-3, -4, 0], [5, 6, 0.2], (6000, 3))
    whole = place_targets(points)
    part = place_targets(points[points[:, 0] < 1])
    assert "t-3_-4" in set(whole["target"])
    same = whole[whole["x"] < 1].reset_index(drop=True)
    # The density around a target is that of its block, which the cut goes through.
    assert part.drop(columns="spacing_m").equals(same.drop(columns="spacing_m"))


def test_rows_run_from_the_south_west(rng):
    targets = place_targets(rng.uniform(0, 3, (2000, 3)))
    order = np.lexsort((targets["x"], targets["y"]))
    assert order.tolist() == list(range(9))


def test_median_height_ignores_stray_points():
    points = block(0, 0, 40, z=1.0)
    points[:15, 2] = 9.0
    assert place_targets(points)["z"].tolist() == [1.0]
    assert place_targets(np.concatenate([block(0, 0, 1, z=1), block(0, 0, 1, z=2)]), 1, 2)[
        "z"
    ].tolist() == [1.5]


def test_medians_equal_numpy(rng):
    points = rng.normal(size=(900, 3))
    targets = place_targets(points, 0.5, 1)
    cells = np.floor(points[:, :2] / 0.5).astype(int)
    for row in targets.itertuples():
        own = (cells == [int(np.floor(row.x / 0.5)), int(np.floor(row.y / 0.5))]).all(axis=1)
        assert row.z == pytest.approx(np.median(points[own, 2]))
        assert row.points == own.sum()
    assert targets["points"].sum() == 900


def test_borders_are_half_open():
    targets = place_targets(np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]), 1.0, 1)
    assert targets["target"].tolist() == ["t1_0", "t0_1"]


def test_no_points_or_too_few_give_no_targets():
    for points in (np.empty((0, 3)), block(0, 0, 24)):
        targets = place_targets(points)
        assert len(targets) == 0
        assert list(targets.columns) == ["target", "x", "y", "z", "points", "spacing_m"]


def test_bad_input_is_refused():
    with pytest.raises(InputError, match=r"targets\.cell_size_m"):
        place_targets(block(0, 0, 30), 0)
    with pytest.raises(InputError, match="not finite"):
        place_targets(np.array([[0, np.nan, 0]]))


def test_targets_stand_on_the_pavement_and_not_beyond_its_edge(rng):
    targets = place_targets(rng.uniform([0, 0, 0], [4, 4, 0.1], (4000, 3)))
    outline = MultiPolygon([box(0, 0, 2.4, 4), box(2.6, 0, 4, 0.5)])
    assert len(targets) == 16
    xy = targets[["x", "y"]].to_numpy()

    def inside(inset_m):
        return xy[at_least_inside(outline, xy, np.full(len(xy), inset_m))]

    assert inside(0.0)[:, 0].max() == 3.5
    assert {tuple(place) for place in inside(0.6)} == {(1.5, 1.5), (1.5, 2.5)}
    assert len(inside(-0.2)) == len(inside(0.0)) + 4
    assert len(inside(-10.0)) == len(targets)
    assert len(inside(3.0)) == 0
    assert len(at_least_inside(MultiPolygon(), xy, np.zeros(len(xy)))) == len(xy)


def test_a_target_needs_points_by_its_width():
    assert [points_needed(width, 1.0) for width in (0.5, 0.25, 2.13)] == [9, 36, 3]
    assert points_needed(0.5, 2.0) == 36


def test_a_thin_cloud_is_examined_as_a_whole(rng):
    """27 points/m2: a flat threshold of 25 leaves out a third of the cells."""
    points = rng.uniform(0, 20, (27 * 400, 3))
    flat, local = place_targets(points), place_targets(points, 1.0, points_needed(0.5, 1.0), True)
    assert len(flat) < 0.75 * 400
    assert len(local) == 400
    assert local["spacing_m"].to_numpy() == pytest.approx(27**-0.5, rel=0.1)


def test_a_hole_in_a_dense_cloud_carries_no_target(rng):
    points = rng.uniform(0, 20, (200 * 400, 3))
    hole = (np.abs(points[:, :2] - 10) < 2).all(axis=1)
    points = np.concatenate([points[~hole], points[hole][: 16 * 20]])  # 20 points/m2 left
    local = place_targets(points, 1.0, 9, True)
    assert len(local) == 400 - 16
    assert len(place_targets(points, 1.0, 9)) == 400


class TestExamined:
    road = MultiPolygon([box(0.3, 0.2, 10.0, 4.4)])

    def targets(self, columns, rows):
        column, row = (part.ravel() for part in np.meshgrid(columns, rows))
        table = pd.DataFrame({"x": column + 0.5, "y": row + 0.5})
        return table, (column, row)

    def test_targets_in_all_cells_examine_all(self):
        # The top row's cells have their middles off the road: slivers of the row below.
        table, cells = self.targets(np.arange(10), np.arange(4))
        area_m2, left = examined_areas_m2(table, cells, self.road, 1.0)
        assert area_m2.sum() == pytest.approx(self.road.area)
        assert left.area == pytest.approx(0, abs=1e-9)
        assert area_m2[0] == pytest.approx(0.7 * 0.8)
        assert area_m2[-1] == pytest.approx(1.4)

    def test_cells_without_targets_stay_out(self):
        table, cells = self.targets(np.arange(5), np.arange(4))
        area_m2, left = examined_areas_m2(table, cells, self.road, 1.0)
        assert left.area == pytest.approx(self.road.area - area_m2.sum())
        # Two cells beside the last column lie off the road in their middles, and are slivers.
        assert area_m2.sum() == pytest.approx(4.7 * 4.2, abs=0.5)

    def test_no_target_examines_nothing(self):
        table, cells = self.targets(np.arange(0), np.arange(0))
        area_m2, left = examined_areas_m2(table, cells, self.road, 1.0)
        assert (len(area_m2), left.area) == (0, self.road.area)

    def test_a_digitised_edge_cuts_off_the_verge_and_no_carriageway(self):
        outline = MultiPolygon([box(0, 0, 100, 16)])
        verge, middle = (LineString([(-5, y), (105, y)]) for y in (1.2, 8.0))
        road = road_within(outline, [verge, middle])
        assert road.area == pytest.approx(100 * 14.8, abs=1.0)
        assert road.bounds[1] == pytest.approx(1.2, abs=0.01)
        assert road_within(outline, []) is outline


def test_boxes_stand_along_the_nearest_edge():
    edges = [LineString([(0, 0), (50, 0)]), LineString([(0, 20), (30, 50)])]
    xy = np.array([[10.0, 2.0], [49.5, -1.0], [11.0, 29.0]])
    np.testing.assert_allclose(headings_along(edges, xy), [0.0, 0.0, np.pi / 4], atol=1e-9)
    backwards = [LineString(edge.coords[::-1]) for edge in edges]
    np.testing.assert_allclose(headings_along(backwards, xy), [0.0, 0.0, np.pi / 4], atol=1e-9)
