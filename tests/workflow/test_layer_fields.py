"""Every field of every layer for people, read back against geometry and what it was made from."""

import json
from collections.abc import Iterable
from functools import cached_property
from itertools import pairwise
from pathlib import Path

import geopandas as gpd
import numpy as np
import pandas as pd
import pyogrio
import pytest
import shapely
from pyproj import Transformer
from scipy.spatial import cKDTree

from roadsight.base.sections.sensing import Lidar
from roadsight.geometry.frames import Frame
from roadsight.io.cloud.clouds import read_laz
from roadsight.io.raster.rasters import read_raster
from roadsight.io.records.placement_tables import read_detections
from roadsight.io.vector.vectors import read_layer
from roadsight.placement.sensors.poses import split_pose
from roadsight.placement.sensors.sensors import AimedSensor, Camera, Sensor, load_sensors

SAME = {"abs": 1e-6}
"""Values that are copied, or computed twice in double precision."""


class Results:
    """A finished site, and what its layers should say."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.frame = Frame.from_dict(json.loads((folder / "scene/frame.json").read_text()))
        self.dem = read_raster(folder / "scene/dem.tif", self.frame)
        self.edges = self.local("placement/edges.gpkg", "edges").set_index("edge").geometry
        parts = self.local("scene/pavement.gpkg", "pavement").geometry.to_numpy()
        self.pavement = shapely.union_all(parts)
        rounds = sorted((folder / "placement").glob("round-*/candidates.parquet"))
        self.candidates = pd.concat(map(pd.read_parquet, rounds)).set_index("candidate")
        self.targets = pd.read_parquet(folder / "placement/targets.parquet").set_index("target")
        self.points = pd.read_parquet(folder / "scene/pavement.parquet", columns=["x", "y", "z"])
        shards = [
            path
            for kind in ("detection", "poses")
            for path in (folder / "placement").glob(f"round-*/{kind}/*/*.parquet")
        ]
        self.detections = read_detections(sorted(map(str, shards)))

    def local(self, file: str, layer: str) -> gpd.GeoDataFrame:
        return read_layer(self.folder / file, layer, self.frame)

    def stands(self, names: Iterable[str]) -> pd.DataFrame:
        """Candidates by their names, with or without a pose."""
        return self.candidates.loc[[split_pose(name)[0] for name in names]]

    def ground_m(self, xy: np.ndarray) -> np.ndarray:
        return self.dem.sample(xy[:, 0], xy[:, 1])


class Plan:
    """One plan of a site."""

    def __init__(self, site: Results, name: str) -> None:
        self.site, self.name = site, name
        self.folder = site.folder / "placement" / name
        self.solution = json.loads((self.folder / "solution.json").read_text())
        self.places = [(entry["sensor"], entry["candidate"]) for entry in self.solution["sensors"]]

    @cached_property
    def seen(self) -> pd.DataFrame:
        """Whether each chosen sensor sees each target."""
        found, names = self.site.detections, self.site.targets.index
        rows = [
            names.isin(found["target"][(found["sensor"] == s) & (found["candidate"] == c)])
            for s, c in self.places
        ]
        return pd.DataFrame(np.array(rows), columns=names)


def places_of(layer: gpd.GeoDataFrame) -> np.ndarray:
    return shapely.get_coordinates(layer.geometry, include_z=True)


def check_sensors(plan: Plan, local: gpd.GeoDataFrame, native: gpd.GeoDataFrame) -> set[str]:
    """Fields of chosen sensors, in a plan's own layer and in the hand-over."""
    site, xyz, high = plan.site, places_of(local), places_of(native)
    assert list(zip(local["sensor"], local["candidate"], strict=True)) == plan.places
    assert local["number"].tolist() == list(range(1, len(local) + 1))
    known = site.stands(local["candidate"])
    assert xyz == pytest.approx(known[["x", "y", "z"]].to_numpy(), **SAME)
    kinds = site.local("placement/edges.gpkg", "edges").set_index("edge")["kind"]
    assert local["mount"].tolist() == kinds[local["edge"]].tolist()
    lines = site.edges[local["edge"]]
    along = shapely.line_locate_point(lines.to_numpy(), shapely.points(xyz[:, :2]))
    way = [
        shapely.get_coordinates(shapely.line_interpolate_point(line, [s - 1e-2, s + 1e-2]))
        for line, s in zip(lines, np.clip(along, 1e-2, lines.length - 1e-2), strict=True)
    ]
    yaw = np.radians(local["yaw_deg"].to_numpy())
    faces = np.column_stack([np.cos(yaw), np.sin(yaw)])
    tangent = np.array([(b - a) / np.hypot(*(b - a)) for a, b in way])
    turns = [split_pose(name)[1] for name in local["candidate"]]
    turned = np.radians([turn.yaw_deg for turn in turns])
    mounted = np.column_stack([np.cos(yaw - turned), np.sin(yaw - turned)])
    # Tangents are taken over some metres.
    assert np.abs((mounted * tangent).sum(axis=1)).max() < 0.2
    check_seen_in_front(plan, local)
    azimuth = np.radians(local["azimuth_deg"].to_numpy())
    assert np.column_stack([np.sin(azimuth), np.cos(azimuth)]) == pytest.approx(faces, abs=1e-9)
    assert xyz[:, 2] - local["height_m"].to_numpy() == pytest.approx(site.ground_m(xyz), **SAME)
    to_wgs84 = Transformer.from_crs(native.crs, "EPSG:4326", always_xy=True)
    degrees = np.column_stack(to_wgs84.transform(high[:, 0], high[:, 1]))
    assert native[["longitude", "latitude"]].to_numpy() == pytest.approx(degrees, abs=1e-9)
    assert local["targets"].to_numpy() == pytest.approx(plan.seen.sum(axis=1))
    alone = plan.seen & (plan.seen.sum(axis=0) == 1)
    assert local["only"].to_numpy() == pytest.approx(alone.sum(axis=1))
    found = {"sensor", "candidate", "number", "mount", "edge", "yaw_deg", "azimuth_deg"}
    found |= {"height_m", "longitude", "latitude", "targets", "only"}
    if "sensor_m" in local:  # the hand-over
        assert native["sensor_m"].to_numpy() == pytest.approx(high[:, 2], **SAME)
        assert native["ground_m"].to_numpy() == pytest.approx(
            high[:, 2] - native["height_m"].to_numpy()
        )
        assert local["pitch_deg"].tolist() == [turn.pitch_deg for turn in turns]
        assert local["roll_deg"].tolist() == [turn.roll_deg for turn in turns]
        return found | {"sensor_m", "ground_m", "pitch_deg", "roll_deg"}
    assert local["edge_m"].to_numpy() == pytest.approx(along, **SAME)
    assert native["ground_z_m"].to_numpy() == pytest.approx(
        high[:, 2] - native["height_m"].to_numpy()
    )
    off = shapely.distance(shapely.points(xyz[:, :2]), site.pavement)
    assert local["off_pavement_m"].to_numpy() == pytest.approx(off, **SAME)
    assert local["wall_m"].to_numpy() == pytest.approx(known["wall_m"].to_numpy(), nan_ok=True)
    assert local["key"].tolist() == [name.rpartition("-h")[0] for name in known.index]
    costs = load_sensors("config/sensors.yaml")
    assert local["cost"].tolist() == [costs[name].cost for name in local["sensor"]]
    if "position" in local:  # a plan with poses
        assert local["position"].tolist() == known.index.tolist()
        assert local["pitch_deg"].tolist() == [turn.pitch_deg for turn in turns]
        assert local["roll_deg"].tolist() == [turn.roll_deg for turn in turns]
        found |= {"position", "pitch_deg", "roll_deg"}
    return found | {"edge_m", "ground_z_m", "off_pavement_m", "wall_m", "key", "cost"}


def check_seen_in_front(plan: Plan, local: gpd.GeoDataFrame) -> None:
    """What cameras see lies between the sides of their images, projected as a pinhole does."""
    kinds, xyz = load_sensors("config/sensors.yaml"), places_of(local)
    targets_m = plan.site.targets[["x", "y", "z"]].to_numpy()
    for row, (name, yaw_deg) in enumerate(zip(local["sensor"], local["yaw_deg"], strict=True)):
        if not isinstance(kinds[name], Camera):
            continue
        pitch = np.radians(split_pose(local["candidate"][row])[1].pitch_deg)
        yaw, half = np.radians(yaw_deg), np.tan(np.radians(kinds[name].hfov_deg / 2))
        ahead = [np.cos(yaw) * np.cos(pitch), np.sin(yaw) * np.cos(pitch), np.sin(pitch)]
        way = targets_m[plan.seen.loc[row].to_numpy()] - xyz[row]
        aside = way @ [np.sin(yaw), -np.cos(yaw), 0.0] / (way @ ahead)
        assert 0.5 * half < np.abs(aside).max() < half + 0.1  # a target is half a metre wide


def on_feet(site: Results, local: gpd.GeoDataFrame) -> pd.DataFrame:
    """The targets of a layer, which stands on their feet."""
    known = site.targets.loc[local["target"]]
    assert places_of(local) == pytest.approx(known[["x", "y", "z"]].to_numpy(), **SAME)
    assert site.ground_m(places_of(local)) == pytest.approx(known["z"].to_numpy(), abs=0.15)
    return known


def check_targets(plan: Plan, local: gpd.GeoDataFrame, _: gpd.GeoDataFrame) -> set[str]:
    """Targets of a plan, with what the cloud has there."""
    site, known = plan.site, on_feet(plan.site, local)
    assert local["sensors"].tolist() == plan.seen[local["target"]].sum().tolist()
    places = np.floor(site.points[["x", "y"]].to_numpy(np.float64)).astype(int)
    table = pd.DataFrame(places, columns=["x", "y"]).value_counts().rename("n").reset_index()
    count = {(x, y): n for x, y, n in table.itertuples(index=False)}
    cells = [(x, y) for x, y in np.floor(known[["x", "y"]].to_numpy()).astype(int)]
    assert local["points"].tolist() == [count[cell] for cell in cells]
    blocks = table.groupby([table["x"] // 10, table["y"] // 10])["n"].median()
    spacing = [1 / np.sqrt(blocks[(x // 10, y // 10)]) for x, y in cells]
    assert local["spacing_m"].to_numpy() == pytest.approx(spacing)
    own = [shapely.box(x, y, x + 1, y + 1).intersection(site.pavement).area for x, y in cells]
    assert (local["area_m2"] >= np.array(own) - 1e-6).all()
    proven = local.loc[local["sensors"] > 0, "area_m2"].sum()
    assert proven == pytest.approx(plan.solution["proven_area_m2"])
    # A plan's layer lists the targets that it can cover.
    excluded = site.targets.loc[plan.solution["excluded"], "area_m2"].sum()
    assert site.pavement.area - local["area_m2"].sum() - excluded == pytest.approx(
        site.local("placement/unexamined.gpkg", "unexamined")["area_m2"].sum(), abs=0.1
    )
    return {"target", "points", "spacing_m", "area_m2", "sensors"}


def per_second(kind: Sensor | AimedSensor) -> tuple[float, float]:
    """Points and pixels that a sensor takes."""
    if isinstance(kind, Camera):
        return 0.0, kind.columns_px * kind.rows_px * Lidar().frames_hz
    return len(kind.elevation_deg) * len(kind.azimuth_deg) * kind.rotation_hz, 0.0


def check_data_sensors(plan: Plan, local: gpd.GeoDataFrame, _: gpd.GeoDataFrame) -> set[str]:
    """Rates of the chosen sensors, and where they stand along the road."""
    site = plan.site
    assert list(zip(local["sensor"], local["candidate"], strict=True)) == plan.places
    road = max(site.edges, key=lambda edge: edge.length)
    inside = shapely.line_locate_point(road, local.geometry.to_numpy())
    within = (inside > 0) & (inside < road.length)
    assert within.any()
    assert local["along_road_m"][within].to_numpy() == pytest.approx(inside[within])
    kinds = load_sensors("config/sensors.yaml")
    rates = [per_second(kinds[name]) for name in local["sensor"]]
    assert local[["points_per_s", "pixels_per_s"]].fillna(0).to_numpy() == pytest.approx(
        np.array(rates)
    )
    order = np.argsort(local["along_road_m"].to_numpy(), kind="stable")
    shared = local["overlap_with_next_m"].to_numpy()
    assert np.isnan(shared[order[-1]])
    for one, two in pairwise(order):
        both = plan.seen.loc[one] & plan.seen.loc[two]
        assert (shared[one] > 0) == both.any() and shared[one] <= both.sum()
    if not local["points_per_s"].any():  # cameras leave no scans
        return set(local.columns) - {"geometry"}
    scan = read_laz(plan.folder / "scans.laz")
    shapely.prepare(site.pavement)
    on = shapely.contains_xy(site.pavement, *site.frame.to_local(scan.xyz)[:, :2].T)
    frames = np.bincount(scan.dims["point_source_id"][on], minlength=len(local) + 1)[1:]
    hz = [kinds[name].rotation_hz for name in local["sensor"]]
    assert local["road_points_per_s"].to_numpy() == pytest.approx(frames * hz, rel=1e-3)
    return set(local.columns) - {"geometry"}


def check_data_targets(plan: Plan, local: gpd.GeoDataFrame, _: gpd.GeoDataFrame) -> set[str]:
    """Targets by points on them, and with dark targets and worn sensors."""
    on_feet(plan.site, local)
    times = plan.seen[local["target"]].sum().to_numpy()
    assert local["sensors"].tolist() == times.tolist()
    for name in ("seen_dark", "seen_shorter"):
        assert (local[name] <= times).all() and set(local[name]) <= {0, 1} | set(times)
    counted = "pixels" if "pixels_1" in local else "points"
    points = local[[f"{counted}_{k}" for k in (1, 2, 3, 4)]].to_numpy()
    assert (points >= 0).all() and (points.sum(axis=1)[times > 0] > 0).all()
    return set(local.columns) - {"geometry"}


def check_tolerance(plan: Plan, local: gpd.GeoDataFrame, _: gpd.GeoDataFrame) -> set[str]:
    """Targets by the changes that lose them; of sensors in poses a failure alone is looked at."""
    on_feet(plan.site, local)
    times = plan.seen[local["target"]].sum().to_numpy()
    assert local["lost_alone"].astype(bool).tolist() == (times == 1).tolist()
    mounted = sum("@" not in candidate for _, candidate in plan.places)
    if not mounted:
        assert local[["times_lost", "lost_share"]].isna().all(axis=None)
    else:
        cases = 14 * mounted  # six moves, six turns, two masts
        share = (local["times_lost"] + (times == 1)) / (cases + 1)
        assert local["lost_share"].to_numpy() == pytest.approx(share.to_numpy())
    return {"target", "times_lost", "lost_alone", "lost_share"}


def check_obstacles(plan: Plan, local: gpd.GeoDataFrame, _: gpd.GeoDataFrame) -> set[str]:
    """What sight lines meet: each hides a target from a chosen sensor that does not see it."""
    site, xyz = plan.site, places_of(local)
    assert local["height_m"].to_numpy() == pytest.approx(xyz[:, 2] - site.ground_m(xyz), **SAME)
    names = [candidate for _, candidate in plan.places]
    for row in local.itertuples():
        assert not plan.seen.loc[names.index(row.candidate), row.target]
    assert (local["sight_lines"] >= local[["targets", "sensors"]].max(axis=1)).all()
    assert (local["sight_lines"] <= local["targets"] * local["sensors"]).all()
    start = site.stands(local["candidate"])[["x", "y", "z"]].to_numpy()
    end = site.targets.loc[local["target"], ["x", "y", "z"]].to_numpy()
    lines = shapely.linestrings(np.stack([start[:, :2], end[:, :2]], axis=1))
    apart = shapely.distance(lines, shapely.points(xyz[:, :2]))
    assert apart.max() < 1.5  # a cube's mean of hits, within the cube's diagonal
    low = local["kind"] == "ground"
    assert (local["height_m"][low] < 0.5).all()
    return {"sight_lines", "targets", "sensors", "target", "candidate", "height_m", "kind"}


def check_objects(plan: Plan, local: gpd.GeoDataFrame, _: gpd.GeoDataFrame) -> set[str]:
    """Objects in the way; their name tells kind and place."""
    known = plan.site.local("placement/objects.gpkg", "objects").set_index("name")
    assert local["name"].isin(known.index).all() and local["name"].is_unique
    assert local["kind"].tolist() == known["kind"][local["name"]].tolist()
    assert (local["sight_lines"] >= local[["targets", "sensors"]].max(axis=1)).all()
    assert (local["sensors"] <= len(plan.places)).all()
    return {"name", "kind", "sight_lines", "targets", "sensors"}


def check_uncovered(plan: Plan, local: gpd.GeoDataFrame, native: gpd.GeoDataFrame) -> set[str]:
    """Targets that none sees: the candidate that is told, what is in its way, how far it is."""
    site = plan.site
    feet = on_feet(site, local)[["x", "y", "z"]].to_numpy()
    assert set(local["target"]) == set(plan.solution["excluded"])
    stands = site.stands(local["candidate"])[["x", "y", "z"]].to_numpy()
    told = [f"sensor_{axis}" for axis in "xyz"]
    assert local[told].to_numpy() == pytest.approx(stands, **SAME)
    assert native[told].to_numpy() == pytest.approx(site.frame.to_native(stands), **SAME)
    near = cKDTree(site.candidates[["x", "y", "z"]]).query(feet)[0]
    assert local["nearest_m"].to_numpy() == pytest.approx(near, abs=1.0)
    hidden = local["blocked_share"] > 0
    hits = local.loc[hidden, [f"obstacle_{axis}" for axis in "xyz"]].to_numpy()
    ways = np.linalg.norm(hits - stands[hidden], axis=1) + np.linalg.norm(
        hits - feet[hidden], axis=1
    )
    straight = np.linalg.norm(feet[hidden] - stands[hidden], axis=1)
    assert (ways >= straight - 1e-6).all() and (ways < straight + 1.0).all()
    assert local.loc[~hidden, "obstacle_x"].isna().all()
    assert local["reason"].str.len().gt(5).all()
    return {*told, *(f"obstacle_{axis}" for axis in "xyz")} | {
        *("target", "candidate", "blocked_share", "nearest_m", "reason")
    }


def check_area(site: Results, local: gpd.GeoDataFrame, native: gpd.GeoDataFrame) -> set[str]:
    """Polygons with their area in square metres, whatever the unit of the coordinates."""
    assert local["area_m2"].to_numpy() == pytest.approx(local.geometry.area.to_numpy(), rel=1e-6)
    if "part" in local:
        assert local["part"].tolist() == list(range(len(local)))
        assert len(set(local["source"])) == 1
    return {"area_m2", "part", "source"}


def check_edges(site: Results, local: gpd.GeoDataFrame, native: gpd.GeoDataFrame) -> set[str]:
    """Lines with their length in metres."""
    flat = shapely.force_2d(local.geometry.to_numpy())
    assert local["length_m"].to_numpy() == pytest.approx(shapely.length(flat), rel=1e-6)
    assert local["edge"].is_unique and set(local["kind"]) <= {"edge", "median", "line"}
    assert set(local["source"]) <= {"digitised", "automatic"}
    return {"edge", "kind", "source", "length_m"}


def check_all_objects(site: Results, local: gpd.GeoDataFrame, _: gpd.GeoDataFrame) -> set[str]:
    """Objects of the scene: named by kind and place."""
    xyz = places_of(local)
    for name, kind, (x, y, _z) in zip(local["name"], local["kind"], xyz, strict=True):
        assert name.startswith(f"{kind}{round(x):+d}{round(y):+d}")
    assert (local["height_m"] > xyz[:, 2] - site.ground_m(xyz) - 0.5).all()
    assert (local["length_m"] >= 0).all() and (local["surfels"] > 0).all()
    assert (local["removed"] == 0).all()
    return {"name", "kind", "height_m", "length_m", "surfels", "removed"}


OF_PLANS = {
    ("solution.gpkg", "sensors"): check_sensors, ("solution.gpkg", "targets"): check_targets,
    ("data.gpkg", "sensors"): check_data_sensors, ("data.gpkg", "targets"): check_data_targets,
    ("tolerance.gpkg", "targets"): check_tolerance,
    ("obstacles.gpkg", "obstacles"): check_obstacles, ("obstacles.gpkg", "objects"): check_objects,
    ("obstacles.gpkg", "uncovered"): check_uncovered,
}  # fmt: skip
OF_SITE = {
    ("scene/pavement.gpkg", "pavement"): check_area,
    ("placement/unexamined.gpkg", "unexamined"): check_area,
    ("placement/edges.gpkg", "edges"): check_edges,
    ("placement/objects.gpkg", "objects"): check_all_objects,
}


def layers_of(file: Path) -> list[str]:
    return [str(name) for name, kind in pyogrio.list_layers(file) if kind is not None]


def check(about, test, file: Path, layer: str) -> None:
    """Read a layer in both frames; it has rows, and no field that its check does not know."""
    native = pyogrio.read_dataframe(file, layer=layer)
    assert len(native), (file.name, layer)
    local = read_layer(file, layer, getattr(about, "site", about).frame)
    known = test(about, local, native)
    assert set(native.columns) - {"geometry"} <= known, (file.name, layer)


def check_hidden(results: Path, plan_name: str) -> None:
    """Layers of what stands in the way, on a site where targets stay hidden from all candidates."""
    plan = Plan(Results(results), plan_name)
    for (name, layer), test in OF_PLANS.items():
        if name == "obstacles.gpkg":
            check(plan, test, plan.folder / name, layer)


def check_posed(results: Path, plan_name: str) -> None:
    """Layers of a plan whose sensors stand in poses."""
    plan = Plan(Results(results), plan_name)
    for (name, layer), test in OF_PLANS.items():
        if layer != "uncovered":
            check(plan, test, plan.folder / name, layer)
    handed = results / f"gis/{results.name}.gpkg"
    check(plan, check_sensors, handed, f"sensors_{plan_name}")


def test_every_field_of_every_layer_reads_back(finished, monkeypatch):
    monkeypatch.chdir(finished.folder)
    site = Results(finished.folder / "results/tiny")
    plans = {name: Plan(site, name) for name in ("os-32", "os-64")}
    files = {path.relative_to(site.folder) for path in site.folder.rglob("*.gpkg")}
    seen = {Path("gis/tiny.gpkg")}
    for (name, layer), test in OF_SITE.items():
        check(site, test, site.folder / name, layer)
        seen.add(Path(name))
    for plan_name, plan in plans.items():
        for (name, layer), test in OF_PLANS.items():
            assert set(layers_of(plan.folder / name)) == {
                known for file, known in OF_PLANS if file == name
            }
            if layer != "uncovered" or plan.solution["excluded"]:
                check(plan, test, plan.folder / name, layer)
            seen.add(Path("placement", plan_name, name))
    assert {path for path in files if "truth" not in path.name} == seen
    handed = site.folder / "gis/tiny.gpkg"
    of_plans = {layer: test for (file, layer), test in OF_PLANS.items() if "data" not in file}
    of_plans["targets"] = check_targets
    of_scene = {layer: test for (_, layer), test in OF_SITE.items() if layer != "objects"}
    for layer in layers_of(handed):
        kind, _, plan_name = layer.partition("_")
        if kind == "uncovered":
            count = pyogrio.read_info(handed, layer=layer)["features"]
            assert count == len(plans[plan_name].solution["excluded"])
        elif plan_name:
            check(plans[plan_name], of_plans[kind], handed, layer)
        else:
            check(site, of_scene[layer], handed, layer)


def test_lengths_along_the_road_mean_one_thing(finished):
    folder = finished.folder / "results/tiny"
    table = pd.read_csv(folder / "stakeout.csv").set_index(["plan", "point"])
    for plan in ("os-32", "os-64"):
        rows = table.loc[plan]
        layer = pyogrio.read_dataframe(folder / "placement" / plan / "solution.gpkg", "sensors")
        data = json.loads((folder / "placement" / plan / "data.json").read_text())["sensors"]
        assert rows["edge_m"].to_numpy() == pytest.approx(layer["edge_m"].to_numpy(), abs=1e-3)
        along = [entry["along_road_m"] for entry in data]
        assert rows["chainage_m"].to_numpy() == pytest.approx(along, abs=1e-3)
        for file in (folder / "placement" / plan).glob("*.gpkg"):
            fields = [pyogrio.read_info(file, layer=name)["fields"] for name in layers_of(file)]
            assert "station_m" not in np.concatenate(fields)
