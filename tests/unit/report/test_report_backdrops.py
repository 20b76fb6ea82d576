import base64

import cv2
import numpy as np
import pytest
from pyproj import CRS, Transformer

from roadsight.base.errors import InputError
from roadsight.geometry.frames import Frame
from roadsight.geometry.north import longitudes_latitudes
from roadsight.io.raster.orthophotos import read_orthophoto
from roadsight.report.document import map_place
from roadsight.report.site.backdrops import backdrops
from tests.helpers.orthophoto import photo

US_FOOT = 1200 / 3937
FEET = Frame((759_000.0, 600_000.0, 0.0), US_FOOT, US_FOOT, CRS.from_epsg(6543).to_wkt())
METRES = Frame((450_000.0, 5_400_000.0, 0.0), crs_wkt=CRS.from_epsg(25832).to_wkt())


def cloud(count=40_000, seed=3):
    """Flat ground of 100 m by 40 m, a bright stripe on it, and a roof above a part of it."""
    rng = np.random.default_rng(seed)
    xyz = np.column_stack([rng.uniform(0, 100, count), rng.uniform(0, 40, count), np.zeros(count)])
    intensity = np.where(np.abs(xyz[:, 1] - 20) < 1, 60_000, 5_000).astype(np.uint16)
    colour = np.full((count, 3), 90, np.uint8)
    roof = xyz[:, 0] > 80
    xyz[roof, 2], intensity[roof], colour[roof] = 9.0, 30_000, (200, 30, 20)
    return xyz, intensity, colour


def at(picture, x, y):
    return picture.pixels[
        int((picture.north_m - y) / picture.cell_size_m),
        int((x - picture.west_m) / picture.cell_size_m),
    ]


def test_colour_is_that_of_the_highest_point_and_intensity_that_near_the_ground():
    xyz, intensity, colour = cloud()
    ground = xyz[:2000] * [0.2, 1, 0] + [80, 0, 0]  # below the roof
    xyz = np.vstack([xyz, ground])
    intensity = np.append(intensity, np.full(2000, 5_000, np.uint16))
    colour = np.vstack([colour, np.full((2000, 3), 90, np.uint8)])
    found = backdrops(xyz, xyz[:, 2], intensity, colour)
    assert list(found) == ["colour", "intensity", "height"]
    assert at(found["colour"], 50, 10).tolist() == [90, 90, 90, 255]
    assert at(found["colour"], 90, 10).tolist() == [200, 30, 20, 255]
    assert at(found["intensity"], 50, 20)[0] > at(found["intensity"], 50, 10)[0] + 100
    height = found["height"].pixels[..., :3].astype(int).sum(axis=2)
    left = height[:, : height.shape[1] // 2].mean()
    assert height[:, -height.shape[1] // 8 :].mean() > left + 100


def test_small_holes_are_filled_and_large_ones_are_not():
    xyz, intensity, _ = cloud(100_000)
    hole = np.hypot(xyz[:, 0] - 30, xyz[:, 1] - 20) < 8
    found = backdrops(xyz[~hole], xyz[~hole, 2], intensity[~hole], None)
    assert list(found) == ["intensity", "height"]
    opaque = found["height"].pixels[..., 3]
    assert at(found["height"], 30, 20)[3] == 0
    assert 0.93 < np.mean(opaque == 255) < 0.97  # the hole is 5 %


@pytest.mark.parametrize("count", [0, 1, 2])
def test_few_points_make_a_small_picture_or_none(count):
    xyz = np.arange(3.0 * count).reshape(count, 3)
    found = backdrops(xyz, np.full(count, np.nan), np.arange(count).astype(np.uint16), None)
    assert (not found) == (count == 0)
    assert all(not picture.pixels[..., 3].any() for n, picture in found.items() if n == "height")


def test_a_picture_is_packed_as_an_image_of_its_size():
    xyz, intensity, colour = cloud(2000)
    packed = backdrops(xyz, xyz[:, 2], intensity, colour)["colour"].packed()
    kind, _, data = packed["address"].partition(",")
    assert kind == "data:image/webp;base64"
    image = cv2.imdecode(np.frombuffer(base64.b64decode(data), np.uint8), cv2.IMREAD_UNCHANGED)
    assert image.shape[:2] == (packed["rows"], packed["columns"])


@pytest.mark.parametrize(("frame", "unit"), [(FEET, "US ft"), (METRES, "m")])
def test_the_page_tells_degrees_as_the_projection_does(frame, unit):
    bounds = np.array([-300.0, -900.0, 4200.0, 150.0])
    place = map_place(frame, bounds, unit)
    rng = np.random.default_rng(1)
    xy = rng.uniform(bounds[:2], bounds[2:], (200, 2))
    u, v = ((xy - place["centre_m"]) / place["span_m"]).T
    terms = np.column_stack([np.ones(len(u)), u, v, u * u, u * v, v * v])
    told = terms @ np.array(place["lon_lat"]).T
    error_m = np.abs(told - longitudes_latitudes(frame, xy)) * 111_000
    assert error_m.max() < 0.005
    native = np.array(place["origin"]) + xy / place["unit_m"]
    assert np.allclose(native, frame.to_native(xy), atol=1e-6)


def test_a_local_site_has_no_degrees():
    assert map_place(Frame((0.0, 0.0, 0.0)), [0, 0, 0, 0], "m")["lon_lat"] is None


def test_an_orthophoto_lies_where_it_was_taken(tmp_path):
    path = photo(tmp_path / "photo.tif", FEET)
    picture = read_orthophoto(path, FEET, -10.0, 45.0, 50, 120, 1.0)
    assert picture.shape == (50, 120, 4)
    assert picture[2, 60, 3] == 0  # north of it
    assert picture[25, 5, 3] == 0  # west of it
    assert picture[25, 30].tolist() == [200, 0, 0, 255]
    assert picture[25, 90].tolist() == [0, 0, 220, 255]


def test_an_orthophoto_of_another_crs_is_warped(tmp_path):
    path = photo(tmp_path / "photo.tif", METRES, epsg=25832)
    lon, lat = longitudes_latitudes(METRES, np.array([[25.0, 20.0]]))[0]
    other = CRS.from_epsg(3035)
    origin = Transformer.from_crs(4326, other, always_xy=True).transform(lon, lat)
    frame = Frame((*origin, 0.0), crs_wkt=other.to_wkt())
    picture = read_orthophoto(path, frame, -3.0, 3.0, 6, 6, 1.0)
    assert (picture == [200, 0, 0, 255]).all()


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"epsg": None}, "has no CRS"),
        ({"dtype": "uint16"}, "is no picture of bytes"),
        ({"west": 5000.0}, "covers nothing of the cloud"),
    ],
)
def test_an_orthophoto_that_cannot_serve_is_refused(tmp_path, changes, message):
    path = photo(tmp_path / "photo.tif", FEET, **changes)
    with pytest.raises(InputError, match=message):
        read_orthophoto(path, FEET, 0.0, 40.0, 20, 50, 2.0)


def test_an_orthophoto_needs_a_site_with_a_crs_and_a_raster(tmp_path):
    path = photo(tmp_path / "photo.tif", FEET)
    with pytest.raises(InputError, match="needs a site with a CRS"):
        read_orthophoto(path, Frame((0.0, 0.0, 0.0)), 0.0, 40.0, 20, 50, 2.0)
    path.write_bytes(b"no raster")
    with pytest.raises(InputError, match="is no raster that can be read"):
        read_orthophoto(path, FEET, 0.0, 40.0, 20, 50, 2.0)
