import argparse
import json
from pathlib import Path

import geopandas as gpd
import numpy as np
import pandas as pd
import pyogrio
import pytest
import shapely
from pyproj import CRS

from roadsight.base.errors import InputError
from roadsight.base.sections.poles import (
    Alignment,
    Calibration,
    Sightings,
    Triangulation,
    Validation,
)
from roadsight.commands import triangulate as verb
from roadsight.geometry.frames import Frame
from roadsight.geometry.north import SiteNorth
from roadsight.io.raster.rasters import write_raster
from roadsight.io.records.atomic import read_json, write_json
from roadsight.io.records.tables import read_about, read_table, write_table
from roadsight.io.vector.known import read_points
from roadsight.io.vector.vectors import read_layer, write_layers
from roadsight.poles.risk.roads import RouteTracks
from roadsight.poles.sightings.metric_depth import COLUMNS as NETWORK_COLUMNS
from roadsight.poles.triangulate.site import SHARED_COLUMNS
from roadsight.stages.evidence import compare_components
from roadsight.stages.poles import measure_poles, rate_hazard, triangulate_poles, validate_poles

FEET = Frame((900_000.0, 700_000.0, 2000.0), 1200 / 3937, 1200 / 3937, CRS("EPSG:6543").to_wkt())
FEET_CRS = "NAD83(2011) / North Carolina (ftUS) (EPSG:6543)"
OUTPUTS = {
    "out": "parquet", "csv": "csv", "layers": "gpkg", "geometry-csv": "csv", "sections": "parquet",
    "doubts": "json",
}  # fmt: skip
POLES = np.array([[20.0, 8.0], [42, -7], [60, 8], [85, 9], [100, -8], [121, 8]])


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """A straight road in feet with six poles, seen from cameras every 8 m."""
    folder = tmp_path_factory.mktemp("poles")
    write_json(folder / "frame.json", FEET.to_dict())
    rng = np.random.default_rng(5)
    rows = []
    for number, x in enumerate(np.arange(0, 136, 8.0)):
        for pole in POLES:
            gap = pole - [x, 0]
            depth = np.hypot(*gap)
            if gap[0] > 1 and depth < 24:
                bearing = np.degrees(np.arctan2(*gap)) + rng.normal(0, 0.2)
                rows.append((f"i{number:03d}.jpg", number, x, bearing, depth * rng.normal(1, 0.05)))
    sightings = pd.DataFrame(
        rows, columns=["image", "sequence", "x", "bearing_grid_deg", "depth_m"]
    ).assign(route="r", kind="pole", y=0.0, sigma_bearing_deg=0.3, sigma_depth_m=1.0, kept=True)
    nothing = dict.fromkeys(NETWORK_COLUMNS, np.nan)
    nothing |= dict.fromkeys(("z", "lower_edge_rise", "upper_edge_rise"), np.nan)
    sightings = sightings.assign(view="front", reason="", depth_from="network", **nothing)
    shared = [name for parts in SHARED_COLUMNS.values() for name in parts]
    sightings = sightings.assign(**dict.fromkeys(shared, 0.0))
    write_table(folder / "s0.parquet", sightings.iloc[::2])
    write_table(folder / "s1.parquet", sightings.iloc[1::2])
    write_table(folder / "none.parquet", sightings.iloc[:0])
    frames = pd.DataFrame(
        {"route": "r", "sequence": range(17), "x": np.arange(0, 136, 8.0), "y": 0.0}
    )
    write_table(folder / "frames.parquet", frames)
    x = np.arange(-5, 140, 0.3)
    edges = [pd.DataFrame({"x": x, "y": y, "z": 0.0}) for y in (-4.0, 4.0)]
    write_table(folder / "edges.parquet", pd.concat(edges))
    slope = np.repeat(-0.1 * np.abs(np.arange(20, -20, -0.5) - 0.25)[:, None], 320, axis=1)
    write_raster(folder / "dem.tif", slope, FEET, -10.0, 20.0, 0.5)
    latitude, longitude = SiteNorth(FEET).to_geographic(POLES)
    truth = pd.DataFrame({"lat": latitude, "lon": longitude})
    far = pd.DataFrame({"lat": [latitude[0] + 0.01], "lon": [longitude[0]]})
    pd.concat([truth, far]).to_csv(folder / "truth.csv", index=False)
    return folder


def run_triangulation(site, *shards, **more):
    ends = {"poles": "parquet", "layers": "gpkg", "csv": "csv", "geojson": "geojson"}
    tag = more.get("tag", "")
    out = {name: str(site / f"{name}{tag}.{end}") for name, end in ends.items()}
    arguments = ["--sightings", *(str(site / s) for s in shards), f"--frame={site / 'frame.json'}"]
    arguments += [f"--{name}={path}" for name, path in out.items()]
    arguments += [
        "--dem", str(site / "dem.tif"), "--sigma-position-m", "0.3", "--min-views", "2",
        "--pole-evidence=-0.5", *more.get("also", []),
    ]  # fmt: skip
    return triangulate_poles.main(arguments), out


def on_road(site):
    """Options that name the frame, the images and the edges."""
    ends = {"frame": "json", "frames": "parquet", "edges": "parquet"}
    return [f"--{name}={site / name}.{end}" for name, end in ends.items()]


@pytest.fixture(scope="module")
def with_objects(site):
    """The same with trees and rails of the cloud, some far away, and what images say of them."""
    trees = [(30.0, 12.0, 0), (70.0, 9.0, 1), (50.0, -30.0, 2)]
    rows = [("tree", n, x, y, -0.1 * abs(y), 9.0, 4.0, 0.8) for x, y, n in trees]
    rails = [(0, 5.5, -10.0, 130.0), (1, 90.0, 0.0, 20.0)]
    for number, y, start, end in rails:
        way = np.arange(start, end + 0.5)
        rows += [("guardrail", number, x, y, -0.1 * abs(y), *[np.nan] * 3) for x in way]
    names = ["kind", "object", "x", "y", "z_ground", "top_m", "width_m", "sigma_m"]
    objects = pd.DataFrame(rows, columns=names)
    shown = {"trunk_x": 31.5, "trunk_y": 12.5, "trunk_sigma_m": 0.2, "cloud_shows": "trunk"}
    objects = objects.assign(**dict.fromkeys(shown, np.nan))
    objects["cloud_shows"] = ""
    objects.loc[1:2, "cloud_shows"] = "crown"
    objects.loc[0, list(shown)] = pd.Series(shown)
    write_table(site / "objects.parquet", objects)
    said = [
        ("tree", 0, "i002.jpg", 1),
        ("tree", 0, "i001.jpg", 1),
        ("tree", 1, "i001.jpg", -1),
        ("guardrail", 0, "i001.jpg", 0),
    ]
    seen = pd.DataFrame(said, columns=["kind", "object", "image", "answer"]).assign(route="r")
    write_table(site / "seen0.parquet", seen.iloc[::2])
    write_table(site / "seen1.parquet", seen.iloc[1::2])
    also = ["--objects", str(site / "objects.parquet"), "--seen"]
    also += [str(site / f"seen{shard}.parquet") for shard in (0, 1)]
    code, out = run_triangulation(site, "s0.parquet", "s1.parquet", tag="_objects", also=also)
    assert code == 0
    return out


@pytest.fixture(scope="module")
def poles(site):
    code, out = run_triangulation(site, "s0.parquet", "s1.parquet")
    assert code == 0
    return out


def test_poles_are_where_they_are(site, poles):
    table = read_table(poles["poles"])
    gaps = np.hypot(*(table[["x", "y"]].to_numpy()[:, None] - POLES).transpose(2, 0, 1))
    assert len(table) == len(POLES)
    assert gaps.min(axis=0).max() < 1.0
    assert table["z"].to_numpy() == pytest.approx(-0.1 * np.abs(table["y"]), abs=0.05)
    lat, _ = SiteNorth(FEET).to_geographic(table[["x", "y"]].to_numpy())
    assert table["latitude"].to_numpy() == pytest.approx(lat)
    assert read_about(poles["poles"])["method"] == "packing"
    layers = dict(pyogrio.list_layers(poles["layers"]))
    assert layers == {
        "poles": "Point Z",
        "ellipses": "Polygon",
        "rays": "LineString",
        "guardrails": "LineString",
    }
    assert len(pyogrio.read_dataframe(poles["layers"], layer="rays")) == table["score"].sum()
    features = json.loads(Path(poles["geojson"]).read_text())["features"]
    assert features[0]["geometry"]["coordinates"][1] == pytest.approx(lat[0], abs=1e-8)
    assert len(pd.read_csv(poles["csv"])) == len(POLES)


def test_shards_in_any_order_give_the_same_poles(site, poles):
    _, again = run_triangulation(site, "s1.parquet", "s0.parquet", tag="_again")
    pd.testing.assert_frame_equal(
        read_table(again["poles"]), read_table(poles["poles"]), check_exact=True
    )


def test_the_published_sweep_places_poles_and_states_no_errors(site):
    also = ["--method", "sweep"]
    code, out = run_triangulation(site, "s0.parquet", "s1.parquet", tag="_sweep", also=also)
    assert code == 0
    table, about = read_table(out["poles"]), read_about(out["poles"])
    gaps = np.hypot(*(table[["x", "y"]].to_numpy()[:, None] - POLES).transpose(2, 0, 1))
    assert gaps.min(axis=0).max() < 1.5
    assert table["kept"].all()
    assert table["sigma_major_m"].isna().all()
    assert about["method"] == "sweep"
    assert about["network_scales"] == []
    assert about["settings"]["sweep_distance_m"] == 25.0
    assert len(pyogrio.read_dataframe(out["layers"], layer="ellipses")) == 0
    assert len(pyogrio.read_dataframe(out["layers"], layer="poles")) == len(table)
    assert len(pd.read_csv(out["csv"])) == len(table)


def test_no_sightings_are_empty_tables_and_a_warning(site, caplog):
    code, out = run_triangulation(site, "none.parquet", tag="_none")
    assert code == 0
    assert "fewer than two sightings" in caplog.text
    assert len(read_table(out["poles"])) == 0
    assert list(read_table(out["poles"]).columns)[:4] == ["id", "kind", "x", "y"]
    assert len(pd.read_csv(out["csv"])) == 0


def test_poles_near_road_voxels_are_withheld(site):
    voxels = pd.DataFrame({"ix": [20, 42], "iy": [7, -8], "iz": 0, "cls": [11, 5]})
    about = {"cell_size_m": 1.0, "anchor": [0.0, 0.0, 0.0]}
    write_table(site / "voxels.parquet", voxels, about)
    also = ["--voxels", str(site / "voxels.parquet")]
    _, out = run_triangulation(site, "s0.parquet", "s1.parquet", tag="_road", also=also)
    table = read_table(out["poles"])
    assert (~table["kept"]).sum() == 1
    assert "road" in table["reason"][~table["kept"]].iloc[0]
    assert len(pd.read_csv(out["csv"])) == len(POLES) - 1


def test_hazard(site, poles):
    common = [*on_road(site), "--poles", poles["poles"]]
    out, csv = site / "hazard.parquet", site / "hazard.csv"
    dem = ["--dem", str(site / "dem.tif"), "--out", str(out), "--csv", str(csv)]
    assert rate_hazard.main([*common, *dem]) == 0
    table = read_table(out)
    assert table["offset_m"].to_numpy() == pytest.approx(np.abs(table["y"]) - 4, abs=0.1)
    assert table["slope_rise_over_run"].to_numpy() == pytest.approx(-0.1, abs=0.02)
    assert table["side"].to_numpy().tolist() == (-np.sign(table["y"])).tolist()
    assert "AASHTO" in read_about(out)["clear_zone"]
    written = pd.read_csv(csv)
    assert {"latitude", "longitude"} <= set(written)
    native = FEET.to_native(table[["x", "y"]].to_numpy())
    assert written[["x", "y"]].to_numpy() == pytest.approx(native, abs=1e-4)
    assert (written[["crs", "unit"]] == [FEET_CRS, "us-survey-foot"]).all(axis=None)
    assert not {"vertical", "vertical_unit"} & set(written)
    assert rate_hazard.main([*common, *dem, "--aadt", "-1"]) == 2
    assert (written["clear_zone_greatest_m"] - written["clear_zone_least_m"] > 3).all()


def test_speed_and_traffic_of_the_site_hold_where_it_states_them(site, poles, tmp_path, caplog):
    out = {name: tmp_path / f"{name}.{end}" for name, end in OUTPUTS.items()}
    arguments = [*on_road(site), "--poles", poles["poles"], *(f"--{k}={v}" for k, v in out.items())]
    # As rules write what is not stated.
    assert rate_hazard.main([*arguments, "--design-speed-kmh=", "--aadt="]) == 0
    (told,) = read_json(out["doubts"])
    assert (told["code"], told["severity"]) == ("traffic_not_stated", "doubt")
    assert told["message"] in caplog.text
    geometry = pd.read_csv(out["geometry-csv"])
    assert (geometry[["speed_least_kmh", "speed_greatest_kmh"]] == [60, 110]).all(axis=None)
    assert rate_hazard.main([*arguments, "--design-speed-kmh=90", "--aadt=2000"]) == 0
    (told,) = read_json(out["doubts"])
    assert (told["code"], told["severity"]) == ("traffic_by_settings", "note")
    table = pd.read_csv(out["csv"])
    assert table["clear_zone_least_m"].tolist() == table["clear_zone_greatest_m"].tolist()
    assert (table[["aadt_least", "aadt_greatest"]] == 2000).all(axis=None)
    geometry = pd.read_csv(out["geometry-csv"])
    assert (geometry[["speed_least_kmh", "speed_greatest_kmh"]] == 90).all(axis=None)


def test_layers_of_the_roadside_say_the_same_as_their_fields(site, poles, tmp_path):
    out = {name: tmp_path / f"{name}.{end}" for name, end in OUTPUTS.items()}
    arguments = [*on_road(site), "--poles", poles["poles"], "--dem", str(site / "dem.tif")]
    arguments += ["--placed", poles["layers"], *(f"--{k}={v}" for k, v in out.items())]
    assert rate_hazard.main(arguments) == 0
    layers = dict(pyogrio.list_layers(out["layers"]))
    assert layers == {
        "poles": "Point Z", "ellipses": "Polygon", "rays": "LineString", "guardrails": "LineString",
        "hazard": "Point Z", "cross_sections": "LineString Z", "road_geometry": "LineString Z",
    }  # fmt: skip
    for layer in layers:
        features = pyogrio.read_dataframe(out["layers"], layer=layer)
        assert features.crs.equals(CRS("EPSG:6543"))
        fields = [name for name in features if name.endswith(("_x", "_y", "_z"))]
        assert not {"x", "y", "z"} & set(features)
        assert bool(fields) == (layer == "cross_sections")
    sections = pyogrio.read_dataframe(out["layers"], layer="cross_sections")
    ends = shapely.get_coordinates(sections.geometry.to_numpy()).reshape(-1, 4)
    fields = sections[["start_x", "start_y", "end_x", "end_y"]].to_numpy()
    assert fields == pytest.approx(ends, abs=1e-6)
    back = read_layer(out["layers"], "cross_sections", FEET)
    width = np.hypot(back["end_x"] - back["start_x"], back["end_y"] - back["start_y"])
    assert width.to_numpy() == pytest.approx(back["width_m"].to_numpy(), abs=1e-3)
    assert set(back["object"]) > {"", "pole-00000"}
    geometry = pd.read_csv(out["geometry-csv"])
    lines = pyogrio.read_dataframe(out["layers"], layer="road_geometry")
    middles = shapely.get_coordinates(shapely.centroid(lines.geometry.to_numpy()))
    inner = slice(1, -1)
    assert geometry[["x", "y"]].to_numpy()[inner] == pytest.approx(middles[inner], abs=0.5)
    assert geometry["paved_width_m"].to_numpy() == pytest.approx(8.0, abs=0.1)
    counted = {"crs": FEET_CRS, "vertical": "as in the cloud"}
    counted |= {"unit": "us-survey-foot", "vertical_unit": "us-survey-foot"}
    assert geometry[list(counted)].drop_duplicates().to_dict("records") == [counted]
    assert lines["station_m"].tolist() == geometry["station_m"].tolist()
    table = pd.read_csv(out["csv"])
    objects = pyogrio.read_dataframe(out["layers"], layer="hazard")
    assert table[["x", "y"]].to_numpy() == pytest.approx(
        objects.geometry.get_coordinates().to_numpy(), abs=1e-3
    )
    assert objects["rating"].tolist() == table["rating"].tolist()
    profiles = read_about(out["sections"])["profiles"]
    assert set(profiles) == set(table["id"])


def markings(folder, *lines):
    """Points of solid lines at offsets (m), as two shards; the last is empty."""
    x = np.arange(-5, 140, 0.5)
    rows = [pd.DataFrame({"x": x, "y": y, "image": (x // 5).astype(str)}) for y in lines]
    table = pd.concat(rows, ignore_index=True)
    for number, part in enumerate((table, table[:0])):
        write_table(folder / f"m{number}.parquet", part)
    return ["--markings", *(str(folder / f"m{n}.parquet") for n in (0, 1))]


def test_markings_come_before_the_inventory_s_lanes(site, poles, tmp_path):
    out = {name: tmp_path / f"{name}.{end}" for name, end in OUTPUTS.items()}
    arguments = [*on_road(site), "--poles", poles["poles"], *(f"--{k}={v}" for k, v in out.items())]
    inventory = tmp_path / "i.csv"
    inventory.write_text("route,from_m,to_m,speed_kmh,aadt,lanes,lane_width_m\nr,0,200,90,9,2,3\n")
    arguments += ["--inventory", str(inventory)]
    one_side = markings(tmp_path, -3.2)
    assert rate_hazard.main([*arguments, *one_side]) == 0
    table = pd.read_csv(out["csv"])
    sides = np.where(table["side"] > 0, "markings", "inventory")
    assert table["travelled_way_from"].tolist() == sides.tolist()
    assert len(set(sides)) == 2
    # The travelled way is 0.3 m nearer to the left edge of the pavement.
    painted = markings(tmp_path, -3.2, -0.1, 0.1, 3.5)
    for more, half_m, source in (([], (3.0, 3.0), "inventory"), (painted, (3.5, 3.2), "markings")):
        assert rate_hazard.main([*arguments, *more]) == 0
        geometry = pd.read_csv(out["geometry-csv"]).iloc[3:-3]
        assert (geometry[["lanes_from", "travelled_from"]] == source).all(axis=None)
        assert (geometry["lanes"] == 2).all()
        assert geometry["lane_width_m"].to_numpy() == pytest.approx(sum(half_m) / 2, abs=0.05)
        for side, edge in zip(("left", "right"), half_m, strict=True):
            assert geometry[f"travelled_{side}_m"].to_numpy() == pytest.approx(edge, abs=0.05)
        shoulder = 4 - sum(half_m) / 2
        assert geometry["paved_shoulder_m"].to_numpy() == pytest.approx(shoulder, abs=0.1)
        table = pd.read_csv(out["csv"])
        assert (table[["travelled_way_from", "lanes_from"]] == source).all(axis=None)
        edge = np.where(table["side"] < 0, *half_m)
        known = table["offset_m"] + 4 - edge
        assert table["offset_travelled_way_m"].to_numpy() == pytest.approx(known, abs=0.15)
        assert table["sigma_travelled_way_m"].notna().all() == (source == "markings")


def given_roads(folder):
    """An inventory that lacks traffic beyond 60 m, a route in other coordinates, a rail."""
    (folder / "inventory.csv").write_text(
        "route,from_m,to_m,speed_kmh,aadt,lanes,lane_width_m\n"
        "SR 7,1000,1060,100,8000,2,3.5\nSR 7,1060,1200,100,,2,\n"
    )
    x = np.array([-20.0, 160.0])
    # Measured against the drive.
    line = shapely.LineString(FEET.to_native(np.column_stack([x[::-1], [0.5, 0.5]])))
    route = {"route": ["SR 7"], "from_m": [990.0], "to_m": [1170.0]}
    frame = gpd.GeoDataFrame(route, geometry=[line], crs="EPSG:6543").to_crs("EPSG:32617")
    frame.to_file(folder / "routes.gpkg")
    rail = shapely.LineString(FEET.to_native(np.array([[0.0, 5.5], [130.0, 5.5]])))
    barrier = gpd.GeoDataFrame({"name": ["rail"]}, geometry=[rail], crs="EPSG:6543")
    barrier.to_file(folder / "barriers.gpkg")
    files = (("inventory", "csv"), ("routes", "gpkg"), ("barriers", "gpkg"))
    return [f"--{name}={folder / name}.{end}" for name, end in files]


def test_inventory_routes_and_barriers_reach_the_hazard(site, poles, tmp_path, caplog):
    out = {name: tmp_path / f"{name}.{end}" for name, end in OUTPUTS.items()}
    arguments = [*on_road(site), "--poles", poles["poles"], "--dem", str(site / "dem.tif")]
    arguments += [*given_roads(tmp_path), *(f"--{k}={v}" for k, v in out.items())]
    assert rate_hazard.main([*arguments, "--measure-unit", "mi"]) == 0
    told = {doubt["code"]: doubt for doubt in read_json(out["doubts"])}
    assert set(told) == {"inventory_without_aadt"}
    assert all(doubt["message"] in caplog.text for doubt in told.values())
    table = pd.read_csv(out["csv"]).set_index("id")
    own = table[table["kind"] == "pole"]
    x = FEET.to_local(own[["x", "y"]].to_numpy())[:, 0]
    assert own["station_m"].to_numpy() == pytest.approx(1150 - x, abs=0.1)
    assert own["measure_mi"].to_numpy() == pytest.approx(own["station_m"] / 1609.344, abs=1e-5)
    assert (own["route"] == "SR 7").all()
    assert own["side"].tolist() == np.sign(FEET.to_local(own[["x", "y"]].to_numpy())[:, 1]).tolist()
    known = own["station_m"] <= 1060
    assert (own.loc[known, "aadt_least"] == own.loc[known, "aadt_greatest"]).all()
    assert (own.loc[~known, "aadt_greatest"] > own.loc[~known, "aadt_least"]).all()
    travelled = own["offset_travelled_way_m"]
    assert travelled[known].to_numpy() == pytest.approx(own.loc[known, "offset_m"] + 0.5, abs=0.1)
    assert travelled[~known].isna().all()
    # Of one rating, those of unknown exposure come last.
    for _, group in own.groupby("rating"):
        ranks = group["rank"]
        sure = group["aadt_least"] == group["aadt_greatest"]
        assert not sure.any() or sure.all() or ranks[sure].max() < ranks[~sure].min()
    beyond = FEET.to_local(own[["x", "y"]].to_numpy())[:, 1] > 5.5
    assert set(own.loc[beyond, "shielded"]) <= {"partial", "full"}
    assert (own.loc[~beyond, "shielded"] == "none").all()
    assert own.loc[beyond, "reasons"].str.contains("behind barrier rail").all()
    ends = table[table["kind"] == "barrier end"]
    assert ends.index.tolist() == ["rail start", "rail end"]
    assert (ends["shielded"] == "none").all()
    assert ends["latitude"].notna().all()
    geometry = pd.read_csv(out["geometry-csv"])
    stated = geometry["station_m"] < 1060
    assert geometry.loc[~stated, "lane_width_m"].median() == pytest.approx(4.0, abs=0.1)
    assert geometry.loc[stated, "paved_shoulder_m"].median() == pytest.approx(0.5, abs=0.1)
    assert "measures_from_first_image" not in told
    without = [argument for argument in arguments if not argument.startswith("--routes")]
    assert rate_hazard.main(without) == 0
    told = {doubt["code"]: doubt for doubt in read_json(out["doubts"])}
    assert set(told) == {"measures_from_first_image", "road_unnamed"}
    assert "does not name road r (it names SR 7)" in told["road_unnamed"]["message"]
    assert told["road_unnamed"]["measured"] == pytest.approx(np.ptp(geometry["station_m"]), abs=10)
    unnamed = pd.read_csv(out["csv"])
    assert (unnamed["clear_zone_greatest_m"] > unnamed["clear_zone_least_m"]).all()
    overlap = tmp_path / "inventory.csv"
    overlap.write_text("route,from_m,to_m\nSR 7,1000,1100\nSR 7,1050,1200\n")
    assert rate_hazard.main(arguments) == 2


def test_objects_of_the_cloud_go_with_the_poles(with_objects):
    table = read_table(with_objects["poles"])
    trees = table[table["kind"] == "tree"].set_index("id")
    assert (table["kind"] == "pole").sum() == len(POLES)
    assert trees[["x", "y", "score", "kept"]].to_numpy().tolist() == [
        [31.5, 12.5, 2, True],
        [70.0, 9.0, 0, False],
    ]
    assert trees["cloud_shows"].tolist() == ["trunk", "crown"]
    assert trees["sigma_major_m"].tolist() == [0.2, 0.8]
    assert trees.loc["tree-00000", "images"] == "i001.jpg;i002.jpg"
    assert trees["z"].to_numpy() == pytest.approx([-1.2, -0.9], abs=0.1)
    assert "something else" in trees["reason"].iloc[1]
    assert trees["probability"].notna().tolist() == [True, False]
    assert trees.loc["tree-00001", "probability_from"].startswith("none: no image shows it")
    rails = read_layer(with_objects["layers"], "guardrails", FEET)
    assert rails["probability"].isna().all()
    assert rails["probability_from"].str.startswith("none: ").all()
    assert rails["id"].tolist() == ["guardrail-00000"]  # no image looks at the other one
    assert rails.geometry.length.to_numpy() == pytest.approx(140.0, rel=1e-4)
    layer = read_layer(with_objects["layers"], "poles", FEET).set_index("id")
    assert layer.loc["tree-00000", "cloud_shows"] == "trunk"
    written = pd.read_csv(with_objects["csv"])
    assert written.loc[written["kind"] == "tree", "cloud_shows"].tolist() == ["trunk"]
    assert written["kind"].value_counts().to_dict() == {"pole": len(POLES), "tree": 1}


@pytest.mark.parametrize("given", [False, True])
def test_a_guardrail_that_was_found_shields_and_its_ends_are_objects(
    site, with_objects, tmp_path, given
):
    """One that the user gives too counts once."""
    common = [*on_road(site), "--dem", str(site / "dem.tif"), "--poles", with_objects["poles"]]
    common += [f"--out={tmp_path / 'h.parquet'}", f"--csv={tmp_path / 'h.csv'}"]
    if given:
        given_roads(tmp_path)
        common += ["--barriers", str(tmp_path / "barriers.gpkg")]
    assert rate_hazard.main([*common, "--placed", with_objects["layers"]]) == 0
    table = read_table(tmp_path / "h.parquet")
    ends = table[table["kind"] == "barrier end"]
    name = "rail" if given else "guardrail-00000"
    assert ends["id"].tolist() == [f"{name} start", f"{name} end"]
    behind = table[(table["kind"] != "barrier end") & (table["y"] > 5.5)]
    assert set(behind["kind"]) == {"pole", "tree"}
    assert behind["shielded"].isin(["partial", "full"]).all()
    assert behind["reasons"].str.contains(f"behind barrier {name}").all()
    assert (table.loc[table["y"] < 0, "shielded"] == "none").all()


def test_buildings_are_left_out_with_a_warning_where_no_image_has_a_place(site, tmp_path, caplog):
    """By the only image that has one they are placed."""
    corners = [(30.0, 12.0), (38.0, 12.0), (38.0, 20.0), (30.0, 20.0)]
    rows = [("building", 0, x, y, -1.0, 6.0, 8.0, 0.3) for x, y in corners]
    names = ["kind", "object", "x", "y", "z_ground", "top_m", "width_m", "sigma_m"]
    write_table(tmp_path / "objects.parquet", pd.DataFrame(rows, columns=names))
    seen = {"kind": ["building"], "object": 0, "image": "i", "answer": 1, "route": "r"}
    write_table(tmp_path / "seen.parquet", pd.DataFrame(seen))
    also = [f"--objects={tmp_path / 'objects.parquet'}", f"--seen={tmp_path / 'seen.parquet'}"]
    for y, left_out in ((0.0, False), (np.nan, True)):
        frames = pd.DataFrame({"route": ["r"], "sequence": 0, "x": 30.0, "y": y})
        write_table(tmp_path / "frames.parquet", frames)
        more = [*also, f"--frames={tmp_path / 'frames.parquet'}"]
        code, out = run_triangulation(site, "none.parquet", tag="_lone", also=more)
        assert code == 0
        assert (read_table(out["poles"])["kind"] == "building").sum() == (not left_out)
        assert ("1 buildings and headwalls are left out" in caplog.text) == left_out


def test_buildings_along_a_route_of_one_image_are_scored():
    camera = np.zeros((1, 2))
    frames = pd.DataFrame({"route": ["r"], "sequence": 0, "x": 0.0, "y": 0.0})
    near = validate_poles._Near(camera, 25.0, np.empty((0, 2)), RouteTracks(frames))
    place = near.nearest([shapely.box(10.0, -5.0, 20.0, 5.0), shapely.box(90.0, -5.0, 99.0, 5.0)])
    assert place == pytest.approx(np.array([[10.0, 0.0], [90.0, 0.0]]), abs=0.2)
    assert near.road(place).tolist() == [True, False]


def test_signs_trees_and_guardrails_are_scored_apart_from_poles(site, with_objects, tmp_path):
    known = {
        "trees": [shapely.Point(31.0, 13.0), shapely.Point(100.0, 10.0), shapely.Point(60.0, 20.0)],
        "guardrails": [shapely.LineString([(0.0, 5.8), (160.0, 5.8)])],
        "buildings": [shapely.box(20.0, -40.0, 32.0, -24.0)],
    }
    layers = {name: gpd.GeoDataFrame(geometry=own) for name, own in known.items()}
    write_layers(tmp_path / "roadside.gpkg", layers, FEET)
    arguments = [
        *on_road(site), "--poles", with_objects["poles"], "--placed", with_objects["layers"],
    ]  # fmt: skip
    arguments += ["--truth", str(site / "truth.csv"), "--out", str(tmp_path / "v.json")]
    arguments += ["--roadside", str(tmp_path / "roadside.gpkg")]
    assert validate_poles.main([*arguments, "--kinds", "pole", "tree", "guardrail"]) == 0
    found = read_json(tmp_path / "v.json")
    assert set(found["kinds"]) == {"tree", "guardrail"}
    assert found["poles"] == len(POLES) and found["thresholds"][0]["f1"] == 1.0
    # The third tree is 16 m from the edge, and counts neither way.
    assert [found["kinds"]["tree"][name] for name in ("tp", "fp", "fn")] == [1, 0, 1]
    # Cameras reach to 152 m.
    rail = found["kinds"]["guardrail"]
    assert [rail[n] for n in ("tp", "fp", "fn")] == pytest.approx([131.0, 9.0, 21.3], abs=0.1)


@pytest.mark.parametrize(("kind", "found"), [("", 5), ("pole", 5), ("sign", 1)])
def test_known_things_are_compared_with_what_is_of_their_kind(site, poles, tmp_path, kind, found):
    """A known sign is no missed pole; where signs are what is known, signs are compared."""
    known = pd.read_csv(site / "truth.csv").assign(kind=["pole"] * 5 + ["sign", "pole"])
    known.to_csv(tmp_path / "truth.csv", index=False)
    table = read_table(poles["poles"])
    sign = np.hypot(*(table[["x", "y"]].to_numpy() - POLES[5]).T).argmin()
    table.loc[sign, "kind"] = "sign"
    write_table(tmp_path / "poles.parquet", table)
    arguments = [
        *on_road(site), "--poles", str(tmp_path / "poles.parquet"), "--kinds", "pole", "sign",
    ]  # fmt: skip
    arguments += ["--truth", str(tmp_path / "truth.csv"), "--truth-kind", kind]
    assert validate_poles.main([*arguments, "--out", str(tmp_path / "v.json")]) == 0
    scores = read_json(tmp_path / "v.json")
    assert [scores["thresholds"][0][name] for name in ("tp", "fp", "fn")] == [found, 0, 0]
    assert scores["kinds"]["sign"]["tp"] == 1


def test_the_published_triangulation_is_scored_like_ours(site, tmp_path):
    """Of poles alone, whatever else was sighted."""
    given = compare_components.Given(
        frames=site / "frames.parquet", image_edges=(), masks=(), depth=(),
        road_edges=site / "edges.parquet", columns=tmp_path, voxels=tmp_path, dem=site / "dem.tif",
        frame=site / "frame.json", truth=str(site / "truth.csv"), settings_json="",
    )  # fmt: skip
    sections = (Calibration, Alignment, Sightings, Triangulation, Validation)
    settings = compare_components.PoleSettings(
        **{section.__name__.lower(): section() for section in sections}
    )
    variant = compare_components._Variant(given, settings, "deterministic_mrf", tmp_path)
    table = pd.concat([read_table(site / f"s{n}.parquet") for n in (0, 1)])
    north, xy = SiteNorth(FEET), table[["x", "y"]].to_numpy()
    table["latitude"], table["longitude"] = north.to_geographic(xy)
    table["bearing_deg"] = table["bearing_grid_deg"] + north.convergence_deg(xy)
    signs = table.assign(kind="sign", depth_m=5.0)
    scores = []
    for rows in (table, pd.concat([table, signs], ignore_index=True)):
        write_table(variant._path("sightings"), rows)
        scores.append(variant._published(1))
    assert scores[0] == scores[1] and scores[0]["poles"] >= 1


def test_variants_share_what_their_component_does_not_change(tmp_path):
    def named(component: str) -> dict[str, str]:
        variant = compare_components._Variant.__new__(compare_components._Variant)
        variant._without, variant._folder = component, tmp_path
        names = ("calibration", "cameras", "sightings", "sightings-0", "poles")
        return {name: variant._path(name).name.partition("-")[0] for name in names}

    assert set(named("all").values()) == {"all"}
    for component in ("deterministic_mrf", "grouping_by_evidence"):
        assert [n for n, of in named(component).items() if of == component] == ["poles"]
    assert named("lidar_bearing")["cameras"] == "all"
    assert named("lidar_bearing")["sightings-0"] == "lidar_bearing"
    assert named("alignment")["calibration"] == "all" != named("alignment")["cameras"]
    assert set(named("side_views").values()) == {"side_views"}


def test_validation(site, poles):
    common = [*on_road(site), "--poles", poles["poles"]]
    result = site / "validation.json"
    truth = ["--truth", str(site / "truth.csv"), "--out", str(result), "--kinds", "pole"]
    assert validate_poles.main([*common, *truth]) == 0
    found = json.loads(result.read_text())
    assert found["kinds"] == {}
    assert found["truth"] == {"within_reach": 6, "out_of_reach": 1, "reach_m": 25.0}
    assert found["thresholds"][0]["f1"] == 1.0
    assert len(found["thresholds"]) == 16
    assert found["mean_m"] < 0.6
    row = found["errors"][0]
    assert np.hypot(row["across_m"], row["along_m"]) == pytest.approx(row["geodesic_m"], rel=1e-3)
    assert row["scenarios"] == ["straight road"]
    assert found["scenarios"]["extraneous"] is None
    assert len(found["warnings"]) == 1


@pytest.mark.parametrize(("cell_m", "known"), [(0.5, 1), (1.5, None)])
def test_voxels_too_wide_to_tell_a_driveway_leave_it_unknown(
    site, poles, tmp_path, caplog, cell_m, known
):
    """Not as if there were none: a driveway of 3 m beside the third pole."""
    x, y = np.meshgrid(np.arange(0, 130, cell_m), np.arange(-4, 30, cell_m))
    paved = (y < 4) | ((x >= 54) & (x < 57))
    index = {"ix": (x[paved] / cell_m).astype(int), "iy": np.round(y[paved] / cell_m).astype(int)}
    about = {"cell_size_m": cell_m, "anchor": [0.0, 0.0, 0.0]}
    write_table(tmp_path / "voxels.parquet", pd.DataFrame(index).assign(cls=11), about)
    arguments = [
        *on_road(site), "--poles", poles["poles"], "--voxels", str(tmp_path / "voxels.parquet"),
    ]  # fmt: skip
    arguments += ["--truth", str(site / "truth.csv"), "--kinds", "pole"]
    assert validate_poles.main([*arguments, "--out", str(tmp_path / "v.json")]) == 0
    extraneous = read_json(tmp_path / "v.json")["scenarios"]["extraneous"]
    assert (extraneous is None) == (known is None)
    assert ("do not tell driveways" in caplog.text) == (known is None)


def test_known_poles_in_native_coordinates(site, tmp_path):
    native = FEET.to_native(POLES)
    pd.DataFrame(native, columns=["X", " y"]).to_csv(tmp_path / "t.csv", index=False)
    points = read_points(tmp_path / "t.csv", FEET)
    assert points[["x", "y"]].to_numpy() == pytest.approx(POLES, abs=1e-6)
    assert points["id"].iloc[0] == "t1"
    (tmp_path / "bad.csv").write_text("lat,lon\n35.5,abc\n")
    with pytest.raises(InputError, match="line 2"):
        read_points(tmp_path / "bad.csv", FEET)
    (tmp_path / "other.csv").write_text("a,b\n1,2\n")
    with pytest.raises(InputError, match="lacks columns"):
        read_points(tmp_path / "other.csv", FEET)


def run_verb(*words):
    parser = argparse.ArgumentParser()
    verb.VERB.add_to(parser.add_subparsers())
    arguments = parser.parse_args(["triangulate", *map(str, words)])
    arguments.run(arguments)


SIGHTINGS = """lat,lon,bearing,depth
51.5,-0.1,45,12
51.5001,-0.1,90,8
51.5,-0.09984,0,
"""


@pytest.mark.parametrize("flags", [[], ["--published", "--seed", "3"], ["--depths-as-given"]])
def test_verb_writes_poles(tmp_path, flags):
    (tmp_path / "s.csv").write_text(SIGHTINGS)
    run_verb(tmp_path / "s.csv", *flags, "-o", tmp_path / "p.csv")
    table = pd.read_csv(tmp_path / "p.csv")
    assert list(table.columns) == ["lat", "lon", "score", "sigma_m"]
    assert len(table) == 1
    assert table["lat"].iloc[0] == pytest.approx(51.5001, abs=5e-5)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("lat,lon,bearing,depth\n51.5,-0.1,45,14\n", "fewer than two sightings"),
        ("lat,lon,bearing,depth\n", "fewer than two sightings"),
        ("lat,lon,depth\n1,2,3\n", "lacks the column bearing"),
        ("lat,lon,bearing\n51,0,1\n95,0,1\n", "line 3.*-90 to 90"),
        ("lat,lon,bearing\n51,0,1\n51,0,x\n", "line 3"),
        ("lat,lon,bearing,depth\n51,0,1,2\n51,0,1,inf\n", "line 3"),
    ],
)
def test_verb_refuses_bad_tables(tmp_path, text, message):
    (tmp_path / "s.csv").write_text(text)
    with pytest.raises(InputError, match=message):
        run_verb(tmp_path / "s.csv", "-o", tmp_path / "p.csv")
    assert not (tmp_path / "p.csv").exists()


def test_verb_refuses_bad_values(tmp_path):
    (tmp_path / "s.csv").write_text(SIGHTINGS)
    with pytest.raises(InputError, match="--max-distance-m"):
        run_verb(tmp_path / "s.csv", "--max-distance-m", "0", "-o", tmp_path / "p.csv")
    with pytest.raises(InputError, match="cannot be read"):
        run_verb(tmp_path / "none.csv", "-o", tmp_path / "p.csv")


def test_errors_along_and_across_the_way_go_with_the_vehicle():
    """East at 90 degrees from north, to the right; nothing where a camera states none."""
    cameras = pd.DataFrame(
        {"x": 0.0, "y": 0.0, "z": 0.0, "heading_deg": [90.0, 180.0, 45.0]}, index=["a", "b", "c"]
    ).assign(sigma_along_m=[0.5, 0.3, np.nan], sigma_lateral_m=[0.1, 0.2, np.nan])
    frames = pd.DataFrame({"image": ["a", "b", "c"], "route": "r", "sequence": [1, 2, 3]})
    empty = dict.fromkeys(measure_poles._COLUMNS, 0.0)
    ways = ["drift_east_m", "drift_north_m", "aside_east_m", "aside_north_m"]
    for name in ("x", "y", "z", "route", "sequence", *ways):
        del empty[name]
    sightings = pd.DataFrame([empty | {"image": name} for name in "abc"])
    found = measure_poles._finished(sightings, frames, cameras, Frame((0.0, 0.0, 0.0)), False)
    expected = np.array([[0.5, 0.0, 0.0, -0.1], [0.0, -0.3, -0.2, 0.0], [0.0, 0.0, 0.0, 0.0]])
    assert found[ways].to_numpy() == pytest.approx(expected, abs=1e-12)
