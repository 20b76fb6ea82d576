import sqlite3
import struct

import geopandas as gpd
import numpy as np
import pyogrio
import pytest
import shapely
from pyproj import CRS, Transformer

from roadsight.base.errors import InputError
from roadsight.geometry.frames import Frame
from roadsight.io.vector.road_files import read_barriers, read_inventory, read_routes
from roadsight.poles.risk.inventory import check_inventory
from roadsight.poles.risk.routes import check_routes

FEET = Frame((900_000.0, 700_000.0, 2000.0), 1200 / 3937, 1200 / 3937, CRS("EPSG:6543").to_wkt())
LINE = np.array([[0.0, 0.0], [100.0, 10.0], [250.0, 10.0]])


def written(path, lines, crs="EPSG:6543", **columns):
    native = [shapely.LineString(FEET.to_native(line)) for line in lines]
    frame = gpd.GeoDataFrame(columns, geometry=native, crs="EPSG:6543")
    frame.to_crs(crs).to_file(path)
    return path


def test_an_inventory_of_miles_and_miles_an_hour(tmp_path):
    path = tmp_path / "inventory.csv"
    path.write_text(
        "Route,FROM_MI,TO_MI,Speed_mph,AADT,Lanes\nSR 7,0.0,0.5,45,1200,2\nSR 7,0.5,1.0,,,\n"
    )
    table, places, routes = read_inventory(path, FEET)
    assert routes == []
    assert places == ["line 2", "line 3"]
    assert table["to_m"].tolist() == pytest.approx([804.672, 1609.344])
    assert table["speed_kmh"].iloc[0] == pytest.approx(72.42, abs=0.01)
    assert table[["speed_kmh", "aadt", "lanes"]].iloc[1].isna().all()
    assert table["carriageway"].tolist() == ["", ""]
    assert len(check_inventory(table, str(path), places).segments) == 2


@pytest.mark.parametrize("crs", ["EPSG:6543", "EPSG:32617"])
def test_an_inventory_as_a_line_layer_in_any_crs_is_a_route_too(tmp_path, crs):
    path = written(tmp_path / "i.gpkg", [LINE], crs, route=["7"], from_m=[500.0], to_m=[750.0])
    table, _, routes = read_inventory(path, FEET)
    assert table["from_m"].tolist() == [500.0]
    assert routes[0].xy_m == pytest.approx(LINE, abs=0.01)
    length = np.hypot(100, 10)
    assert routes[0].measure_m[1] == pytest.approx(500 + 250 * length / (length + 150), abs=0.01)


def with_measures(path, *parts, many=True, frame=FEET, epsg=6543):
    """A layer of one feature, a MultiLineString if ``many``, of parts (n, 3) with measures."""
    native = [np.column_stack([frame.to_native(part[:, :2]), part[:, 2]]) for part in parts]
    text = ", ".join(f"({', '.join(' '.join(map(str, v)) for v in part)})" for part in native)
    line = shapely.from_wkt(f"MULTILINESTRING M ({text})" if many else f"LINESTRING M {text}")
    flat = shapely.from_wkt(shapely.force_2d(line).wkt)
    table = gpd.GeoDataFrame({"name": ["SR 7"]}, geometry=[flat], crs=f"EPSG:{epsg}")
    # GDAL's Python side writes no measures: they are put into the file itself.
    pyogrio.write_dataframe(table, path, layer="lrs", SPATIAL_INDEX="NO")
    header = b"GP\x00\x01" + struct.pack("<i", epsg)
    with sqlite3.connect(path) as file:
        file.execute("update lrs set geom = ?", (header + shapely.to_wkb(line, flavor="iso"),))
        file.execute("update gpkg_geometry_columns set m = 1")
    return path


def test_measures_in_vertices(tmp_path):
    path = with_measures(tmp_path / "lrs.gpkg", np.column_stack([LINE, [1, 1.1, 1.2]]), many=False)
    (route,) = read_routes(path, FEET, unit="mi")
    assert route.name == "SR 7"
    assert route.xy_m == pytest.approx(LINE, abs=0.01)
    assert route.measure_m == pytest.approx(1609.344 * np.array([1.0, 1.1, 1.2]))


@pytest.mark.parametrize("parts", [1, 2, 3])
def test_each_part_keeps_its_measures_whatever_its_direction_or_repeated_vertices(tmp_path, parts):
    whole = np.array([[0.0, 0, 0], [10, 0, 10], [10, 0, 10], [20, 0, 20]])
    before = np.array([[-10.0, 0, 90], [0, 0, 100]])
    other = np.array([[20.0, 0, 20], [30, 0, 30]])
    given = [whole, other, before][:parts]
    routes = read_routes(with_measures(tmp_path / "lrs.gpkg", *given), FEET)
    assert len(routes) == parts
    for route, part in zip(routes, given, strict=True):
        kept = part[np.r_[True, np.diff(part[:, 0]) != 0]]
        assert route.xy_m == pytest.approx(kept[:, :2], abs=0.01)
        assert route.measure_m.tolist() == kept[:, 2].tolist()
    assert routes[-1].where.endswith("feature 1" if parts == 1 else f"feature 1, part {parts}")


def test_measures_between_columns_run_on_over_parts_as_stored(tmp_path):
    parts = [np.array([[0.0, 0], [60, 0]]), np.array([[60.0, 0], [60, 0], [100, 0]])]
    line = shapely.MultiLineString([FEET.to_native(part) for part in parts])
    columns = {"route": ["7"], "from_m": [500.0], "to_m": [600.0]}
    path = tmp_path / "i.gpkg"
    gpd.GeoDataFrame(columns, geometry=[line], crs="EPSG:6543").to_file(path)
    for routes in (read_routes(path, FEET), read_inventory(path, FEET)[2]):
        assert [route.measure_m.round(3).tolist() for route in routes] == [[500, 560], [560, 600]]
        check_routes(routes)


def test_routes_as_tables_and_tracks(tmp_path):
    degrees = Transformer.from_crs("EPSG:6543", "EPSG:4326", always_xy=True)
    lon, lat = degrees.transform(*FEET.to_native(LINE).T)
    rows = [f"a,{x:.10f},{y:.10f},{m}" for x, y, m in zip(lon, lat, (0.0, 0.1, 0.25), strict=True)]
    (tmp_path / "r.csv").write_text("\n".join(["route,lon,lat,measure_km", *rows]))
    (route,) = read_routes(tmp_path / "r.csv", FEET)
    assert route.measure_m.tolist() == pytest.approx([0, 100, 250])
    assert route.xy_m == pytest.approx(LINE, abs=0.01)
    points = "".join(f'<trkpt lat="{y}" lon="{x}"/>' for x, y in zip(lon, lat, strict=True))
    (tmp_path / "t.gpx").write_text(
        '<gpx version="1.1" creator="t" xmlns="http://www.topografix.com/GPX/1/1">'
        f"<trk><name>ride</name><trkseg>{points}</trkseg></trk></gpx>"
    )
    (track,) = read_routes(tmp_path / "t.gpx", FEET)
    assert track.name == "ride"
    assert track.measure_m[-1] == pytest.approx(np.hypot(100, 10) + 150, abs=0.1)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("route,x,y\na,0,0\n", "lacks columns"),
        ("route,x,y,measure_m\na,0,0,zero\na,1,1,1\n", "measure_m is no number.*zero"),
        ("route,x,y,measure_m\na,0,0,0\n", "fewer than two vertices"),
    ],
)
def test_bad_tables_of_routes(tmp_path, text, message):
    (tmp_path / "r.csv").write_text(text)
    with pytest.raises(InputError, match=message):
        read_routes(tmp_path / "r.csv", FEET)


def test_lines_without_measures_and_tables_without_columns(tmp_path):
    path = written(tmp_path / "r.gpkg", [LINE], route=["7"])
    with pytest.raises(InputError, match="states no measures"):
        read_routes(path, FEET)
    with pytest.raises(InputError, match=r"lacks columns.*from_m"):
        read_inventory(path, FEET)
    (tmp_path / "i.csv").write_text("route,from_m,to_m,aadt\n7,0,5,many\n")
    with pytest.raises(InputError, match=r"line 2: aadt is no number.*many"):
        read_inventory(tmp_path / "i.csv", FEET)


@pytest.mark.parametrize(
    ("columns", "told"),
    [
        ("route,from_m,to_m,Speed", "column speed names no unit.*speed_kmh, speed_mph"),
        ("route,from_m,to_m,lane_width", "column lane_width names no unit.*lane_width_ft"),
        ("route,from,to_m,aadt", "column from names no unit.*from_m, from_km"),
    ],
)
def test_columns_that_name_no_unit_are_not_taken_for_unknown(tmp_path, columns, told):
    (tmp_path / "i.csv").write_text(f"{columns}\n7,0,5,60\n")
    with pytest.raises(InputError, match=told):
        read_inventory(tmp_path / "i.csv", FEET)


def test_a_local_site_refuses_routes_of_a_crs(tmp_path):
    path = written(tmp_path / "r.gpkg", [LINE], route=["7"], from_m=[0.0], to_m=[1.0])
    with pytest.raises(InputError, match="the site is local"):
        read_routes(path, Frame((0.0, 0.0, 0.0)))


def test_barriers_have_names_and_parts(tmp_path):
    far = LINE + np.array([0.0, 30.0])
    both = shapely.MultiLineString([FEET.to_native(LINE), FEET.to_native(far)])
    one = shapely.LineString(FEET.to_native(LINE))
    frame = gpd.GeoDataFrame({"name": ["rail", None]}, geometry=[both, one], crs="EPSG:6543")
    frame.to_file(tmp_path / "b.gpkg")
    lines, names = read_barriers(tmp_path / "b.gpkg", FEET)
    assert names == ["rail.1", "rail.2", "b2"]
    assert lines[1] == pytest.approx(far, abs=0.01)
