"""A small site's poles job as the workflow leaves it on disk: a curved road and its poles."""

import json

import cv2
import numpy as np
import pandas as pd

from roadsight.base.shards import deal
from roadsight.geometry.cameras import Intrinsics, azimuth_deg, cam_from_world, project
from roadsight.geometry.north import SiteNorth
from roadsight.io.images.image_shards import ImageShardWriter
from roadsight.io.raster.rasters import write_raster
from roadsight.io.raster.top_rasters import TopRasterWriter
from roadsight.io.records.atomic import read_json, write_json
from roadsight.io.records.tables import write_table
from roadsight.scene.voxel_classes import Columns, VoxelGrid
from tests.helpers.report_site import ReportSite

SHARDS, STEP_M, ABOVE_ROAD_M = 2, 8.0, 2.2
EDGE_M, POLE_OFFSET_M = 4.0, 7.0
WIDTH_PX, HEIGHT_PX, FOCAL_PX = 800, 400, 500.0
REASON = "no <edges> in the image"


class PolesSite(ReportSite):
    """Artifacts of one site's poles job under ``folder``, and the arguments of its page.

    Parameters
    ----------
    length_m, poles : size of the route, and poles along it.
    rejected_every : every so many images one is rejected.
    known : whether there is a validation; of how many poles at the most.
    """

    def __init__(
        self, folder, name="tiny", length_m=400.0, poles=12, rejected_every=7, known=12, **options
    ):
        super().__init__(folder, name, length_m=length_m, placed=False, **options)
        self.pole_count, self.rejected_every, self.known = poles, rejected_every, known
        self._ground()
        self._frames()
        self._cameras()
        self._poles()
        self._sightings()
        self._images()
        self._results()
        self.poles_arguments = self._poles_arguments()

    @property
    def poles_page(self):
        """Where the page of the poles is written."""
        return self.path("poles", "page.json")

    def shards(self, kind, suffix):
        """Paths of the shards of an artifact."""
        return [str(self.path("poles", kind, f"{n}.{suffix}")) for n in range(SHARDS)]

    def _on_road(self, station_m, offset_m=0.0, above_m=0.0):
        xy = self.road(np.asarray(station_m, float), offset_m)
        return np.column_stack([xy, self.ground_m(xy) + above_m])

    def _ground(self):
        west, south, cell = -60.0, -60.0, 0.3048
        x = west + cell * (np.arange(1800) + 0.5)
        y = south + cell * (np.arange(1300) + 0.5)
        across = np.hypot(*(np.meshgrid(x - 15.0, y - 420.0))) - 400.0
        classes = np.where(np.abs(across) < EDGE_M, 11.0, 2.0)
        classes[(np.abs(across) > 14) & (self.rng.random(across.shape) < 0.4)] = 5.0
        classes[(np.abs(across - 30) < 5) & ((x // 12) % 4 == 0)] = 6.0
        classes = np.where(np.meshgrid(x, y)[0] > west + cell * 1795, np.nan, classes)[::-1]
        north = south + cell * len(y)
        self._top(classes, west, south, cell)
        stations = np.arange(-20.0, self.length_m + 80.0, 0.3)
        edges = np.concatenate([self._on_road(stations, side * EDGE_M) for side in (-1, 1)])
        self.edges = edges
        table = pd.DataFrame(edges, columns=["x", "y", "z"])
        write_table(self.path("poles", "road_edges.parquet"), table, {"cell_size_m": cell})
        heights = self.ground_m(np.stack(np.meshgrid(x[::4], y[::4]), axis=-1))[::-1]
        dem = self.path("poles", "dem.tif")
        write_raster(dem, heights, self.frame, west, north, 4 * cell)

    def _top(self, classes, west, south, cell):
        """Overhead view; the classes have their first row in the north."""
        grid = VoxelGrid(cell, (west, south, 0.0), (0, 0, 0), (*classes.shape[::-1], 1))
        row, column = np.nonzero(np.isfinite(classes[::-1]))
        cls = classes[::-1][row, column].astype(np.uint8)
        columns = Columns(row, column, cls, np.zeros(len(cls)), (cls == 11) * 1.0)
        with TopRasterWriter(self.path("poles", "top.tif"), self.frame, grid) as raster:
            raster.add(columns)

    def _frames(self):
        stations = np.arange(0.0, self.length_m, STEP_M)
        here, ahead = self._on_road(stations, 1.8), self._on_road(stations + 1.0, 1.8)
        names = [f"2021/{number:05d}.jpg" for number in range(len(stations))]
        status = np.where(np.arange(len(stations)) == 3, "stands still", "ok")
        self.frames = pd.DataFrame(
            {
                "image": names, "route": "40001", "sequence": np.arange(len(stations)),
                "path": names, "left_path": "", "right_path": "", "width_px": WIDTH_PX,
                "height_px": HEIGHT_PX, "x": here[:, 0], "y": here[:, 1], "z_road": here[:, 2],
                "heading_deg": azimuth_deg(here[:, :2], ahead[:, :2]), "step_m": STEP_M,
                "status": status,
            }
        )  # fmt: skip
        lost = self.frames.iloc[-1:].assign(image="lost.jpg", path="", status="has no place")
        lost[["x", "y", "z_road", "heading_deg", "step_m"]] = np.nan
        self.frames = pd.concat([self.frames, lost], ignore_index=True)
        write_table(self.path("poles", "frames.parquet"), self.frames)

    def _write_shards(self, kind, table):
        dealt = deal(self.frames["image"], SHARDS)
        own = np.array([dealt[name] for name in table["image"]], int)
        for number, path in enumerate(self.shards(kind, "parquet")):
            write_table(path, table[own == number])

    def _cameras(self):
        used = self.frames[self.frames["status"] == "ok"].reset_index(drop=True)
        count = len(used)
        accepted = (used["sequence"] + 2) % self.rejected_every > 0
        turn = 0.6 * np.sin(np.arange(count) / 5) + self.rng.normal(0, 0.1, count)
        self.cameras = pd.DataFrame(
            {
                "image": used["image"],
                "x": used["x"] + self.rng.normal(0, 0.2, count),
                "y": used["y"] + self.rng.normal(0, 0.2, count),
                "z": used["z_road"] + ABOVE_ROAD_M,
                "heading_deg": (used["heading_deg"] + turn) % 360,
                "pitch_deg": -1.0,
                "roll_deg": 0.2,
                "focal_px": FOCAL_PX,
                "cx_px": (WIDTH_PX - 1) / 2,
                "cy_px": (HEIGHT_PX - 1) / 2,
                "width_px": WIDTH_PX,
                "height_px": HEIGHT_PX,
                "sigma_heading_deg": 0.25,
                "sigma_pitch_deg": 0.1,
                "sigma_lateral_m": 0.3,
                "sigma_along_m": 0.8,
                "residual_px": np.where(accepted, self.rng.gamma(3, 1.0, count), np.nan),
                "edge_points": 300,
                "accepted": accepted,
                "reason": np.where(accepted, "", REASON),
            }
        )
        self._write_shards("cameras", self.cameras)

    def _pixels(self, camera, points):
        own = Intrinsics.centred(WIDTH_PX, HEIGHT_PX, FOCAL_PX)
        rotation = cam_from_world(*camera[["heading_deg", "pitch_deg", "roll_deg"]].astype(float))
        uv, depth = project(own, rotation, camera[["x", "y", "z"]].to_numpy(float), points)
        return uv, depth, own.contains(uv)

    def _poles(self):
        stations = np.linspace(30.0, self.length_m, self.pole_count)
        sides = np.where(np.arange(self.pole_count) % 3 == 0, -1.0, 1.0)
        self.true_poles = self._on_road(stations, sides * POLE_OFFSET_M)
        self.sides = sides

    def _sightings(self):
        rows = []
        tops = self.true_poles + np.array([0.0, 0.0, 9.0])
        for _, camera in self.cameras[self.cameras["accepted"]].iterrows():
            foot, depth, seen = self._pixels(camera, self.true_poles)
            top, _, _ = self._pixels(camera, tops)
            away = np.hypot(*(self.true_poles - camera[["x", "y", "z"]].to_numpy(float)).T[:2])
            for n in np.flatnonzero(seen & (depth > 4) & (away < 55)):
                u, v = foot[n] + self.rng.normal(0, 1.5, 2)
                kept = bool(self.rng.random() > 0.15)
                rows.append(
                    {
                        "image": camera["image"],
                        "route": "40001",
                        "sequence": int(camera["image"][5:10]),
                        "view": "front",
                        "kind": "pole",
                        "foot_visible": kept,
                        "u_foot": u,
                        "v_foot": v,
                        "u_min": min(u, top[n, 0]) - 2,
                        "v_min": max(top[n, 1], 0.0),
                        "u_max": max(u, top[n, 0]) + 2,
                        "v_max": v,
                        **camera[["x", "y", "z"]].astype(float).to_dict(),
                        "bearing_grid_deg": float(
                            azimuth_deg(camera[["x", "y"]].to_numpy(float), self.true_poles[n, :2])
                        )
                        + self.rng.normal(0, 0.2),
                        "depth_m": away[n] * self.rng.normal(1, 0.05),
                        "depth_network_m": away[n] * self.rng.normal(1, 0.15),
                        "depth_ground_m": away[n] * self.rng.normal(1, 0.08),
                        "depth_lidar_m": np.nan,
                        "sigma_bearing_deg": 0.3,
                        "sigma_depth_m": 2.0,
                        "kept": kept,
                        "reason": "" if kept else "too low",
                        "pole": n,
                    }
                )
        self.sightings = pd.DataFrame(rows)
        self._write_shards("sightings", self.sightings.drop(columns="pole"))

    def _images(self):
        """Photographs, segmented edges, masks and relative depth of every image."""
        edges = []
        masks, depths = (
            [ImageShardWriter(path).__enter__() for path in self.shards(kind, "zip")]
            for kind in ("masks", "depth")
        )
        for _, camera in self.cameras.iterrows():
            name = camera["image"]
            shard = deal(self.frames["image"], SHARDS)[name]
            uv, depth, seen = self._pixels(camera, self.edges)
            found = uv[seen & (depth > 4) & (depth < 40)] + self.rng.normal(0, 1.0, 2)
            if camera["accepted"]:
                edges.append(pd.DataFrame({"image": name, "u": found[:, 0], "v": found[:, 1]}))
            photo = np.full((HEIGHT_PX, WIDTH_PX, 3), (120, 150, 110), np.uint8)
            photo[: HEIGHT_PX // 2] = (225, 200, 170)
            mask = np.zeros((HEIGHT_PX, WIDTH_PX), np.uint8)
            mask[HEIGHT_PX // 2 + 10 :] = 1
            photo[mask == 1] = (105, 105, 105)
            for sighting in self.sightings[self.sightings["image"] == name].itertuples():
                ends = [(sighting.u_foot, sighting.v_foot), (sighting.u_foot, sighting.v_min)]
                a, b = (tuple(np.rint(end).astype(int).tolist()) for end in ends)
                cv2.line(photo, a, b, (50, 70, 90), 3)
                cv2.line(mask, a, b, 4, 3)
            path = self.path("images", name)
            cv2.imwrite(str(path), photo)
            row = np.arange(HEIGHT_PX)[:, None] - HEIGHT_PX / 2
            near = np.clip(row / (ABOVE_ROAD_M * FOCAL_PX), 0.001, None) * 3.0
            relative = np.clip(near + self.rng.normal(0, 0.004, (1, WIDTH_PX)), 1e-5, 1)
            masks[shard].write(name[:-4], mask)
            depths[shard].write(name[:-4], np.rint(65535 * relative).astype(np.uint16))
        for writer in (*masks, *depths):
            writer.__exit__(None, None, None)
        table = pd.concat(edges, ignore_index=True).astype({"u": np.float32, "v": np.float32})
        self._write_shards("image_edges", table.assign(side=np.int8(0), kind="lane"))

    def _results(self):
        seen = self.sightings[self.sightings["kept"]].groupby("pole")["image"].apply(list)
        shown = seen[seen.apply(len) > 1]
        rows = shown.index.to_numpy()
        placed = self.true_poles[rows] + self.rng.normal(0, [1.2, 1.2, 0.1], (len(rows), 3))
        self.poles = pd.DataFrame(
            {
                "id": [f"p{n:03d}" for n in range(len(rows))], "kind": "pole", "x": placed[:, 0],
                "y": placed[:, 1], "z": placed[:, 2], "score": [len(images) for images in shown],
                "sigma_major_m": 1.5, "sigma_minor_m": 0.4, "sigma_azimuth_deg": 40.0,
                "images": [";".join(images) for images in shown], "routes": "40001", "kept": True,
                "reason": "",
            }
        )  # fmt: skip
        if self.frame.crs_wkt is not None:
            latitude, longitude = SiteNorth(self.frame).to_geographic(placed)
            self.poles["latitude"], self.poles["longitude"] = latitude, longitude
        withheld = self.poles.iloc[:1].assign(id="p999", kept=False, reason="near a building")
        located = pd.concat([self.poles, withheld], ignore_index=True)
        write_table(self.path("poles", "poles.parquet"), located)
        hazard = pd.DataFrame(
            {
                "id": self.poles["id"],
                "kind": "pole",
                "offset_m": np.abs(self.rng.normal(3.0, 1.0, len(rows))),
                "side": self.sides[rows].astype(np.int8),
                "clear_zone_m": 4.9,
                "inside_clear_zone": True,
                "slope_rise_over_run": self.rng.normal(-0.1, 0.1, len(rows)),
                "slope_class": "recoverable",
                "station_m": 1.0,
                "objects_per_km": 40.0,
                "rating": np.where(np.arange(len(rows)) % 2, "high", "low"),
                "rank": np.arange(1, len(rows) + 1),
                "route": "40001",
                "reasons": "3 m from the edge, inside the clear zone of 4.9 m [RDG 3.1]",
            }
        )
        write_table(self.path("poles", "hazard.parquet"), hazard)
        self._sections()
        if self.known:
            self._validation(rows, placed)

    def _sections(self):
        """A ditch beside each pole."""
        run = np.arange(0.0, 12.0, 0.2)
        height = np.interp(run, [0, 1.5, 3, 4.5, 12], [0, -0.1, -0.7, -0.1, 0])
        profile = {"run_m": run.tolist(), "height_m": height.round(3).tolist()}
        elements = [
            ("shoulder", 0.0, 1.5, -0.1, "1V:15.0H"),
            ("foreslope", 1.5, 3.0, -0.6, "1V:2.5H"),
            ("backslope", 3.0, 4.5, 0.6, "1V:2.5H"),
            ("level", 4.5, 12.0, 0.1, "1V:75.0H"),
        ]
        names = ["object", "kind", "start_m", "end_m", "rise_m", "slope_ratio"]
        rows = [(name, *element) for name in self.poles["id"] for element in elements]
        about = {"profiles": dict.fromkeys(self.poles["id"], profile)}
        table = pd.DataFrame(rows, columns=names)
        write_table(self.path("poles", "cross_sections.parquet"), table, about)

    def _validation(self, rows, placed):
        apart = np.hypot(*(placed - self.true_poles[rows]).T[:2])[: self.known]
        thresholds = []
        for limit in (1.0, 2.0, 3.0, 5.0, 6.0, 7.0, 9.0, 16.0):
            right = int((apart <= limit).sum())
            share = right / len(apart)
            counts = {"tp": right, "fp": len(apart) - right, "fn": len(apart) - right}
            scores = dict.fromkeys(("precision", "recall", "f1"), share)
            thresholds.append({"threshold_m": limit, **counts, **scores})
        errors = [
            {
                "pole": self.poles["id"][n],
                "truth": f"t{n}",
                "geodesic_m": float(error),
                "across_m": float(error / 3),
                "along_m": float(error / 2),
                "scenarios": ["curved road", "intersection"] if n % 3 else ["straight road"],
            }
            for n, error in enumerate(apart)
        ]
        ablation = [
            {
                "component": component, "images_accepted": 40, "poles": 9, "mean_error_m": 3.25,
                "f1_3m": 0.5, "f1_6m": None,
            }
            for component in ("side_views", "occlusion", "my <own>")
        ]  # fmt: skip
        content = {
            "truth": {"within_reach": len(apart), "out_of_reach": 2, "reach_m": 25.0},
            "thresholds": thresholds,
            "errors": errors,
            "mean_m": float(apart.mean()),
            "warnings": ["the known poles cover half of the route"],
            "ablation": ablation,
        }
        write_json(self.path("poles", "validation.json"), content)

    def _poles_arguments(self):
        names = ("top.tif", "road_edges.parquet", "frames.parquet", "poles.parquet")
        given = {
            "site": self.name,
            "title": self.title,
            "summary": self.path("summary.json"),
            "frame": self.path("scene/frame.json"),
            **{name.split(".")[0].replace("_", "-"): self.path("poles", name) for name in names},
            "hazard": self.path("poles", "hazard.parquet"),
            "sections": self.path("poles", "cross_sections.parquet"),
            "images": self.path("images"),
            "dem": self.path("poles", "dem.tif"),
            "out": self.poles_page,
        }
        if self.known:
            given["validation"] = self.path("poles", "validation.json")
        arguments = [part for key, value in given.items() for part in (f"--{key}", str(value))]
        for kind, suffix in (
            ("cameras", "parquet"),
            ("image-edges", "parquet"),
            ("sightings", "parquet"),
            ("masks", "zip"),
            ("depth", "zip"),
        ):
            arguments += [f"--{kind}", *self.shards(kind.replace("-", "_"), suffix)]
        return [*arguments, "--files", "poles.parquet", "poles.gpkg", "poles.geojson", "poles.csv"]


def without(arguments, *names):
    """Arguments without some options and their values."""
    kept, skipping = [], False
    for argument in arguments:
        if argument.startswith("--"):
            skipping = argument[2:] in names
        if not skipping:
            kept.append(argument)
    return kept


def changed_validation(site, **changes):
    """Content of a site's validation with some keys replaced."""
    return json.loads(json.dumps(read_json(site.path("poles", "validation.json")) | changes))
