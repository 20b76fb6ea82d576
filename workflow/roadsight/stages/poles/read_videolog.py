"""Frames of a videolog: images, places, headings, and what is wrong with which."""

from __future__ import annotations

import logging
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Annotated

import numpy as np
import pandas as pd
import shapely
from numpy.typing import ArrayLike

from roadsight.base.arrays import Bools, Floats
from roadsight.base.errors import InputError
from roadsight.base.sections.poles import Videolog
from roadsight.geometry.frames import Frame
from roadsight.geometry.north import SiteNorth
from roadsight.io.cloud.tiles import CloudTiles
from roadsight.io.images.videologs import ImageSource, every_nth, read_videolog_table
from roadsight.io.raster.rasters import read_raster
from roadsight.io.raster.top_rasters import TopRaster, read_top
from roadsight.io.records.atomic import read_json
from roadsight.io.records.tables import write_table
from roadsight.poles.drive.videolog import OK, Site, build_frames
from roadsight.scene.classes import is_road
from roadsight.stages.command import Command, logged

log = logging.getLogger("read_videolog")

COLUMNS = [
    "image",
    "route",
    "sequence",
    "path",
    "left_path",
    "right_path",
    "width_px",
    "height_px",
    "latitude",
    "longitude",
    "x",
    "y",
    "z_road",
    "heading_deg",
    "heading_raw_deg",
    "step_m",
    "status",
]
_ROAD_REACH_M = 2.5
"""How far to either side cells of road give the road's height: positions are about a metre off."""
_GROUND_REACHES_M = (2.0, 5.0, 10.0)
"""Without road, the terrain model is read on rings of these radii, the next wider one where the
last met no ground."""
_RING = np.array([[0.0, 0.0], *([np.sin(a), np.cos(a)] for a in np.radians(range(0, 360, 45)))])
"""Middle and eight places of a ring of radius 1."""


def read_videolog(
    videolog: Annotated[str, "CSV table, or folder of tagged JPEGs"],
    images: Annotated[str, "folder or ZIP file of images"],
    cloud: Path,
    frame_path: Path,
    dem: Path,
    settings: Videolog,
    top: Annotated[Path | None, "overhead view, for the height of the road"] = None,
    outside_m: float = 30.0,
    *,
    out: Path,
) -> None:
    """Write the frames of all routes."""
    frame = Frame.from_dict(read_json(frame_path))
    source = ImageSource(images)
    table = read_videolog_table(videolog, source)
    table = find_images(every_nth(table, settings.every), source)
    frames = build_frames(table, _site(cloud, dem, top, outside_m, frame), settings)
    if frame.crs_wkt is None:
        # What was read under these names are places in the local system.
        frames[["latitude", "longitude"]] = np.nan
    _tell(table, frames, source)
    write_table(out, frames[COLUMNS], {"settings": settings.model_dump()})


def find_images(table: pd.DataFrame, source: ImageSource) -> pd.DataFrame:
    """Table with path, left_path, right_path, width_px, height_px and status of each image."""
    rows = []
    for row in logged(table.to_dict("records"), len(table), log, "images"):
        path, status, size = _image(source, row["image"])
        left, right = (_side(source, row[f"{side}_image"]) for side in ("left", "right"))
        rows.append((path, left, right, *size, status))
    names = ["path", "left_path", "right_path", "width_px", "height_px", "status"]
    found = pd.DataFrame(rows, columns=names)
    return pd.concat([table.drop(columns=["left_image", "right_image"]), found], axis=1)


def _image(source: ImageSource, name: str) -> tuple[str, str, tuple[int, int]]:
    """Path, status and size of an image that a table names."""
    try:
        path = source.find(name)
        if not path:
            return "", "image missing", (0, 0)
        facts = source.facts(path)
    except InputError as error:
        log.warning("%s", error)
        return "", "image unreadable", (0, 0)
    status = OK if facts.complete else "image truncated"
    return path, status, (facts.width_px, facts.height_px)


def _side(source: ImageSource, name: str) -> str:
    """Path of a side view, "" if there is none to be used."""
    if not name:
        return ""
    path, status, _ = _image(source, name)
    if status != OK:
        log.warning("side view %s: %s", name, status)
        return ""
    return path


def _site(
    cloud_path: Path, dem_path: Path, top: Path | None, outside_m: float, frame: Frame
) -> Site:
    cloud = CloudTiles(cloud_path)
    bounds = np.array([tile.bounds_m for tile in cloud.tiles])
    tree = shapely.STRtree(shapely.box(bounds[:, 0], bounds[:, 1], bounds[:, 3], bounds[:, 4]))

    def covers(xy: Floats) -> Bools:
        near, _ = tree.query(shapely.points(xy), predicate="dwithin", distance=outside_m)
        return np.isin(np.arange(len(xy)), near)

    corners = np.array([bounds[:, :2].min(axis=0), bounds[:, 3:5].max(axis=0)])
    to_local, extent = _coordinates(frame, corners)
    dem = read_raster(dem_path, frame)
    view = read_top(top, frame) if top else None
    heights = road_heights(dem.sample, view)
    return Site(to_local, covers, heights, extent, frame.crs_wkt is None)


def _coordinates(
    frame: Frame, corners_m: Floats
) -> tuple[Callable[[ArrayLike, ArrayLike], Floats], str]:
    """Function of the table's coordinates (see `Site`), and the cloud's extent in words."""
    if frame.crs_wkt is None:
        (west, south), (east, north) = frame.to_native(corners_m)[:, :2]
        extent = f"x {west:.1f} to {east:.1f}, y {south:.1f} to {north:.1f}"
        return lambda y, x: frame.to_local(np.column_stack([x, y])), extent
    geographic = SiteNorth(frame)
    (south, top), (west, east) = geographic.to_geographic(corners_m)
    extent = f"latitude {south:.5f} to {top:.5f}, longitude {west:.5f} to {east:.5f}"
    return geographic.to_local, extent


def road_heights(
    ground_at: Callable[[ArrayLike, ArrayLike], Floats], view: TopRaster | None
) -> Callable[[Floats], Floats]:
    """Function of places (n, 2) that gives the road's height, or the ground's where there is none.

    On a bridge the terrain model may be that of the ground below, which the road is not.
    """

    def heights(xy: Floats) -> Floats:
        found = np.full(len(xy), np.nan) if view is None else _paved_heights(view, xy)
        for reach in _GROUND_REACHES_M:
            bare = np.flatnonzero(np.isnan(found))
            places = xy[bare, None] + reach * _RING
            ground = ground_at(*places.reshape(-1, 2).T).reshape(len(bare), len(_RING))
            some = np.isfinite(ground).any(axis=1)
            found[bare[some]] = np.nanmedian(ground[some], axis=1)
        return found

    return heights


def _paved_heights(view: TopRaster, xy: Floats) -> Floats:
    """Median height of the road cells around each place, NaN without any."""
    reach = int(np.ceil(_ROAD_REACH_M / view.cell_size_m))
    heights = np.full(len(xy), np.nan)
    rows, columns = (np.round(p).astype(int) for p in view.pixels(xy))
    for number, (row, column) in enumerate(zip(rows, columns, strict=True)):
        window = (
            slice(max(row - reach, 0), max(row + reach + 1, 0)),
            slice(max(column - reach, 0), max(column + reach + 1, 0)),
        )
        road = is_road(view.cls[window])
        if road.any():
            heights[number] = np.median(view.height_m[window][road])
    return heights


def _tell(table: pd.DataFrame, frames: pd.DataFrame, source: ImageSource) -> None:
    """Say in the log what is used, what is not, and why."""
    log.info("%d of %d images usable", (frames["status"] == OK).sum(), len(frames))
    for reason, rows in frames[frames["status"] != OK].groupby("status", sort=False):
        log.warning("%d not used: %s (%s)", len(rows), reason, _some(rows["image"].tolist()))
    if len(table) > len(frames):
        log.warning("%d rows repeat an image or name none", len(table) - len(frames))
    turned = sum((rows["sequence"].diff() < 0).sum() for _, rows in table.groupby("route"))
    if turned:
        log.warning("%d images come before their predecessor; sorted by sequence", turned)
    used = {*table["path"], *table["left_path"], *table["right_path"]}
    if extra := [name for name in source.names() if name not in used]:
        log.warning("%d images are not in the table (%s)", len(extra), _some(extra))


def _some(names: list[str]) -> str:
    return ", ".join(names[:5]) + (", ..." if len(names) > 5 else "")


main = Command(read_videolog)


if __name__ == "__main__":
    sys.exit(main())
