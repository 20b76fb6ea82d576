"""Every field of every layer of poles, read back on a site in US feet with heights above NAVD88."""

import json
from pathlib import Path

import geopandas as gpd
import numpy as np
import pandas as pd
import pyogrio
import pytest
import shapely
from pyproj import CRS, Transformer

from roadsight.geometry.crs import horizontal
from roadsight.geometry.frames import Frame
from roadsight.geometry.north import SiteNorth
from roadsight.io.raster.rasters import read_raster
from roadsight.io.vector.vectors import read_layer
from roadsight_worlds.rural.rural_ground import LANE_M

US_FOOT = 1200 / 3937
SAME = {"abs": 1e-6, "nan_ok": True}
"""Values that are copied, or computed twice in double precision."""
_FLAT_M = 0.3
"""Heights of the terrain's triangles, against cells of the DEM."""


class Poles:
    """A finished site with poles, and what its layers should say."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder / "poles"
        self.frame = Frame.from_dict(json.loads((folder / "scene/frame.json").read_text()))
        self.dem = read_raster(folder / "scene/dem.tif", self.frame)
        self.poles = pd.read_parquet(self.folder / "poles.parquet").set_index("id")
        self.hazard = pd.read_parquet(self.folder / "hazard.parquet").set_index("id")
        shards = sorted((self.folder / "sightings").glob("*.parquet"))
        self.sightings = pd.concat(map(pd.read_parquet, shards))
        self.edges = read_layer(self.folder / "road_edges.gpkg", "road_edges", self.frame)
        self.north = SiteNorth(self.frame)
        self.scale = float(self.north.scale(self.poles[["x", "y"]].to_numpy()).mean())

    def ground_m(self, xy: np.ndarray) -> np.ndarray:
        return self.dem.sample(xy[:, 0], xy[:, 1])


def same_fields(layer: pd.DataFrame, table: pd.DataFrame, left_out: set[str]) -> set[str]:
    """Compare all columns of a layer with those of the table that it was made from."""
    names = [name for name in layer.columns if name not in {"geometry", *left_out}]
    for name in names:
        found, known = layer[name].to_numpy(), table[name].to_numpy()
        if pd.api.types.is_numeric_dtype(table[name]) and table[name].dtype != bool:
            assert found.astype(float) == pytest.approx(known.astype(float), **SAME), name
        else:
            assert [str(v) for v in found] == [str(v) for v in known], name
    return set(names)


def check_points(site: Poles, local: gpd.GeoDataFrame, native: gpd.GeoDataFrame) -> None:
    """Places of poles, their heights in feet, and their latitude and longitude."""
    known = site.poles.loc[local["id"]]
    xyz = shapely.get_coordinates(local.geometry, include_z=True)
    assert xyz[:, :2] == pytest.approx(known[["x", "y"]].to_numpy(), **SAME)
    ground = site.ground_m(xyz)
    assert xyz[:, 2] == pytest.approx(ground, abs=_FLAT_M)
    feet = shapely.get_coordinates(native.geometry, include_z=True)[:, 2]
    assert (feet - site.frame.origin[2]) * US_FOOT == pytest.approx(xyz[:, 2], abs=1e-6)
    crs = horizontal(CRS.from_user_input(native.crs))
    to_wgs84 = Transformer.from_crs(crs, "EPSG:4326", always_xy=True)
    degrees = np.column_stack(to_wgs84.transform(native.geometry.x, native.geometry.y))
    assert native[["longitude", "latitude"]].to_numpy() == pytest.approx(degrees, abs=1e-9)


def check_poles(site: Poles, local: gpd.GeoDataFrame, native: gpd.GeoDataFrame) -> set[str]:
    """Poles: every field is that of the table, what was withheld has a reason."""
    check_points(site, local, native)
    assert local["id"].tolist() == site.poles.index.tolist()
    z = shapely.get_coordinates(local.geometry, include_z=True)[:, 2]
    assert z == pytest.approx(site.poles["z"].to_numpy(), **SAME)
    assert ((local["reason"].fillna("") == "") == local["kept"].astype(bool)).all()
    images = local["images"].str.split(";").str.len()
    assert images.tolist() == local["score"].tolist()
    return same_fields(local, site.poles.reset_index().fillna({"reason": ""}), {"reason"}) | {
        "reason"
    }


def check_ellipses(site: Poles, local: gpd.GeoDataFrame, native: gpd.GeoDataFrame) -> set[str]:
    """Ellipses: around their poles, as large and turned as the sigmas say."""
    known = site.poles.loc[local["id"]]
    centres = shapely.get_coordinates(shapely.centroid(local.geometry.to_numpy()))
    assert centres == pytest.approx(known[["x", "y"]].to_numpy(), abs=1e-6)
    corners = 32
    share = corners / 2 * np.sin(2 * np.pi / corners)
    area = share * known["sigma_major_m"] * known["sigma_minor_m"]
    assert local.geometry.area.to_numpy() == pytest.approx(area.to_numpy(), rel=1e-6)
    for shape, centre, row in zip(local.geometry, centres, known.itertuples(), strict=True):
        if row.sigma_major_m < 1.1 * row.sigma_minor_m:
            continue
        away = shapely.get_coordinates(shape) - centre
        dx, dy = away[np.hypot(*away.T).argmax()]
        turn = np.degrees(np.arctan2(dx, dy)) - row.sigma_azimuth_deg
        assert abs((turn + 90) % 180 - 90) < 0.1
    assert local["kept"].tolist() == known["kept"].tolist()
    return {"id", "kept"}


def check_rays(site: Poles, local: gpd.GeoDataFrame, native: gpd.GeoDataFrame) -> set[str]:
    """Sight lines: from a camera that saw a pole to that pole."""
    ends = shapely.get_coordinates(local.geometry.to_numpy()).reshape(-1, 2, 2)
    known = site.poles.loc[local["pole"], ["x", "y"]].to_numpy()
    assert ends[:, 1] == pytest.approx(known, **SAME)
    cameras = site.sightings.groupby("image")[["x", "y"]]
    for name, start in zip(local["image"], ends[:, 0], strict=True):
        places = cameras.get_group(name).to_numpy()
        assert np.hypot(*(places - start).T).min() < 1e-6
    for pole, images in local.groupby("pole")["image"]:
        assert set(images) == set(site.poles.loc[pole, "images"].split(";"))
    return {"pole", "image"}


def check_hazard(site: Poles, local: gpd.GeoDataFrame, native: gpd.GeoDataFrame) -> set[str]:
    """Rated poles: offset, side and clear zone by the geometry beside them."""
    check_points(site, local, native)
    assert site.poles.loc[local["id"], "kept"].all()
    edges = shapely.union_all(site.edges.geometry.to_numpy())
    away = shapely.distance(local.geometry.to_numpy(), edges) / site.scale
    known = local["rating"] != "unknown"
    assert known.any()
    farther = local["offset_m"][known].abs().to_numpy() - away[known]
    assert (
        farther.min() > -0.1
    )  # the nearest edge may be that of a side road, which is not the road's
    assert np.median(farther) == pytest.approx(0, abs=0.1)
    inside = local["offset_m"] <= local["clear_zone_m"]
    assert local["inside_clear_zone"][known].astype(bool).tolist() == inside[known].tolist()
    assert set(local["side"]) <= {-1, 0, 1}
    assert sorted(local["rank"]) == list(range(1, len(local) + 1))
    least, greatest = local["hazard_rating_least"], local["hazard_rating_greatest"]
    assert local["hazard_rating_1_to_7"].between(least, greatest).all()
    return same_fields(local, site.hazard.reset_index(), set())


def check_sections(site: Poles, local: gpd.GeoDataFrame, native: gpd.GeoDataFrame) -> set[str]:
    """Elements of cross-sections: ends in feet, widths and rises in metres."""
    ends = shapely.get_coordinates(native.geometry.to_numpy()).reshape(-1, 4)
    told = [f"{end}_{axis}" for end in ("start", "end") for axis in "xy"]
    assert native[told].to_numpy() == pytest.approx(ends, abs=1e-6)
    length = shapely.length(shapely.force_2d(local.geometry.to_numpy())) / site.scale
    assert local["width_m"].to_numpy() == pytest.approx(length, abs=1e-3)
    assert (local["end_m"] - local["start_m"]).to_numpy() == pytest.approx(length, abs=1e-3)
    z = shapely.get_coordinates(local.geometry.to_numpy(), include_z=True)[:, 2].reshape(-1, 2)
    error = z[:, 1] - z[:, 0] - local["rise_m"].to_numpy()
    assert np.median(np.abs(error)) < 0.05  # single ends lie on kerbs and ditches
    slope = local["rise_m"] / local["width_m"]
    assert local["slope_rise_over_run"].to_numpy() == pytest.approx(slope.to_numpy(), abs=1e-6)
    assert set(local["side"]) <= {-1, 1}
    at = local["object"].fillna("") != ""
    assert (local["section"][at] == "at " + local["object"][at]).all()
    assert local["object"][at].isin(site.hazard.index).all()
    station = site.hazard.loc[local["object"][at], "station_m"]
    assert local["station_m"][at].to_numpy() == pytest.approx(station.to_numpy(), **SAME)
    table = pd.read_parquet(site.folder / "cross_sections.parquet")
    steps = table["kind"].isin(["kerb", "drop-off", "wall"])
    assert sorted(local["step_m"][local["step_m"] != 0]) == pytest.approx(
        sorted(table["rise_m"][steps])
    )
    found = same_fields(local, table[~steps].reset_index(drop=True), {"step", "step_m"})
    return found | {"step", "step_m"}


def check_geometry(site: Poles, local: gpd.GeoDataFrame, native: gpd.GeoDataFrame) -> set[str]:
    """Pieces of centreline: heading and grade are theirs, stations grow by their spacing."""
    csv = pd.read_csv(site.folder / "road_geometry.csv")
    ends = [shapely.get_coordinates(line, include_z=True)[[0, -1]] for line in local.geometry]
    way = np.array([end - start for start, end in ends])
    middles = np.array([(start + end)[:2] / 2 for start, end in ends])
    azimuth = np.degrees(np.arctan2(way[:, 0], way[:, 1]))
    turn = (local["heading_deg"].to_numpy() - azimuth + 180) % 360 - 180
    assert np.abs(turn).max() < 1.0  # of the grid, as azimuths of sensors
    run = np.hypot(way[:, 0], way[:, 1]) / site.scale
    grade = 100 * way[:, 2] / run / site.scale
    assert np.abs(local["grade_percent"].to_numpy() - grade).max() < 0.2
    for _, road in local.groupby("road"):
        apart = np.diff(road["station_m"])
        moved = np.hypot(*np.diff(middles[road.index], axis=0).T) / site.scale
        assert moved[1:-1] == pytest.approx(apart[1:-1], abs=0.05)
    curved = local["bend"] != "straight"
    assert curved.any() and np.isinf(local["radius_m"][~curved]).all()
    radius = 1000 / local["curvature_per_km"][curved].abs()
    assert local["radius_m"][curved].to_numpy() == pytest.approx(radius.to_numpy(), rel=1e-3)
    texts = {"road", "bend", "lanes_from", "travelled_from"}
    for name in set(local.columns) - {"geometry", *texts}:
        assert local[name].to_numpy() == pytest.approx(csv[name].to_numpy(), abs=1e-3, nan_ok=True)
    for name in texts:
        found, known = (table[name].fillna("").astype(str) for table in (local, csv))
        assert found.tolist() == known.tolist()
    assert set(local["travelled_from"]) == {"markings"}
    # To the middles of the edge lines, 6 cm inside their outer sides.
    for side in ("left", "right"):
        edge = local[f"travelled_{side}_m"].to_numpy()
        assert np.nanmax(np.abs(edge - (LANE_M - 0.06))) < 0.2
    assert local["lanes"].dropna().isin([2]).all() and local["lanes"].notna().mean() > 0.5
    assert np.nanmax(np.abs(local["lane_width_m"] - (LANE_M - 0.06))) < 0.2
    return set(local.columns) - {"geometry"}


def check_edges(site: Poles, local: gpd.GeoDataFrame, native: gpd.GeoDataFrame) -> set[str]:
    """Road edges: lengths in metres though coordinates are feet."""
    flat = shapely.force_2d(local.geometry.to_numpy())
    assert local["length_m"].to_numpy() == pytest.approx(shapely.length(flat), rel=1e-6)
    feet = shapely.length(shapely.force_2d(native.geometry.to_numpy()))
    assert feet * US_FOOT == pytest.approx(local["length_m"].to_numpy(), rel=1e-6)
    assert local["polyline"].is_unique
    xyz = shapely.get_coordinates(local.geometry.to_numpy(), include_z=True)
    ground = site.ground_m(xyz)
    assert np.nanmedian(np.abs(xyz[:, 2] - ground)) < _FLAT_M
    return {"polyline", "length_m"}


def check_guardrails(site: Poles, local: gpd.GeoDataFrame, native: gpd.GeoDataFrame) -> set[str]:
    """None, as the site asks for poles alone; `test_pole_stages.py` reads some back."""
    assert local.empty and native.empty
    return set(local.columns)


PLACED = {
    "poles": check_poles,
    "ellipses": check_ellipses,
    "rays": check_rays,
    "guardrails": check_guardrails,
}
RATED = {"hazard": check_hazard, "cross_sections": check_sections, "road_geometry": check_geometry}
FILES = {
    "placed.gpkg": PLACED,
    "poles.gpkg": PLACED | RATED,
    "road_edges.gpkg": {"road_edges": check_edges},
    "../gis/tiny_road.gpkg": PLACED | RATED | {"road_edges": check_edges},
}


def read_back(site: Poles, files: dict[str, dict]) -> None:
    """Check all fields of all layers; one that its check does not know fails."""
    for name, layers in files.items():
        file = site.folder / name
        there = {str(layer) for layer, kind in pyogrio.list_layers(file) if kind is not None}
        assert there == set(layers), name
        for layer, check in layers.items():
            native = pyogrio.read_dataframe(file, layer=layer)
            assert len(native) or check is check_guardrails, (name, layer)
            known = check(site, read_layer(file, layer, site.frame), native)
            assert set(native.columns) - {"geometry"} <= known, (name, layer)


def test_every_field_of_every_layer_of_poles_reads_back(finished_road):
    site = Poles(finished_road.folder / "results/tiny_road")
    assert site.frame.unit_m == pytest.approx(US_FOOT)
    read_back(site, FILES)
    high = pyogrio.read_info(site.folder / "../gis/tiny_road.gpkg", layer="poles")["crs"]
    assert CRS.from_user_input(high).is_compound
