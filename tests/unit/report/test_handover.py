import os
import sqlite3
import subprocess
import sys
import xml.etree.ElementTree as ET
from dataclasses import replace

import ezdxf
import geopandas as gpd
import numpy as np
import pandas as pd
import pyogrio
import pytest
import shapely
from pyproj import CRS, Geod, Transformer
from pyproj.crs import CompoundCRS

from roadsight.geometry.frames import Frame
from roadsight.io.raster.rasters import Raster, crs_wkt, read_raster
from roadsight.io.vector.vectors import points, read_layer, write_layers
from roadsight.report.handover.drawing import drawing
from roadsight.report.handover.kml import kml
from roadsight.report.handover.layers import (
    draped,
    plan_layers,
    pole_layers,
    scene_layers,
    sensor_table,
)
from roadsight.report.handover.project import project
from roadsight.report.handover.stakeout import stakeout
from roadsight.report.handover.styles import SEEN, Category, Style, qml
from roadsight.stages.evidence import write_handover, write_stakeout
from roadsight.stages.evidence.write_handover import StyledLayer, write_styled
from tests.helpers.report_site import PLANS, ReportSite

COMPOUND = CRS.from_user_input("EPSG:6543+6360")
US_FOOT = 1200 / 3937
FEET = Frame((759_000.0, 600_000.0, 2100.0), US_FOOT, US_FOOT, COMPOUND.to_wkt())
KML = "{http://www.opengis.net/kml/2.2}"


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    return ReportSite(tmp_path_factory.mktemp("handover"), "tiny", hidden=0.1, traffic=PLANS)


def handed_over(site, folder):
    names = {"layers": "gpkg", "project": "qgs", "kml": "kml", "drawing": "dxf"}
    files = {name: folder / f"tiny.{suffix}" for name, suffix in names.items()}
    site.path("photo.tif").touch()
    arguments = ["--site", "tiny", *(t for n, p in files.items() for t in (f"--{n}", str(p)))]
    for name, path in (
        ("frame", "scene/frame.json"),
        ("dem", "scene/dem.tif"),
        ("pavement", "scene/pavement.gpkg"),
        ("edges", "placement/edges.gpkg"),
        ("orthophoto", "photo.tif"),
    ):
        arguments += [f"--{name}", str(site.path(path))]
    for name, file in (
        ("solutions", "solution.json"),
        ("plan-layers", "solution.gpkg"),
        ("obstacles", "obstacles.gpkg"),
    ):
        arguments += [f"--{name}", *(str(site.path("placement", plan, file)) for plan in PLANS)]
    assert write_handover.main(arguments) == 0
    return files


@pytest.fixture(scope="module")
def files(site, tmp_path_factory):
    return handed_over(site, tmp_path_factory.mktemp("gis"))


def layer(path, name):
    return pyogrio.read_dataframe(path, layer=name)


def test_every_field_of_a_sensor_agrees_with_its_geometry(site, files):
    dem = read_raster(site.path("scene/dem.tif"), site.frame)
    for plan in PLANS:
        found = layer(files["layers"], f"sensors_{plan}")
        sensors = site.solutions[plan]["sensors"]
        assert found["candidate"].tolist() == [entry["candidate"] for entry in sensors]
        x, y, z = shapely.get_coordinates(found.geometry, include_z=True).T
        assert found["sensor_m"].to_numpy() == pytest.approx(z, abs=1e-6)
        assert found["ground_m"].to_numpy() == pytest.approx(z - found["height_m"], abs=1e-6)
        local = site.frame.to_local(np.column_stack([x, y, found["ground_m"]]))
        ground = dem.sample(local[:, 0], local[:, 1])
        known = np.isfinite(ground)
        assert local[known, 2] == pytest.approx(ground[known], abs=0.6)
        to_wgs84 = Transformer.from_crs(found.crs, "EPSG:4326", always_xy=True)
        lon, lat = to_wgs84.transform(x, y)
        assert found["longitude"].to_numpy() == pytest.approx(lon, abs=1e-9)
        assert found["latitude"].to_numpy() == pytest.approx(lat, abs=1e-9)
        turned = np.radians(found["yaw_deg"].to_numpy())
        compass = np.radians(found["azimuth_deg"].to_numpy())
        assert np.sin(compass) == pytest.approx(np.cos(turned), abs=1e-9)
        assert np.cos(compass) == pytest.approx(np.sin(turned), abs=1e-9)


def test_places_and_heights_in_fields_are_native_and_come_back(tmp_path):
    table = gpd.GeoDataFrame(
        {"sensor_x": [1.0], "sensor_y": [2.0], "sensor_z": [3.0], "ground_z_m": [4.0]},
        geometry=[shapely.Point(1, 2, 4)],
    )
    write_layers(tmp_path / "a.gpkg", {"a": table}, FEET)
    native = layer(tmp_path / "a.gpkg", "a").iloc[0]
    assert (native["sensor_x"], native["sensor_y"]) == pytest.approx(native.geometry.coords[0][:2])
    assert native["sensor_z"] == pytest.approx(FEET.to_native([0, 0, 3])[2])
    assert native["ground_z_m"] / US_FOOT == pytest.approx(native.geometry.z)
    back = read_layer(tmp_path / "a.gpkg", "a", FEET)
    for name in ("sensor_x", "sensor_y", "sensor_z", "ground_z_m"):
        assert back[name].to_numpy() == pytest.approx(table[name].to_numpy(), abs=1e-9)


def test_the_vertical_crs_is_kept_where_there_are_heights(tmp_path):
    high = gpd.GeoDataFrame({"n": [1]}, geometry=[shapely.Point(1, 2, 3)])
    flat = gpd.GeoDataFrame({"n": [1]}, geometry=[shapely.Point(1, 2)])
    layers = [
        StyledLayer("high", "With z.", high, "Point Z", "<qgis/>"),
        StyledLayer("flat", "Without.", flat, "Point", "<qgis/>"),
    ]
    write_styled(tmp_path / "a.gpkg", layers, FEET)
    found = {
        n: CRS.from_user_input(pyogrio.read_info(tmp_path / "a.gpkg", layer=n)["crs"])
        for n in ("high", "flat")
    }
    assert found["high"].is_compound
    assert found["high"].sub_crs_list[1].equals(COMPOUND.sub_crs_list[1])
    assert not found["flat"].is_compound
    again = tmp_path / "b.gpkg"
    write_styled(again, layers, FEET)
    assert again.read_bytes() == (tmp_path / "a.gpkg").read_bytes()


def test_each_layer_has_a_style_and_a_description(files):
    with sqlite3.connect(files["layers"]) as database:
        styles = dict(database.execute("SELECT f_table_name, styleQML FROM layer_styles"))
        about = dict(database.execute("SELECT table_name, description FROM gpkg_contents"))
    names = [name for name, kind in pyogrio.list_layers(files["layers"]) if kind is not None]
    assert set(styles) == set(names)
    assert all(about[name].endswith(".") for name in names)
    for text in styles.values():
        assert ET.fromstring(text).find("renderer-v2/symbols/symbol/layer") is not None
    targets = ET.fromstring(styles[f"targets_{next(iter(PLANS))}"]).iter("category")
    assert [one.get("label") for one in targets] == [f"seen {by}" for by in SEEN]


def test_edges_and_pavement_lie_on_the_ground(site, files):
    dem = read_raster(site.path("scene/dem.tif"), site.frame)
    for name in ("edges", "pavement"):
        found = layer(files["layers"], name)
        assert shapely.has_z(found.geometry).all()
        local = site.frame.to_local(shapely.get_coordinates(found.geometry, include_z=True))
        ground = dem.sample(local[:, 0], local[:, 1])
        known = np.isfinite(ground)
        assert known.any()
        assert local[known, 2] == pytest.approx(ground[known], abs=1e-6)


def test_unknown_ground_takes_its_neighbours():
    dem = Raster(np.array([[1.0, np.nan, 3.0]], np.float32), 0.0, 1.0, 1.0)
    line = gpd.GeoDataFrame(geometry=[shapely.LineString([(0.5, 0.5), (9.0, 0.5), (2.5, 0.5)])])
    z = shapely.get_coordinates(draped(line, dem).geometry, include_z=True)[:, 2]
    assert z.tolist() == [1.0, 2.0, 3.0]


def test_the_project_names_every_layer_and_where_it_lies(site, files):
    root = ET.fromstring(files["project"].read_text(encoding="utf-8").split("\n", 1)[1])
    named = [element.text for element in root.iter("datasource")]
    names = [name for name, kind in pyogrio.list_layers(files["layers"]) if kind is not None]
    own = [address for address in named if address.startswith("./")]
    assert own == [f"./tiny.gpkg|layername={name}" for name in names]
    others = [address for address in named if not address.startswith("./")]
    assert len(others) == 3 * len(PLANS) + 2
    for address in others:
        file, _, name = address.partition("|layername=")
        path = (files["project"].parent / file).resolve()
        assert path.is_relative_to(site.path()), address
        assert bool(name) == (path.suffix == ".gpkg")
        if not name:
            assert path.exists()
    assert len(root.findall("layer-tree-group/layer-tree-group")) == len(PLANS) + 1
    ids = [element.get("id") for element in root.iter("layer-tree-layer")]
    assert len(set(ids)) == len(ids) == len(named)
    relief = root.find("projectlayers/maplayer[id='terrain']")
    assert relief.get("type") == "raster" and relief.find("pipe/rasterrenderer") is not None
    assert ids == [element.text for element in root.findall("projectlayers/maplayer/id")]
    assert root.find("projectCrs/spatialrefsys/authid").text == "EPSG:25832"
    west, east = (float(root.find(f"mapcanvas/extent/{k}").text) for k in ("xmin", "xmax"))
    bounds = pd.DataFrame([layer(files["layers"], name).total_bounds for name in names])
    assert west < bounds[0].min() and bounds[2].max() < east


def test_kml_is_where_the_sensors_are(site, files):
    root = ET.parse(files["kml"]).getroot()
    plan = next(iter(PLANS))
    folder = next(
        f for f in root.iter(f"{KML}Folder") if f.find(f"{KML}name").text == f"sensors_{plan}"
    )
    marks = folder.findall(f"{KML}Placemark")
    table = layer(files["layers"], f"sensors_{plan}")
    assert len(marks) == len(table)
    for mark, row in zip(marks, table.itertuples(), strict=True):
        lon, lat = map(float, mark.find(f"{KML}Point/{KML}coordinates").text.split(","))
        apart = Geod(ellps="WGS84").inv(lon, lat, row.longitude, row.latitude)[2]
        assert apart < 0.01
        assert mark.find(f"{KML}name").text == str(row.number)
    assert not any(
        f.find(f"{KML}name").text.startswith("uncovered") and not f.findall(f"{KML}Placemark")
        for f in root.iter(f"{KML}Folder")
    )


def test_kml_says_which_layers_it_leaves_out():
    few = gpd.GeoDataFrame(geometry=gpd.points_from_xy([0.0], [0.0]))
    many = gpd.GeoDataFrame(geometry=gpd.points_from_xy(np.arange(1501.0), np.zeros(1501)))
    text = kml("Long", plan_layers("p", few, many, few, few), FEET)
    document = ET.fromstring(text.encode()).find(f"{KML}Document")
    about = document.find(f"{KML}description").text
    assert "targets_p (1,501)" in about and "sensors_p" not in about
    assert not any(f.find(f"{KML}name").text == "targets_p" for f in document.iter(f"{KML}Folder"))


def test_kml_of_a_site_without_crs_says_so():
    text = kml("Local", [], Frame((0.0, 0.0, 0.0)))
    assert "no coordinate reference system" in text
    ET.fromstring(text)


def test_the_drawing_has_sensors_as_blocks_with_their_fields(files):
    document = ezdxf.readfile(files["drawing"])
    assert not document.audit().errors
    plan = next(iter(PLANS))
    table = layer(files["layers"], f"sensors_{plan}")
    blocks = document.modelspace().query(f'INSERT[layer=="SENSORS_{plan.upper()}"]')
    assert len(blocks) == len(table)
    for block, row in zip(blocks, table.itertuples(), strict=True):
        assert tuple(block.dxf.insert) == pytest.approx(row.geometry.coords[0], abs=1e-6)
        assert block.dxf.rotation == pytest.approx(row.yaw_deg)
        assert block.get_attrib_text("CANDIDATE") == row.candidate
        assert float(block.get_attrib_text("HEIGHT_M")) == pytest.approx(row.height_m)
    edges = document.modelspace().query('POLYLINE[layer=="EDGES"]')
    first = layer(files["layers"], "edges").geometry.iloc[0]
    drawn = [tuple(vertex.dxf.location) for vertex in edges[0].vertices]
    assert drawn == pytest.approx(list(first.coords), abs=1e-6)


@pytest.mark.parametrize(("unit", "code"), [("metre", 6), ("foot", 2), ("us-survey-foot", 21)])
def test_the_drawing_names_its_unit(unit, code):
    sensors = [{"x": 1.0, "y": 2.0, "z": 3.0, "yaw_deg": 0.0, "height_m": 2.0}]
    features = points(sensor_table(sensors, FEET))
    empty = gpd.GeoDataFrame({"n": []}, geometry=[])
    text = drawing(plan_layers("a:b", features, empty, empty, empty), FEET, unit)
    assert f"$INSUNITS\n 70\n{code}\n" in text
    assert "SENSORS_A_B" in text
    assert text == drawing(plan_layers("a:b", features, empty, empty, empty), FEET, unit)


def test_the_same_results_give_the_same_files(site, files, tmp_path):
    again = handed_over(site, tmp_path)
    for name, path in files.items():
        assert again[name].read_bytes() == path.read_bytes()


def test_the_stake_out_leads_back_to_the_sensors(site, tmp_path):
    out = tmp_path / "stakeout.csv"
    solutions = [str(site.path("placement", plan, "solution.json")) for plan in PLANS]
    arguments = ["--frame", str(site.path("scene/frame.json")), "--out", str(out)]
    arguments += ["--edges", str(site.path("placement/edges.gpkg")), "--solutions", *solutions]
    assert write_stakeout.main(arguments) == 0
    table = pd.read_csv(out)
    sensors = [entry for plan in PLANS for entry in site.solutions[plan]["sensors"]]
    assert table["point"].is_unique and len(table) == len(sensors)
    native = site.frame.to_native([[entry[axis] for axis in "xyz"] for entry in sensors])
    assert table[["easting", "northing", "height"]].to_numpy() == pytest.approx(native, abs=2e-3)
    assert (table["sensor_m"] - table["ground_m"]).to_numpy() == pytest.approx(
        table["mast_m"].to_numpy(), abs=2e-3
    )


def test_lengths_and_offset_lead_to_the_place():
    line = shapely.LineString([(0, 0), (100, 0), (100, 100)])
    longest = shapely.LineString([(-40, 8), (100, 8), (100, 100)])
    edges = gpd.GeoDataFrame({"edge": ["kerb", "other"]}, geometry=[line, longest])
    places = [(10.0, -3.0), (60.0, 2.0), (104.0, 50.0), (97.0, 80.0)]
    sensors = [
        {"x": x, "y": y, "z": 5.0, "height_m": 4.0, "yaw_deg": 10.0, "edge": "kerb"}
        for x, y in places
    ]
    table = stakeout("p", sensors, edges, Frame((0.0, 0.0, 0.0)))
    assert table["edge_m"].tolist() == [10.0, 60.0, 150.0, 180.0]
    assert table["edge_offset_m"].tolist() == [3.0, -2.0, 4.0, -3.0]
    assert table["chainage_m"].tolist() == [50.0, 100.0, 182.0, 212.0]
    assert table["offset_m"].tolist() == [11.0, 6.0, 4.0, -3.0]
    assert table["latitude"].isna().all()
    beyond = stakeout("p", [sensors[0] | {"y": 103.0, "x": 105.0}], edges, Frame((0.0, 0.0, 0.0)))
    assert beyond[["chainage_m", "offset_m"]].to_numpy().tolist() == [[235.0, 5.0]]
    assert beyond[["edge_m", "edge_offset_m"]].to_numpy().tolist() == [[203.0, 5.0]]
    unknown = stakeout("p", [sensors[0] | {"edge": "none"}], edges, Frame((0.0, 0.0, 0.0)))
    assert unknown["edge_m"].isna().all()
    assert unknown["chainage_m"].tolist() == [50.0]


def test_the_stake_out_of_a_site_in_feet_says_what_it_counts_in():
    edges = gpd.GeoDataFrame({"edge": ["e"]}, geometry=[shapely.LineString([(0, 0), (100, 0)])])
    sensor = {"x": 10.0, "y": 20.0, "z": 30.0, "height_m": 6.0, "yaw_deg": 10.0, "edge": "e"}
    row = stakeout("p", [sensor], edges, FEET).iloc[0]
    assert row["crs"] == f"{COMPOUND.sub_crs_list[0].name} (EPSG:6543)"
    assert row["vertical"] == "NAVD88 height (ftUS) (EPSG:6360)"
    assert row[["unit", "vertical_unit"]].tolist() == ["us-survey-foot", "us-survey-foot"]
    native = FEET.to_native([10.0, 20.0, 30.0])
    assert row[["easting", "northing", "height"]].tolist() == pytest.approx(native, abs=1e-3)
    assert row["height"] * US_FOOT == pytest.approx(row["sensor_m"], abs=1e-3)
    assert row["ground"] * US_FOOT == pytest.approx(row["ground_m"], abs=1e-3)
    to_wgs84 = Transformer.from_crs(COMPOUND.sub_crs_list[0], "EPSG:4326", always_xy=True)
    (lon, lat), (north_lon, north_lat) = (
        to_wgs84.transform(row["easting"], row["northing"] + step) for step in (0.0, 100.0)
    )
    true_deg = Geod(ellps="WGS84").inv(lon, lat, north_lon, north_lat)[0]
    assert row["convergence_deg"] == pytest.approx(true_deg, abs=2e-3)
    local = stakeout("p", [sensor], edges, Frame((0.0, 0.0, 0.0))).iloc[0]
    assert np.isnan(local["convergence_deg"]) and local["crs"] == "local"
    assert len(stakeout("bought nothing", [], edges, FEET)) == 0


def test_heights_in_another_unit_than_the_header_says_name_no_vertical_crs():
    """A header's NAVD88 height counts in metres, the site says feet: its heights are feet."""
    metres = CompoundCRS("header", [COMPOUND.sub_crs_list[0], CRS.from_epsg(5703)])
    frame = replace(FEET, crs_wkt=metres.to_wkt())
    edges = gpd.GeoDataFrame({"edge": ["e"]}, geometry=[shapely.LineString([(0, 0), (100, 0)])])
    sensor = {"x": 10.0, "y": 20.0, "z": 30.0, "height_m": 6.0, "yaw_deg": 10.0, "edge": "e"}
    row = stakeout("p", [sensor], edges, frame).iloc[0]
    assert row[["vertical", "vertical_unit"]].tolist() == ["as in the cloud", "us-survey-foot"]
    assert not CRS.from_wkt(crs_wkt(frame)).is_compound
    assert CRS.from_wkt(crs_wkt(FEET)).is_compound


def test_pitch_and_roll_go_along_to_layers_and_crew():
    sensor = {"x": 1.0, "y": 2.0, "z": 3.0, "height_m": 6.0, "yaw_deg": 10.0, "edge": "e"}
    sensors = [sensor | {"pitch_deg": -15.0, "roll_deg": 2.5}, sensor]
    edges = gpd.GeoDataFrame({"edge": ["e"]}, geometry=[shapely.LineString([(0, 0), (100, 0)])])
    for table in (points(sensor_table(sensors, FEET)), stakeout("p", sensors, edges, FEET)):
        assert table["pitch_deg"].tolist() == [-15.0, 0.0]
        assert table["roll_deg"].tolist() == [2.5, 0.0]


def test_styles_are_told_by_value():
    style = Style("marker", "#112233", by="rating", categories=(Category("a", "A", "#ff0000"),))
    root = ET.fromstring(qml(style))
    assert root.find("renderer-v2").get("attr") == "rating"
    assert root.find("renderer-v2/categories/category").get("value") == "a"
    options = {o.get("name"): o.get("value") for o in root.iter("Option") if o.get("name")}
    assert options["color"] == "255,0,0,255"
    hatched = Style("fill", "#112233", pattern="b_diagonal", opacity=0.4)
    options = {o.get("name"): o.get("value") for o in ET.fromstring(qml(hatched)).iter("Option")}
    assert options["style"] == "b_diagonal"
    assert (options["color"], options["outline_color"]) == ("17,34,51,102", "17,34,51,255")


def test_poles_and_rating_are_layers_of_their_own():
    pole = gpd.GeoDataFrame({"id": ["p"], "kept": [True]}, geometry=[shapely.Point(1, 2, 3)])
    found = pole_layers({"poles": pole, "hazard": pole.assign(rating="high")})
    assert [one.name for one in found] == ["poles", "hazard"]
    text = project("T", "t.gpkg", found, None, np.zeros(4))
    assert text.count("<maplayer") == 2


def test_a_plan_without_sensors_has_its_layer(tmp_path):
    table = points(sensor_table([], FEET))
    empty = gpd.GeoDataFrame({"n": []}, geometry=[])
    square = gpd.GeoDataFrame({"part": [0]}, geometry=[shapely.box(0, 0, 1, 1)])
    edge = gpd.GeoDataFrame({"edge": ["e"]}, geometry=[shapely.LineString([(0, 0), (1, 1)])])
    dem = Raster(np.full((2, 2), 1.0, np.float32), 0.0, 1.0, 0.5)
    layers = [
        *plan_layers("p", table, empty, empty, empty),
        *scene_layers(square, edge, dem, square),
    ]
    styled = [StyledLayer(n.name, n.about, n.features, n.geometry, qml(n.style)) for n in layers]
    write_styled(tmp_path / "a.gpkg", styled, FEET)
    assert pyogrio.read_info(tmp_path / "a.gpkg", layer="sensors_p")["features"] == 0


def test_a_drawing_does_not_depend_on_the_order_of_sets():
    code = (
        "from roadsight.geometry.frames import Frame;"
        "from roadsight.report.handover.drawing import drawing;"
        "import hashlib;"
        "text = drawing([], Frame((0.0, 0.0, 0.0)), 'metre');"
        "print(hashlib.sha256(text.encode()).hexdigest())"
    )
    digests = {
        subprocess.run(
            [sys.executable, "-c", code], env={**os.environ, "PYTHONHASHSEED": seed}, check=True,
            capture_output=True, text=True,
        ).stdout
        for seed in ("0", "4")  # two that order the library's sets differently
    }  # fmt: skip
    assert len(digests) == 1
