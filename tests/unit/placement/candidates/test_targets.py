import numpy as np
import pytest
from shapely import LineString, MultiPolygon, box

from roadsight.base.errors import InputError
from roadsight.placement.candidates.targets import headings_along, place_targets, standing_inside


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
    assert part.equals(whole[whole["x"] < 1].reset_index(drop=True))


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
        assert list(targets.columns) == ["target", "x", "y", "z", "points"]


def test_bad_input_is_refused():
    with pytest.raises(InputError, match=r"targets\.cell_size_m"):
        place_targets(block(0, 0, 30), 0)
    with pytest.raises(InputError, match="not finite"):
        place_targets(np.array([[0, np.nan, 0]]))


def test_targets_stand_on_the_pavement_and_not_beyond_its_edge(rng):
    targets = place_targets(rng.uniform([0, 0, 0], [4, 4, 0.1], (4000, 3)))
    outline = MultiPolygon([box(0, 0, 2.4, 4), box(2.6, 0, 4, 0.5)])
    assert len(targets) == 16
    assert standing_inside(targets, outline, 0.0)["x"].max() == 3.5
    kept = standing_inside(targets, outline, 0.6)
    assert set(zip(kept["x"], kept["y"], strict=True)) == {(1.5, 1.5), (1.5, 2.5)}
    wider = standing_inside(targets, outline, -0.2)
    assert len(wider) == len(standing_inside(targets, outline, 0.0)) + 4
    assert standing_inside(targets, outline, -10.0).equals(targets)
    assert len(standing_inside(targets, outline, 3.0)) == 0


def test_boxes_stand_along_the_nearest_edge():
    edges = [LineString([(0, 0), (50, 0)]), LineString([(0, 20), (30, 50)])]
    xy = np.array([[10.0, 2.0], [49.5, -1.0], [11.0, 29.0]])
    np.testing.assert_allclose(headings_along(edges, xy), [0.0, 0.0, np.pi / 4], atol=1e-9)
    backwards = [LineString(edge.coords[::-1]) for edge in edges]
    np.testing.assert_allclose(headings_along(backwards, xy), [0.0, 0.0, np.pi / 4], atol=1e-9)
