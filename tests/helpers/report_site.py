"""A small site as the workflow leaves it on disk: a curved road, sensors on both sides of it."""

import json
from pathlib import Path

import geopandas as gpd
import numpy as np
import pandas as pd
from pyproj import CRS
from shapely import LineString, Polygon

from roadsight.base.sections.sensing import Targets
from roadsight.config.schema import Settings
from roadsight.geometry.frames import Frame
from roadsight.io.cloud.clouds import write_laz
from roadsight.io.cloud.tile_writer import TileWriter
from roadsight.io.raster.rasters import write_raster
from roadsight.io.records.atomic import write_json
from roadsight.io.records.placement_tables import write_detections
from roadsight.io.records.tables import write_table
from roadsight.io.vector.vectors import write_layers
from roadsight.stages.placement.solve_cover import described
from tests.conftest import PROJECT

PLANS = {
    "vlp-16": ("VLP-16 only", ["VLP-16"]),
    "puck-32c": ("VLP-32C only", ["VLP-32C"]),
    "puck-32c-or-os-32": ("VLP-32C or OS1-32", ["VLP-32C", "OS1-32"]),
    "os-32": ("OS1-32 only", ["OS1-32"]),
    "os-64": ("OS1-64 only", ["OS1-64"]),
    "os-128": ("OS1-128 only", ["OS1-128"]),
}
REACH_M = {"VLP-16": 16.0, "VLP-32C": 30.0, "OS1-32": 26.0, "OS1-64": 40.0, "OS1-128": 55.0}
HALF_WIDTH_M, SPACING_M = 6.0, 4.0
TILE_M = 25
SETTINGS = Settings(targets=Targets(cell_size_m=1.5))


class ReportSite:
    """Artifacts of one site under ``folder``, and the arguments of its page.

    Parameters
    ----------
    length_m, points : size of the road and its cloud.
    crs : EPSG code, or None for a local site.
    hidden : share of the road's length, at its end, that no sensor sees.
    unproven : plans whose bound stays one below the cost.
    traffic : plans that know how often each target is in sight.
    """

    def __init__(
        self,
        folder,
        name="tiny",
        length_m=60.0,
        points=4000,
        crs="EPSG:25832",
        hidden=0.0,
        unproven=(),
        placed=True,
        coloured=True,
        title="Tiny road",
        truth=True,
        traffic=(),
    ):
        self.folder, self.name, self.title = Path(folder) / name, name, title
        self.length_m, self.hidden, self.unproven = length_m, hidden, unproven
        self.traffic = traffic
        wkt = None if crs is None else CRS.from_user_input(crs).to_wkt()
        self.frame = Frame((458000.0, 5428000.0, 110.0), crs_wkt=wkt)
        self.rng = np.random.default_rng(7)
        self.truth = truth
        self._scene(points, coloured)
        self.arguments = self._scene_arguments()
        if placed:
            self._placement()
        self._summary(placed)

    def path(self, *parts):
        path = self.folder.joinpath(*parts)
        path.parent.mkdir(parents=True, exist_ok=True)
        return path

    def road(self, station_m, offset_m):
        """Plan positions on a gentle curve."""
        angle = np.asarray(station_m) / 400.0
        radius = 400.0 - np.asarray(offset_m)
        x = 15.0 + radius * np.sin(angle)
        y = 20.0 + 400.0 - radius * np.cos(angle)
        return np.stack(np.broadcast_arrays(x, y), axis=-1)

    def ground_m(self, xy):
        return 2.0 + 0.02 * xy[..., 0] + 0.4 * np.sin(xy[..., 1] / 9.0)

    # Scene

    def _scene(self, points, coloured):
        station = self.rng.uniform(0, self.length_m, points)
        offset = self.rng.normal(0, 8.0, points).clip(-14.0, 14.0)
        xy = self.road(station, offset)
        above = np.where(np.abs(offset) > 9, self.rng.gamma(1.5, 1.2, points), 0.0)
        columns = {
            "x": xy[:, 0],
            "y": xy[:, 1],
            "z": self.ground_m(xy) + above,
            "intensity": np.where(np.abs(offset) < HALF_WIDTH_M, 900, 2600)
            + self.rng.integers(0, 300, points),
            "classification": np.zeros(points),
            "return_number": np.ones(points),
            "number_of_returns": np.ones(points),
        }
        if coloured:
            columns |= {"red": 90 + 0 * above, "green": 100 + 20 * (above > 0), "blue": 80 + above}
        with TileWriter(self.path("scene/cloud.parquet"), TILE_M, coloured) as writer:
            writer.append(columns)
            tiles = writer.finish()
        corners = np.array([tile.bounds_m for tile in tiles])
        self.bounds_m = [*corners[:, :3].min(axis=0).tolist(), *corners[:, 3:].max(axis=0).tolist()]
        write_json(self.path("scene/frame.json"), self._about(points))
        self._dem()
        self._layers()

    def _about(self, points):
        return self.frame.to_dict() | {
            "points": points,
            "bounds_m": self.bounds_m,
            "crs_name": "ETRS89 / UTM zone 32N" if self.frame.crs_wkt else "local",
            "unit": "metre",
            "vertical_unit": "metre",
            "notes": ["z assumed to be in metre, as x and y"],
            "inputs": {"clouds/road <1>.laz": "0f" * 32},
        }

    def _dem(self):
        west, south = self.bounds_m[:2]
        columns = int((self.bounds_m[3] - west) / 0.5) + 2
        rows = int((self.bounds_m[4] - south) / 0.5) + 2
        north = south + 0.5 * rows
        x = west + 0.5 * (np.arange(columns) + 0.5)
        y = north - 0.5 * (np.arange(rows) + 0.5)
        heights = self.ground_m(np.stack(np.meshgrid(x, y), axis=-1))
        heights[:3, :5] = np.nan
        write_raster(self.path("scene/dem.tif"), heights, self.frame, west, north, 0.5)

    def _layers(self):
        stations = np.linspace(0, self.length_m, 40)
        sides = [self.road(stations, side * HALF_WIDTH_M) for side in (1, -1)]
        island = self.road(np.array([20.0, 26.0, 26.0, 20.0]), np.array([-0.5, -0.5, 0.5, 0.5]))
        outline = Polygon(np.vstack([sides[0], sides[1][::-1]]), [island])
        pavement = gpd.GeoDataFrame({"part": [0]}, geometry=[outline])
        write_layers(self.path("scene/pavement.gpkg"), {"pavement": pavement}, self.frame)
        lines = [LineString(self.road(stations, side * (HALF_WIDTH_M + 1))) for side in (1, -1)]
        edges = gpd.GeoDataFrame(
            {
                "edge": ["left", "right"],
                "kind": ["edge", "median"],
                "source": ["digitised", "automatic"],
                "length_m": [line.length for line in lines],
            },
            geometry=lines,
        )
        write_layers(self.path("placement/edges.gpkg"), {"edges": edges}, self.frame)

    def _scene_arguments(self):
        sensors = PROJECT / "config" / "sensors.yaml"
        named = {
            "site": self.name, "title": self.title, "sensors": sensors,
            "summary": self.path("summary.json"), "frame": self.path("scene/frame.json"),
            "cloud": self.path("scene/cloud.parquet"), "dem": self.path("scene/dem.tif"),
            "pavement": self.path("scene/pavement.gpkg"),
            "edges": self.path("placement/edges.gpkg"), "out": self.path("page.json"),
        }  # fmt: skip
        return [part for key, value in named.items() for part in (f"--{key}", str(value))]

    # Placement

    def _placement(self):
        self.targets = self._targets()
        self.rounds = [self._candidates(0, SPACING_M), self._candidates(1, SPACING_M / 2)]
        self.solutions = {}
        write_table(self.path("placement/targets.parquet"), self.targets)
        for number, table in enumerate(self.rounds):
            write_table(self.path(f"placement/round-{number}/candidates.parquet"), table)
        seen = {sensor: self._detections(sensor) for sensor in REACH_M}
        files = [str(self._shard(sensor, *shard)) for sensor in seen for shard in ((0, 0), (1, 0))]
        coverage = {}
        for plan, (_, sensors) in PLANS.items():
            coverage[plan] = self._plan(plan, {name: seen[name] for name in sensors})
        write_json(
            self.path("placement/round-1/coverage.json"),
            {"targets": len(self.targets), "candidates": self.total, "plans": coverage},
        )
        self.arguments += ["--plans", *(f"{name}={title}" for name, (title, _) in PLANS.items())]
        self.arguments += ["--targets", str(self.path("placement/targets.parquet"))]
        self.arguments += ["--candidates", *self._each("placement/round-{}/candidates.parquet")]
        self.arguments += ["--detections", *files]
        self.arguments += ["--coverage", str(self.path("placement/round-1/coverage.json"))]
        files = ("solution.json", "solution.gpkg", "obstacles.gpkg", "scans.laz")
        for key, file in zip(("solutions", "layers", "obstacles", "scans"), files, strict=True):
            self.arguments += [f"--{key}", *(str(self.path("placement", p, file)) for p in PLANS)]

    def _each(self, pattern):
        return [str(self.path(pattern.format(number))) for number in range(len(self.rounds))]

    @property
    def candidates(self):
        return pd.concat(self.rounds, ignore_index=True)

    @property
    def total(self):
        return sum(map(len, self.rounds))

    def _targets(self):
        station, offset = np.meshgrid(
            np.arange(1.0, self.length_m, 1.5), np.arange(-HALF_WIDTH_M + 0.5, HALF_WIDTH_M, 1.5)
        )
        xy = self.road(station.ravel(), offset.ravel())
        names = [f"t{int(x)}_{int(y)}.{n}" for n, (x, y) in enumerate(xy)]
        table = pd.DataFrame({"target": names, "x": xy[:, 0], "y": xy[:, 1]})
        table["z"] = self.ground_m(xy)
        table["points"] = np.int32(30)
        self.station_m = station.ravel()
        return table

    def _candidates(self, round_number, spacing_m):
        """Both sides; the second round only where the road ends, between the first ones."""
        rows = []
        start = 0.0 if round_number == 0 else self.length_m - 6 + spacing_m
        step = SPACING_M if round_number else spacing_m
        for side, edge in ((1, "left"), (-1, "right")):
            for station in np.arange(start, self.length_m, step):
                xy = self.road(station, side * (HALF_WIDTH_M + 1))
                ground = float(self.ground_m(xy))
                heading = np.degrees(station / 400.0) - side * 90
                key = f"{edge}-s{station:06.1f}"
                rows += [
                    (
                        f"{key}-h{h:04.1f}", key, edge, "edge", station, *xy, ground + h, h, ground,
                        heading,
                    )
                    for h in (4.0, 6.0, 8.0)
                ]  # fmt: skip
        names = ["candidate", "key", "edge", "mount", "station_m", "x", "y", "z", "height_m"]
        return pd.DataFrame(rows, columns=[*names, "ground_z_m", "yaw_deg"])

    def _detections(self, sensor):
        """Within reach, and not on the hidden stretch."""
        candidates, targets = self.candidates, self.targets
        apart = candidates[["x", "y"]].to_numpy()[:, None] - targets[["x", "y"]].to_numpy()[None]
        near = (
            np.linalg.norm(apart, axis=2)
            < REACH_M[sensor] * (0.8 + 0.02 * candidates["height_m"].to_numpy())[:, None]
        )
        near &= self.station_m < self.length_m * (1 - self.hidden)
        for number, table in enumerate(self.rounds):
            first = sum(map(len, self.rounds[:number]))
            row, column = np.nonzero(near[first : first + len(table)])
            content = pd.DataFrame(
                {
                    "candidate": pd.Categorical(table["candidate"].to_numpy()[row]),
                    "target": targets["target"].to_numpy()[column],
                    "hits": np.full(len(row), 12, np.uint16),
                }
            )
            write_detections(self._shard(sensor, number, 0), content, {"sensor": sensor})
        return near

    def _shard(self, sensor, round_number, shard):
        return self.path(f"placement/round-{round_number}/detection/{sensor}/{shard}.parquet")

    def _plan(self, plan, seen):
        """A greedy cover, its obstacles and its scan; returns the plan's coverage."""
        matrix = np.vstack(list(seen.values()))
        reachable = matrix.any(axis=0)
        uncovered = self.targets["target"][~reachable].tolist()
        open_targets, rows = reachable.copy(), []
        while open_targets.any():
            rows.append(int((matrix & open_targets).sum(axis=1).argmax()))
            open_targets &= ~matrix[rows[-1]]
        names = list(seen)
        table = self.candidates.iloc[[row % self.total for row in rows]]
        table = table.rename(columns={"station_m": "edge_m"})
        table.insert(1, "sensor", [names[row // self.total] for row in rows])
        times = matrix[rows].sum(axis=0)
        table["targets"] = matrix[rows].sum(axis=1)
        table["only"] = (matrix[rows] & (times == 1)).sum(axis=1)
        table["native"] = self.frame.to_native(table[["x", "y", "z"]].to_numpy()).round(4).tolist()
        bound = len(rows) - (1.0 if plan in self.unproven else 0.0)
        self.solutions[plan] = {
            "site": self.name,
            "plan": plan,
            "sensor_types": names,
            "status": "time_limit" if plan in self.unproven else "optimal",
            "objective": float(len(rows)),
            "bound": bound,
            "gap": 1 - bound / len(rows),
            "at_least": 1,
            "sensors": json.loads(table.to_json(orient="records")),
            "targets": len(self.targets),
            "covered_targets": int(reachable.sum()),
            "uncoverable_targets": len(uncovered),
            "excluded": uncovered,
            "reductions": {
                "rows": len(matrix),
                "columns": int(reachable.sum()),
                "rows_reduced": 40,
                "columns_reduced": 12,
            },
        }
        if plan in self.traffic:
            self.solutions[plan]["availability"] = self._in_sight(plan, reachable)
        write_json(self.path("placement", plan, "solution.json"), self.solutions[plan])
        self._obstacles(plan, uncovered, table)
        points = self.road(self.rng.uniform(0, self.length_m, 50 * len(rows)), 0.0)
        xyz = np.column_stack([points, self.ground_m(points)])
        source = np.repeat(np.arange(1, len(rows) + 1), 50).astype(np.uint16)
        write_laz(
            self.path("placement", plan, "scans.laz"), xyz, self.frame, {"point_source_id": source}
        )
        return {"uncovered": uncovered, "covered_share": float(reachable.mean())}

    def _in_sight(self, plan, reachable):
        """Shares of the time that rise along the road from 0.4 to 1, and their description."""
        seen = self.targets[reachable]
        shares = np.minimum(0.4 + 0.7 * self.station_m[reachable] / self.length_m, 1.0)
        places = gpd.points_from_xy(seen["x"], seen["y"], seen["z"])
        layer = gpd.GeoDataFrame(
            {"target": seen["target"].to_list(), "availability": shares}, geometry=places
        )
        write_layers(self.path("placement", plan, "solution.gpkg"), {"targets": layer}, self.frame)
        return described(shares)

    def _obstacles(self, plan, uncovered, sensors):
        xy = self.road(np.array([18.0, 41.0]), np.array([8.5, -9.0]))
        obstacles = gpd.GeoDataFrame(
            {
                "sight_lines": [40, 12], "targets": [31, 9], "sensors": [2, 1],
                "target": self.targets["target"].iloc[[3, 5]].to_list(),
                "candidate": [sensors["candidate"].iloc[0]] * 2, "height_m": [2.4, 0.1],
                "kind": ["object", "ground"],
            },
            geometry=gpd.points_from_xy(*xy.T, self.ground_m(xy) + 1),
        )  # fmt: skip
        gaps = self.targets[self.targets["target"].isin(uncovered)]
        aside = gaps[["x", "y"]].to_numpy() + np.array([-3, 2])
        obstacle_x, obstacle_y = aside.T
        explained = gpd.GeoDataFrame(
            {
                "target": gaps["target"].to_list(), "reason": "hidden", "nearest_m": 12.5,
                "blocked_share": 0.875, "obstacle_x": obstacle_x, "obstacle_y": obstacle_y,
            },
            geometry=gpd.points_from_xy(gaps["x"], gaps["y"], gaps["z"]),
        )  # fmt: skip
        objects = gpd.GeoDataFrame(
            {"name": ["tree-1"], "kind": ["tree"], "targets": [31.0]},
            geometry=gpd.points_from_xy(*xy[:1].T, self.ground_m(xy[:1]) + 1),
        )
        layers = {"obstacles": obstacles, "uncovered": explained, "objects": objects}
        write_layers(self.path("placement", plan, "obstacles.gpkg"), layers, self.frame)

    def _summary(self, placed):
        scores = {
            "accuracy": 0.951, "precision": 0.94, "recall": 0.982, "f1": 0.9605, "points": 800,
        }  # fmt: skip
        summary = {
            "site": self.name,
            "version": "0.1.0",
            "seed": 1,
            "inputs": {"clouds/road <1>.laz": "0f" * 32},
            "settings": json.loads(SETTINGS.model_dump_json()),
            "scene": {
                "points": 4000,
                "density_per_m2": {"median": 27.0, "p05": 15.0, "cell_m": 1.0},
                "spacing_m": 0.1392,
                "overhead_cover_share": 0.1148,
                "has_colour": True,
                "pavement_scores": scores if self.truth else None,
            },
            "effects": {},
        }
        if placed:
            summary["placement"] = {
                name: {"status": solution["status"], "seconds_cpu": 0.4 + 3 * number}
                for number, (name, solution) in enumerate(self.solutions.items())
            }
        write_json(self.path("summary.json"), summary)
