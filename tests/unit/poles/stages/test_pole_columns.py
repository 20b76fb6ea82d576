import numpy as np
import pytest
from pyproj import CRS

from roadsight.base.sections.poles import Columns
from roadsight.geometry.frames import Frame
from roadsight.io.cloud.tile_writer import TileWriter
from roadsight.io.raster.rasters import write_raster
from roadsight.io.records.atomic import write_json
from roadsight.io.records.tables import read_table
from roadsight.stages.poles.find_pole_columns import find_columns


def stem(rng, x, y, high_m=9.0, count=300):
    turn = rng.uniform(0, 2 * np.pi, count)
    around = [x, y] + 0.1 * np.column_stack([np.sin(turn), np.cos(turn)])
    return np.column_stack([around, rng.uniform(0.3, high_m, count)])


def columns_of(folder, xyz, cls, tile_m=100.0, **asked):
    """Table of the columns in a cloud on level ground."""
    frame = Frame((500_000.0, 4_600_000.0, 0.0), 1.0, 1.0, CRS.from_epsg(32617).to_wkt())
    write_json(folder / "frame.json", frame.to_dict())
    write_raster(folder / "dem.tif", np.zeros((120, 120)), frame, -10.0, 110.0, 1.0)
    names = ("intensity", "return_number", "number_of_returns")
    points = dict(zip("xyz", xyz.T, strict=True)) | dict.fromkeys(names, np.ones(len(xyz)))
    with TileWriter(folder / "cloud.parquet", tile_m, coloured=False) as writer:
        writer.append(points | {"classification": np.full(len(xyz), cls, np.uint8)})
        writer.finish()
    inputs = [folder / name for name in ("cloud.parquet", "frame.json", "dem.tif")]
    find_columns(*inputs, Columns(**asked), out=folder / "columns.parquet")
    return read_table(folder / "columns.parquet")


@pytest.mark.parametrize(("around_m", "count"), [(2.0, 1), (10.0, 0)])
def test_tiles_do_not_show_however_far_a_column_is_alone(rng, tmp_path, around_m, count):
    hedge = rng.uniform([37, 15, 1.2], [38, 25, 4.0], (4000, 3))
    xyz = np.concatenate([stem(rng, 29.0, 20.0, count=60), hedge])
    for tile_m in (30.0, 100.0):
        found = columns_of(tmp_path, xyz, 5, tile_m, around_m=around_m)
        assert (found["x"].round() == 29).sum() == count


@pytest.mark.parametrize("asked", [{"radius_m": 2.0}, {"around_m": 21.0}, {"radius_m": 2.1}])
def test_radii_that_mean_nothing_are_refused(asked):
    with pytest.raises(ValueError, match=r"radius_m|around_m"):
        Columns(**asked)


def test_excluded_classes_are_so_for_stems_and_leans_too(rng, tmp_path):
    xyz = np.concatenate([stem(rng, 20.0, 20.0), stem(rng, 40.0, 20.0, 2.5)])
    found = columns_of(tmp_path, xyz, 9, excluded_classes=[2])
    # The second is too low for a column, and is a stem.
    assert np.round(found["x"]).tolist() == [20.0, 40.0]
    assert np.isfinite(found["lean_deg"].iloc[0])
    assert columns_of(tmp_path, xyz, 5, excluded_classes=[5]).empty
