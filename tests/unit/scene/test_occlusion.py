import time

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from roadsight.base.errors import InputError
from roadsight.io.cloud.tile_writer import TileWriter
from roadsight.io.records.scene_tables import read_terrain, write_terrain
from roadsight.io.records.tables import write_table
from roadsight.scene.terrain.tin import (
    Terrain,
    TerrainSight,
    add_cells,
    cell_means,
    sum_cells,
    triangulate,
    visible,
)
from roadsight.stages.scene import build_terrain


def hills(rng, count=1500, side=100.0, origin=(0.0, 0.0, 0.0)):
    xy = rng.uniform(0, side, (count, 2))
    z = 4 * np.sin(xy[:, 0] / 12) + 3 * np.cos(xy[:, 1] / 9)
    return np.column_stack([xy, z]) + origin


def blocked(terrain, camera, target):
    """Moeller-Trumbore: whether any triangle meets the way from the camera to the target."""
    way = target - camera
    a, b, c = (terrain.vertices[terrain.triangles[:, k]] for k in range(3))
    e1, e2 = b - a, c - a
    p = np.cross(way, e2)
    det = np.einsum("ij,ij->i", e1, p)
    with np.errstate(divide="ignore", invalid="ignore"):
        t0 = camera - a
        u = np.einsum("ij,ij->i", t0, p) / det
        q = np.cross(t0, e1)
        v = (q @ way) / det
        t = np.einsum("ij,ij->i", e2, q) / det
    return bool(((u >= 0) & (v >= 0) & (u + v <= 1) & (t > 0) & (t < 0.9999)).any())


@pytest.mark.parametrize("origin", [(0.0, 0.0, 0.0), (40_000.0, 70_000.0, 900.0)])
def test_agrees_with_every_triangle(rng, origin):
    points = hills(rng, 500, origin=origin)
    terrain = triangulate(points, 1000.0)
    camera = np.add(origin, [50.0, 50.0, 5.5])
    targets = hills(rng, 400, origin=origin) + rng.normal(0, 0.5, (400, 1)) * [0, 0, 1]
    expected = [not blocked(terrain, camera, np.add(t, [0, 0, 0.15])) for t in targets]
    found = visible(terrain, camera, targets)
    assert 50 < sum(expected) < 350
    assert np.mean(found == expected) > 0.995  # single precision at the rim


def test_surface_does_not_hide_itself_and_a_crest_does():
    x, y = np.meshgrid(np.arange(0.0, 201.0, 2.0), np.arange(-10.0, 11.0, 2.0))
    flat = triangulate(np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)]), 100.0)
    rng = np.random.default_rng(0)
    road = np.column_stack(
        [rng.uniform(5, 195, 3000), rng.uniform(-5, 5, 3000), rng.normal(0, 0.03, 3000)]
    )
    assert visible(flat, [0.5, 0.0, 2.5], road).all()
    crest = np.where(np.abs(x - 60) < 5, 3.0, 0.0)
    ridge = TerrainSight(triangulate(np.column_stack([x.ravel(), y.ravel(), crest.ravel()]), 100.0))
    seen = visible(ridge, [0.5, 0.0, 2.5], road)
    assert seen[road[:, 0] < 50].all() and not seen[(road[:, 0] > 70)].any()
    assert visible(ridge, [0.5, 0.0, 2.5], np.add(road, [0, 0, 30.0])).all()
    assert not visible(ridge, [0.5, 0.0, 2.5], [[np.nan, 0, 0]]).any()
    assert ridge.visible([0, 0, 1], np.empty((0, 3))).shape == (0,)


def test_no_terrain_hides_nothing():
    empty = Terrain(np.empty((0, 3)), np.empty((0, 3), np.int32))
    assert visible(empty, [0, 0, 0], [[1, 2, 3]]).tolist() == [True]


def test_fifty_thousand_rays_cost_little(rng):
    sight = TerrainSight(triangulate(hills(rng, 40_000, 400.0), 1000.0))
    targets = hills(rng, 50_000, 400.0)
    sight.visible([200.0, 200.0, 6.0], targets)
    start = time.process_time()
    sight.visible([200.0, 200.0, 6.0], targets)
    assert time.process_time() - start < 0.1  # 20 ms on a quiet machine


@settings(max_examples=10, deadline=None)
@given(st.integers(0, 1000))
def test_triangles_do_not_depend_on_place_or_order(seed):
    rng = np.random.default_rng(seed)
    points = np.round(hills(rng, 120), 3)
    here = triangulate(points, 1000.0)
    there = triangulate(np.add(points, [400_000.0, 4_000_000.0, 0.0]), 1000.0)
    np.testing.assert_array_equal(here.triangles, there.triangles)
    order = rng.permutation(len(points))
    mixed = triangulate(points[order], 1000.0)

    def corners(terrain):
        return {frozenset(map(tuple, t)) for t in terrain.vertices[terrain.triangles].tolist()}

    assert corners(mixed) == corners(here)
    a, b, c = (here.vertices[here.triangles[:, k], :2].T for k in range(3))
    area = (b - a)[0] * (c - a)[1] - (b - a)[1] * (c - a)[0]
    assert (area > 0).all()


def test_long_triangles_go_at_the_outside_only(rng):
    x, y = (a.ravel() for a in np.meshgrid(np.arange(0.0, 101.0, 2), np.arange(0.0, 101.0, 2)))
    lake = (np.abs(x - 50) < 20) & (np.abs(y - 50) < 15)
    bay = (x > 30) & (y < 25)
    keep = ~lake & ~bay
    points = np.column_stack([x, y, 0 * x])[keep]
    terrain = triangulate(points, 10.0)
    centre = terrain.vertices[terrain.triangles].mean(axis=1)
    inside_lake = (np.abs(centre[:, 0] - 50) < 15) & (np.abs(centre[:, 1] - 50) < 10)
    assert inside_lake.any()
    assert not ((centre[:, 0] > 35) & (centre[:, 1] < 20)).any()
    assert len(terrain.vertices) == keep.sum()


@pytest.mark.parametrize("points", [[], [[0, 0, 0]], [[0, 0, 0], [1, 1, 0], [2, 2, 0], [3, 3, 1]]])
def test_too_few_or_collinear_points_are_one_message(points):
    with pytest.raises(InputError, match="span no surface"):
        triangulate(np.array(points, float).reshape(-1, 3), 10.0)


def test_cells_take_the_mean_and_road_wins(rng):
    xyz = rng.uniform(0, 3, (400, 3)).astype(np.float32)
    road = rng.random(400) < 0.1
    whole = sum_cells(xyz, road, 1.0)
    order = rng.permutation(400)
    parts = [sum_cells(xyz[order[k::3]], road[order[k::3]], 1.0) for k in range(3)]
    joined = add_cells(parts)
    np.testing.assert_array_equal(joined.cell, whole.cell)
    np.testing.assert_array_equal(joined.sums, whole.sums)
    means = cell_means(whole)
    assert len(means) == 9
    for mean in means:
        own = (np.floor(xyz[:, :2]) == np.floor(mean[:2])).all(axis=1)
        own &= road if (own & road).any() else True
        np.testing.assert_allclose(mean, xyz[own].mean(axis=0), atol=1e-4)
    assert len(cell_means(sum_cells(xyz[:0], road[:0], 1.0))) == 0


def test_stage_and_file(tmp_path, rng):
    x, y = rng.uniform(0, 60, (2, 20_000))
    z = 10 + 0.05 * x
    cls = np.where(np.abs(y - 30) < 4, 11, 2).astype(np.uint8)
    tree = rng.random(len(x)) < 0.2
    z[tree] += 6
    cls[tree] = 5
    ones = np.ones(len(x), np.uint8)
    found = []
    for number, tile_m in enumerate((7.0, 50.0)):
        with TileWriter(tmp_path / "cloud.parquet", tile_m, coloured=False) as writer:
            columns = dict(zip("xyz", (x, y, z), strict=True)) | {"classification": cls}
            writer.append(
                columns | dict.fromkeys(("intensity", "return_number", "number_of_returns"), ones)
            )
            writer.finish()
        out = tmp_path / f"terrain{number}.npz"
        cloud = ("--cloud", str(tmp_path / "cloud.parquet"))
        assert build_terrain.main([*cloud, "--out", str(out), "--terrain-cell-m", "1.5"]) == 0
        found.append(out.read_bytes())
    assert found[0] == found[1]
    terrain = read_terrain(tmp_path / "terrain0.npz")
    assert len(terrain.vertices) == 1600
    np.testing.assert_allclose(
        terrain.vertices[:, 2], 10 + 0.05 * terrain.vertices[:, 0], atol=1e-3
    )
    write_table(tmp_path / "ground.parquet", pd.DataFrame({"ground": [True]}))
    wrong = ("--ground", str(tmp_path / "ground.parquet"), "--out", str(tmp_path / "no.npz"))
    assert build_terrain.main([*cloud, *wrong]) == 2


def test_damaged_terrain_is_one_message(tmp_path):
    with pytest.raises(InputError, match="terrain"):
        read_terrain(tmp_path / "none.npz")
    (tmp_path / "cut.npz").write_bytes(b"PK\x03\x04cut")
    with pytest.raises(InputError, match="terrain"):
        read_terrain(tmp_path / "cut.npz")
    write_terrain(tmp_path / "odd.npz", Terrain(np.zeros((2, 3)), np.array([[0, 1, 2]], np.int32)))
    with pytest.raises(InputError, match="belong together"):
        read_terrain(tmp_path / "odd.npz")
