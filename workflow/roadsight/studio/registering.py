"""Registration by hand (paper 2, section 3.2.3): error, direct solve."""

from __future__ import annotations

import csv
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from pydantic import Field
from scipy.spatial import cKDTree

from roadsight.base.arrays import Bools, Floats
from roadsight.base.errors import InputError
from roadsight.geometry.cameras import Intrinsics, cam_from_world, project, wrap_deg
from roadsight.geometry.frames import Frame
from roadsight.io.cloud.tiles import CloudTiles, stack_xyz
from roadsight.io.images.camera_tables import read_baselines
from roadsight.io.raster.rasters import read_raster
from roadsight.io.records.atomic import write_json
from roadsight.poles.alignment.drive import Place
from roadsight.poles.alignment.published import WINDOW_PX, by_row, window_squares
from roadsight.poles.calibration.registration import (
    Registration,
    baseline,
    is_flat,
    register_camera,
)
from roadsight.studio.cloud_tiles import level_of_points
from roadsight.studio.drawing import Metre
from roadsight.studio.drive_views import POSE, SiteDrive, read_corrections
from roadsight.studio.project import CLOUD, DEM, Project, SiteFolder
from roadsight.studio.requests import Body
from roadsight.studio.site_files import Writer, save_beside, saving, write_table

# Points nearer than this are sent in all directions, because a camera that is moved may come to see
# them
_BESIDE_M = 5.0
_AHEAD_M = 150.0  # Points further away are not sent
# Points so far beyond the image's sides are sent, so that the camera can be turned
_ROOM_DEG = 12.0
_MOST_POINTS = 60_000  # Points that are sent of an image, coarse ones first
POINT = np.dtype([("xyz", "<f4", 3), ("height_m", "<f4")])
Angle = Annotated[float, Field(ge=-360, le=360, allow_inf_nan=False)]
Pixel = Annotated[float, Field(ge=-1e5, le=1e5, allow_inf_nan=False)]


class PoseBody(Body):
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


class Pair(Body):
    """A clicked pixel and the place that it shows."""

    u: Pixel
    v: Pixel
    x: Metre
    y: Metre
    z: Metre


class PairsBody(Body):
    """Clicked pairs of one image."""

    pairs: Annotated[list[Pair], Field(max_length=500)]


class Registered(Body):
    """One registered image: its number, pose, and the pairs it rests on, if any."""

    number: Annotated[int, Field(ge=0)]
    pose: PoseBody
    pairs: Annotated[list[Pair], Field(max_length=500, default_factory=list)]


class BaselineBody(Body):
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
    sides = {"left": slice(None, map_edges.left), "right": slice(map_edges.left, None)}
    for first, (side, part) in enumerate(sides.items()):
        pixels = np.concatenate([_group(image_edges, first), _group(image_edges, first + 2)])
        points = uv[part][inside[part]]
        squares = window_squares(points, by_row(pixels), WINDOW_PX, WINDOW_PX)
        squares = squares[np.isfinite(squares)]
        gained, near = float(squares.sum()), len(squares)
        if len(points) and len(pixels):
            gap_px, _ = cKDTree(pixels).query(points)
            every.append(gap_px[gap_px <= WINDOW_PX])
        found[f"{side}_px"] = float(np.sqrt(gained / near)) if near else None
        total, count = total + gained, count + near
    gaps = np.concatenate(every)
    return found | {
        "rms_px": float(np.sqrt(total / count)) if count else None,
        "median_px": float(np.median(gaps)) if len(gaps) else None,
        "points": count,
    }


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
    half = np.degrees(np.arctan2(0.5 * place.start.width_px, pose["focal_px"]))
    view_deg = float(min(half + _ROOM_DEG, 90.0))  # half the field of view, and room to turn
    xyz = xyz[before_camera(xyz[:, :2] - eye, pose["heading_deg"], view_deg)]
    xyz = xyz[np.argsort(level_of_points(xyz), kind="stable")[:_MOST_POINTS]]
    ground = read_raster(site.file(DEM), drive.frame).sample(xyz[:, 0], xyz[:, 1])
    packed = np.zeros(len(xyz), POINT)
    packed["xyz"] = xyz
    packed["height_m"] = np.nan_to_num(xyz[:, 2] - ground)
    return packed.tobytes()


def before_camera(offset_m: NDArray[np.floating], heading_deg: float, half_deg: float) -> Bools:
    """Whether plan offsets (n, 2) from a camera lie within its view, or right beside it."""
    azimuth = np.degrees(np.arctan2(offset_m[:, 0], offset_m[:, 1]))
    away = np.hypot(*offset_m.T)
    within = np.abs(wrap_deg(azimuth - heading_deg)) <= half_deg
    return (away <= _AHEAD_M) & (within | (away <= _BESIDE_M))


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


# What registration by hand leaves: baselines with their pairs, corrections of single images.

# Standard deviations of a pose set by eye: metres, radians, log focal length
_HAND = np.array([0.3, 0.3, 0.1, 0.005, 0.005, 0.005, 0.01])
_BASELINE = "baseline.json"
_PAIRS = "pairs.csv"
_CORRECTIONS = "corrections.csv"
_HEADER = ["image", "pixel_x", "pixel_y", "x", "y", "z"]


def save_baseline(project: Project, drive: SiteDrive, images: list[Registered]) -> dict[str, Any]:
    """Write the baseline of each image size, and the pairs that it rests on.

    Baselines and pairs of other image sizes stay.

    Returns
    -------
    changed : files. baselines : content by image size, of these images.

    Raises
    ------
    InputError : an image has no place, or the site file cannot be changed.
    """
    found: dict[str, list[Any]] = {}
    for one in images:
        place = drive.place(one.number)
        size = f"{place.start.width_px}x{place.start.height_px}"
        seen = _by_hand(drive, place, one)
        # The same view about the expected principal point: a drive's is found after its baseline.
        turn = np.arctan(drive.shift_px(place) / seen.focal_px)
        seen = replace(seen, heading_deg=seen.heading_deg - float(np.degrees(turn)))
        found.setdefault(size, []).append((seen, place.start))
    content = {size: baseline(registered) for size, registered in sorted(found.items())}
    with saving(project, drive.site.stem, "registration") as site:
        path = site.resolved.beside(site.resolved.site.poles.baseline)
        known = {} if path is None else read_baselines(path)
        files: dict[str, Writer] = {_BASELINE: lambda to: write_json(to, known | content)}
        pairs = None if path is None else Path(path).with_name(_PAIRS)
        rows = _other_pairs(drive, pairs, {*content})
        # Pairs as `roadsight register` reads them: pixels, and places in the cloud's coordinates.
        for one in images:
            for pair in one.pairs:
                numbers = [f"{n:.4f}" for n in drive.frame.to_native([pair.x, pair.y, pair.z])]
                image = drive.place(one.number).image
                rows.append([image, f"{pair.u:.2f}", f"{pair.v:.2f}", *numbers])
        if rows or (pairs and pairs.is_file()):
            files[_PAIRS] = lambda to: write_table(to, [_HEADER, *rows])
        named: dict[str, str | None] = {"baseline": _BASELINE}
        changed = save_beside(project, site, "poles", files, named, {_PAIRS: "baseline"})
    return {"changed": changed, "baselines": content}


def _other_pairs(drive: SiteDrive, path: Path | None, sizes: set[str]) -> list[list[str]]:
    """Rows of a file of pairs, if it is there, without those of images of some sizes."""
    if path is None or not path.is_file():
        return []
    with path.open(encoding="utf-8", newline="") as stream:
        header, *rows = [row for row in csv.reader(stream) if row] or [_HEADER]
    if header != _HEADER:
        raise InputError(
            "has other columns",
            where=str(path),
            found=",".join(header),
            allowed=",".join(_HEADER),
            hint="move it away",
        )
    frames = drive.frames[["image", "width_px", "height_px"]].itertuples(index=False)
    size_of = {str(image): f"{int(width)}x{int(height)}" for image, width, height in frames}
    return [row for row in rows if size_of.get(row[0]) not in sizes]


def _by_hand(drive: SiteDrive, place: Place, one: Registered) -> Registration:
    """Registration from pairs where they determine it; else the pose as it was set by eye."""
    pose = one.pose.row()
    if len(one.pairs) >= 4:
        solved = registration(place, one.pairs)
        if all(abs(v - pose[n]) < 1e-6 for n, v in registered_pose(solved).items()):
            return solved
    rms = alignment_error(drive, place, pose)["rms_px"]
    x, y, z, heading_deg, pitch_deg, roll_deg, focal_px = pose.values()
    return Registration(
        np.array([x, y, z]),
        heading_deg,
        pitch_deg,
        roll_deg,
        focal_px,
        np.array([0.0 if rms is None else rms]),
        np.diag(_HAND**2),
    )


def save_correction(
    project: Project, drive: SiteDrive, number: int, pose: PoseBody | None
) -> list[str]:
    """Write the pose of one image as set by a person, or forget it; the files that changed.

    Raises
    ------
    InputError : the image has no place, or the site file cannot be changed.
    """
    image = str(drive.row(number)["image"])
    with saving(project, drive.site.stem, "registration") as site:
        known = read_corrections(site, drive.frame)
        keys = (*POSE, "cx_px", "cy_px")
        poses = {name: {key: float(row[key]) for key in keys} for name, row in known.items()}
        poses.pop(image, None)
        if pose is not None:
            start = drive.place(number).start
            poses[image] = pose.row() | {"cx_px": start.cx_px, "cy_px": start.cy_px}
        files: dict[str, Writer] = {}
        if poses:
            files[_CORRECTIONS] = lambda to: _write_poses(to, drive.frame, poses)
        named = {"corrections": _CORRECTIONS if poses else None}
        return save_beside(project, site, "poles", files, named)


def _write_poses(path: Path, frame: Frame, poses: dict[str, dict[str, float]]) -> None:
    """Cameras as `io.camera_tables` reads them, in the cloud's coordinates."""
    rows = []
    for image, pose in sorted(poses.items()):
        east, north, up = frame.to_native([pose["x"], pose["y"], pose["z"]])
        rows.append(
            {
                "image": image,
                "easting_native": round(east, 4),
                "northing_native": round(north, 4),
                "height_native": round(up, 4),
                "heading_grid_deg": round(pose["heading_deg"], 5),
                "pitch_deg": round(pose["pitch_deg"], 5),
                "roll_deg": round(pose["roll_deg"], 5),
                "focal_px": round(pose["focal_px"], 3),
                "cx_px": pose["cx_px"],
                "cy_px": pose["cy_px"],
            }
        )
    pd.DataFrame(rows).to_csv(path, index=False, lineterminator="\n")
