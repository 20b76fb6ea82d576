"""A winding lane of 280 m with ten poles, and the whole pole job on it in this process."""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import laspy
import numpy as np
import pandas as pd
from pyproj import CRS, Transformer

from roadsight.base.sections.poles import (
    AlignmentLimits,
    AlignmentMethod,
    EdgeTracing,
    RoadEdges,
    Sightings,
    Triangulation,
    Videolog,
    Voxels,
)
from roadsight.geometry.cameras import Intrinsics, cam_from_world, pixel_directions, project
from roadsight.io.records.tables import read_table
from roadsight.poles.images.kinds import PixelClass
from tests.properties.stage_calls import StageCalls

LABELS = str(Path(__file__).resolve().parents[2] / "resources/manifests/labels_project.yaml")
LENS = Intrinsics.from_field_of_view(800, 480, 60.0)
PROJECTION = "+proj=tmerc +lat_0=0 +lon_0=-81 +k=0.9996 +datum=WGS84 +y_0=0 +x_0={:.4f} +units={}"
HALF_M, HEIGHT_M = 3.6, 2.3


@dataclass(frozen=True)
class Lane:
    """The lane on a map, local metres from a point of the map.

    Parameters
    ----------
    xyz, cls : points of the cloud. gps : (k, 2) places of the images. poles : (p, 2) true places.
    east_m, units : false easting and unit of the map. mirrored : left and right are exchanged.
    """

    xyz: np.ndarray
    cls: np.ndarray
    gps: np.ndarray
    poles: np.ndarray
    east_m: float = 500_000.0
    units: str = "m"
    mirrored: bool = False

    def turned(self, matrix) -> Lane:
        """Everything in plan times a matrix (2, 2)."""
        move = np.asarray(matrix, float)
        xyz = np.column_stack([self.xyz[:, :2] @ move.T, self.xyz[:, 2]])
        mirrored = bool(np.linalg.det(move) < 0)
        gps, poles = self.gps @ move.T, self.poles @ move.T
        return replace(self, xyz=xyz, gps=gps, poles=poles, mirrored=mirrored)

    def rows(self, chosen) -> Lane:
        """The lane with some of its points, in that order."""
        return replace(self, xyz=self.xyz[chosen], cls=self.cls[chosen])


def middle(y):
    """x of the lane's middle, and its slope."""
    return 6.0 * np.sin(y / 60.0), 0.1 * np.cos(y / 60.0)


def aside(x, y):
    """Distance from the lane's middle, positive to the right."""
    at, slope = middle(y)
    return (x - at) / np.hypot(1.0, slope)


def ground(y):
    """Height of the ground."""
    return 100.0 + 0.01 * y


def place(y, right):
    """Place so far to the right of the middle, at least to first order."""
    at, slope = middle(np.asarray(y, float))
    return np.column_stack([at + right * np.hypot(1.0, slope), y])


def make_lane(seed=2, images=18) -> tuple[Lane, list[tuple[np.ndarray, np.ndarray]]]:
    """The lane, and masks and inverse depth of its images."""
    rng = np.random.default_rng(seed)
    x, y = rng.uniform(-22, 22, 110_000), rng.uniform(-40, 240, 110_000)
    x = x + middle(y)[0]
    flat = np.column_stack([x, y, ground(y) + rng.normal(0, 0.01, len(x))])
    cls = np.where(np.abs(aside(x, y)) < HALF_M, 11, 2)
    poles = place(12.0 + 21.0 * np.arange(10), np.where(np.arange(10) % 2, 6.5, -7.0))
    turn, rise = rng.uniform(0, 2 * np.pi, (2, 10, 80))
    rise = rise / (2 * np.pi) * 8.0
    posts = poles[:, None] + 0.13 * np.stack([np.cos(turn), np.sin(turn)], axis=-1)
    posts = np.column_stack([posts.reshape(-1, 2), (ground(poles[:, 1:]) + rise).ravel()])
    xyz = np.round(np.concatenate([flat, posts]), 3)
    cls = np.append(cls, np.full(len(posts), 1)).astype(np.uint8)
    station = 8.0 * np.arange(images)
    true = place(station, 1.8)
    shown = [_image(spot, poles, rng) for spot in true]
    slow = np.array([0.4, -0.3]) + 0.1 * np.sin(station[:, None] / 50.0 + [0.0, 1.0])
    return Lane(xyz, cls, true + slow, poles), shown


def _image(spot, poles, rng) -> tuple[np.ndarray, np.ndarray]:
    """Mask of project classes and 16 bit inverse depth, seen from a place in the right lane."""
    heading = float(np.degrees(np.arctan(middle(spot[1])[1]))) + 0.8 + rng.normal(0, 0.2)
    rotation = cam_from_world(heading, -2.5 + rng.normal(0, 0.2), 0.3)
    at = np.array([*spot, ground(spot[1]) + HEIGHT_M])
    v, u = (part.ravel() for part in np.mgrid[0 : LENS.height_px, 0 : LENS.width_px])
    way = pixel_directions(LENS, rotation, np.column_stack([u, v]))
    down = way[:, 2] - 0.01 * way[:, 1]
    reach = np.where(down < -1e-4, -HEIGHT_M / np.minimum(down, -1e-4), np.inf)
    seen = reach < 250.0
    hit = at + np.where(seen, reach, 0.0)[:, None] * way
    off = np.abs(aside(hit[:, 0], hit[:, 1]))
    mask = np.full(len(u), int(PixelClass.SKY), np.uint8)
    mask[seen] = np.where(off[seen] < HALF_M, int(PixelClass.ROAD), int(PixelClass.OTHER))
    mask[seen & (np.abs(off - 3.2) < 0.07)] = int(PixelClass.MARKING)
    inverse = np.where(seen, 1.0 / np.maximum(reach * (way @ rotation[2]), 1e-6), 0.0)
    mask, inverse = (part.reshape(LENS.height_px, LENS.width_px) for part in (mask, inverse))
    _draw_poles(mask, inverse, poles, rotation, at)
    steps = np.where(inverse > 0, 1 + 65_534 * np.minimum(inverse / 0.4, 1.0), 0)
    return np.ascontiguousarray(mask), steps.astype(np.uint16)


def _draw_poles(mask, inverse, poles, rotation, at) -> None:
    """Upright strips 0.26 m wide, the farthest first."""
    gaps = np.hypot(*(poles - at[:2]).T)
    for k in np.argsort(-gaps):
        across = np.array([-(poles[k] - at[:2])[1], (poles[k] - at[:2])[0]]) / gaps[k] * 0.13
        z = ground(poles[k, 1])
        ends = [[*(poles[k] + s * across), z + h] for s, h in ((1, 0), (1, 8), (-1, 8), (-1, 0))]
        uv, depth = project(LENS, rotation, at, np.array(ends))
        if (depth < 2.0).any() or gaps[k] > 90:
            continue
        corners = np.round(uv * 256).astype(np.int32)
        cv2.fillPoly(mask, [corners], int(PixelClass.POLE), shift=8)
        one = np.zeros_like(mask)
        cv2.fillPoly(one, [corners], 1, shift=8)
        inverse[one > 0] = 1.0 / depth[0]


TAKEN = {
    "rasterise_lidar": ("voxels", (Voxels,)),
    "extract_road_edges": ("road_edges", (RoadEdges,)),
    "read_videolog": ("videolog", (Videolog,)),
    "trace_image_edges": ("image_edges", (EdgeTracing,)),
    "calibrate_drive": ("alignment", (AlignmentMethod,)),
    "align_cameras": ("alignment", (AlignmentMethod, AlignmentLimits)),
    "measure_poles": ("sightings", (Sightings,)),
    "triangulate_poles": ("triangulation", (Triangulation,)),
}
"""Section of the settings that a stage takes, and which parts of it."""
BASELINE = {
    "800x480": {
        "hfov_deg": 60.0, "along_m": 0.0, "lateral_m": 0.0, "height_m": HEIGHT_M,
        "yaw_deg": 0.8, "pitch_deg": -3.1, "roll_deg": 0.3,
    }
}  # fmt: skip
"""The camera as a person would register it, to 0.1 m and 0.1 degrees."""


class PolesJob(StageCalls):
    """Runs the job in a folder.

    Parameters
    ----------
    folder : empty. shown : masks and depth of the images. tile_size_m, shards : of the run.
    settings : by section, those that are not as usual.
    """

    def __init__(
        self, folder: Path, shown, tile_size_m: float = 64.0, shards: int = 1, settings=None
    ) -> None:
        super().__init__(folder)
        self._shown, self._settings = shown, settings or {}
        self._tile_size_m, self._shards = tile_size_m, shards

    def _stage(self, stage: str, *options: str, **files: str) -> None:
        super()._stage(stage, *self._options(stage), *options, **files)

    def _options(self, stage: str) -> list[str]:
        """Options of the settings that a stage takes."""
        section, parts = TAKEN.get(stage, ("", ()))
        taken = {name for part in parts for name in part.model_fields} - {"landmarks", "ties"}
        options = []
        for name, value in self._settings.get(section, {}).items():
            if name in taken:
                values = value if isinstance(value, list) else [value]
                options += [f"--{name.replace('_', '-')}", *map(str, values)]
        if stage == "calibrate_drive" and self._settings.get(section, {}).get("method"):
            (self.folder / "baseline.json").write_text(json.dumps(BASELINE))
            options += ["--baseline", self.path("baseline.json")]
        return options

    def run(self, lane: Lane) -> PolesJob:
        """All stages from the cloud and the videolog to the poles."""
        self._scene(self.write(lane))
        parts = range(self._shards)
        for part in reversed(parts):
            self._show(part)
        self._cameras(parts)
        self._stage("triangulate_poles", "--sightings", *self._all("sightings", parts),
                    frame="frame", dem="dem.tif", voxels="voxels", poles="poles",
                    layers="poles.gpkg", csv="poles.csv", geojson="poles.geojson")  # fmt: skip
        return self

    def write(self, lane: Lane) -> Lane:
        """The cloud, the videolog and what its images show."""
        self._write_cloud(lane)
        self._write_images(lane)
        return lane

    def _all(self, name: str, parts) -> list[str]:
        return [self.path(f"{name}{part}") for part in parts]

    def _write_cloud(self, lane: Lane) -> None:
        unit_m = 1200 / 3937 if lane.units == "us-ft" else 1.0
        native = np.add(lane.xyz, [lane.east_m, 4_000_000.0, 0.0]) / unit_m
        header = laspy.LasHeader(point_format=6, version="1.4")
        header.scales = np.full(3, 0.001 if unit_m == 1.0 else 0.0001)
        header.offsets = np.floor(native.min(axis=0))
        cloud = laspy.LasData(header)
        cloud.x, cloud.y, cloud.z = native.T
        cloud.classification = lane.cls
        cloud.return_number = cloud.number_of_returns = np.ones(len(native), np.uint8)
        cloud.write(self.path("cloud.laz"))

    def _write_images(self, lane: Lane) -> None:
        to_degrees = Transformer.from_crs(
            CRS.from_proj4(PROJECTION.format(lane.east_m, "m")), 4326, always_xy=True
        )
        longitude, latitude = to_degrees.transform(*np.add(lane.gps, [lane.east_m, 4_000_000.0]).T)
        names = [f"i{number:03d}.png" for number in range(len(lane.gps))]
        grey = np.full((LENS.height_px, LENS.width_px), 90, np.uint8)
        for name, pair in zip(names, self._shown, strict=True):
            for folder, image in zip(("images", "masks", "depth"), (grey, *pair), strict=True):
                (self.folder / folder).mkdir(exist_ok=True)
                flipped = image[:, ::-1] if lane.mirrored else image
                cv2.imwrite(str(self.folder / folder / name), flipped)
        table = {"image": names, "latitude": latitude, "longitude": longitude, "route": "r"}
        pd.DataFrame(table | {"sequence": range(len(names))}).to_csv(
            self.path("videolog.csv"), index=False, float_format="%.10f"
        )

    def _scene(self, lane: Lane) -> None:
        site, both = ("--site", "lane"), {"cloud": "cloud", "frame": "frame"}
        unit = "metre" if lane.units == "m" else "us-survey-foot"
        crs = CRS.from_proj4(PROJECTION.format(lane.east_m, lane.units)).to_wkt()
        self._stage("ingest_cloud", *site, "--crs", crs, "--vertical-units", unit, "--units", unit,
                    "--tile-size-m", str(self._tile_size_m), clouds="cloud.laz",
                    **both)  # fmt: skip
        self._stage("profile_scene", **both, out="profile")
        self._stage("build_dem", *site, **both, profile="profile", dem="dem.tif", ground="ground")
        self._stage("rasterise_lidar", "--road-source", "class", **both, dem="dem.tif",
                    voxels="voxels", top="top.tif")  # fmt: skip
        self._stage("extract_road_edges", top="top.tif", frame="frame", edges="road_edges",
                    lines="lines.gpkg")  # fmt: skip
        self._stage("find_pole_columns", **both, dem="dem.tif", out="columns")
        self._stage("build_terrain", cloud="cloud", out="terrain.npz")
        self._stage("read_videolog", **both, videolog="videolog.csv", images="images",
                    dem="dem.tif", top="top.tif", out="frames")  # fmt: skip

    def _show(self, part: int) -> None:
        """What the images of a shard show."""
        shard = ("--shard", str(part), "--shards", str(self._shards))
        given = {"frames": "frames", "images": "images"}
        self._stage("segment_images", *shard, "--source", self.path("masks"), LABELS, **given,
                    out=f"masks{part}")  # fmt: skip
        self._stage("estimate_depth", *shard, "--source", self.path("depth"), **given,
                    out=f"depth{part}")  # fmt: skip
        shown = {"frames": "frames", "masks": f"masks{part}"}
        self._stage("trace_image_edges", *shard, **shown, out=f"edges{part}")
        self._stage("trace_pole_axes", *shard, **shown, out=f"axes{part}")
        self._stage("match_images", *shard, **given, out=f"matches{part}")

    def _cameras(self, parts) -> None:
        traced = ("--image-edges", *self._all("edges", parts), "--pole-axes")
        traced = (*traced, *self._all("axes", parts))
        there = {"frames": "frames", "road_edges": "road_edges", "frame": "frame",
                 "dem": "dem.tif", "terrain": "terrain.npz", "columns": "columns"}  # fmt: skip
        tied = ("--matches", *self._all("matches", parts))
        self._stage("calibrate_drive", *traced, *tied, **there, out="calibration")
        for part in parts:
            shard = ("--shard", str(part), "--shards", str(self._shards))
            marked = ("--min-marking-px", "60")
            self._stage("align_cameras", *traced, *shard, **there, calibration="calibration",
                        out=f"cameras{part}")  # fmt: skip
            self._stage("measure_poles", *shard, *marked, frames="frames",
                        calibration="calibration", cameras=f"cameras{part}",
                        masks=f"masks{part}", depth=f"depth{part}", dem="dem.tif",
                        columns="columns", voxels="voxels", frame="frame",
                        out=f"sightings{part}")  # fmt: skip

    @property
    def cameras(self) -> pd.DataFrame:
        """Poses of all images, by image."""
        tables = [read_table(path) for path in self._all("cameras", range(self._shards))]
        return pd.concat(tables).sort_values("image", ignore_index=True)

    def poles(self, lane: Lane) -> np.ndarray:
        """Kept poles (n, 2) in the lane's own metres, in the order of the true ones near them."""
        table = read_table(self.path("poles"))
        kept = table[table["kept"].to_numpy(bool)]
        origin = lane.xyz[:, :2].min(axis=0)
        found = kept[["x", "y"]].to_numpy(float) + origin
        return found[np.argsort(np.hypot(*(found[:, None] - lane.poles).T).argmin(axis=0))]
