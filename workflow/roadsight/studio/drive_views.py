"""A site's images with their cameras and what the alignment compares them with."""

from __future__ import annotations

import threading
from dataclasses import replace
from functools import lru_cache
from pathlib import Path, PurePath
from typing import Any

import cv2
import numpy as np
import pandas as pd

from roadsight.base.arrays import Floats
from roadsight.base.errors import InputError
from roadsight.base.sections.poles import Reach
from roadsight.geometry.frames import Frame
from roadsight.geometry.lens import RadialLens
from roadsight.io.images.camera_tables import read_cameras
from roadsight.io.images.exif import decoded_image
from roadsight.io.images.videologs import ImageSource
from roadsight.io.records.atomic import read_json
from roadsight.io.records.tables import read_table
from roadsight.poles.alignment.drive import Place
from roadsight.poles.alignment.pose import CX, Pose, Start, pose_of
from roadsight.poles.calibration.calibration import weak_mount
from roadsight.poles.calibration.calibration_table import DriveCalibration, from_content
from roadsight.poles.drive.drive_lenses import Key, lens_of, with_given
from roadsight.poles.images.views import source_places, straightened
from roadsight.stages.poles.shared.alignment_inputs import AlignmentScene, SceneFiles, read_scene
from roadsight.studio.project import CLOUD, DEM, FRAME, SiteFolder

POSE = ("x", "y", "z", "heading_deg", "pitch_deg", "roll_deg", "focal_px")
# Field of view that an image starts from where nothing is known of its camera
_USUAL_HFOV_DEG = 60.0
_FRAMES = "poles/frames.parquet"


class SiteDrive:
    """Images of one site as they are now on disk.

    Parameters
    ----------
    site : whose videolog was read by the workflow already.

    Raises
    ------
    InputError : a result that is needed is not there yet, or damaged.
    """

    def __init__(self, site: SiteFolder) -> None:
        self.site, self.frame = site, site.frame()
        self.scene = _scene(site)
        self.frames = read_table(site.file(_FRAMES))
        self.cameras = _cameras(site)
        self.corrections = read_corrections(site, self.frame)
        path = site.results / "poles/calibration.json"
        drives = map(from_content, read_json(path)["drives"]) if path.exists() else ()
        self._expected = {drive.key: drive for drive in drives}
        # Places with the principal point that their drive was found to have.
        self.places: dict[str, Place] = {}
        for place in self.scene.places:
            cx_px = place.start.cx_px + self.shift_px(place)
            self.places[place.image] = replace(place, start=replace(place.start, cx_px=cx_px))
        self._source: ImageSource | None = None

    def _drive(self, start: Start, route: str) -> DriveCalibration | None:
        return self._expected.get((route, start.width_px, start.height_px))

    def shift_px(self, place: Place) -> float:
        """By how much a drive's principal point was found right of where it is expected."""
        drive = self._drive(place.start, place.route)
        return 0.0 if drive is None else float(drive.mount.mean[CX])

    def row(self, number: int) -> pd.Series:
        """Row of an image by its place in the table of frames.

        Raises
        ------
        InputError : no such image.
        """
        if not 0 <= number < len(self.frames):
            raise InputError("no such image", where="studio", found=number)
        return self.frames.iloc[number]

    def place(self, number: int) -> Place:
        """Where the track says that an image was taken.

        Raises
        ------
        InputError : no such image, or it has no usable place.
        """
        row = self.row(number)
        if row["image"] not in self.places:
            raise InputError("has no usable place", where=str(row["image"]), found=row["status"])
        return self.places[str(row["image"])]

    def about(self) -> list[dict[str, Any]]:
        """State of every image, in the order of the frames."""
        return [self._state(row) for _, row in self.frames.iterrows()]

    def _state(self, row: pd.Series) -> dict[str, Any]:
        image = str(row["image"])
        found = {
            "image": image,
            "route": str(row["route"]),
            "x": _number(row["x"]),
            "y": _number(row["y"]),
            "size": [int(row["width_px"]), int(row["height_px"])],
            "state": "unsolved",
            "reason": "",
            "residual_px": None,
        }
        if row["status"] != "ok":
            return found | {"state": "unusable", "reason": str(row["status"])}
        if image in self.corrections:
            return found | {"state": "corrected", "reason": "by hand"}
        if image not in self.cameras.index:
            return found
        camera = self.cameras.loc[image]
        return found | {
            "state": "accepted" if camera["accepted"] else "rejected",
            "reason": str(camera["reason"]),
            "residual_px": _number(camera["residual_px"]),
        }

    def solved(self, image: str) -> dict[str, float] | None:
        """Pose that the workflow found, or a person set."""
        if image in self.corrections:
            return {name: float(self.corrections[image][name]) for name in POSE}
        if image not in self.cameras.index:
            return None
        camera = self.cameras.loc[image].to_dict()
        pose = {name: float(camera[name]) for name in POSE}
        return pose if np.isfinite(list(pose.values())).all() else None

    def expected(self, place: Place) -> dict[str, float]:
        """Pose by the drive's calibration, else by the track and a usual camera."""
        start = place.start
        drive = self._drive(start, place.route)
        if drive is not None:
            return pose_content(pose_of(start, drive.expected(place)[0]))
        return pose_content(pose_of(start, weak_mount(_USUAL_HFOV_DEG, start.width_px).mean))

    def picture(self, number: int) -> bytes:
        """Bytes of an image's file."""
        if self._source is None:
            self._source = ImageSource(images_of(self.site))
        return self._source.content(str(self.row(number)["path"]))


def read_corrections(site: SiteFolder, frame: Frame) -> dict[str, pd.Series]:
    """Cameras that a person set, by image, as `io.camera_tables` reads them."""
    path = site.resolved.beside(site.resolved.site.poles.corrections)
    if path is None:
        return {}
    return {str(row["image"]): row for _, row in read_cameras(path, frame).iterrows()}


def images_of(site: SiteFolder) -> str:
    """Folder or archive of a site's images."""
    resolved = site.resolved
    if resolved.site.sample:
        return str(site.results / "sample/images")
    path = resolved.beside(resolved.site.poles.images)
    if path is None:
        raise InputError("names no images", where=f"site {site.stem}", hint="set poles.images")
    return path


def pose_content(pose: Pose) -> dict[str, float]:
    """A pose by the names of `POSE`."""
    values = (pose.x_m, pose.y_m, pose.z_m, pose.heading_deg, pose.pitch_deg, pose.roll_deg)
    return dict(zip(POSE, map(float, (*values, pose.focal_px)), strict=True))


def _scene(site: SiteFolder) -> AlignmentScene:
    edges = sorted((site.results / "poles/image_edges").glob("*.parquet"))
    if not edges:
        site.file("poles/image_edges/0.parquet")
    terrain = site.results / "poles/terrain.npz"
    asked = site.resolved.settings.alignment
    return read_scene(
        SceneFiles(
            site.file(_FRAMES),
            site.file("poles/road_edges.parquet"),
            site.file(FRAME),
            edges,
            Reach(**asked.model_dump(include=set(Reach.model_fields))),
            terrain if terrain.exists() else None,
            site.file(DEM),
        )
    )


def _cameras(site: SiteFolder) -> pd.DataFrame:
    """Cameras of all shards by image: aligned ones, else given ones."""
    for folder in ("cameras", "given_cameras"):
        files = sorted((site.results / "poles" / folder).glob("*.parquet"))
        if files:
            return pd.concat([read_table(path) for path in files]).set_index("image")
    return pd.DataFrame(columns=["image"]).set_index("image")


def _number(value: Any) -> float | None:
    return float(value) if np.isfinite(value) else None


class Drives:
    """Drives by site, read again when their files change."""

    def __init__(self) -> None:
        self._known: tuple[object, SiteDrive] | None = None
        self._lock = threading.Lock()

    def of(self, site: SiteFolder) -> SiteDrive:
        """Drive of a site; only the one asked for last is kept.

        Raises
        ------
        InputError : as `SiteDrive`.
        """
        poles = site.results / "poles"
        own = site.resolved.beside(site.resolved.site.poles.corrections)
        watched = [site.resolved.file, *([Path(own)] if own else []), site.results / CLOUD]
        watched += sorted(
            [*poles.glob("*.parquet"), *poles.glob("*.json"), *poles.glob("*/*.parquet")]
        )
        state = [(str(p), p.stat().st_mtime_ns) for p in watched if p.exists()]
        with self._lock:
            if self._known is None or self._known[0] != state:
                self._known = state, SiteDrive(site)
            return self._known[1]


# Images as the workflow looks at them: without the distortion of their lens, where it has any.


_TYPES = {".png": "image/png", ".jpg": "image/jpeg", ".jpeg": "image/jpeg", ".webp": "image/webp"}


def picture_type(path: str) -> str:
    """Media type of an image by the name of its file."""
    return _TYPES.get(PurePath(path).suffix.lower(), "application/octet-stream")


def lens_for(site: SiteFolder, key: Key) -> RadialLens | None:
    """Lens whose distortion the workflow takes out of a drive's images; None if it does not.

    Parameters
    ----------
    key : route, width and height of the images.
    """
    drive, effects = site.results / "poles/drive.json", site.results / "effects.json"
    if not (drive.exists() and effects.exists()):
        return None
    decided = {one["effect"]: one["decision"] for one in read_json(effects)}
    if decided.get("lens_distortion") != "simulate":
        return None
    given = [lens.model_dump() for lens in site.resolved.site.poles.lenses]
    lenses = with_given(read_json(drive)["lenses"], given)
    return lens_of(lenses, key, (key[2], key[1]))


def without_distortion(content: bytes, lens: RadialLens) -> bytes:
    """An image's file as JPEG, as a pinhole camera would have taken it.

    Raises
    ------
    InputError : it is no image.
    """
    image = decoded_image(content, cv2.IMREAD_COLOR)
    if image is None:
        raise InputError("is no image that can be read", where="picture")
    turned = straightened(image, _places(lens, image.shape[1], image.shape[0]), smooth=True)
    return cv2.imencode(".jpg", turned, [cv2.IMWRITE_JPEG_QUALITY, 90])[1].tobytes()


@lru_cache(maxsize=4)
def _places(lens: RadialLens, width_px: int, height_px: int) -> Floats:
    return source_places(lens, (width_px, height_px), (height_px, width_px))
