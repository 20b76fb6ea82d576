import time

import numpy as np
import pytest
import rasterio
from hypothesis import given
from hypothesis import strategies as st
from pyproj import CRS

from roadsight.base.errors import InputError
from roadsight.geometry.frames import Frame
from roadsight.io.raster.rasters import Raster, read_raster, write_raster
from tests.helpers.las_files import wkt_of

US_FOOT = 1200 / 3937
FRAMES = [
    Frame((458000.25, 5428000.5, 98.0), 1.0, 1.0, wkt_of("EPSG:25832")),
    Frame((2095637.0, 727526.0, 330.0), US_FOOT, US_FOOT, wkt_of("EPSG:6543")),
    Frame((638000.0, 221000.0, 330.0), 1.0, 0.3048, wkt_of("EPSG:32119")),
    Frame((-50.0, -60.0, -15.0)),
]
VALUES = np.random.default_rng(0).uniform(-2, 30, (20, 30)).astype(np.float32)
VALUES[3, 4] = np.nan
VALUES[5, 6] = np.inf


@pytest.mark.parametrize("frame", FRAMES, ids=["utm", "feet", "mixed", "local"])
def test_raster_reads_back_where_it_was(tmp_path, frame):
    path = tmp_path / "dem.tif"
    write_raster(path, VALUES, frame, -3.0, 25.5, 0.5)
    back = read_raster(path, frame)
    assert (back.west_m, back.north_m, back.cell_size_m) == (-3.0, 25.5, 0.5)
    expected = np.where(np.isfinite(VALUES), VALUES, np.nan)
    np.testing.assert_allclose(back.values, expected, atol=1e-4)
    with rasterio.open(path) as raster:
        pixels = raster.read(1)
        assert raster.nodata == -9999
        np.testing.assert_allclose(raster.xy(0, 0), frame.to_native([-2.75, 25.25]), rtol=1e-12)
        assert (raster.crs is None) == (frame.crs_wkt is None)
    assert pixels[3, 4] == pixels[5, 6] == -9999
    native = frame.to_native([0, 0, float(VALUES[0, 0])])[2]
    assert pixels[0, 0] == pytest.approx(native, abs=1e-3)


@pytest.mark.parametrize(
    ("code", "unit_m", "unit"),
    [("EPSG:6543+6360", US_FOOT, "US survey foot"), ("EPSG:25832+7837", 1.0, "metre")],
)
def test_heights_carry_the_vertical_crs(tmp_path, code, unit_m, unit):
    frame = Frame(FRAMES[1].origin, unit_m, unit_m, wkt_of(code))
    write_raster(tmp_path / "a.tif", VALUES, frame, 0, 0, 1)
    with rasterio.open(tmp_path / "a.tif") as raster:
        assert CRS.from_wkt(raster.crs.to_wkt()).equals(CRS.from_user_input(code))
        assert raster.units == (unit,)


def test_same_values_same_bytes_at_another_time(tmp_path):
    write_raster(tmp_path / "a.tif", VALUES, FRAMES[0], 0, 0, 1)
    time.sleep(1.1)
    write_raster(tmp_path / "b.tif", VALUES, FRAMES[0], 0, 0, 1)
    assert (tmp_path / "a.tif").read_bytes() == (tmp_path / "b.tif").read_bytes()
    assert len(list(tmp_path.iterdir())) == 2


def test_cell_in_feet_comes_back_to_the_digit(tmp_path):
    for cell_size_m in (0.1, 0.5, 1 / 3, 7.0):
        write_raster(tmp_path / "a.tif", VALUES, FRAMES[1], 12.3, 45.6, cell_size_m)
        back = read_raster(tmp_path / "a.tif", FRAMES[1])
        assert back.west_m == 12.3
        assert back.cell_size_m == pytest.approx(cell_size_m, abs=1e-9)


def slow_sample(raster, x, y):
    """Weighted mean over all cells by the tent function of bilinear interpolation."""
    rows, columns = raster.values.shape
    width, height = columns * raster.cell_size_m, rows * raster.cell_size_m
    east, south = raster.west_m + width, raster.north_m - height
    if not (raster.west_m <= x <= east and south <= y <= raster.north_m):
        return np.nan
    total = weight = 0.0
    # Centres beyond the border repeat the border cell.
    for i in range(-1, rows + 1):
        for j in range(-1, columns + 1):
            centre_x = raster.west_m + (j + 0.5) * raster.cell_size_m
            centre_y = raster.north_m - (i + 0.5) * raster.cell_size_m
            tent = max(0, 1 - abs(x - centre_x) / raster.cell_size_m)
            tent *= max(0, 1 - abs(y - centre_y) / raster.cell_size_m)
            value = raster.values[min(max(i, 0), rows - 1), min(max(j, 0), columns - 1)]
            if tent > 0 and np.isfinite(value):
                total += tent * value
                weight += tent
    return total / weight if weight > 0 else np.nan


def test_sample_equals_the_slow_definition():
    rng = np.random.default_rng(1)
    values = rng.uniform(0, 9, (5, 7)).astype(np.float32)
    values[rng.uniform(size=values.shape) < 0.3] = np.nan
    raster = Raster(values, 2.0, 9.0, 1.5)
    x, y = rng.uniform(1, 14, 300), rng.uniform(0, 10, 300)
    expected = [slow_sample(raster, *place) for place in zip(x, y, strict=True)]
    np.testing.assert_allclose(raster.sample(x, y), expected, rtol=1e-6)
    assert np.isnan(raster.sample([np.nan, np.inf], [5.0, 5.0])).all()


def test_bad_rasters_are_one_message(tmp_path):
    frame = FRAMES[0]
    with pytest.raises(InputError, match="cannot be read"):
        read_raster(tmp_path / "missing.tif", frame)
    (tmp_path / "text.tif").write_text("no raster")
    with pytest.raises(InputError, match="cannot be read"):
        read_raster(tmp_path / "text.tif", frame)
    with rasterio.open(
        tmp_path / "other.tif",
        "w",
        driver="GTiff",
        height=2,
        width=2,
        count=1,
        dtype="float32",
        transform=rasterio.transform.from_origin(0, 0, 1, 1),
    ) as raster:
        raster.write(np.zeros((1, 2, 2), np.float32))
    with pytest.raises(InputError, match="no raster that this workflow wrote"):
        read_raster(tmp_path / "other.tif", frame)
    write_raster(tmp_path / "cut.tif", VALUES, frame, 0, 0, 1)
    data = (tmp_path / "cut.tif").read_bytes()
    (tmp_path / "cut.tif").write_bytes(data[: len(data) // 2])
    with pytest.raises(InputError, match="cannot be read"):
        read_raster(tmp_path / "cut.tif", frame)


@given(seed=st.integers(0, 2**31), rows=st.integers(1, 6), columns=st.integers(1, 6))
def test_measured_cells_come_back_as_they_were_written(tmp_path_factory, seed, rows, columns):
    rng = np.random.default_rng(seed)
    values, measured = rng.normal(size=(rows, columns)), rng.random((rows, columns)) < 0.5
    values[rng.random(values.shape) < 0.3] = np.nan
    path = tmp_path_factory.mktemp("raster") / "two.tif"
    frame = Frame((500.0, 600.0, 10.0))
    write_raster(path, values, frame, -2.0, 3.0, 0.5, measured=measured)
    with rasterio.open(path) as raster:
        np.testing.assert_array_equal(raster.read(2) == 1, measured)
    np.testing.assert_array_equal(np.isnan(read_raster(path, frame).values), np.isnan(values))


def test_a_large_raster_opens_fast_in_any_gis(tmp_path):
    path = tmp_path / "dem.tif"
    heights = np.add.outer(np.arange(1300.0), np.arange(900.0)) / 100
    write_raster(path, heights, FRAMES[1], 0.0, 1300.0, 1.0)
    with rasterio.open(path) as raster:
        assert raster.tags(ns="IMAGE_STRUCTURE")["LAYOUT"] == "COG"
        assert raster.overviews(1) == [2, 4]
        assert raster.units == ("US survey foot",)
        coarse = raster.read(1, out_shape=(325, 225))
    native = heights / US_FOOT + FRAMES[1].origin[2]
    assert np.allclose(coarse, native.reshape(325, 4, 225, 4).mean(axis=(1, 3)), atol=0.01)
    again = tmp_path / "again.tif"
    write_raster(again, heights, FRAMES[1], 0.0, 1300.0, 1.0)
    assert again.read_bytes() == path.read_bytes()
