"""An analytic road with known cameras, for the tests and the benchmark of camera alignment.

A winding, hilly road with two pavement edges and two painted edge lines; a vehicle in the right
lane whose position is known to about a metre and whose camera sways; edge pixels with noise, gaps
and clutter; LiDAR edges snapped to a raster.
"""

from dataclasses import dataclass, field

import numpy as np
import pandas as pd

from roadsight.geometry.cameras import Intrinsics, cam_from_world, project
from roadsight.poles.alignment.pose import Pose

STEP_M = 0.5


@dataclass
class Mount:
    """What all images of the drive share."""

    hfov_deg: float = 60.0
    yaw_deg: float = 0.6
    pitch_deg: float = -2.0
    roll_deg: float = 0.4
    height_m: float = 2.4
    lateral_m: float = 0.2
    lane_inset_m: float = 0.5


@dataclass
class RoadBed:
    """Road, drive and images."""

    seed: int = 0
    images: int = 60
    mount: Mount = field(default_factory=Mount)
    width_px: int = 2000
    height_px: int = 1200
    spacing_m: float = 8.0
    gps_m: float = 1.0
    gps_length_m: float = 80.0
    yaw_sway_deg: float = 0.3
    pitch_sway_deg: float = 0.3
    roll_sway_deg: float = 0.1
    pixel_px: float = 1.0
    outliers: float = 0.2
    raster_m: float = 0.3
    raster_heights: bool = False
    bend: float = 1.0
    hills: float = 1.0
    lanes: bool = True
    borders: bool = True
    left: bool = True
    half_width_m: float = 4.1
    origin_m: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def __post_init__(self):
        rng = np.random.default_rng(self.seed)
        length = self.images * self.spacing_m + 340.0
        s = np.arange(0.0, length, STEP_M)
        phase = rng.uniform(0, 2 * np.pi, 4)
        curvature = self.bend * (
            0.0025 * np.sin(2 * np.pi * s / 330.0 + phase[0])
            + 0.0015 * np.sin(2 * np.pi * s / 140.0 + phase[1])
        )
        heading = rng.uniform(0, 2 * np.pi) + np.cumsum(curvature) * STEP_M
        self.line = np.cumsum(np.column_stack([np.sin(heading), np.cos(heading)]), axis=0) * STEP_M
        self.right = np.column_stack([np.cos(heading), -np.sin(heading)])
        self.z = self.hills * (
            2.5 * np.sin(2 * np.pi * s / 600.0 + phase[2])
            + 0.6 * np.sin(2 * np.pi * s / 230.0 + phase[3])
        )
        self.heading_rad = heading
        self.grade = np.gradient(self.z, STEP_M)
        self._edges()
        self._drive(rng)
        self.seen = [self._see(i, rng) for i in range(self.images)]

    def on_road(self, index, aside_m):
        """Places at stations, so far to the right, crowned by 2 %; local metres."""
        xy = self.line[index] + self.right[index] * np.asarray(aside_m, float)[..., None]
        z = self.z[index] - 0.02 * np.abs(aside_m)
        return np.concatenate([xy, z[..., None]], axis=-1) + self.origin_m

    def _edges(self):
        every = np.arange(len(self.line) * 5) / 5.0
        low = np.minimum(every.astype(int), len(self.line) - 2)
        part = (every - low)[:, None]
        sides = []
        for aside in (-self.half_width_m, self.half_width_m):
            a = self.on_road(low, np.full(len(low), aside))
            b = self.on_road(low + 1, np.full(len(low), aside))
            sides.append(a + part * (b - a))
        points = np.concatenate(sides)
        self.true_edges = points[::10]
        if self.raster_m:
            cell = np.floor(points / self.raster_m).astype(np.int64)
            _, first = np.unique(cell[:, :2], axis=0, return_index=True)
            first = np.sort(first)
            snapped = (cell[first] + 0.5) * self.raster_m
            if not self.raster_heights:
                rng = np.random.default_rng(self.seed + 1)
                snapped[:, 2] = points[first, 2] + rng.normal(0, 0.03, len(first))
            points = snapped
        self.road_edges = points

    def _drive(self, rng):
        index = (60 + np.arange(self.images) * self.spacing_m / STEP_M).astype(int)
        self.index = index
        aside = np.full(self.images, 1.8) + 0.2 * np.sin(np.arange(self.images) / 9.0)
        self.vehicle = self.on_road(index, aside)
        gaps = np.subtract.outer(index, index) * STEP_M
        shape = np.exp(-0.5 * (gaps / self.gps_length_m) ** 2) + 1e-6 * np.eye(self.images)
        error = np.linalg.cholesky(shape) @ rng.normal(0, self.gps_m, (self.images, 2))
        self.track = self.vehicle[:, :2] + error
        self.z_road = self.on_road(index, aside)[:, 2]
        sway = rng.normal(0, 1, (self.images, 3))
        m = self.mount
        focal = Intrinsics.from_field_of_view(self.width_px, self.height_px, m.hfov_deg).focal_px
        self.intrinsics = Intrinsics.centred(self.width_px, self.height_px, focal)
        self.truth = []
        for i, k in enumerate(index):
            centre = self.vehicle[i] + [*(m.lateral_m * self.right[k]), m.height_m]
            self.truth.append(
                Pose(
                    *centre,
                    float(
                        np.degrees(self.heading_rad[k]) + m.yaw_deg + self.yaw_sway_deg * sway[i, 0]
                    )
                    % 360,
                    float(
                        np.degrees(np.arctan(self.grade[k]))
                        + m.pitch_deg
                        + self.pitch_sway_deg * sway[i, 1]
                    ),
                    m.roll_deg + self.roll_sway_deg * sway[i, 2] - np.degrees(0.02),
                    focal,
                    self.intrinsics.cx_px,
                )
            )

    def project(self, pose, points_m):
        """Pixels of points, NaN where out of sight of the image."""
        rotation = cam_from_world(pose.heading_deg, pose.pitch_deg, pose.roll_deg)
        camera = Intrinsics.centred(self.width_px, self.height_px, pose.focal_px)
        uv, _ = project(camera, rotation, pose.position_m, points_m)
        uv[~camera.contains(uv)] = np.nan
        return uv

    def _see(self, i, rng):
        pose, k = self.truth[i], self.index[i]
        reach_m = rng.uniform(90.0, 200.0)
        stations = k + np.arange(8, int(reach_m / STEP_M))
        # Hidden behind a crest: below the highest line of sight over the road before it.
        rise = (self.z[stations] + self.origin_m[2] - pose.z_m) / ((stations - k) * STEP_M)
        stations = stations[rise >= np.maximum.accumulate(rise) - 1e-3]
        found = []
        for lane, aside in (
            (True, self.half_width_m - self.mount.lane_inset_m),
            (False, self.half_width_m),
        ):
            if not (self.lanes if lane else self.borders):
                continue
            for side in (-1, 1) if self.left else (1,):
                uv = self._trace(pose, stations, side * aside, rng)
                found.append(np.column_stack([uv, np.full(len(uv), side), np.full(len(uv), lane)]))
        rows = np.concatenate(found) if found else np.empty((0, 4))
        return np.concatenate([rows, self._clutter(rows, rng)])

    def _trace(self, pose, stations, aside, rng):
        points = self.on_road(stations, np.full(len(stations), aside))
        rotation = cam_from_world(pose.heading_deg, pose.pitch_deg, pose.roll_deg)
        uv, depth = project(self.intrinsics, rotation, pose.position_m, points)
        joined = np.diff(stations) == 1
        pixels = []
        for a, b, near in zip(uv[:-1], uv[1:], joined & (depth[:-1] > 1), strict=True):
            if near and np.isfinite([a, b]).all():
                steps = max(int(np.hypot(*(b - a))), 1)
                if steps < 3000:
                    pixels.append(a + np.linspace(0, 1, steps, endpoint=False)[:, None] * (b - a))
        if not pixels:
            return np.empty((0, 2))
        pixels = np.concatenate(pixels)
        pixels = pixels[self.intrinsics.contains(pixels)]
        gap = np.sin(np.arange(len(pixels)) / max(len(pixels), 1) * 25 + rng.uniform(0, 7)) > 0.6
        pixels = pixels[~gap]
        return pixels + rng.normal(0, self.pixel_px, pixels.shape)

    def _clutter(self, rows, rng):
        """Straight lines of other things, some of them along the road."""
        wanted = int(self.outliers / (1 - self.outliers) * len(rows)) if self.outliers else 0
        parts, count = [], 0
        while count < wanted and len(rows):
            a = rows[rng.integers(len(rows)), :2] + rng.normal(0, 60, 2)
            angle, length = rng.uniform(0, np.pi), rng.uniform(30, 250)
            t = np.arange(length)[:, None]
            line = a + t * [np.cos(angle), np.sin(angle)]
            side = np.where(rng.random() < 0.8, np.sign(a[0] - np.median(rows[:, 0])), 0) or 1.0
            parts.append(
                np.column_stack([line, np.full(len(t), side), np.full(len(t), rng.integers(2))])
            )
            count += len(t)
        return np.concatenate(parts)[:wanted] if parts else np.empty((0, 4))


def frames_of(bed, route="r1"):
    """Table of the bed's images as the videolog's reader writes it."""
    chord = np.diff(bed.track, axis=0)
    heading = np.degrees(np.arctan2(chord[:, 0], chord[:, 1])) % 360
    return pd.DataFrame(
        {
            "image": [f"{route}_{i:04d}.jpg" for i in range(bed.images)],
            "route": route,
            "sequence": np.arange(bed.images),
            "x": bed.track[:, 0],
            "y": bed.track[:, 1],
            "z_road": bed.z_road,
            "heading_deg": np.append(heading, heading[-1]),
            "width_px": bed.width_px,
            "height_px": bed.height_px,
            "status": "ok",
        }
    )


def edge_table(bed, route="r1"):
    """Table of the bed's image edges."""
    parts = []
    for i, rows in enumerate(bed.seen):
        kind = np.where(rows[:, 3] > 0.5, "lane", "border")
        parts.append(
            pd.DataFrame(
                {
                    "image": f"{route}_{i:04d}.jpg",
                    "u": rows[:, 0].astype(np.float32),
                    "v": rows[:, 1].astype(np.float32),
                    "side": rows[:, 2].astype(np.int8),
                    "kind": kind,
                }
            )
        )
    return pd.concat(parts, ignore_index=True)
