"""Everything that the report shows of one site's poles, in one compact file."""

from __future__ import annotations

import json
import logging
import sys
from collections.abc import Iterator, Sequence
from functools import cache
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import pandas as pd

from roadsight.base.arrays import Bytes
from roadsight.base.sections.poles import Pictures
from roadsight.base.shards import shard_of
from roadsight.geometry.cameras import Intrinsics
from roadsight.geometry.frames import Frame
from roadsight.io.images.image_shards import ImageShard, ImageShardWriter
from roadsight.io.images.videologs import ImageSource
from roadsight.io.raster.rasters import read_raster
from roadsight.io.raster.top_rasters import read_top
from roadsight.io.records.atomic import read_json, write_json
from roadsight.io.records.tables import read_about, read_table
from roadsight.poles.drive.drive_lenses import lens_of, with_given
from roadsight.poles.images.pictures import best_views, cut_out, unrecognisable
from roadsight.poles.images.straightening import source_places, straightened
from roadsight.poles.images.views import view_name, views_of
from roadsight.poles.sightings.sighting_bearing import ViewCamera
from roadsight.report.poles.poles_depth import depth_fit
from roadsight.report.poles.poles_layers import match_sightings
from roadsight.report.poles.poles_page import PolesResult, ReadEdges, ReadImage, build_poles_page
from roadsight.stages.command import Command

log = logging.getLogger("write_poles_page")

_MOST_FITS_TRIED = 12
"""Images of which the fit of depth is tried, spread over the drive, until one can be shown."""


def write_poles_page(
    site: str,
    summary_path: Path,
    frame: Path,
    top: Path,
    road_edges: Path,
    frames: Path,
    poles: Path,
    cameras_paths: Annotated[Sequence[Path], "shards in order"],
    image_edges: Annotated[Sequence[Path], "shards in order"],
    sightings: Annotated[Sequence[Path], "shards in order"],
    settings: Pictures,
    title: Annotated[str, "name of the site for people"] = "",
    hazard: Annotated[Path | None, "table of hazards by pole"] = None,
    sections: Annotated[Path | None, "cross-sections at poles"] = None,
    components: Annotated[Path | None, "scores without each component"] = None,
    validation: Annotated[Path | None, "validation.json of a site with truth"] = None,
    images: Annotated[str | None, "folder or archive of the images to embed"] = None,
    drive: Annotated[Path | None, "profile of the drives, where lenses distort"] = None,
    lenses: Annotated[str, "given lenses as JSON"] = "[]",
    dem: Annotated[Path | None, "terrain; with masks and depth for the depth fit"] = None,
    masks: Annotated[Sequence[Path], "shards in order"] = (),
    depth: Annotated[Sequence[Path], "shards in order"] = (),
    files: Annotated[Sequence[Path], "files of the poles, to be named"] = (),
    *,
    out: Path,
    pictures: Annotated[Path | None, "ZIP of a picture of each pole"] = None,
) -> None:
    """Read the artifacts of a site's poles job and write its page and its poles' pictures."""
    about, summary = read_json(frame), read_json(summary_path)
    edges = read_table(road_edges, ["x", "y", "z"])
    cameras = _joined(cameras_paths)
    read_image = None
    if images:
        hide = _Hidden(frames, masks if settings.blur else ())
        read_image = _reader(images, drive, lenses, frames, hide)
    seen, found = _joined(sightings), read_table(poles)
    own = _cut_outs(found, seen, read_table(frames), read_image)
    result = PolesResult(
        read_top(top, Frame.from_dict(about)),
        edges.to_numpy(np.float64),
        read_table(frames),
        cameras,
        seen,
        found,
        read_table(hazard) if hazard else pd.DataFrame(),
        _image_edges(image_edges),
        read_image,
        _depth_fit(dem, masks, depth, cameras, Frame.from_dict(about)),
        _validation(components, validation),
        [path.name for path in files],
        read_table(sections) if sections else pd.DataFrame(),
        read_about(sections).get("profiles", {}) if sections else {},
        own,
    )
    page = build_poles_page(title or site, summary, about, result)
    counts = page["counts"]
    log.info(
        "%d images, %d shown, %d poles", counts["images"], len(page["images"]), counts["poles"]
    )
    write_json(out, page)
    if pictures:
        about = {name: {"image": image, "view": view} for name, (image, view, _) in own.items()}
        with ImageShardWriter(pictures, about) as archive:
            for name, (_, _, picture) in own.items():
                archive.write(name, picture)


class _Hidden:
    """Makes unrecognisable what masks say moves, in the image of a path."""

    def __init__(self, frames: Path, masks: Sequence[Path]) -> None:
        self._shards = [ImageShard(path) for path in masks]
        self._views = {view.path: view for view in views_of(read_table(frames))}

    def __call__(self, path: str, image: Bytes) -> Bytes:
        view = self._views.get(path)
        if not self._shards or view is None:
            return image
        shard = self._shards[shard_of(view.image, len(self._shards))]
        return unrecognisable(image, shard.read(view.name)) if view.name in shard else image


def _cut_outs(
    poles: pd.DataFrame,
    sightings: pd.DataFrame,
    frames: pd.DataFrame,
    read_image: ReadImage | None,
) -> dict[str, tuple[str, str, Bytes]]:
    """Image, view and picture of each pole that is kept and seen, by its id."""
    if read_image is None:
        return {}
    kept = poles[poles["kept"].to_numpy(bool)].reset_index(drop=True)
    best = best_views(sightings, match_sightings(sightings, kept), len(kept))
    paths = {(view.image, view.view): view.path for view in views_of(frames)}
    found = {}
    for name, row in zip(kept["id"].astype(str), best, strict=True):
        if row < 0:
            continue
        seen = sightings.iloc[row]
        place = str(seen["image"]), str(seen["view"])
        u_min, v_min, u_max, v_max = (float(seen[k]) for k in ("u_min", "v_min", "u_max", "v_max"))
        found[name] = (*place, cut_out(read_image(paths[place]), (u_min, v_min, u_max, v_max)))
    return found


def _reader(
    images: str, drive: Path | None, lenses_json: str, frames: Path, hide: _Hidden
) -> ReadImage:
    """Reader of images by their path; without the distortion of their lenses, if told of any."""
    source = ImageSource(images)
    if not drive:
        return lambda path: hide(path, source.read(path))
    lenses = with_given(read_json(drive)["lenses"], json.loads(lenses_json))
    keys = {
        str(path): (str(route), int(width), int(height))
        for path, route, width, height in read_table(frames)[
            ["path", "route", "width_px", "height_px"]
        ].itertuples(index=False)
    }

    def read(path: str) -> Bytes:
        image = source.read(path)
        lens = lens_of(lenses, keys[path], (image.shape[0], image.shape[1]))
        places = source_places(lens, image.shape[1::-1], image.shape[:2])
        return hide(path, straightened(image, places, smooth=True))

    return read


def _joined(paths: Sequence[Path]) -> pd.DataFrame:
    """Shards of a table in order; those without rows do not decide about its types."""
    tables = [read_table(path) for path in paths]
    filled = [table for table in tables if len(table)]
    return pd.concat(filled or tables[:1], ignore_index=True)


def _image_edges(paths: Sequence[Path]) -> ReadEdges:
    """Reader of an image's edges; a shard is read once."""

    @cache
    def shard(number: int) -> pd.DataFrame:
        return read_table(paths[number], ["image", "u", "v"])

    def read(image: str) -> pd.DataFrame:
        table = shard(shard_of(image, len(paths)))
        return table[table["image"] == image]

    return read


def _depth_fit(
    dem: Path | None,
    masks: Sequence[Path],
    depth_paths: Sequence[Path],
    cameras: pd.DataFrame,
    frame: Frame,
) -> dict[str, Any] | None:
    """Depth fit of the accepted image in the middle of the route that allows one."""
    if not (masks and depth_paths and dem):
        return None
    ground = read_raster(dem, frame)
    for camera, pose in _middle_first(cameras[cameras["accepted"].astype(bool)]):
        name = view_name(str(pose["image"]))
        number = shard_of(str(pose["image"]), len(masks))
        shards = [ImageShard(paths[number]) for paths in (masks, depth_paths)]
        if not all(name in shard for shard in shards):
            continue
        mask, depth = (shard.read(name) for shard in shards)
        found = depth_fit(str(pose["image"]), camera, mask, depth, ground.sample)
        if found is not None:
            return found
    return None


def _middle_first(accepted: pd.DataFrame) -> Iterator[tuple[ViewCamera, pd.Series]]:
    """A few accepted cameras, spread over the route, from its middle outwards."""
    if accepted.empty:
        return
    ordered = accepted.sort_values("image", kind="stable")
    rows = np.unique(np.linspace(0, len(ordered) - 1, _MOST_FITS_TRIED).astype(int))
    for row in sorted(rows.tolist(), key=lambda r: abs(2 * r - len(ordered))):
        pose = ordered.iloc[row]
        numbers = [float(pose[name]) for name in ("focal_px", "cx_px", "cy_px")]
        own = Intrinsics(int(pose["width_px"]), int(pose["height_px"]), *numbers)
        position = (float(pose["x"]), float(pose["y"]), float(pose["z"]))
        angles = [float(pose[f"{name}_deg"]) for name in ("heading", "pitch", "roll")]
        yield ViewCamera(own, position, *angles), pose


def _validation(components: Path | None, validation: Path | None) -> dict[str, Any] | None:
    """Scores against known poles, with those of the components where they were compared."""
    if not validation:
        return None
    content: dict[str, Any] = read_json(validation)
    if components:
        content["ablation"] = read_json(components)
    return content


main = Command(write_poles_page)


if __name__ == "__main__":
    sys.exit(main())
