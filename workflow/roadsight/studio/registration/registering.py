"""Registration by hand (paper 2, section 3.2.3): error, direct solve."""

from __future__ import annotations

from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from scipy.spatial import cKDTree

from roadsight.base.arrays import Bools, Floats
from roadsight.geometry.cameras import Intrinsics, cam_from_world, project, wrap_deg
from roadsight.io.cloud.tiles import CloudTiles, stack_xyz
from roadsight.io.raster.rasters import read_raster
from roadsight.poles.alignment.drive import Place
from roadsight.poles.alignment.published import WINDOW_PX, by_row, window_squares
from roadsight.poles.calibration.registration import Registration, is_flat, register_camera
from roadsight.studio.cloud.levels import level_of_points
from roadsight.studio.edges.shapes import Metre, Shape
from roadsight.studio.project import CLOUD, DEM, SiteFolder
from roadsight.studio.registration.drive import POSE, SiteDrive

_BESIDE_M = 5.0
"""Points nearer than this are sent in all directions, because a camera that is moved may come to
see them."""
_AHEAD_M = 150.0
"""Points further away are not sent."""
_ROOM_DEG = 12.0
"""Points so far beyond the image's sides are sent, so that the camera can be turned."""
_MOST_POINTS = 60_000
"""Points that are sent of an image, coarse ones first."""
POINT = np.dtype([("xyz", "<f4", 3), ("height_m", "<f4")])
Angle = Annotated[float, Field(ge=-360, le=360, allow_inf_nan=False)]
Pixel = Annotated[float, Field(ge=-1e5, le=1e5, allow_inf_nan=False)]


class PoseBody(Shape):
    """A camera's pose in the local frame and its focal length."""

    x: Metre
    y: Metre
    z: Metre
    heading_deg: Angle
    pitch_deg: Annotated[float, Field(ge=-89, le=89, allow_inf_nan=False)]
    roll_deg: Angle
    focal_px: Annotated[float, Field(ge=10, le=1e6, allow_inf_nan=False)]

    def row(self) -> dict[str, float]:
        """Numbers by the names of `POSE`."""
        return {name: float(getattr(self, name)) for name in POSE}


class Pair(Shape):
    """A clicked pixel and the place that it shows."""

    u: Pixel
    v: Pixel
    x: Metre
    y: Metre
    z: Metre


class PairsBody(Shape):
    """Clicked pairs of one image."""

    pairs: Annotated[list[Pair], Field(max_length=500)]


class Registered(Shape):
    """One registered image: its number, pose, and the pairs it rests on, if any."""

    number: Annotated[int, Field(ge=0)]
    pose: PoseBody
    pairs: Annotated[list[Pair], Field(max_length=500, default_factory=list)]


class BaselineBody(Shape):
    """Registered images that make the baselines."""

    images: Annotated[list[Registered], Field(min_length=1, max_length=200)]


def image_content(drive: SiteDrive, number: int) -> dict[str, Any]:
    """Poses of an image, its edges, and the cloud's edges and poles around it."""
    place = drive.place(number)
    image_edges, map_edges = drive.scene.edges_of(place)
    groups = [
        image_edges.uv_px[a:b]
        for a, b in zip(image_edges.groups[:-1], image_edges.groups[1:], strict=True)
    ]
    names = ("lane_left", "lane_right", "border_left", "border_right")
    expected = drive.expected(place)
    return {
        "image": place.image,
        "size": [place.start.width_px, place.start.height_px],
        "centre": [place.start.cx_px, place.start.cy_px],
        "expected": expected,
        "solved": drive.solved(place.image),
        "corrected": place.image in drive.corrections,
        "pixels": {n: g.round(1).ravel().tolist() for n, g in zip(names, groups, strict=True)},
        "left": map_edges.xyz_m[: map_edges.left].round(3).ravel().tolist(),
        "right": map_edges.xyz_m[map_edges.left :].round(3).ravel().tolist(),
        "error": alignment_error(drive, place, drive.solved(place.image) or expected),
    }


def alignment_error(drive: SiteDrive, place: Place, pose: dict[str, float]) -> dict[str, Any]:
    """Distance of the cloud's edges from the image's: typical, and root mean square by side.

    Each projected edge point in the image counts with the nearest edge pixel of its own side within
    the window of the published alignment; None where nothing is near. Edges that the image does not
    show (a crest, a crossing) weigh on the mean square; the median is what fits by eye.
    """
    image_edges, map_edges = drive.scene.edges_of(place)
    start = place.start
    camera = Intrinsics(start.width_px, start.height_px, pose["focal_px"], start.cx_px, start.cy_px)
    rotation = cam_from_world(pose["heading_deg"], pose["pitch_deg"], pose["roll_deg"])
    uv, _ = project(camera, rotation, [pose["x"], pose["y"], pose["z"]], map_edges.xyz_m)
    inside = camera.contains(uv)
    found: dict[str, Any] = {}
    total, count, every = 0.0, 0, [np.empty(0)]
    for side, part in (
        ("left", slice(None, map_edges.left)),
        ("right", slice(map_edges.left, None)),
    ):
        first = ("left", "right").index(side)
        pixels = np.concatenate([_group(image_edges, first), _group(image_edges, first + 2)])
        squares = window_squares(uv[part][inside[part]], by_row(pixels), WINDOW_PX, WINDOW_PX)
        squares = squares[np.isfinite(squares)]
        gained, near = float(squares.sum()), len(squares)
        every.append(_gaps(uv[part][inside[part]], pixels))
        found[f"{side}_px"] = float(np.sqrt(gained / near)) if near else None
        total, count = total + gained, count + near
    gaps = np.concatenate(every)
    return found | {
        "rms_px": float(np.sqrt(total / count)) if count else None,
        "median_px": float(np.median(gaps)) if len(gaps) else None,
        "points": count,
    }


def _gaps(uv: Floats, pixels: Floats) -> Floats:
    """Distances to the nearest pixel of the points that have one within the window."""
    if not len(uv) or not len(pixels):
        return np.empty(0)
    gap_px, _ = cKDTree(pixels).query(uv)
    return gap_px[gap_px <= WINDOW_PX]


def _group(seen: Any, number: int) -> Floats:
    return np.asarray(seen.uv_px[seen.groups[number] : seen.groups[number + 1]], np.float64)


def points_around(site: SiteFolder, drive: SiteDrive, number: int) -> bytes:
    """Points of the cloud that a camera may see, as `POINT`, coarse ones first."""
    place = drive.place(number)
    pose = drive.solved(place.image) or drive.expected(place)
    eye = np.array([pose["x"], pose["y"]])
    west, south, east, north = (*(eye - _AHEAD_M), *(eye + _AHEAD_M))
    tiles = CloudTiles(site.file(CLOUD))
    xyz = stack_xyz(tiles.read_within((west, south, east, north), ("x", "y", "z")))
    xyz = xyz[before_camera(xyz[:, :2] - eye, pose["heading_deg"], _view_deg(place, pose))]
    order = np.argsort(level_of_points(xyz), kind="stable")[:_MOST_POINTS]
    packed = np.zeros(len(order), POINT)
    packed["xyz"] = xyz[order]
    packed["height_m"] = _above_ground(site, drive, xyz[order])
    return packed.tobytes()


def _view_deg(place: Place, pose: dict[str, float]) -> float:
    """Half the horizontal field of view, and room to turn."""
    half = np.degrees(np.arctan2(0.5 * place.start.width_px, pose["focal_px"]))
    return float(min(half + _ROOM_DEG, 90.0))


def before_camera(offset_m: NDArray[np.floating], heading_deg: float, half_deg: float) -> Bools:
    """Whether plan offsets (n, 2) from a camera lie within its view, or right beside it."""
    azimuth = np.degrees(np.arctan2(offset_m[:, 0], offset_m[:, 1]))
    away = np.hypot(*offset_m.T)
    within = np.abs(wrap_deg(azimuth - heading_deg)) <= half_deg
    return (away <= _AHEAD_M) & (within | (away <= _BESIDE_M))


def _above_ground(site: SiteFolder, drive: SiteDrive, xyz: NDArray) -> Floats:
    ground = read_raster(site.file(DEM), drive.frame).sample(xyz[:, 0], xyz[:, 1])
    return np.nan_to_num(xyz[:, 2] - ground)


def solve_pairs(drive: SiteDrive, number: int, pairs: list[Pair]) -> dict[str, Any]:
    """Pose from clicked pairs, each pair's distance, and how certain it is.

    Raises
    ------
    InputError : the pairs do not determine the camera.
    """
    found = registration(drive.place(number), pairs)
    names = ("x_m", "y_m", "z_m", "pitch_rad", "yaw_rad", "roll_rad", "log_focal")
    return {
        "pose": registered_pose(found),
        "residuals_px": found.residuals_px.round(2).tolist(),
        "rms_px": float(np.sqrt((found.residuals_px**2).mean())),
        "sigma": dict(zip(names, found.sigma.tolist(), strict=True)),
        "flat": is_flat([[p.x, p.y, p.z] for p in pairs]),
    }


def registration(place: Place, pairs: list[Pair]) -> Registration:
    """Camera of an image from its pairs, about the principal point of its drive."""
    uv = [[p.u, p.v] for p in pairs]
    xyz = [[p.x, p.y, p.z] for p in pairs]
    start = place.start
    return register_camera(uv, xyz, start.width_px, start.height_px, (start.cx_px, start.cy_px))


def registered_pose(found: Registration) -> dict[str, float]:
    """A registered camera by the names of `POSE`."""
    angles = (found.heading_deg, found.pitch_deg, found.roll_deg)
    return dict(zip(POSE, map(float, (*found.position_m, *angles, found.focal_px)), strict=True))
