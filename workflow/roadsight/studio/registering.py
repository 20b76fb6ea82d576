"""Registration by hand (paper 2, section 3.2.3): error, direct solve, baseline, corrections."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from pydantic import Field

from roadsight.geometry.cameras import Intrinsics, cam_from_world, project, wrap_deg
from roadsight.io.atomic import write_json
from roadsight.io.rasters import read_raster
from roadsight.io.tiles import CloudTiles, stack_xyz
from roadsight.poles.alignment.drive import Place
from roadsight.poles.alignment.published import squared_gaps
from roadsight.poles.baselines import baseline
from roadsight.poles.registration import Registration, is_flat, register_camera
from roadsight.studio.drive import POSE, SiteDrive
from roadsight.studio.levels import level_of_points
from roadsight.studio.project import CLOUD, DEM, Project, SiteFolder
from roadsight.studio.shapes import Metre, Shape
from roadsight.studio.site_files import save_beside

WINDOW_PX = 300.0
_BESIDE_M, _AHEAD_M, _ROOM_DEG, _MOST_POINTS = 5.0, 150.0, 12.0, 60_000
_HAND = np.array([0.3, 0.3, 0.1, 0.005, 0.005, 0.005, 0.01])
"""Standard deviations of a pose set by eye: metres, radians, log focal length."""
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
    seen, there = drive.scene.edges_of(place)
    groups = [seen.uv_px[a:b] for a, b in zip(seen.groups[:-1], seen.groups[1:], strict=True)]
    names = ("lane_left", "lane_right", "border_left", "border_right")
    expected = drive.expected(place)
    return {
        "image": place.image,
        "size": [place.start.width_px, place.start.height_px],
        "expected": expected,
        "solved": drive.solved(place.image),
        "corrected": place.image in drive.corrections,
        "pixels": {n: g.round(1).ravel().tolist() for n, g in zip(names, groups, strict=True)},
        "left": there.xyz_m[: there.left].round(3).ravel().tolist(),
        "right": there.xyz_m[there.left :].round(3).ravel().tolist(),
        "error": alignment_error(drive, place, drive.solved(place.image) or expected),
    }


def alignment_error(drive: SiteDrive, place: Place, pose: dict[str, float]) -> dict[str, Any]:
    """Root of the mean squared distance of the cloud's edges from the image's, by side.

    Each projected edge point counts with the nearest edge pixel of its own side within a window, as
    in the published alignment; None where nothing is near.
    """
    seen, there = drive.scene.edges_of(place)
    start = place.start
    camera = Intrinsics(start.width_px, start.height_px, pose["focal_px"], start.cx_px, start.cy_px)
    rotation = cam_from_world(pose["heading_deg"], pose["pitch_deg"], pose["roll_deg"])
    uv, _ = project(camera, rotation, [pose["x"], pose["y"], pose["z"]], there.xyz_m)
    inside = camera.contains(uv)
    found: dict[str, Any] = {}
    total, count = 0.0, 0
    for side, part in (("left", slice(None, there.left)), ("right", slice(there.left, None))):
        first = ("left", "right").index(side)
        pixels = np.concatenate([_group(seen, first), _group(seen, first + 2)])
        gained, near = squared_gaps(uv[part][inside[part]], pixels, WINDOW_PX)
        found[f"{side}_px"] = float(np.sqrt(gained / near)) if near else None
        total, count = total + gained, count + near
    return found | {"rms_px": float(np.sqrt(total / count)) if count else None, "points": count}


def _group(seen: Any, number: int) -> NDArray[np.float64]:
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


def before_camera(
    offset_m: NDArray[np.floating], heading_deg: float, half_deg: float
) -> NDArray[np.bool_]:
    """Whether plan offsets (n, 2) from a camera lie within its view, or right beside it."""
    azimuth = np.degrees(np.arctan2(offset_m[:, 0], offset_m[:, 1]))
    away = np.hypot(*offset_m.T)
    within = np.abs(wrap_deg(azimuth - heading_deg)) <= half_deg
    return (away <= _AHEAD_M) & (within | (away <= _BESIDE_M))


def _above_ground(site: SiteFolder, drive: SiteDrive, xyz: NDArray) -> NDArray[np.float64]:
    ground = read_raster(site.file(DEM), drive.frame).sample(xyz[:, 0], xyz[:, 1])
    return np.nan_to_num(xyz[:, 2] - ground)


def solve_pairs(drive: SiteDrive, number: int, pairs: list[Pair]) -> dict[str, Any]:
    """Pose from clicked pairs, each pair's distance, and how certain it is.

    Raises
    ------
    InputError : the pairs do not determine the camera.
    """
    found = _registration(drive.place(number), pairs)
    names = ("x_m", "y_m", "z_m", "pitch_rad", "yaw_rad", "roll_rad", "log_focal")
    return {
        "pose": _registered_pose(found),
        "residuals_px": found.residuals_px.round(2).tolist(),
        "rms_px": float(np.sqrt((found.residuals_px**2).mean())),
        "sigma": dict(zip(names, found.sigma.tolist(), strict=True)),
        "flat": is_flat([[p.x, p.y, p.z] for p in pairs]),
    }


def _registration(place: Place, pairs: list[Pair]) -> Registration:
    uv = [[p.u, p.v] for p in pairs]
    xyz = [[p.x, p.y, p.z] for p in pairs]
    return register_camera(uv, xyz, place.start.width_px, place.start.height_px)


def _registered_pose(found: Registration) -> dict[str, float]:
    angles = (found.heading_deg, found.pitch_deg, found.roll_deg)
    return dict(zip(POSE, map(float, (*found.position_m, *angles, found.focal_px)), strict=True))


def save_baseline(project: Project, drive: SiteDrive, images: list[Registered]) -> dict[str, Any]:
    """Write the baseline of each image size, and the pairs that it rests on.

    Returns
    -------
    changed : files. baselines : content by image size.

    Raises
    ------
    InputError : an image has no place, or the site file cannot be changed.
    """
    found: dict[str, list[Any]] = {}
    for one in images:
        place = drive.place(one.number)
        size = f"{place.start.width_px}x{place.start.height_px}"
        found.setdefault(size, []).append((_by_hand(drive, place, one), place.start))
    content = {size: baseline(registered) for size, registered in sorted(found.items())}
    files = {"baseline.json": lambda to: write_json(to, content)}
    if any(one.pairs for one in images):
        files["pairs.csv"] = lambda to: _write_pairs(to, drive, images)
    changed = save_beside(project, drive.site, "poles", files, {"baseline": "baseline.json"})
    return {"changed": changed, "baselines": content}


def _by_hand(drive: SiteDrive, place: Place, one: Registered) -> Registration:
    """Registration from pairs where they determine it; else the pose as it was set by eye."""
    pose = one.pose.row()
    if len(one.pairs) >= 4:
        solved = _registration(place, one.pairs)
        close = all(abs(v - pose[n]) < 1e-6 for n, v in _registered_pose(solved).items())
        if close:
            return solved
    rms = alignment_error(drive, place, pose)["rms_px"]
    residuals = np.array([] if rms is None else [rms])
    return Registration(
        np.array([pose["x"], pose["y"], pose["z"]]), pose["heading_deg"], pose["pitch_deg"],
        pose["roll_deg"], pose["focal_px"], residuals if len(residuals) else np.zeros(1),
        np.diag(_HAND**2),
    )  # fmt: skip


def _write_pairs(path: Path, drive: SiteDrive, images: list[Registered]) -> None:
    """Pairs as `roadsight register` reads them: pixels, and places in the cloud's coordinates."""
    with path.open("w", encoding="utf-8", newline="") as stream:
        table = csv.writer(stream, lineterminator="\n")
        table.writerow(["image", "pixel_x", "pixel_y", "x", "y", "z"])
        for one in images:
            image = drive.place(one.number).image
            for pair in one.pairs:
                native = drive.frame.to_native([pair.x, pair.y, pair.z])
                table.writerow(
                    [image, f"{pair.u:.2f}", f"{pair.v:.2f}", *(f"{n:.4f}" for n in native)]
                )


def save_correction(
    project: Project, drive: SiteDrive, number: int, pose: PoseBody | None
) -> list[str]:
    """Write the pose of one image as set by a person, or forget it; the files that changed."""
    place = drive.place(number)
    poses = {image: {n: float(row[n]) for n in POSE} for image, row in drive.corrections.items()}
    poses.pop(place.image, None)
    if pose is not None:
        poses[place.image] = pose.row()
    name = "corrections.csv" if poses else None
    files = {"corrections.csv": lambda to: _write_poses(to, drive, poses)} if poses else {}
    return save_beside(project, drive.site, "poles", files, {"corrections": name})


def _write_poses(path: Path, drive: SiteDrive, poses: dict[str, dict[str, float]]) -> None:
    """Cameras as `io.camera_tables` reads them, in the cloud's coordinates."""
    rows = []
    for image, pose in sorted(poses.items()):
        place = drive.places[image]
        east, north, up = drive.frame.to_native([pose["x"], pose["y"], pose["z"]])
        rows.append({
            "image": image, "easting_native": round(east, 4), "northing_native": round(north, 4),
            "height_native": round(up, 4), "heading_grid_deg": round(pose["heading_deg"], 5),
            "pitch_deg": round(pose["pitch_deg"], 5), "roll_deg": round(pose["roll_deg"], 5),
            "focal_px": round(pose["focal_px"], 3), "cx_px": place.start.cx_px,
            "cy_px": place.start.cy_px,
        })  # fmt: skip
    pd.DataFrame(rows).to_csv(path, index=False, lineterminator="\n")
