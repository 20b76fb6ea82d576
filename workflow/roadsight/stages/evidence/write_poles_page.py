"""Everything that the report shows of one site's poles, in one compact file."""

from __future__ import annotations

import json
import logging
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import nullcontext
from functools import cache
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import pandas as pd

from roadsight.base.arrays import Bytes, Floats, Ints
from roadsight.base.sections.poles import Pictures
from roadsight.base.shards import deal
from roadsight.geometry.cameras import Intrinsics
from roadsight.geometry.frames import Frame
from roadsight.io.images.image_shards import ImageShard, ImageShardWriter
from roadsight.io.images.videologs import ImageSource
from roadsight.io.raster.rasters import read_raster
from roadsight.io.raster.top_rasters import read_top
from roadsight.io.records.atomic import read_json, write_json
from roadsight.io.records.tables import read_about, read_table
from roadsight.poles.drive.drive_lenses import lens_of, with_given
from roadsight.poles.images.kinds import KINDS, PixelClass
from roadsight.poles.images.pictures import best_views, cut_out, projected_box, unrecognisable
from roadsight.poles.images.views import View, source_places, straightened, view_name, views_of
from roadsight.poles.sightings.sighting_bearing import ViewCamera
from roadsight.report.poles_layers import match_sightings
from roadsight.report.poles_page import (
    MOST_PICTURES,
    Picture,
    PolesResult,
    ReadEdges,
    ReadImage,
    build_poles_page,
    depth_fit,
)
from roadsight.stages.command import Command

log = logging.getLogger("write_poles_page")

Hide = Callable[[str, Bytes], Bytes]
_Best = tuple[str, View, tuple[float, float, float, float]]
_NEAR_M = 60.0
"""Images so near to an object of the cloud may show it best."""
_BUILDING_M = 6.0
"""Width of a picture's object at the nearest place of a building."""
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
    cameras, places, seen = _joined(cameras_paths), read_table(frames), _joined(sightings)
    located = read_table(poles)
    kept = located["kept"].to_numpy(bool)
    found, withheld = located[kept].reset_index(drop=True), located.loc[~kept, "reason"].astype(str)
    owner = match_sightings(seen, found)
    rated = read_table(hazard) if hazard else pd.DataFrame()
    scores = read_json(validation) if validation else None
    if scores is not None and components:
        scores["ablation"] = read_json(components)
    hide: Hide = _Hidden(places, masks) if settings.blur else lambda _, image: image
    read_image = _reader(images, drive, lenses, places, hide) if images else None
    best = _best(found, seen, owner, places) if images else []
    best += _projected(found, cameras, places) if images else []
    rank = {} if rated.empty else dict(zip(rated["id"].astype(str), rated["rank"], strict=True))
    # The most dangerous first.
    names = sorted((name for name, _, _ in best), key=lambda name: rank.get(name, np.inf))
    result = PolesResult(
        read_top(top, Frame.from_dict(about)),
        edges.to_numpy(np.float64),
        places,
        cameras,
        seen,
        owner,
        found,
        withheld,
        rated,
        _image_edges(image_edges, places["image"]),
        read_image,
        _depth_fit(dem, masks, depth, cameras, Frame.from_dict(about)),
        scores,
        [path.name for path in files],
        read_table(sections) if sections else pd.DataFrame(),
        read_about(sections).get("profiles", {}) if sections else {},
        _pictures(best, names[:MOST_PICTURES], read_image, pictures),
        settings.blur,
    )
    page = build_poles_page(title or site, summary, about, result)
    counts = page["counts"]
    log.info(
        "%d images, %d shown, %d poles", counts["images"], len(page["images"]), counts["poles"]
    )
    write_json(out, page)


class _Hidden:
    """Makes unrecognisable what masks say moves; the whole image where there is no mask."""

    def __init__(self, frames: pd.DataFrame, masks: Sequence[Path]) -> None:
        shards = _by_name(masks)
        self._masks = {
            view.path: (shards[view.name], view.name)
            for view in views_of(frames)
            if view.name in shards
        }
        self._told: set[str] = set()

    def __call__(self, path: str, image: Bytes) -> Bytes:
        if path in self._masks:
            shard, name = self._masks[path]
            return unrecognisable(image, shard.read(name))
        if path not in self._told:
            self._told.add(path)
            log.warning("%s has no mask: all of it is made unrecognisable", path)
        return unrecognisable(image, np.full((1, 1), PixelClass.VEHICLE, np.uint8))


def _best(
    poles: pd.DataFrame, sightings: pd.DataFrame, owner: Ints, frames: pd.DataFrame
) -> list[_Best]:
    """Id, view and box (least u and v, greatest) of the best sighting of each pole that is seen."""
    views = {(view.image, view.view): view for view in views_of(frames)}
    rows = best_views(sightings, owner, len(poles))
    seen = sightings.iloc[rows[rows >= 0]]
    boxes = seen[["u_min", "v_min", "u_max", "v_max"]].to_numpy(np.float64).tolist()
    places = zip(seen["image"].astype(str), seen["view"].astype(str), strict=True)
    names = poles["id"].astype(str)[rows >= 0]
    return [
        (name, views[place], (u_min, v_min, u_max, v_max))
        for name, place, (u_min, v_min, u_max, v_max) in zip(names, places, boxes, strict=True)
    ]


def _projected(poles: pd.DataFrame, cameras: pd.DataFrame, frames: pd.DataFrame) -> list[_Best]:
    """The same of objects of the cloud, which have no sightings: by their place and their size.

    The front view counts that holds the tallest picture, of those that show the object, or of all
    near ones where none is known to.
    """
    views = {view.image: view for view in views_of(frames) if view.view == "front"}
    known = cameras[cameras["accepted"].astype(bool)].set_index("image")
    by_image = {str(image): _view_camera(pose)[0] for image, pose in known.iterrows()}
    at_m = known[["x", "y"]].to_numpy(np.float64)
    of_cloud = np.array([KINDS[kind].from_cloud for kind in poles["kind"]], bool)
    if not of_cloud.any():
        return []
    own = poles[of_cloud & poles["height_m"].notna().to_numpy()]
    sizes = own[["x", "y", "z", "height_m", "crown_width_m"]].to_numpy(np.float64)
    found = []
    for name, shown_in, (*place, height_m, crown_m) in zip(
        own["id"].astype(str), own["images"].astype(str), sizes, strict=True
    ):
        near = np.hypot(*(at_m - place[:2]).T) <= _NEAR_M
        images = [image for image in shown_in.split(";") if image in by_image]
        images = images or known.index[near].astype(str).tolist()
        width_m = crown_m if np.isfinite(crown_m) else _BUILDING_M
        boxes = {
            image: projected_box(by_image[image], np.array(place), height_m, width_m)
            for image in sorted(images)
            if image in views
        }
        shown = {image: box for image, box in boxes.items() if box is not None}
        if shown and np.isfinite(place).all():
            best = max(shown, key=lambda image: shown[image][3] - shown[image][1])
            found.append((name, views[best], shown[best]))
    return found


def _pictures(
    best: Sequence[_Best], wanted: Sequence[str], read_image: ReadImage | None, out: Path | None
) -> list[Picture]:
    """Cut the pictures out, all of them into the ZIP; those that are wanted, in their order."""
    about = {name: {"image": view.image, "view": view.view} for name, view, _ in best}
    found: dict[str, Picture] = {}
    with ImageShardWriter(out, about) if out else nullcontext() as archive:
        for name, view, box_px in best:
            if read_image and (archive or name in wanted):
                picture = cut_out(read_image(view.path), box_px)
                if archive:
                    archive.write(name, picture)
                if name in wanted:
                    found[name] = name, view, picture
    return [found[name] for name in wanted]


def _reader(
    images: str, drive: Path | None, lenses_json: str, frames: pd.DataFrame, hide: Hide
) -> ReadImage:
    """Reader of images by their path; without the distortion of their lenses, if told of any."""
    source = ImageSource(images)
    if not drive:
        return lambda path: hide(path, source.read(path))
    lenses = with_given(read_json(drive)["lenses"], json.loads(lenses_json))
    names = ["image", "route", "width_px", "height_px"]
    places = {
        str(image): (str(route), int(width), int(height))
        for image, route, width, height in frames[names].itertuples(index=False)
    }
    keys = {view.path: places[view.image] for view in views_of(frames)}

    @cache
    def bent(key: tuple[str, int, int], shape: tuple[int, int]) -> Floats:
        return source_places(lens_of(lenses, key, shape), shape[::-1], shape)

    def read(path: str) -> Bytes:
        image = source.read(path)
        shape = image.shape[0], image.shape[1]
        return hide(path, straightened(image, bent(keys[path], shape), smooth=True))

    return read


def _joined(paths: Sequence[Path]) -> pd.DataFrame:
    """Shards of a table in order; those without rows do not decide about its types."""
    tables = [read_table(path) for path in paths]
    filled = [table for table in tables if len(table)]
    return pd.concat(filled or tables[:1], ignore_index=True)


def _by_name(paths: Sequence[Path]) -> dict[str, ImageShard]:
    """Shard that holds the mask or depth of each name."""
    return {name: shard for shard in map(ImageShard, paths) for name in shard.names}


def _image_edges(paths: Sequence[Path], images: pd.Series) -> ReadEdges:
    """Reader of an image's edges; a shard is read once."""
    shards = deal(images, len(paths))

    @cache
    def shard(number: int) -> pd.DataFrame:
        return read_table(paths[number], ["image", "u", "v"])

    def read(image: str) -> pd.DataFrame:
        table = shard(shards[image])
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
    shards = [_by_name(paths) for paths in (masks, depth_paths)]
    for camera, pose in _middle_first(cameras[cameras["accepted"].astype(bool)]):
        name = view_name(str(pose["image"]))
        if not all(name in found for found in shards):
            continue
        mask, depth = (found[name].read(name) for found in shards)
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
        yield _view_camera(ordered.iloc[row])


def _view_camera(pose: pd.Series) -> tuple[ViewCamera, pd.Series]:
    """Camera of an image's front view, with its row."""
    numbers = [float(pose[name]) for name in ("focal_px", "cx_px", "cy_px")]
    own = Intrinsics(int(pose["width_px"]), int(pose["height_px"]), *numbers)
    position = (float(pose["x"]), float(pose["y"]), float(pose["z"]))
    angles = [float(pose[f"{name}_deg"]) for name in ("heading", "pitch", "roll")]
    return ViewCamera(own, position, *angles), pose


main = Command(write_poles_page)


if __name__ == "__main__":
    sys.exit(main())
