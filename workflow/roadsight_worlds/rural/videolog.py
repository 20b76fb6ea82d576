"""Drives along the rural road: where every image is taken, truly and by GPS.

A vehicle follows its lane with a slow wander, pitches and rolls with the road, and shakes. A camera
is bolted to it with small angles that nobody wrote down. Side cameras share the front camera's
mount and turn about its vertical axis by just under the field of view, so that views stitch.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import ArrayLike

from roadsight.base.arrays import Floats
from roadsight.base.sections.run import RuralScene
from roadsight.geometry.cameras import (
    Intrinsics,
    attitude_deg,
    cam_from_world,
    compass_deg,
    wrap_deg,
)
from roadsight_worlds.rendering.images import Camera
from roadsight_worlds.rural.image_names import STEPS_M, place_name, places_along
from roadsight_worlds.rural.rural_road import RuralSite

_USUAL = RuralScene()  # What a rural road is, unless asked for another.
_STITCH_OVERLAP_DEG = 1.5  # Side views overlap the front view by so much.
# From a camera's axes (right, down, ahead) to right, ahead, up.
_UP_FROM_CAMERA = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])


@dataclass(frozen=True)
class Mount:
    """How a camera sits on its vehicle: what the pipeline has to find out.

    Parameters
    ----------
    height_m : above the road. yaw_deg, pitch_deg, roll_deg : against the vehicle (right, up, right
        side up). antenna_left_m, antenna_ahead_m : GPS antenna from the camera.
    """

    height_m: float
    yaw_deg: float
    pitch_deg: float
    roll_deg: float
    antenna_left_m: float
    antenna_ahead_m: float


@dataclass(frozen=True)
class Shake:
    """Sigma of what changes from image to image: angles in degrees, height in metres."""

    yaw_deg: float = 0.3
    pitch_deg: float = 0.3
    roll_deg: float = 0.1
    height_m: float = 0.02


@dataclass(frozen=True)
class GpsNoise:
    """Error of a GPS place, each axis: slow (Gauss-Markov over distance) and white."""

    slow_sigma_m: float = 0.7
    correlation_m: float = 100.0
    white_sigma_m: float = 0.2

    def draw(self, travelled_m: ArrayLike, rng: np.random.Generator) -> Floats:
        """Errors (n, 2) at distances travelled (n,), increasing, metres."""
        step = np.diff(np.asarray(travelled_m, float), prepend=-np.inf)
        keep = np.exp(-step / self.correlation_m)
        kicks = rng.normal(size=(len(step), 2)) * np.sqrt(1.0 - keep**2)[:, None]
        slow, error = np.empty_like(kicks), np.zeros(2)
        for i in range(len(step)):
            error = keep[i] * error + kicks[i]
            slow[i] = error
        white = rng.normal(0.0, self.white_sigma_m, slow.shape)
        return self.slow_sigma_m * slow + white


def drifting(drift_m: float) -> GpsNoise:
    """A receiver without corrections whose error stays within ``drift_m`` for 19 of 20 places.

    A real drive's positions scatter by 0.6 m beside a drift of 3 m that takes some hundred metres.
    """
    return GpsNoise(slow_sigma_m=drift_m / 2.0, correlation_m=400.0, white_sigma_m=0.6)


@dataclass(frozen=True)
class Drive:
    """One pass along the road.

    Parameters
    ----------
    route : its name. forward : towards rising stations. step_m : between images.
    intrinsics, mount : of the front camera. views : names and turns to the right, degrees.
    """

    route: str
    forward: bool
    step_m: float
    intrinsics: Intrinsics
    mount: Mount
    views: dict[str, float]
    shake: Shake = field(default_factory=Shake)
    gps: GpsNoise = field(default_factory=GpsNoise)


@dataclass(frozen=True)
class Shot:
    """One place where images are taken.

    Parameters
    ----------
    route, sequence : of the place, from 1. station_m : where on the road.
    cameras : by view, true. gps_xy_m : (2,) what the GPS says, local metres.
    ground_m : height of the road under the camera.
    """

    route: str
    sequence: int
    station_m: float
    cameras: dict[str, Camera]
    gps_xy_m: Floats
    ground_m: float

    def name(self, view: str = "front") -> str:
        """File name of the view's image."""
        ending = "" if view == "front" else f"_{view}"
        return f"{place_name(self.route, self.sequence)}{ending}.jpg"


def random_drives(
    seed: int,
    narrow_px: tuple[int, int] = (640, 416),
    wide_px: tuple[int, int] = (640, 448),
    hfov_deg: float = _USUAL.hfov_deg,
    side_views: bool = _USUAL.side_views,
    principal_point_px: float = _USUAL.principal_point_px,
    gps: GpsNoise | None = None,
) -> tuple[Drive, Drive]:
    """A narrow camera with side views ahead every 8 m, and a wide one back every 16 m.

    Parameters
    ----------
    narrow_px, wide_px : width and height of the images. hfov_deg : field of view of the first
    camera, about 20 degrees if 0. side_views : whether it has any. principal_point_px : to the
    right of and below the images' middle. gps : error of the places, the usual one if None.
    """
    rng = np.random.default_rng([seed, 21])
    usual = rng.uniform(19.0, 22.5)
    fov = hfov_deg or usual
    turn = fov - _STITCH_OVERLAP_DEG
    narrow = Intrinsics.from_field_of_view(*narrow_px, fov)
    wide = Intrinsics.from_field_of_view(*wide_px, rng.uniform(55.0, 64.0))
    narrow, wide = (
        replace(lens, cx_px=lens.cx_px + principal_point_px, cy_px=lens.cy_px + principal_point_px)
        for lens in (narrow, wide)
    )
    gps = gps or GpsNoise()
    views = {"front": 0.0}
    if side_views:
        views |= {"left": -turn, "right": turn}
    (ahead, ahead_m), (back, back_m) = STEPS_M.items()
    return (
        Drive(ahead, True, ahead_m, narrow, _random_mount(2.2, rng), views, gps=gps),
        Drive(back, False, back_m, wide, _random_mount(1.6, rng), {"front": 0.0}, gps=gps),
    )


def _random_mount(height_m: float, rng: np.random.Generator) -> Mount:
    """Angles of one to two degrees either way; the antenna within half a metre aside."""
    yaw, roll = rng.choice([-1.0, 1.0], 2) * rng.uniform(0.8, 1.8, 2)
    pitch = -rng.uniform(0.8, 2.0)
    left = rng.choice([-1.0, 1.0]) * rng.uniform(0.2, 0.5)
    return Mount(
        height_m + float(rng.uniform(-0.08, 0.08)),
        float(yaw),
        float(pitch),
        float(roll),
        float(left),
        float(rng.uniform(-1.6, -0.6)),
    )


def shots(site: RuralSite, drive: Drive, seed: int) -> list[Shot]:
    """Every place of a drive in order; the same arguments give the same places."""
    rng = np.random.default_rng([seed, 22, int(drive.forward)])
    count = places_along(site.length_m, drive.step_m)
    travelled = drive.step_m * np.arange(count, dtype=np.float64)
    station = travelled if drive.forward else site.length_m - travelled
    way_m = site.ground.section.drive_m * (-1.0 if drive.forward else 1.0)
    # Two slow waves in the lane.
    lengths, phases = rng.uniform(90.0, 260.0, 2), rng.uniform(0.0, 2.0 * np.pi, 2)
    angle = 2.0 * np.pi * station[:, None] / lengths + phases
    rate = 2.0 * np.pi / lengths
    offset = way_m + 0.11 * np.sin(angle).sum(axis=1)
    drift = 0.11 * (np.cos(angle) * rate).sum(axis=1)  # per metre of station
    noise = drive.gps.draw(travelled, rng)
    shakes = rng.normal(size=(count, 4))
    return [
        _shot(site, drive, i + 1, (station[i], offset[i], drift[i]), noise[i], shakes[i])
        for i in range(count)
    ]


def _shot(
    site: RuralSite,
    drive: Drive,
    sequence: int,
    place: tuple[float, float, float],
    noise: Floats,
    shake: Floats,
) -> Shot:
    """Cameras and GPS place at a station, offset and drift."""
    station, offset, _ = place
    vehicle = vehicle_rotation(site, drive.forward, *place)
    mount, sigma = drive.mount, drive.shake
    front = mounted(
        vehicle,
        mount.yaw_deg + sigma.yaw_deg * shake[0],
        mount.pitch_deg + sigma.pitch_deg * shake[1],
        mount.roll_deg + sigma.roll_deg * shake[2],
    )
    xy, ground = site.line.plan(station, offset), float(site.ground.height(station, offset))
    eye = ground + mount.height_m + sigma.height_m * shake[3]
    position = np.array([*xy, eye])
    cameras = {
        view: Camera(drive.intrinsics, mounted(front, turn, 0.0, 0.0), position)
        for view, turn in drive.views.items()
    }
    right, _, ahead = vehicle
    antenna = position - mount.antenna_left_m * right + mount.antenna_ahead_m * ahead
    return Shot(drive.route, sequence, float(station), cameras, antenna[:2] + noise, ground)


def vehicle_rotation(
    site: RuralSite, forward: bool, station: float, offset: float, drift: float
) -> Floats:
    """Rotation (3, 3) whose rows are right, down and ahead of a vehicle on the road."""
    turn = float(site.line.heading(station)) + np.arctan(drift)
    heading = 90.0 - np.degrees(turn) + (0.0 if forward else 180.0)
    way = 1.0 if forward else -1.0
    ends = site.ground.height(np.array([station - 1.4, station + 1.4]), offset)
    sides = site.ground.height(station, offset + np.array([-0.75, 0.75]))
    pitch = np.degrees(np.arctan2(way * (ends[1] - ends[0]), 2.8))
    roll = np.degrees(np.arctan2(way * (sides[0] - sides[1]), 1.5))
    return cam_from_world(heading, pitch, roll)


def road_rotation(site: RuralSite, forward: bool, station: float) -> Floats:
    """The same of the road at a station, as its edges have it: without the fall of one lane."""
    way, edge_m = 1.0 if forward else -1.0, site.ground.section.pavement_m
    heading = 90.0 - np.degrees(float(site.line.heading(station))) + (0.0 if forward else 180.0)
    ends = site.ground.height(np.array([station - 1.4, station + 1.4]), 0.0)
    sides = site.ground.height(station, np.array([-edge_m, edge_m]))
    pitch = np.degrees(np.arctan2(way * (ends[1] - ends[0]), 2.8))
    roll = np.degrees(np.arctan2(way * (sides[0] - sides[1]), 2.0 * edge_m))
    return cam_from_world(heading, pitch, roll)


def mounted(base: Floats, yaw_deg: float, pitch_deg: float, roll_deg: float) -> Floats:
    """Rotation of a camera turned against another: right about its vertical, up, right side up."""
    return cam_from_world(yaw_deg, pitch_deg, roll_deg) @ _UP_FROM_CAMERA @ base


def mount_of(camera: Camera, base: Floats) -> tuple[float, float, float]:
    """Yaw, pitch and roll of a camera against another rotation, degrees; inverse of `mounted`."""
    yaw, pitch, roll = attitude_deg(camera.rotation @ base.T @ _UP_FROM_CAMERA.T)
    return float(wrap_deg(yaw)), float(pitch), float(roll)


def attitude_of(camera: Camera) -> tuple[float, float, float]:
    """Heading from grid north, pitch, roll, degrees."""
    heading, pitch, roll = attitude_deg(camera.rotation)
    return float(compass_deg(heading)), float(pitch), float(roll)
