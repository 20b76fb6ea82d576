"""Routes, an inventory and barriers of a user through the whole pole job."""

import json

import geopandas as gpd
import numpy as np
import pandas as pd
import pytest
import shapely
from pyproj import Transformer

from roadsight.geometry.frames import Frame
from roadsight.io.records.tables import read_table
from roadsight.poles.risk.roads import RouteTracks, roads_of
from tests.workflow.conftest import Checkout

ROADS = """\
roads:
  inventory: given/inventory.csv
  routes: given/ride.gpx
  barriers: given/rails.shp
  measure_unit: mi
  carriageway: divided
"""
RAIL_M = 1.0
"""From the road's edge."""


def give_roads(checkout: Checkout) -> None:
    """Files as a user has them, of the road that the first run found; named in the site file."""
    results = checkout.folder / "results/tiny_road"
    frame = Frame.from_dict(json.loads((results / "scene/frame.json").read_text()))
    tracks = RouteTracks(read_table(results / "poles/frames.parquet"))
    edges = read_table(results / "poles/road_edges.parquet", ["x", "y"]).to_numpy()
    (road,) = roads_of(tracks, edges).roads
    folder = checkout.folder / "config/sites/given"
    folder.mkdir()
    # The ride starts 30 m before the drives, runs against them, and is 2 m off the middle.
    stations = np.arange(road.end_m + 30, road.start_m - 30, -5.0)
    native = frame.to_native(road.place(stations, 2.0))
    degrees = Transformer.from_crs(frame.crs_wkt, "EPSG:4326", always_xy=True)
    points = "".join(
        f'<trkpt lat="{y:.9f}" lon="{x:.9f}"/>'
        for x, y in zip(*degrees.transform(*native.T), strict=True)
    )
    (folder / "ride.gpx").write_text(
        '<gpx version="1.1" creator="t" xmlns="http://www.topografix.com/GPX/1/1">'
        f"<trk><name>SR-1427</name><trkseg>{points}</trkseg></trk></gpx>"
    )
    (folder / "inventory.csv").write_text(
        "route,from_mi,to_mi,speed_mph,aadt,lanes,lane_width_ft,carriageway\n"
        "SR 1427,0,0.09,50,3000,2,11,two-way\nSR 1427,0.09,0.5,50,,2,11,\n"
    )
    along = np.arange(road.start_m, road.end_m, 2.0)
    rails = [
        shapely.LineString(
            frame.to_native(road.place(along, side * (half + RAIL_M))[np.isfinite(half)])
        )
        for side in (-1, 1)
        for half in [road.bridged_edge_m(along, np.full(len(along), side))]
    ]
    layer = gpd.GeoDataFrame({"name": ["left", "right"]}, geometry=rails, crs=frame.crs_wkt)
    layer.to_file(folder / "rails.shp")
    site = checkout.folder / "config/sites/tiny_road.yaml"
    site.write_text(site.read_text() + ROADS)


def test_routes_inventory_and_barriers_go_through_the_whole_run(copy_of_road):
    before = pd.read_csv(copy_of_road.folder / "results/tiny_road/poles/hazard.csv")
    check_offsets(copy_of_road, before)
    give_roads(copy_of_road)
    assert "rate_hazard" in copy_of_road.stale_rules()
    result = copy_of_road.snakemake("--cores", "2")
    assert result.returncode == 0, result.stdout[-3000:] + result.stderr[-5000:]
    poles = copy_of_road.folder / "results/tiny_road/poles"
    table = pd.read_csv(poles / "hazard.csv")
    own = table[table["kind"] != "barrier end"].set_index("id").loc[before["id"]].reset_index()
    assert (own["route"] == "SR-1427").all()
    assert own["offset_m"].to_numpy() == pytest.approx(before["offset_m"].to_numpy(), abs=0.05)
    # The ride went the other way: measures fall where they rose, and sides change places.
    assert own["side"].tolist() == (-before["side"]).tolist()
    total = own["station_m"] + before["station_m"]
    assert np.ptp(total) < 1.0
    assert own["measure_mi"].to_numpy() == pytest.approx(own["station_m"] / 1609.344, abs=1e-5)
    stated = own["station_m"] <= 0.09 * 1609.344
    assert own["design_speed_greatest_kmh"].to_numpy() == pytest.approx(80.47, abs=0.01)
    assert (own.loc[stated, "aadt_least"] == 3000).all()
    assert (own.loc[~stated, "aadt_greatest"] > own.loc[~stated, "aadt_least"]).all()
    assert (own["carriageway"] == np.where(stated, "two-way", "divided")).all()
    railed = table.loc[table["kind"] == "barrier end", "station_m"]
    behind = (own["offset_m"] > RAIL_M + 0.3) & (own["rating"] != "unknown")
    assert (own.loc[behind & (own["station_m"] > railed.max()), "shielded"] == "none").all()
    behind &= own["station_m"].between(railed.min(), railed.max())
    assert behind.sum() >= 5
    assert set(own.loc[behind, "shielded"]) <= {"partial", "full"}
    offsets = own.loc[behind, "barrier_offset_m"].to_numpy()
    assert offsets == pytest.approx(np.full(len(offsets), RAIL_M), abs=0.2)
    ends = table.loc[table["kind"] == "barrier end", "id"].tolist()
    assert sorted(ends) == ["left end", "left start", "right end", "right start"]
    summary = json.loads((poles.parent / "summary.json").read_text())
    given = {name.rsplit("/", 1)[-1] for name in summary["inputs"] if "/given/" in name}
    assert given >= {"ride.gpx", "inventory.csv", "rails.shp", "rails.dbf", "rails.prj"}
    page = (poles / "page.json").read_text()
    assert "SR-1427" in page
    (lacks,) = [told for told in summary["warnings"] if told["code"] == "inventory_without_aadt"]
    assert lacks["measured"] > lacks["limit"]
    cautions = [caution["text"] for caution in json.loads(page)["cautions"]]
    assert any(lacks["message"][1:] in text for text in cautions)
    assert copy_of_road.stale_rules() == set()
    check_what_makes_it_stale(copy_of_road)
    check_one_message(copy_of_road)


def check_offsets(checkout: Checkout, hazard: pd.DataFrame) -> None:
    """Offsets are those of the generated road, in the mouth of a side road too."""
    truth = pd.read_csv(checkout.folder / "results/tiny_road/sample/truth_poles.csv")
    known = truth[["latitude", "longitude"]].to_numpy() * [111_000.0, 90_500.0]
    found = hazard[["latitude", "longitude"]].to_numpy() * [111_000.0, 90_500.0]
    apart = np.hypot(*np.moveaxis(found[:, None] - known[None], 2, 0))
    own = truth.iloc[apart.argmin(axis=1)]
    near = (apart.min(axis=1) < 1.0) & (own["station_m"] > 0).to_numpy()
    error = hazard["offset_m"].to_numpy() - own["edge_distance_m"].to_numpy()
    assert near.sum() >= 4
    assert np.abs(error[near]).max() < 0.25


def check_what_makes_it_stale(checkout: Checkout) -> None:
    """Attributes of a shapefile lie in another file than its geometry."""
    path = checkout.folder / "config/sites/given/rails.shp"
    rails = gpd.read_file(path)
    shape = path.read_bytes()
    rails.assign(name=["left", "rail"]).to_file(path)
    assert path.read_bytes() == shape
    assert "rate_hazard" in checkout.stale_rules()


def check_one_message(checkout: Checkout) -> None:
    """Measures that are in miles but not named so end the run with what to do."""
    folder = checkout.folder / "config/sites/given"
    points = gpd.read_file(folder / "ride.gpx", layer="tracks").geometry.get_coordinates()
    miles = np.linspace(0, 0.19, len(points))
    rows = points.assign(route="SR-1427", measure_m=miles).rename(columns={"x": "lon", "y": "lat"})
    rows.to_csv(folder / "ride.csv", index=False)
    checkout.edit("config/sites/tiny_road.yaml", "given/ride.gpx", "given/ride.csv")
    result = checkout.snakemake("--cores", "2")
    assert result.returncode != 0
    told = result.stdout + result.stderr
    assert "measures of route SR-1427 do not go with the length of its line" in told
    assert "what is read as m were mi" in told
