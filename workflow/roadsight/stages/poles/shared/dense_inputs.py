"""What the dense alignment reads beside the rest: cloud, photographs, masks."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Annotated

import cv2
import numpy as np

from roadsight.base.arrays import Bytes, Floats
from roadsight.base.errors import InputError
from roadsight.base.sections.poles import AlignmentMethod
from roadsight.geometry.frames import Frame
from roadsight.io.cloud.tiles import CloudTiles
from roadsight.io.images.image_shards import ImageShard
from roadsight.io.images.videologs import ImageSource
from roadsight.io.raster.rasters import read_raster
from roadsight.io.records.atomic import read_json
from roadsight.io.records.tables import read_table
from roadsight.poles.alignment.dense import SIZE, DenseTask, GivenLens
from roadsight.poles.alignment.drive import Place
from roadsight.poles.alignment.pose import SIZE as ALL
from roadsight.poles.alignment.pose import Start, pose_of
from roadsight.poles.alignment.visible import FARTHEST_M, SceneCloud
from roadsight.poles.calibration.calibration_dense import DenseLoader
from roadsight.poles.drive.drive_lenses import lens_of, with_given
from roadsight.poles.images.evidence import ImageEvidence
from roadsight.poles.images.views import source_places, straightened, view_name
from roadsight.stages.poles.shared.alignment_inputs import SceneFiles

_TILES = 64
"""Tiles that are kept in memory: of 50 m they cover the 80 m about a few images in a row."""
_IMAGES = 16
"""Photographs whose fields are kept: those of one calibration."""


@dataclass(frozen=True)
class DenseFiles:
    """What the dense alignment is run on besides, and whether it is asked for."""

    method: Annotated[str, AlignmentMethod]
    intrinsics: Annotated[str | None, "known lens: CSV, or a row of it as JSON"] = None
    cloud: Annotated[Path | None, "tiled cloud; needed where the lens is known"] = None
    photographs: Annotated[Path | None, "folder or ZIP of the images"] = None
    masks: Annotated[Sequence[Path], "masks of all shards"] = ()
    drive: Annotated[Path | None, "profile whose lenses distort; none: pinholes"] = None
    lenses: Annotated[str, "given lenses as JSON: route, k1, k2, focal_px"] = "[]"


def _given(path: Path | None, name: str) -> Path:
    """A file that the dense alignment cannot do without."""
    if path is None:
        raise InputError("is needed by the dense alignment", where=f"--{name}")
    return path


def method_of(stated: str, lens_is_known: bool) -> str:
    """The method that is used.

    Raises
    ------
    InputError : the dense method is asked for, but no lens is known; or the published one, which
        has that of its registered camera, and a lens is known.
    """
    if stated == "published" and lens_is_known:
        raise InputError(
            "the published alignment keeps the lens of its registered camera",
            where="alignment.method",
            found="published, and a known lens (poles.intrinsics, --intrinsics)",
            allowed="one of both",
            hint="leave the known lens out, or align with it: dense",
        )
    if stated == "dense" and not lens_is_known:
        raise InputError(
            "needs a known lens",
            where="alignment.method",
            found=stated,
            allowed="auto, road, published, none",
            hint="give poles.intrinsics: fx_px, cx_px, cy_px",
        )
    if stated == "auto":
        return "dense" if lens_is_known else "road"
    return stated


class DenseScene:
    """Photographs, masks and cloud of a site, for the places of its images.

    Parameters
    ----------
    lenses : by image.

    Raises
    ------
    InputError : a file is missing or cannot be read.
    """

    def __init__(
        self, files: SceneFiles, given: DenseFiles, lenses: Mapping[str, GivenLens]
    ) -> None:
        if not given.masks:
            raise InputError("is needed by the dense alignment", where="--masks")
        names = ["image", "path", "route", "width_px", "height_px"]
        rows = read_table(files.frames, names).to_dict("records")
        self._rows = {str(row["image"]): row for row in rows}
        self._lenses = lenses
        self._photographs = ImageSource(_given(given.photographs, "photographs"))
        shards = [ImageShard(path) for path in given.masks]
        self._masks = {name: shard for shard in shards for name in shard.names}
        self._distortion = None
        if given.drive:
            measured = read_json(given.drive)["lenses"]
            self._distortion = with_given(measured, json.loads(given.lenses))
        self._dem = read_raster(_given(files.dem, "dem"), Frame.from_dict(read_json(files.frame)))
        self._cloud = CloudTiles(_given(given.cloud, "cloud"))
        bounds = np.array([tile.bounds_m for tile in self._cloud.tiles]).reshape(-1, 6)
        self._bounds = bounds[:, [0, 1, 3, 4]]
        self._tile = lru_cache(_TILES)(self._read_tile)
        self._evidence = lru_cache(_IMAGES)(self._read_evidence)

    def loader(self, place: Place) -> DenseLoader:
        """Maker of the task of one image."""

        def load(mean: Floats, covariance: Floats) -> DenseTask:
            return self.task(place, mean, covariance)

        return load

    def task(self, place: Place, mean: Floats, covariance: Floats) -> DenseTask:
        """Task of one image.

        Parameters
        ----------
        mean, covariance : the first six unknowns of `alignment.pose` that are expected.
        """
        unknowns = np.zeros(ALL)
        unknowns[:SIZE] = mean
        pose = pose_of(on_level(place.start), unknowns)
        expected = np.array(
            [*pose.position_m, pose.heading_deg, pose.pitch_deg, pose.roll_deg], np.float64
        )
        turn = turned_axes(pose.heading_deg - place.start.heading_deg)
        cloud = self._around(pose.x_m, pose.y_m)
        evidence = self._evidence(place.image)
        lens = self._lenses[place.image]
        return DenseTask(cloud, evidence, lens, expected, turn @ covariance @ turn.T)

    def _around(self, x_m: float, y_m: float) -> SceneCloud:
        west, south, east, north = self._bounds.T
        away = np.hypot(
            np.maximum(np.maximum(west - x_m, x_m - east), 0.0),
            np.maximum(np.maximum(south - y_m, y_m - north), 0.0),
        )
        near = np.flatnonzero(away <= FARTHEST_M)
        return SceneCloud.joined([self._tile(int(number)) for number in near])

    def _read_tile(self, number: int) -> SceneCloud:
        points = self._cloud.read(["x", "y", "z", "intensity"], [number])
        xyz = np.column_stack([points[name] for name in "xyz"]).astype(np.float64)
        ground_m = self._dem.sample(xyz[:, 0], xyz[:, 1])
        return SceneCloud.of(xyz, points["intensity"].astype(np.float64), ground_m)

    def _read_evidence(self, image: str) -> ImageEvidence:
        row, name = self._rows[image], view_name(image)
        photograph = self._photographs.read(str(row["path"]))
        grey: Bytes = np.asarray(cv2.cvtColor(photograph, cv2.COLOR_BGR2GRAY), np.uint8)
        if name not in self._masks:
            raise InputError("has no mask", where="--masks", found=image)
        classes = np.asarray(self._masks[name].read(name), np.uint8)
        if self._distortion is not None:
            key = str(row["route"]), int(row["width_px"]), int(row["height_px"])
            size = int(row["width_px"]), int(row["height_px"])
            lens = lens_of(self._distortion, key, size[::-1])
            places = source_places(lens, size, (grey.shape[0], grey.shape[1]))
            grey = np.asarray(straightened(grey, places, smooth=True), np.uint8)
        if classes.shape != grey.shape:
            size = grey.shape[1], grey.shape[0]
            resized = cv2.resize(classes, size, interpolation=cv2.INTER_NEAREST)
            classes = np.asarray(resized, np.uint8)
        return ImageEvidence(grey, classes)


def on_level(start: Start) -> Start:
    """The same place without what only road edges say about the road there.

    Their heights bank a street with parked cars by 3 degrees, which no image needs to believe.
    """
    return replace(start, bank=0.0, bend=0.0, hump=0.0)


def turned_axes(deg: float) -> Floats:
    """Matrix (6, 6) from along and lateral of one heading to those of another, ``deg`` further."""
    turn = np.eye(SIZE)
    cos, sin = np.cos(np.radians(deg)), np.sin(np.radians(deg))
    turn[:2, :2] = [[cos, sin], [-sin, cos]]
    return turn
