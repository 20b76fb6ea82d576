"""What registration by hand leaves: baselines with their pairs, corrections of single images."""

from __future__ import annotations

import csv
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from roadsight.base.errors import InputError
from roadsight.geometry.frames import Frame
from roadsight.io.images.baselines import read_baselines
from roadsight.io.records.atomic import write_json
from roadsight.poles.alignment.drive import Place
from roadsight.poles.calibration.baselines import baseline
from roadsight.poles.calibration.registration import Registration
from roadsight.studio.project import Project
from roadsight.studio.registration.drive import POSE, SiteDrive, read_corrections
from roadsight.studio.registration.registering import (
    Pair,
    PoseBody,
    Registered,
    alignment_error,
    registered_pose,
    registration,
)
from roadsight.studio.site_files import Writer, save_beside, saving

_HAND = np.array([0.3, 0.3, 0.1, 0.005, 0.005, 0.005, 0.01])
"""Standard deviations of a pose set by eye: metres, radians, log focal length."""
_BASELINE = "baseline.json"
_PAIRS = "pairs.csv"
_CORRECTIONS = "corrections.csv"
_HEADER = ["image", "pixel_x", "pixel_y", "x", "y", "z"]
_LENS = ("cx_px", "cy_px")


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
        by_hand = _expected_centre(drive, place, _by_hand(drive, place, one))
        found.setdefault(size, []).append((by_hand, place.start))
    content = {size: baseline(registered) for size, registered in sorted(found.items())}
    with saving(project, drive.site.stem, "registration") as site:
        path = site.resolved.beside(site.resolved.site.poles.baseline)
        known = {} if path is None else read_baselines(path)
        files: dict[str, Writer] = {_BASELINE: lambda to: write_json(to, known | content)}
        pairs = None if path is None else Path(path).with_name(_PAIRS)
        rows = _other_pairs(drive, pairs, {*content}) + _pair_rows(drive, images)
        if rows or (pairs and pairs.is_file()):
            files[_PAIRS] = lambda to: _write_rows(to, rows)
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


def _expected_centre(drive: SiteDrive, place: Place, found: Registration) -> Registration:
    """The same view about the expected principal point: a drive's is found after its baseline."""
    turn = np.arctan(drive.shift_px(place) / found.focal_px)
    return replace(found, heading_deg=found.heading_deg - float(np.degrees(turn)))


def _by_hand(drive: SiteDrive, place: Place, one: Registered) -> Registration:
    """Registration from pairs where they determine it; else the pose as it was set by eye."""
    pose = one.pose.row()
    if len(one.pairs) >= 4:
        solved = registration(place, one.pairs)
        close = all(abs(v - pose[n]) < 1e-6 for n, v in registered_pose(solved).items())
        if close:
            return solved
    rms = alignment_error(drive, place, pose)["rms_px"]
    residuals = np.array([] if rms is None else [rms])
    return Registration(
        np.array([pose["x"], pose["y"], pose["z"]]),
        pose["heading_deg"],
        pose["pitch_deg"],
        pose["roll_deg"],
        pose["focal_px"],
        residuals if len(residuals) else np.zeros(1),
        np.diag(_HAND**2),
    )


def _pair_rows(drive: SiteDrive, images: list[Registered]) -> list[list[str]]:
    """Pairs as `roadsight register` reads them: pixels, and places in the cloud's coordinates."""
    return [
        [drive.place(one.number).image, *_numbers(drive.frame, pair)]
        for one in images
        for pair in one.pairs
    ]


def _numbers(frame: Frame, pair: Pair) -> list[str]:
    native = frame.to_native([pair.x, pair.y, pair.z])
    return [f"{pair.u:.2f}", f"{pair.v:.2f}", *(f"{n:.4f}" for n in native)]


def _write_rows(path: Path, rows: list[list[str]]) -> None:
    with path.open("w", encoding="utf-8", newline="") as stream:
        csv.writer(stream, lineterminator="\n").writerows([_HEADER, *rows])


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
        poses = {
            name: {key: float(row[key]) for key in (*POSE, *_LENS)} for name, row in known.items()
        }
        poses.pop(image, None)
        if pose is not None:
            start = drive.place(number).start
            poses[image] = pose.row() | {"cx_px": start.cx_px, "cy_px": start.cy_px}
        name = _CORRECTIONS if poses else None
        files: dict[str, Writer] = (
            {_CORRECTIONS: lambda to: _write_poses(to, drive.frame, poses)} if poses else {}
        )
        return save_beside(project, site, "poles", files, {"corrections": name})


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
