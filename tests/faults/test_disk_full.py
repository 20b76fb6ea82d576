"""A full disk: no writer leaves a damaged file under a result's name, or a scrap beside it.

The disk is full for a process when its file may not grow beyond a limit (RLIMIT_FSIZE): writes fail
in the middle, as they do on a full disk, with EFBIG instead of ENOSPC.
"""

import resource
from contextlib import contextmanager
from unittest.mock import patch

import geopandas as gpd
import numpy as np
import pandas as pd
import pytest
import shapely

from roadsight.base.errors import InputError
from roadsight.geometry.frames import Frame
from roadsight.geometry.reference import UnitChoice
from roadsight.io.cloud.clouds import write_laz
from roadsight.io.cloud.tile_writer import TileWriter
from roadsight.io.images.image_shards import ImageShardWriter, JpegShardWriter
from roadsight.io.raster.rasters import write_raster
from roadsight.io.raster.top_rasters import TopRasterWriter
from roadsight.io.records.atomic import write_json
from roadsight.io.records.depth_maps import DepthMapInfo, DepthMapWriter
from roadsight.io.records.scene_tables import write_terrain
from roadsight.io.records.tables import write_table
from roadsight.io.records.text_tables import write_csv
from roadsight.io.vector.vectors import write_geojson, write_layers
from roadsight.scene.terrain.tin import Terrain
from roadsight.scene.voxel_classes import Columns, VoxelGrid
from roadsight.stages.scene.ingest_cloud import ingest
from roadsight.stages.scene.rasterise_lidar import VoxelTableWriter
from tests.helpers.las_files import wkt_of

FRAME = Frame((458_000.0, 5_428_000.0, 100.0), crs_wkt=wkt_of("EPSG:25832"))
RNG = np.random.default_rng(5)
XYZ = RNG.uniform(0, 200, (20_000, 3)).astype(np.float32)
NOISE = RNG.integers(0, 255, (200, 300, 3), np.uint8)
RANGES = RNG.uniform(1, 90, (20, 40, 500)).astype(np.float32)
VOXELS = RNG.integers(0, 9999, (20_000, 3), np.int32)
GROUND = RNG.uniform(0, 9, (200, 200))
HEIGHTS = RNG.uniform(0, 9, 90_000)
TRIANGLES = RNG.integers(0, 20_000, (30_000, 3))


def table(path):
    write_table(path, pd.DataFrame(XYZ, columns=list("xyz")), {"a": 1})


def depth_maps(path):
    with DepthMapWriter(path, DepthMapInfo("OS-64", "surfel", 40, 500, 0.002)) as writer:
        for number, ranges in enumerate(RANGES):
            writer.append(f"c{number}", ranges)


def tiles(path):
    points = {axis: XYZ[:, i] for i, axis in enumerate("xyz")}
    numbers = ("intensity", "classification", "return_number", "number_of_returns")
    with TileWriter(path, 50.0, coloured=False) as writer:
        writer.append(points | {name: np.zeros(len(XYZ), np.uint8) for name in numbers})
        writer.finish()


def waiting_tiles(path):
    """As `tiles`, when hardly any points are held."""
    with patch("roadsight.io.cloud.tile_writer._HELD_POINTS", 5000):
        tiles(path)


def voxels(path):
    with VoxelTableWriter(path, {"a": 1}) as writer:
        for part in np.array_split(VOXELS, 5):
            writer.add(part, np.zeros(len(part), np.uint8))


def raster(path):
    write_raster(path, GROUND, FRAME, 0, 200, 1)


def top(path):
    grid = VoxelGrid(0.3, (0, 0, 0), (0, 0, 0), (300, 300, 1))
    row, column = (index.ravel() for index in np.indices((300, 300)))
    ground = np.full(len(row), 2, np.uint8)
    with TopRasterWriter(path, FRAME, grid) as writer:
        writer.add(Columns(row, column, ground, HEIGHTS, HEIGHTS / 9))


def features():
    points = gpd.GeoDataFrame({"n": np.arange(900)}, geometry=shapely.points(XYZ[:900]))
    return points


def layers(path):
    write_layers(path, {"points": features(), "more": features()}, FRAME)


def geojson(path):
    write_geojson(path, features(), FRAME)


def laz(path):
    write_laz(path, XYZ, FRAME, {"intensity": np.arange(len(XYZ)) % 999})


def terrain(path):
    write_terrain(path, Terrain(XYZ.astype(float), TRIANGLES))


def images(path):
    with ImageShardWriter(path, {"a": 1}) as writer:
        for number in range(6):
            writer.write(f"i{number}", NOISE)


def jpegs(path):
    with JpegShardWriter(path) as writer:
        for number in range(6):
            writer.write(f"i{number}.jpg", NOISE)


def csv(path):
    write_csv(path, pd.DataFrame(XYZ, columns=list("xyz")), {"x": 3})


def json_file(path):
    write_json(path, {"a": XYZ.tolist()})


WRITERS = {
    "table.parquet": table, "depth.parquet": depth_maps, "cloud.parquet": tiles,
    "waiting.parquet": waiting_tiles, "voxels.parquet": voxels, "dem.tif": raster, "top.tif": top,
    "layers.gpkg": layers, "poles.geojson": geojson, "scans.laz": laz, "terrain.npz": terrain,
    "masks.zip": images, "images.zip": jpegs, "poles.csv": csv, "page.json": json_file,
}  # fmt: skip


@contextmanager
def files_at_most(size):
    """No file of this process may grow beyond ``size`` bytes."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


@pytest.mark.parametrize("name", WRITERS)
@pytest.mark.parametrize("share", [0.0, 0.3, 0.9, 0.999])
def test_writer_on_a_full_disk(tmp_path, name, share):
    target, old = tmp_path / name, b"what was there before"
    WRITERS[name](target)
    limit = int(target.stat().st_size * share)
    target.write_bytes(old)
    with files_at_most(limit), pytest.raises(InputError, match="no room") as error:
        WRITERS[name](target)
    assert str(target) in str(error.value)
    assert "\n" not in str(error.value)
    assert target.read_bytes() == old
    assert list(tmp_path.iterdir()) == [target]


def test_a_cloud_is_read_on_a_full_disk(tmp_path):
    """The disk is full while tiles are drafted, before the cloud is read to its end."""
    laz(tmp_path / "a.laz")
    target = tmp_path / "out" / "cloud.parquet"
    whole = (UnitChoice(), None, 25.0, target, tmp_path / "out" / "frame.json", 1000)
    with (
        patch("roadsight.io.cloud.tile_writer._HELD_POINTS", 5000),
        files_at_most(30_000),
        pytest.raises(InputError, match="no room") as error,
    ):
        ingest([tmp_path / "a.laz"], *whole)
    assert str(target) in str(error.value)
    assert list(target.parent.iterdir()) == []
