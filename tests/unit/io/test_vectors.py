import json
import time

import geopandas as gpd
import numpy as np
import pyogrio
import pytest
import shapely
from pyproj import Transformer
from shapely import LineString, MultiLineString, MultiPolygon, Point, Polygon

from roadsight.base.errors import InputError
from roadsight.geometry.frames import Frame
from roadsight.io.vector.vectors import (
    read_layer,
    read_lines,
    read_polygons,
    write_geojson,
    write_layers,
)
from tests.helpers.las_files import DATA, needs_data, wkt_of

US_FOOT = 1200 / 3937
UTM = Frame((458000.25, 5428000.5, 98.0), 1.0, 1.0, wkt_of("EPSG:25832"))
FEET = Frame((2095637.0, 727526.0, 330.0), US_FOOT, US_FOOT, wkt_of("EPSG:6543+6360"))
LOCAL = Frame((-50.0, -60.0, -15.0))
FRAMES = pytest.mark.parametrize("frame", [UTM, FEET, LOCAL], ids=["utm", "feet", "local"])
LINES = [LineString([(0, 0), (10, 1), (20, 0)]), LineString([(0, 8), (20, 8)])]


def layer(*geometries, **columns):
    return gpd.GeoDataFrame(columns, geometry=list(geometries))


def geojson(path, geometries, properties=None, **members):
    features = [
        {
            "type": "Feature",
            "properties": {} if properties is None else properties[i],
            "geometry": None if geometry is None else json.loads(shapely.to_geojson(geometry)),
        }
        for i, geometry in enumerate(geometries)
    ]
    path.write_text(json.dumps({"type": "FeatureCollection", "features": features, **members}))
    return path


def in_crs(geometry, frame, code):
    """Local geometry in the coordinates of another CRS."""
    transformer = Transformer.from_crs(6543 if frame is FEET else 25832, code, always_xy=True)
    return shapely.transform(
        geometry, lambda xy: np.transpose(transformer.transform(*frame.to_native(xy).T))
    )


def assert_same_lines(found, expected, tolerance_m=1e-4):
    for one, other in zip(found, expected, strict=True):
        difference = shapely.get_coordinates(one) - shapely.get_coordinates(other)
        assert np.abs(difference).max() < tolerance_m


# --- own layers ---


@FRAMES
def test_layers_read_back_where_they_were(tmp_path, frame):
    path = tmp_path / "a.gpkg"
    points = layer(Point(1, 2, 3), Point(4, 5, -6), n=[1, 2])
    write_layers(path, {"points": points, "lines": layer(*LINES, edge=["a", "b"])}, frame)
    back = read_layer(path, "points", frame)
    np.testing.assert_allclose(
        shapely.get_coordinates(back.geometry, include_z=True), [[1, 2, 3], [4, 5, -6]], atol=1e-6
    )
    assert back["n"].tolist() == [1, 2]
    assert back.crs is None
    assert_same_lines(read_layer(path, "lines", frame).geometry, LINES)
    stored = gpd.read_file(path, layer="points")
    np.testing.assert_allclose(
        stored.get_coordinates(include_z=True), frame.to_native([[1, 2, 3], [4, 5, -6]])
    )
    assert (stored.crs is None) == (frame is LOCAL)
    if frame is FEET:
        assert stored.crs.axis_info[0].unit_name == "US survey foot"


def test_empty_and_mixed_layers(tmp_path):
    path = tmp_path / "a.gpkg"
    mixed = layer(Point(0, 0), LINES[0], Point(1, 1, 1))
    write_layers(
        path, {"mixed": mixed, "empty": layer(Point(0, 0), n=[1])[:0]}, UTM, {"empty": "Point Z"}
    )
    assert pyogrio.read_info(path, layer="empty")["geometry_type"] == "Point Z"
    assert pyogrio.read_info(path, layer="empty")["crs"] is not None
    assert len(read_layer(path, "mixed", UTM)) == 3
    empty = read_layer(path, "empty", UTM)
    assert (len(empty), list(empty.columns)) == (0, ["n", "geometry"])


def test_same_layers_same_bytes_at_another_time(tmp_path):
    contents = []
    for name in ("a", "b"):
        write_layers(tmp_path / name / "x.gpkg", {"lines": layer(*LINES)}, UTM)
        write_geojson(tmp_path / name / "x.geojson", layer(*LINES), UTM)
        contents.append([p.read_bytes() for p in sorted((tmp_path / name).iterdir())])
        time.sleep(1.1)
    assert len(contents[0]) == 2
    assert contents[0] == contents[1]


def test_failed_write_leaves_the_old_file(tmp_path, monkeypatch):
    path = tmp_path / "a.gpkg"
    write_layers(path, {"lines": layer(*LINES)}, UTM)
    before = path.read_bytes()

    def fail(features, temporary, **options):
        temporary.write_text("half")
        raise OSError("disk full")

    monkeypatch.setattr("pyogrio.write_dataframe", fail)
    with pytest.raises(OSError, match="disk full"):
        write_layers(path, {"lines": layer(*LINES)}, UTM)
    with pytest.raises(ValueError, match="layer"):
        write_layers(path, {}, UTM)
    assert path.read_bytes() == before
    assert [p.name for p in tmp_path.iterdir()] == ["a.gpkg"]


def test_geojson_is_wgs_84_with_metres_and_native_without_crs(tmp_path):
    write_geojson(tmp_path / "a.geojson", layer(Point(10, 20, 30)), FEET)
    feature = json.loads((tmp_path / "a.geojson").read_text())["features"][0]
    lon, lat, z = feature["geometry"]["coordinates"]
    x, y, native_z = FEET.to_native([10, 20, 30])
    assert (lon, lat) == pytest.approx(
        Transformer.from_crs(6543, 4326, always_xy=True).transform(x, y), abs=1e-8
    )
    assert z == pytest.approx(native_z * US_FOOT, abs=1e-6)
    write_geojson(tmp_path / "b.geojson", layer(Point(10, 20, 30)), LOCAL)
    content = json.loads((tmp_path / "b.geojson").read_text())
    assert content["features"][0]["geometry"]["coordinates"] == [-40, -40, 15]
    assert "crs" not in content


def test_missing_file_and_layer(tmp_path):
    with pytest.raises(InputError, match="no such file"):
        read_layer(tmp_path / "a.gpkg", "lines", UTM)
    write_layers(tmp_path / "a.gpkg", {"lines": layer(*LINES)}, UTM)
    with pytest.raises(InputError, match=r"found lines.*allowed: edges"):
        read_layer(tmp_path / "a.gpkg", "edges", UTM)
    (tmp_path / "b.gpkg").write_text("no database")
    with pytest.raises(InputError, match="cannot be read"):
        read_layer(tmp_path / "b.gpkg", "edges", UTM)


# --- users' lines ---


@pytest.mark.parametrize(
    ("frame", "code"),
    [(UTM, 4326), (UTM, 3857), (UTM, 32632), (FEET, 4326), (FEET, 3857), (FEET, 2264)],
)
@pytest.mark.parametrize("suffix", ["gpkg", "shp", "geojson"])
def test_lines_of_any_crs_land_where_they_are(tmp_path, frame, code, suffix):
    path = tmp_path / f"edges.{suffix}"
    lines = gpd.GeoDataFrame(
        {"edge": ["left", "right"], "kind": ["edge", "median"]},
        geometry=[in_crs(line, frame, code) for line in LINES],
        crs=code,
    )
    lines.to_file(path)
    found = read_lines(path, frame)
    assert found["edge"].tolist() == ["left", "right"]
    assert found["kind"].tolist() == ["edge", "median"]
    assert_same_lines(found.geometry, LINES, 0.01 if suffix == "geojson" and code == 4326 else 1e-3)


def test_csv_in_native_coordinates_and_in_degrees(tmp_path):
    path = tmp_path / "edges.csv"
    native = [UTM.to_native(shapely.get_coordinates(line)) for line in LINES]
    rows = [(name, x, y) for name, line in zip("ba", native, strict=True) for x, y in line.tolist()]
    path.write_text("Edge, X ,Y\n" + "".join(f"{n},{x!r},{y!r}\n" for n, x, y in rows))
    found = read_lines(path, UTM)
    assert found["edge"].tolist() == ["b", "a"]  # as they come, not sorted
    assert found["kind"].tolist() == ["edge", "edge"]
    assert_same_lines(found.geometry, LINES)
    degrees = [in_crs(line, UTM, 4326) for line in LINES]
    path.write_text(
        "lon,lat,edge,kind\n"
        + "".join(f"{x},{y},1,line\n" for x, y in shapely.get_coordinates(degrees[0]))
    )
    found = read_lines(path, UTM)
    assert (found["edge"][0], found["kind"][0]) == ("1", "line")
    assert_same_lines(found.geometry, LINES[:1], 1e-3)


def test_csv_heights_are_in_the_site_s_vertical_unit(tmp_path):
    path = tmp_path / "edges.csv"
    path.write_text("edge,x,y,z\na,2095637,727526,330\na,2095737,727526,340\n")
    found = read_lines(path, FEET)
    np.testing.assert_allclose(
        shapely.get_coordinates(found.geometry[0], include_z=True),
        [[0, 0, 0], [100 * US_FOOT, 0, 10 * US_FOOT]],
        atol=1e-9,
    )
    path.write_text("edge,x,y,z\na,2095637,727526,\na,2095737,727526,\n")
    assert not read_lines(path, FEET).geometry[0].has_z


def test_default_crs_is_used_only_where_the_file_names_none(tmp_path):
    utm = [in_crs(line, UTM, 25832) for line in LINES]
    path = geojson(tmp_path / "a.geojson", utm)
    assert_same_lines(read_lines(path, UTM, "EPSG:25832").geometry, LINES)
    assert_same_lines(read_lines(path, UTM, "local").geometry, LINES)
    with pytest.raises(InputError, match=r"longitude and latitude.*x 458000"):
        read_lines(path, UTM)
    named = {"type": "name", "properties": {"name": "urn:ogc:def:crs:EPSG::25832"}}
    path = geojson(tmp_path / "b.geojson", utm, crs=named)
    assert_same_lines(read_lines(path, UTM, "EPSG:4326").geometry, LINES)
    with pytest.raises(InputError, match="no CRS that PROJ knows"):
        read_lines(geojson(tmp_path / "c.geojson", utm), UTM, "EPSG:0")


def test_local_sites_take_native_coordinates_only(tmp_path):
    native = [shapely.transform(line, LOCAL.to_native) for line in LINES]
    assert_same_lines(read_lines(geojson(tmp_path / "a.geojson", native), LOCAL).geometry, LINES)
    placed = gpd.GeoDataFrame(geometry=native, crs=25832)
    placed.to_file(tmp_path / "a.gpkg")
    with pytest.raises(InputError, match="the site is local"):
        read_lines(tmp_path / "a.gpkg", LOCAL)


def test_names_kinds_and_parts(tmp_path):
    joined = MultiLineString([[(0, 0), (5, 0)], [(5, 0), (9, 0)]])
    apart = MultiLineString([[(0, 0), (5, 0)], [(6, 1), (9, 1)]])
    path = geojson(
        tmp_path / "a.geojson",
        [joined, apart, LINES[0]],
        [{"name": "one"}, {"name": "two", "kind": None}, {"name": None, "kind": "line"}],
    )
    found = read_lines(path, Frame((0.0, 0.0, 0.0)))
    assert found["edge"].tolist() == ["one", "two.1", "two.2", "e3"]
    assert found["kind"].tolist() == ["edge", "edge", "edge", "line"]
    assert found.geometry[0].length == 9


def test_repeated_vertices_and_zero_heights_are_dropped(tmp_path):
    line = LineString([(0, 0, 0), (0, 0, 0), (5, 0, 0), (5, 0, 0), (9, 1, 0)])
    found = read_lines(geojson(tmp_path / "a.geojson", [line]), Frame((0.0, 0.0, 0.0)))
    assert found.geometry[0].equals_exact(LineString([(0, 0), (5, 0), (9, 1)]))
    assert not found.geometry[0].has_z


RING = LineString([(0, 0), (9, 0), (9, 9), (0, 0)])


def test_a_closed_line_is_fine(tmp_path):
    found = read_lines(geojson(tmp_path / "a.geojson", [RING]), Frame((0.0, 0.0, 0.0)))
    assert found.geometry[0].is_closed


@pytest.mark.parametrize(
    ("geometries", "properties", "message"),
    [
        ([], None, "holds no features"),
        ([LINES[0], None], None, "feature 2: has no geometry"),
        ([LineString()], None, "has no geometry"),
        ([Point(0, 0)], None, "found Point"),
        ([RING.convex_hull], None, "found Polygon"),
        ([LineString([(1, 1), (1, 1)])], None, "two different vertices"),
        ([LineString([(0, 0), (9, 9), (9, 0), (0, 9)])], None, "e1: crosses itself"),
        (LINES, [{"edge": "a"}, {"edge": "a"}], "share a name; found a"),
        (LINES[:1], [{"kind": "kerb"}], "unknown kind; found kerb; allowed: edge, median, line"),
    ],
)
def test_bad_lines_are_one_message(tmp_path, geometries, properties, message):
    path = geojson(tmp_path / "a.geojson", geometries, properties)
    with pytest.raises(InputError, match=message) as caught:
        read_lines(path, Frame((0.0, 0.0, 0.0)))
    assert "a.geojson" in str(caught.value)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "no CSV table"),
        ("edge,x,y\n", "holds no vertices"),
        ("edge,x\na,1\n", "lacks columns"),
        ("x,y\n1,2\n3,4\n", "lacks columns"),
        ("edge,x,y\na,1,2\n", "edge a: has fewer than two"),
        ("edge,x,y\na,1,2\na,nan,4\n", r"line 3: x is no finite number; found 'nan'"),
        ("edge,x,y\na,1,2\na,3,inf\n", r"line 3: y is no finite number"),
        ("edge,x,y\na,1,2\na,3,\n", r"line 3: y is no finite number; found ''"),
        ("edge,x,y\na,1,two\na,3,4\n", r"line 2: y is no finite number; found 'two'"),
        ("edge,x,y\na,1,2\n ,3,4\n", "line 3: has no edge name"),
        ("edge,x,y,z\na,1,2,\na,3,4,5\n", "line 2: z is no finite number"),
        ("edge,x,y,kind\na,1,2,edge\na,3,4,line\n", "rows differ in kind"),
        ("edge,x,y\na,1,2,3,4,5\na,3\n", r"no CSV table|finite|lacks"),
        ("edge,lon,lat\na,400,52\na,401,52\n", "longitude and latitude"),
    ],
)
def test_bad_tables_are_one_message(tmp_path, text, message):
    path = tmp_path / "edges.csv"
    path.write_text(text)
    with pytest.raises(InputError, match=message):
        read_lines(path, UTM)


def test_bad_files_are_one_message(tmp_path):
    (tmp_path / "a.xyz").write_text("")
    (tmp_path / "a.geojson").write_text('{"type": "FeatureCollection"')
    (tmp_path / "b.csv").write_bytes(b"\xff\xfe\x00edge")
    (tmp_path / "folder.gpkg").mkdir()
    for name in ("a.xyz", "a.geojson", "b.csv", "folder.gpkg", "missing.gpkg", "missing.csv"):
        with pytest.raises(InputError, match=name):
            read_lines(tmp_path / name, UTM)
    two = tmp_path / "two.gpkg"
    write_layers(two, {"a": layer(*LINES), "b": layer(*LINES)}, UTM)
    with pytest.raises(InputError, match="found a, b; allowed: a file with one layer"):
        read_lines(two, UTM)


def test_infinite_coordinates_in_a_geopackage(tmp_path):
    path = tmp_path / "a.gpkg"
    gpd.GeoDataFrame(geometry=[LineString([(0, 0), (np.inf, 1)])], crs=25832).to_file(path)
    with pytest.raises(InputError, match="no finite number"):
        read_lines(path, UTM)


# --- users' polygons ---

SQUARE = Polygon([(0, 0), (40, 0), (40, 30), (0, 30)], [[(10, 10), (20, 10), (20, 20)]])


@pytest.mark.parametrize("code", [4326, 25832])
def test_polygons_keep_holes_parts_and_attributes(tmp_path, code):
    both = MultiPolygon([SQUARE, shapely.transform(SQUARE, lambda xy: xy + 100)])
    placed = gpd.GeoDataFrame({"kind": ["road"]}, geometry=[in_crs(both, UTM, code)], crs=code)
    placed.to_file(tmp_path / "a.gpkg")
    found = read_polygons(tmp_path / "a.gpkg", UTM)
    assert found["kind"].tolist() == ["road", "road"]
    assert found.geometry.area.tolist() == pytest.approx([SQUARE.area] * 2, rel=1e-6)
    assert found.geometry[0].symmetric_difference(SQUARE).area < 1e-3
    assert found.crs is None


@pytest.mark.parametrize(
    ("geometry", "message"),
    [
        (LINES[0], "found LineString"),
        (Polygon([(0, 0), (9, 9), (9, 0), (0, 9)]), "no valid polygon; found Self-intersection"),
        (Polygon(), "has no geometry"),
    ],
)
def test_bad_polygons_are_one_message(tmp_path, geometry, message):
    path = geojson(tmp_path / "a.geojson", [geometry])
    with pytest.raises(InputError, match=message):
        read_polygons(path, Frame((0.0, 0.0, 0.0)))


@needs_data
def test_real_road_polygons():
    frame = Frame((84808.3, 447412.8, -0.568), crs_wkt=wkt_of("EPSG:28992"))
    roads = read_polygons(DATA / "clouds" / "delft" / "bgt_wegdeel.sqlite", frame)
    assert len(roads) == 151
    west, south, east, north = roads.total_bounds
    assert -50 < west < 0 < south < 30
    assert 190 < east < 300
    assert 200 < north < 230
