import json
import subprocess
import sys

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from roadsight.base.errors import InputError
from roadsight.io.cloud.tile_writer import TileSpill, TileWriter
from roadsight.io.cloud.tiles import COLOUR, COLUMN_TYPES, METADATA_KEY, CloudTiles, stack_xyz
from roadsight.io.records.atomic import write_json
from roadsight.io.records.tables import as_numpy, as_table


def cloud(count, seed=0, extent=(120.0, 80.0, 12.0), coloured=True):
    rng = np.random.default_rng(seed)
    points = dict(zip("xyz", rng.uniform(0, 1, (3, count)) * np.array([extent]).T, strict=True))
    for name, kind in COLUMN_TYPES.items():
        if name not in points and (coloured or name not in COLOUR):
            points[name] = rng.integers(0, np.iinfo(kind).max, count, endpoint=True)
    return {name: values.astype(COLUMN_TYPES[name]) for name, values in points.items()}


def write(path, points, tile_size_m=25.0, batch=10**9):
    with TileWriter(path, tile_size_m, "red" in points) as writer:
        for start in range(0, len(points["x"]), batch):
            writer.append({n: values[start : start + batch] for n, values in points.items()})
        return writer.finish()


def test_tiles_hold_every_point_once_in_row_major_order(tmp_path):
    points = cloud(5000)
    points["classification"] |= 1  # of some classes there is no point
    write(tmp_path / "c.parquet", points)
    tiles = CloudTiles(tmp_path / "c.parquet")
    assert tiles.points == 5000
    assert tiles.columns == list(COLUMN_TYPES)
    assert [(t.iy, t.ix) for t in tiles.tiles] == [(iy, ix) for iy in range(4) for ix in range(5)]
    ix, iy = (np.floor(points[a].astype(float) / 25).astype(int) for a in "xy")
    for number, tile in enumerate(tiles.tiles):
        own = np.flatnonzero((ix == tile.ix) & (iy == tile.iy))  # in the order of the file
        found = tiles.read(tiles=[number])
        assert tile.rows == len(own)
        for name, values in points.items():
            assert found[name].dtype == np.dtype(COLUMN_TYPES[name])
            np.testing.assert_array_equal(found[name], values[own])
        xyz = stack_xyz(found)
        np.testing.assert_array_equal(tile.bounds_m, [*xyz.min(axis=0), *xyz.max(axis=0)])
    assert len(tiles.read(["z"])["z"]) == 5000
    classes, counts = np.unique(points["classification"], return_counts=True)
    assert tiles.classes == dict(zip(classes.tolist(), counts.tolist(), strict=True))


@pytest.mark.parametrize("stray_m", [0.0, 30_000.0])
def test_bytes_do_not_depend_on_the_batches(tmp_path, stray_m):
    points = cloud(3000, coloured=False)
    points["x"][40] += stray_m  # tiles beyond what 16 bits number
    points["y"][41] += stray_m
    short = in_order(points, slice(60))
    for some, batches in ((short, (1, 10**9)), (points, (37, 1000, 10**9))):
        written = set()
        for batch in batches:
            write(tmp_path / "c.parquet", some, batch=batch)
            written.add((tmp_path / "c.parquet").read_bytes())
        assert len(written) == 1


def by_tile(points, tile_size_m=25.0):
    """Numbers of the points of each tile, in row-major order: the slow way."""
    ix, iy = (np.floor(points[a].astype(float) / tile_size_m).astype(int) for a in "xy")
    keys = sorted(set(zip(iy.tolist(), ix.tolist(), strict=True)))
    return [np.flatnonzero((iy == row) & (ix == column)) for row, column in keys]


def in_order(points, order):
    return {name: values[order] for name, values in points.items()}


ORDERS = {
    "as flown": lambda points: np.argsort(points["x"] // 4, kind="stable"),
    "in no order": lambda points: np.arange(len(points["x"])),
    "tile after tile": lambda points: np.concatenate(by_tile(points)),
}


@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize(("held", "least"), [(50, 1), (50, 200), (400, 30), (900, 300), (5000, 1)])
@pytest.mark.parametrize("extent", [(120.0, 80.0, 12.0), (20.0, 20.0, 5.0)])
def test_more_points_than_are_held(tmp_path, monkeypatch, order, held, least, extent):
    monkeypatch.setattr("roadsight.io.cloud.tile_writer._HELD_POINTS", held)
    monkeypatch.setattr("roadsight.io.cloud.tile_writer._LEAST_POINTS", least)
    points = cloud(4000, 3, extent)
    points = in_order(points, ORDERS[order](points))
    tiles = write(tmp_path / "c.parquet", points, batch=170)
    found = CloudTiles(tmp_path / "c.parquet")
    expected = by_tile(points)
    assert found.tiles == tiles
    assert [tile.rows for tile in tiles] == [len(own) for own in expected]
    for number, own in enumerate(expected):
        alone = found.read(tiles=[number])
        for name, values in points.items():
            np.testing.assert_array_equal(alone[name], values[own])
        xyz = stack_xyz(alone)
        np.testing.assert_array_equal(tiles[number].bounds_m, [*xyz.min(axis=0), *xyz.max(axis=0)])
    everything = found.read()
    np.testing.assert_array_equal(everything["z"], points["z"][np.concatenate(expected)])
    assert sum(found.classes.values()) == found.points == 4000
    bytes_of_batches = (tmp_path / "c.parquet").read_bytes()
    write(tmp_path / "c.parquet", points)
    assert (tmp_path / "c.parquet").read_bytes() == bytes_of_batches
    assert [path.name for path in tmp_path.iterdir()] == ["c.parquet"]


def test_points_that_come_together_hardly_wait_in_a_file(tmp_path, monkeypatch):
    monkeypatch.setattr("roadsight.io.cloud.tile_writer._HELD_POINTS", 1000)
    monkeypatch.setattr("roadsight.io.cloud.tile_writer._LEAST_POINTS", 100)
    waited = []
    monkeypatch.setattr(TileSpill, "add", spied(waited, TileSpill.add))
    points = cloud(8000, 4, (500.0, 25.0, 5.0))
    points = in_order(points, np.argsort(points["x"]))
    points["y"][:5] += 25.0  # a tile that does not grow
    assert len(write(tmp_path / "c.parquet", points)) == 21
    assert {(1, 0): 5} in waited
    assert sum(sum(rows.values()) for rows in waited) < 80
    assert pq.ParquetFile(tmp_path / "c.parquet").num_row_groups <= 31


def spied(seen, function):
    def wrapper(self, rows, points):
        seen.append(rows)
        return function(self, rows, points)

    return wrapper


@pytest.mark.parametrize(
    "groups", [None, [[0], [1]], [[0], [1], [1]], [[0], [2], [1]], [[0], [1], []], [0, 1, 2], "012"]
)
def test_files_whose_index_does_not_fit_are_refused(tmp_path, groups):
    """None: as the index was before tiles had several row groups."""
    path = tmp_path / "c.parquet"
    write(path, cloud(3000, extent=(60.0, 20.0, 5.0)))
    table = pq.ParquetFile(path)
    index = json.loads(table.metadata.metadata[METADATA_KEY])
    assert index["groups"] == [[0], [1], [2]]
    if groups is None:
        del index["groups"]
    else:
        index["groups"] = groups
    parts = [table.read_row_group(group) for group in range(3)]
    with pq.ParquetWriter(path, table.schema_arrow) as writer:
        for part in parts:
            writer.write_table(part)
        writer.add_key_value_metadata({METADATA_KEY: json.dumps(index).encode()})
    with pytest.raises(InputError, match=r"cannot be read as a tiled cloud.*delete it"):
        CloudTiles(path)


@pytest.mark.parametrize("columns", [2**8 - 1, 2**8, 2**16 - 1, 2**16, 2**16 + 1, 2**32])
def test_tiles_of_a_batch_that_are_far_apart(tmp_path, columns):
    points = cloud(40, coloured=False)
    points["x"][::2], points["y"][:] = 0.0, 1.0
    points["x"][1::2] = (columns - 0.5) * 25.0
    tiles = write(tmp_path / "c.parquet", points)
    far = int(points["x"][1].astype(float) // 25.0)  # single precision moves the farthest
    assert [(tile.ix, tile.iy, tile.rows) for tile in tiles] == [(0, 0, 20), (far, 0, 20)]
    assert far == pytest.approx(columns - 1, rel=1e-7)
    found = CloudTiles(tmp_path / "c.parquet").read()
    np.testing.assert_array_equal(found["z"], np.append(points["z"][::2], points["z"][1::2]))


def test_points_on_a_border_belong_to_the_tile_that_begins_there(tmp_path):
    points = {name: values[:4] for name, values in cloud(4).items()}
    points["x"] = np.array([0, np.nextafter(np.float32(25), 0), 25, 50], np.float32)
    points["y"] = np.array([0, 0, 25, 0], np.float32)
    tiles = write(tmp_path / "c.parquet", points)
    assert [(t.ix, t.iy, t.rows) for t in tiles] == [(0, 0, 2), (2, 0, 1), (1, 1, 1)]


def test_one_point_and_duplicates(tmp_path):
    points = {name: np.repeat(values[:1], 3) for name, values in cloud(1).items()}
    tiles = write(tmp_path / "c.parquet", points)
    assert [tile.rows for tile in tiles] == [3]
    one = {name: values[:1] for name, values in points.items()}
    write(tmp_path / "c.parquet", one)
    assert CloudTiles(tmp_path / "c.parquet").points == 1


@pytest.mark.parametrize("halo_m", [0.0, 3.0, 25.0, 60.0])
def test_iter_tiles_partitions_and_adds_the_margin(tmp_path, halo_m):
    points = cloud(2000, 1)
    write(tmp_path / "c.parquet", points)
    tiles = CloudTiles(tmp_path / "c.parquet")
    everything = stack_xyz(tiles.read())
    counted = 0
    for core, found in tiles.iter_tiles(halo_m, ["x", "y", "z"]):
        west, south, east, north = core
        x, y, _ = everything.T
        wanted = (
            (x >= west - halo_m)
            & (x < east + halo_m)
            & (y >= south - halo_m)
            & (y < north + halo_m)
        )
        np.testing.assert_array_equal(stack_xyz(found), everything[wanted])
        own = (found["x"] >= west) & (found["x"] < east)
        counted += int((own & (found["y"] >= south) & (found["y"] < north)).sum())
    assert counted == 2000


def test_read_within_equals_a_plain_selection(tmp_path):
    points = cloud(2000, 2)
    write(tmp_path / "c.parquet", points)
    tiles = CloudTiles(tmp_path / "c.parquet")
    everything = tiles.read()
    rng = np.random.default_rng(0)
    for _ in range(20):
        west, south = rng.uniform(-20, 100, 2)
        east, north = np.array([west, south]) + rng.uniform(0, 70, 2)
        inside = (everything["x"] >= np.float32(west)) & (everything["x"] < np.float32(east))
        inside &= (everything["y"] >= np.float32(south)) & (everything["y"] < np.float32(north))
        found = tiles.read_within((west, south, east, north), ["intensity"])
        assert list(found) == ["intensity"]
        np.testing.assert_array_equal(found["intensity"], everything["intensity"][inside])
    assert len(tiles.read_within((500.0, 500.0, 600.0, 600.0))["x"]) == 0


def test_read_without_tiles_is_empty_and_typed(tmp_path):
    write(tmp_path / "c.parquet", cloud(10))
    found = CloudTiles(tmp_path / "c.parquet").read(["z", "intensity"], [])
    assert (found["z"].shape, found["intensity"].dtype) == ((0,), np.uint16)


def test_missing_column_is_named(tmp_path):
    write(tmp_path / "c.parquet", cloud(10, coloured=False))
    with pytest.raises(InputError, match=r"lacks a column.*red"):
        CloudTiles(tmp_path / "c.parquet").read(["x", "red"])


def test_too_many_tiles(tmp_path, monkeypatch):
    monkeypatch.setattr("roadsight.io.cloud.tile_writer._MAX_TILES", 5)
    with pytest.raises(InputError, match=r"tile_size_m.*too many tiles"):
        write(tmp_path / "c.parquet", cloud(100))
    assert list(tmp_path.iterdir()) == []


def test_damaged_files_are_one_message(tmp_path):
    path = tmp_path / "c.parquet"
    write(path, cloud(3000))
    data = path.read_bytes()
    rng = np.random.default_rng(0)
    failed = 0
    for trial in range(60):
        damaged = bytearray(data)
        if trial % 3 == 0:
            damaged = damaged[: rng.integers(len(data))]
        else:
            first = len(data) // 2 if trial % 3 == 1 else 0  # more often in the footer
            for place in rng.integers(first, len(data), 4):
                damaged[place] = rng.integers(256)
        path.write_bytes(damaged)
        try:
            CloudTiles(path).read()
        except InputError as error:
            failed += "cannot be read as a tiled cloud" in str(error)
    assert failed >= 20


def test_other_files_are_refused(tmp_path):
    import pandas as pd

    from roadsight.io.records.tables import write_table

    write_json(tmp_path / "a.json", {})
    write_table(tmp_path / "t.parquet", pd.DataFrame({"x": [1.0]}))
    for name in ("a.json", "t.parquet", "missing.parquet"):
        with pytest.raises(InputError, match="cannot be read as a tiled cloud"):
            CloudTiles(tmp_path / name)


@pytest.mark.parametrize("kind", ["f4", "u2", "u1", "i4", "f8"])
@pytest.mark.parametrize("rows", [0, 1, 7])
def test_columns_pass_through_arrow_unchanged(kind, rows):
    values = (np.arange(2 * rows) * 3).astype(kind)[::2]
    schema = pa.schema([("a", pa.from_numpy_dtype(kind))])
    table = as_table({"a": values}, schema)
    table.validate(full=True)
    assert table["a"].to_pylist() == values.tolist()
    twice = pa.concat_tables([table, table])["a"]
    found = as_numpy(twice)
    assert found.dtype == values.dtype
    np.testing.assert_array_equal(found, np.tile(values, 2))


def test_clouds_are_written_and_read_without_pandas(tmp_path):
    np.savez(tmp_path / "points.npz", **cloud(100))
    script = """
import sys
import numpy as np
from roadsight.io.cloud.tile_writer import TileSpill
from roadsight.io.cloud.tile_writer import TileWriter
from roadsight.io.cloud.tiles import CloudTiles
with TileWriter("c.parquet", 25.0, coloured=True) as writer:
    writer.append(np.load("points.npz"))
    writer.finish()
assert len(CloudTiles("c.parquet").read()["x"]) == 100
assert "pandas" not in sys.modules
"""
    subprocess.run([sys.executable, "-c", script], cwd=tmp_path, check=True)
