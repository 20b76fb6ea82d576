from collections import Counter, defaultdict
from unittest import mock

import geopandas as gpd
import numpy as np
import pytest
import rasterio
from hypothesis import given, settings
from hypothesis import strategies as st
from shapely import box

from roadsight.base.errors import InputError
from roadsight.geometry.frames import Frame
from roadsight.io.cloud.tile_writer import TileWriter
from roadsight.io.raster.rasters import write_raster
from roadsight.io.raster.top_rasters import TopRasterWriter, read_top
from roadsight.io.records.atomic import write_json
from roadsight.io.records.tables import read_about, read_table
from roadsight.io.vector.vectors import write_layers
from roadsight.scene import voxel_classes
from roadsight.scene.classes import class_table, is_road
from roadsight.scene.voxel_classes import (
    Columns,
    VoxelGrid,
    add_runs,
    count_classes,
    seen_from_above,
    settle,
)
from roadsight.stages.scene import rasterise_lidar
from roadsight.stages.scene.rasterise_lidar import PavedArea

FOOT = 0.3048


def reference(xyz_m, cls, anchor, cell):
    """Voxels as {(ix, iy, iz): class} and columns as {(ix, iy): (class, heights)}."""
    counts, heights = defaultdict(Counter), defaultdict(list)
    for point, kind in zip(xyz_m, cls, strict=True):
        key = tuple(
            int(np.floor((p - a + 2.5e-4) / cell)) for p, a in zip(point, anchor, strict=True)
        )
        counts[key][int(kind)] += 1
        heights[key, int(kind)].append(float(point[2]))
    voxels, columns = {}, {}
    for key, counter in counts.items():
        road = {k: n for k, n in counter.items() if k in (11, 17)}
        voxels[key] = min((road or counter), key=lambda k, c=(road or counter): (-c[k], k))
    stacks = defaultdict(list)
    for ix, iy, iz in voxels:
        stacks[ix, iy].append(iz)
    for (ix, iy), stack in stacks.items():
        layers = sorted(stack, reverse=True)
        roads = [iz for iz in layers if voxels[ix, iy, iz] in (11, 17)]
        top = roads[0] if roads else layers[0]
        used = [top, top - 1] if top - 1 in roads else [top]
        own = [
            z
            for iz in used
            for kind in counts[ix, iy, iz]
            if not roads or kind in (11, 17)
            for z in heights[(ix, iy, iz), kind]
        ]
        columns[ix, iy] = (voxels[ix, iy, top], np.mean(own))
    return voxels, columns


def cloud(seed, count=600, extent=(4.0, 3.0, 2.0)):
    rng = np.random.default_rng(seed)
    xyz = (rng.integers(0, 1000, (count, 3)) / 1000 * extent).astype(np.float32)
    return xyz, rng.choice([1, 2, 5, 11, 17], count, p=[0.3, 0.4, 0.2, 0.07, 0.03]).astype(np.uint8)


def voxelise(xyz, cls, frame, cell=FOOT, pieces=1):
    grid = VoxelGrid.over(frame, cell, [*xyz.min(axis=0), *xyz.max(axis=0)])
    parts = [
        count_classes(grid, list(xyz[i::pieces].T.copy()), cls[i::pieces]) for i in range(pieces)
    ]
    return grid, settle(add_runs(parts))


def as_dict(grid, voxels):
    keys = map(tuple, grid.indices(voxels.voxel).tolist())
    return dict(zip(keys, voxels.cls.tolist(), strict=True))


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 10**6), st.sampled_from([0.2, FOOT, 0.7]), st.integers(1, 5))
def test_agrees_with_counters(seed, cell, pieces):
    xyz, cls = cloud(seed, 400)
    frame = Frame((1234.5, 77.25, -3.0))
    grid, voxels = voxelise(xyz, cls, frame, cell, pieces)
    expected, columns = reference(xyz.astype(float), cls, grid.anchor_m, cell)
    assert as_dict(grid, voxels) == expected
    top = seen_from_above(grid, voxels)
    found = {
        (c + grid.low[0], r + grid.low[1]): (k, h)
        for r, c, k, h in zip(
            top.row.tolist(), top.column.tolist(), top.cls.tolist(), top.height_m, strict=True
        )
    }
    assert found.keys() == columns.keys()
    for key, (kind, height) in columns.items():
        assert found[key][0] == kind
        assert found[key][1] == pytest.approx(height, abs=cell / 256)


def test_ties_go_to_the_lowest_class_and_one_road_point_beats_many():
    xyz = np.full((9, 3), 0.1, np.float32)
    frame = Frame((0.0, 0.0, 0.0))
    for classes, winner in (
        ([5, 5, 2, 2], 2),
        ([5, 5, 5, 2], 5),
        ([5, 5, 5, 11], 11),
        ([11, 17, 17, 1], 17),
        ([17, 11, 1, 1], 11),
    ):
        _, voxels = voxelise(xyz[:4], np.array(classes, np.uint8), frame)
        assert voxels.cls.tolist() == [winner]


def test_road_under_trees_and_wires_stays_road():
    # A column: road at 10.1 m, a wire at 17 m, a crown at 14 m.
    xyz = np.array([[0.1, 0.1, 10.10], [0.1, 0.1, 10.12], [0.1, 0.1, 17.0], [0.1, 0.1, 14.0]])
    grid, voxels = voxelise(
        xyz.astype(np.float32), np.array([11, 11, 14, 5], np.uint8), Frame((0, 0, 0))
    )
    top = seen_from_above(grid, voxels)
    assert top.cls.tolist() == [11]
    assert top.height_m[0] == pytest.approx(10.11, abs=0.002)
    assert top.road_share.tolist() == [1.0]


def test_surface_across_a_voxel_floor_keeps_its_mean_and_share():
    # Floor at 1.2192 m; road just above and below it, and grass of the same column.
    z = [1.21, 1.23, 1.22, 1.225]
    xyz = np.column_stack([np.full(4, 0.1), np.full(4, 0.1), z]).astype(np.float32)
    grid, voxels = voxelise(xyz, np.array([11, 11, 11, 2], np.uint8), Frame((0, 0, 0)))
    top = seen_from_above(grid, voxels)
    assert top.height_m[0] == pytest.approx(np.mean(z[:3]), abs=0.002)
    assert top.road_share[0] == pytest.approx(0.75)


def test_points_on_faces_do_not_depend_on_the_extent():
    # Hundredths of a foot: every hundredth point lies on a face, where single precision decides.
    feet = np.random.default_rng(3).integers(0, 50_000, (4000, 3)) / 100 + [643_000, 4_852_000, 400]
    found = []
    for origin in ([643_000, 4_852_000, 400], [640_217, 4_850_003, 351], [642_999.5, 4_851_000, 0]):
        frame = Frame(tuple(map(float, origin)), FOOT, FOOT)
        local = frame.to_local(feet).astype(np.float32)
        grid, voxels = voxelise(local, np.full(len(feet), 2, np.uint8), frame)
        found.append(set(as_dict(grid, voxels)))
    assert found[0] == found[1] == found[2] == set(map(tuple, np.floor(feet).astype(int).tolist()))


def test_metres_and_feet_give_the_same_voxels():
    xyz, cls = cloud(5)
    in_metres = voxelise(xyz, cls, Frame((100.0, 200.0, 5.0)))
    origin = tuple(v / FOOT for v in (100.0, 200.0, 5.0))
    in_feet = voxelise(xyz, cls, Frame(origin, FOOT, FOOT))
    assert as_dict(*in_metres) == as_dict(*in_feet)


def runs_of(grid, xyz, cls):
    runs = count_classes(grid, list(xyz.T.copy()), cls)
    return [getattr(runs, name) for name in ("voxel", "cls", "points", "heights")]


def sorted_runs(grid, xyz, cls):
    """Runs of points that are sorted, whatever the columns are."""
    with mock.patch.object(voxel_classes, "_COLUMNS_A_POINT", -1):
        return runs_of(grid, xyz, cls)


@settings(max_examples=40, deadline=None)
@given(
    st.integers(0, 10**6),
    st.integers(1, 2000),
    st.sampled_from([(4.0, 3.0, 2.0), (0.5, 0.4, 90.0), (90.0, 80.0, 0.0), (0.0, 0.0, 9.0)]),
    st.sampled_from([0.2, FOOT, 0.7, 200.0]),
    st.sampled_from([0, 1, 32]),
)
def test_columns_count_as_sorting_does(seed, count, extent, cell, steps):
    # Sparse and dense, flat and tall, and with chains that are given up.
    xyz, cls = cloud(seed, count, extent)
    cls[::7], cls[::11] = 255, 0
    window = [-3, -2, -1, *(xyz.max(axis=0) + 5)]
    grid = VoxelGrid.over(Frame((1234.5, 77.25, -3.0)), cell, window)
    with mock.patch.object(voxel_classes, "_STEPS_A_POINT", steps):
        found = runs_of(grid, xyz, cls)
    expected = sorted_runs(grid, xyz, cls)
    for one, other in zip(found, expected, strict=True):
        assert one.dtype == other.dtype
        np.testing.assert_array_equal(one, other)
    counts = Counter(zip(*map(tuple, grid_indices(grid, xyz).T), cls.tolist(), strict=True))
    keys = zip(*map(tuple, grid.indices(found[0]).T.tolist()), found[1].tolist(), strict=True)
    assert dict(zip(keys, found[2].tolist(), strict=True)) == counts


def grid_indices(grid, xyz):
    """Indices (n, 3) of the voxels of points."""
    moved = xyz.astype(float) - (grid.corner_m - 2.5e-4)
    return np.floor(moved / grid.cell_size_m).astype(int) + grid.low


def test_points_beside_the_window_go_to_its_nearest_voxels():
    grid = VoxelGrid.over(Frame((0, 0, 0)), 0.5, [0, 0, 0, 1.9, 1.9, 1.9])
    xyz = np.array([[-1, 0.1, 0.1], [0.1, 7, 0.1], [0.1, 0.1, 9], [1, 1, -3], [np.nan, 1, 1]])
    inside = np.array([[0, 0.1, 0.1], [0.1, 1.9, 0.1], [0.1, 0.1, 1.9], [1, 1, 0], [0, 1, 1]])
    cls = np.arange(5, dtype=np.uint8)
    for some in (slice(None), slice(0, 4), slice(4, 5)):
        found, expected = (runs_of(grid, points[some], cls[some]) for points in (xyz, inside))
        for one, other in zip(found[:3], expected[:3], strict=True):
            np.testing.assert_array_equal(one, other)


def test_stray_points_are_refused_with_a_hint():
    with pytest.raises(InputError, match=r"too many voxels.*stray"):
        VoxelGrid.over(Frame((0, 0, 0)), 0.3, [0, 0, 0, 1e6, 1e6, 1e5])
    with pytest.raises(InputError):
        VoxelGrid.over(Frame((0, 0, 0)), 0.3, [0, 0, 0, np.nan, 1, 1])


def test_no_points():
    grid = VoxelGrid.over(Frame((0, 0, 0)), 0.3, [0, 0, 0, 1, 1, 1])
    none = np.empty(0, np.float32)
    voxels = settle(add_runs([count_classes(grid, [none] * 3, none.astype(np.uint8))]))
    assert len(voxels.voxel) == len(seen_from_above(grid, voxels).cls) == 0


def test_class_table():
    table = class_table([11, 40], [26])
    assert table[[11, 40, 26, 2]].tolist() == [11, 11, 17, 2]
    assert table[[0, 1]].tolist() == [1, 1]
    assert class_table([0], [])[[0, 1]].tolist() == [11, 1]
    assert is_road(np.arange(256, dtype=np.uint8)).nonzero()[0].tolist() == [11, 17]


def test_paved_area_needs_plan_and_height():
    area = PavedArea(box(0, 0, 10, 10), lambda x, y: np.where(np.asarray(x) > 8, np.nan, 1.0))
    x, y, z = np.array([[5, 5, 1.1], [5, 5, 2.0], [15, 5, 1.0], [9, 5, 1.0], [5, 5, 0.75]]).T
    assert area.holds(x, y, z).tolist() == [True, False, False, False, True]
    assert not area.holds(x + 100, y, z).any()
    assert area.holds([], [], []).shape == (0,)


def write_site(folder, xyz, cls, tile_m, order=None, name="cloud"):
    order = np.arange(len(xyz)) if order is None else order
    ones = np.ones(len(xyz), np.uint8)
    with TileWriter(folder / f"{name}.parquet", tile_m, coloured=False) as writer:
        columns = dict(zip("xyz", xyz[order].T, strict=True)) | {"classification": cls[order]}
        writer.append(
            columns | dict.fromkeys(("intensity", "return_number", "number_of_returns"), ones)
        )
        writer.finish()
    return folder / f"{name}.parquet"


def run(folder, cloud_path, name, *extra):
    return rasterise_lidar.main(
        [
            *("--cloud", str(cloud_path), "--frame", str(folder / "frame.json"), *extra),
            *("--voxels", str(folder / f"{name}.parquet"), "--top", str(folder / f"{name}.tif")),
        ]
    )


@pytest.fixture
def site(tmp_path):
    write_json(tmp_path / "frame.json", Frame((500_000.3, 4_100_000.7, 100.0)).to_dict())
    return tmp_path


def test_stage_gives_the_same_bytes_for_any_tiles_order_and_threads(site):
    xyz, cls = cloud(7, 30_000, (130.0, 90.0, 12.0))
    rng = np.random.default_rng(1)
    for name, tile_m, order, threads in (
        ("a", 50.0, None, "1"),
        ("b", 7.0, None, "3"),
        ("c", 500.0, rng.permutation(len(xyz)), "2"),
    ):
        path = write_site(site, xyz, cls, tile_m, order, f"cloud_{name}")
        assert run(site, path, name, "--threads", threads) == 0
    table = read_table(site / "a.parquet")
    about = read_about(site / "a.parquet")
    expected, columns = reference(xyz.astype(float), cls, about["anchor"], about["cell_size_m"])
    rows = table[["ix", "iy", "iz"]].itertuples(index=False, name=None)
    assert dict(zip(rows, table["cls"], strict=True)) == expected
    assert list(expected) != [] and len(table) == len(expected)
    assert table.dtypes.astype(str).tolist() == ["int32"] * 3 + ["uint8"]
    for kind in ("parquet", "tif"):
        content = (site / f"a.{kind}").read_bytes()
        assert (site / f"b.{kind}").read_bytes() == content, kind
        assert (site / f"c.{kind}").read_bytes() == content, kind
    frame = Frame((500_000.3, 4_100_000.7, 100.0))
    top = read_top(site / "a.tif", frame)
    assert (top.cls > 0).sum() == len(columns)
    row, column = np.nonzero(top.cls)
    centre = frame.to_native(top.xy_m(row, column))
    index = np.floor(centre / about["cell_size_m"]).astype(int)
    for r, c, key in zip(row, column, map(tuple, index.tolist()), strict=True):
        assert top.cls[r, c] == columns[key][0]
        assert top.height_m[r, c] == pytest.approx(columns[key][1], abs=0.002)


@settings(max_examples=50, deadline=None)
@given(st.integers(0, 10**6), st.sampled_from([0.2, FOOT, 0.7]), st.sampled_from([0.5, 1.0, 7.0]))
def test_voxels_within_a_tile_hold_no_points_of_others(seed, cell, tile_m):
    xyz, cls = cloud(seed, 3000, (9.0, 8.0, 1.0))
    xyz[:500, :2] = np.rint(xyz[:500, :2] / tile_m) * tile_m  # on the seams
    grid = VoxelGrid.over(Frame((1234.5, 77.25, -3.0)), cell, [*xyz.min(axis=0), *xyz.max(axis=0)])
    tile = np.floor(xyz[:, :2].astype(float) / tile_m)
    west, south = tile[-1] * tile_m
    here = (tile == tile[-1]).all(axis=1)
    inner, others = (count_classes(grid, list(xyz[own].T), cls[own]) for own in (here, ~here))
    within = grid.within(inner.voxel, west, south, tile_m)
    columns = {int(v) // grid.shape[2] for v in others.voxel}
    assert not columns & {int(v) // grid.shape[2] for v in inner.voxel[within]}
    if tile_m == 7.0:
        assert within.any()


def test_stage_takes_the_road_from_the_pavement(site):
    xyz, cls = cloud(8, 24_000, (20.0, 20.0, 0.2))
    cls[cls >= 11] = 2
    path = write_site(site, xyz, cls, 10.0)
    frame = Frame((500_000.3, 4_100_000.7, 100.0))
    assert run(site, path, "none") == 2
    write_layers(
        site / "pavement.gpkg", {"pavement": gpd.GeoDataFrame(geometry=[box(4, 4, 16, 12)])}, frame
    )
    write_raster(site / "dem.tif", np.full((20, 20), 0.1), frame, 0.0, 20.0, 1.0)
    extra = ("--pavement", str(site / "pavement.gpkg"), "--dem", str(site / "dem.tif"))
    assert run(site, path, "paved", *extra) == 0
    top = read_top(site / "paved.tif", frame)
    assert (top.cls == 11).sum() * FOOT**2 == pytest.approx(96, rel=0.1)
    # Points that nobody classified are points all the same: the road ends where they begin.
    never = write_site(site, xyz, 0 * cls, 10.0, name="cloud_never")
    assert run(site, never, "never", *extra) == 0
    found = read_top(site / "never.tif", frame)
    np.testing.assert_array_equal(found.cls == 11, top.cls == 11)
    np.testing.assert_array_equal(found.cls > 0, top.cls > 0)
    assert run(site, path, "strict", *extra, "--road-source", "class") == 2
    write_raster(site / "dem.tif", np.full((20, 20), 9.0), frame, 0.0, 20.0, 1.0)
    assert run(site, path, "wrong", *extra) == 2
    assert not (site / "none.tif").exists()


def test_top_raster_blocks_and_georeference(tmp_path):
    frame = Frame((1000.0, 2000.0, 50.0), FOOT, FOOT)
    grid = VoxelGrid.over(frame, FOOT, [0, 0, 0, 180, 200, 3])
    with TopRasterWriter(tmp_path / "top.tif", frame, grid) as writer:
        for row in (0, 300, 600, 656):
            writer.add(Columns(*(np.array([v]) for v in (row, 5, 11, row / 100.0, 0.5))))
    top = read_top(tmp_path / "top.tif", frame)
    rows, columns = np.nonzero(top.cls)
    assert (grid.shape[1] - 1 - rows).tolist() == [656, 600, 300, 0]
    assert set(columns.tolist()) == {5}
    np.testing.assert_allclose(top.height_m[rows, columns], [6.56, 6.0, 3.0, 0.0], atol=1e-4)
    np.testing.assert_allclose(top.pixels(top.xy_m(rows, columns)), [rows, columns], atol=1e-6)
    for names in ([], ["height_m"], ["road_share"]):
        part = read_top(tmp_path / "top.tif", frame, names)
        np.testing.assert_array_equal(part.cls, top.cls)
        for name in ("height_m", "road_share"):
            expected = getattr(top, name) if name in names else np.empty((0, 0))
            np.testing.assert_array_equal(getattr(part, name), expected)
    with rasterio.open(tmp_path / "top.tif") as raster:
        assert raster.xy(rows[-1], 5) == pytest.approx((1005.5, 2000.5))
        assert raster.descriptions == ("class", "height", "road share")


@pytest.mark.parametrize("content", [None, b"not a raster"])
def test_a_damaged_top_raster_is_one_message(tmp_path, content):
    if content is not None:
        (tmp_path / "top.tif").write_bytes(content)
    with pytest.raises(InputError, match="overhead view"):
        read_top(tmp_path / "top.tif", Frame((0, 0, 0)))
