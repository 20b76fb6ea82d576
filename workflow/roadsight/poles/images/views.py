"""The views of one place: front, and left and right where a videolog has them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import PurePosixPath
from typing import Literal

import cv2
import numpy as np
import pandas as pd
from numpy.typing import NDArray

from roadsight.base.arrays import Floats
from roadsight.base.errors import InputError
from roadsight.base.sections.poles import SideViews
from roadsight.base.shards import Shard
from roadsight.geometry.cameras import Intrinsics, wrap_deg
from roadsight.geometry.lens import RadialLens

# Height of the second study's images, for which settings and thresholds in pixels hold
PUBLISHED_HEIGHT_PX = 1200
ViewName = Literal["front", "left", "right"]
# Views in the order in which they are looked at
VIEWS: tuple[ViewName, ...] = ("front", "left", "right")
# Column of the frames that names each view's image
_PATHS = {"front": "path", "left": "left_path", "right": "right_path"}


@dataclass(frozen=True)
class View:
    """One image of a place.

    Parameters
    ----------
    image : name of the place's (front) image. view : front, left or right.
    path : of this image in the videolog. name : of what is made from it, without extension.
    """

    image: str
    view: str
    path: str
    name: str


def scale_of(height_px: int) -> float:
    """Pixels of an image in one pixel of the published size, in which settings are stated."""
    return height_px / PUBLISHED_HEIGHT_PX


def view_name(image: str, view: str = "front") -> str:
    """Name under which masks and depth of a view are kept in a shard."""
    stem = str(PurePosixPath(image).with_suffix(""))
    return stem if view == "front" else f"{stem}.{view}"


def usable(frames: pd.DataFrame, shard: Shard) -> pd.DataFrame:
    """Frames of one shard that may be used, in the table's order."""
    own = frames["image"].isin(shard.dealt(frames["image"]))
    return frames[(frames["status"] == "ok") & own].reset_index(drop=True)


def views_of(frames: pd.DataFrame, wanted: tuple[str, ...] = VIEWS) -> Iterator[View]:
    """Views of each frame, front first; a path of "" or none means that there is no such view."""
    for row in frames.to_dict("records"):
        for view in VIEWS:
            path = row.get(_PATHS[view])
            if view in wanted and isinstance(path, str) and path:
                yield View(row["image"], view, path, view_name(row["image"], view))


# Images of a lens turned into those of a pinhole camera.


def source_places(lens: RadialLens, size_px: tuple[int, int], shape: tuple[int, int]) -> Floats:
    """Where each pixel of a pinhole's map comes from in the lens's map: (rows, columns, 2) u, v.

    Parameters
    ----------
    lens : of the image. size_px : width and height of the image.
    shape : rows and columns of the map, which may be coarser than the image.
    """
    per_px = np.array([size_px[0] / shape[1], size_px[1] / shape[0]])
    uv = np.indices(shape, np.float64)[::-1].reshape(2, -1).T
    image_uv = (uv + 0.5) * per_px - 0.5
    return ((lens.distort(image_uv) + 0.5) / per_px - 0.5).reshape(*shape, 2)


def straightened(image: NDArray, places: Floats, smooth: bool = False) -> NDArray:
    """Map or image as a pinhole camera would have taken it; 0 where the lens showed nothing.

    Parameters
    ----------
    image : (rows, columns) or (rows, columns, channels), uint8 or uint16.
    places : see `source_places`. smooth : whether to interpolate; classes must not be.
    """
    uv = np.nan_to_num(places, nan=-1e6).astype(np.float32)
    way = cv2.INTER_LINEAR if smooth else cv2.INTER_NEAREST
    turned = cv2.remap(
        image, uv[..., 0], uv[..., 1], way, borderMode=cv2.BORDER_CONSTANT, borderValue=0
    )
    return np.asarray(turned, image.dtype)


# Left, front and right view as one: cameras that turn about one centre (paper 2, section 3.2.3).
# The paper lays the views side by side and uses the front view's parameters for all (`beside`).
# Else each view is measured with a camera of its own, turned from the front camera by a known
# yaw: nothing is resampled; objects that cross a seam, or that two views show, become one
# sighting.

_SIGMAS = 3.0  # Standard deviations within which bearings and distances of one object agree
# Bearings of what the frame cuts in both views may differ by this: either view shows a part only
_SEAM_DEG = 0.5


@dataclass(frozen=True)
class ViewOffsets:
    """Yaw of the side views from the front view, clockwise, degrees.

    Parameters
    ----------
    left_deg, right_deg : for example -60 and 60.
    """

    left_deg: float = SideViews().left_yaw_deg
    right_deg: float = SideViews().right_yaw_deg

    def of(self, view: str) -> float:
        """Yaw of a view; 0 for the front."""
        return {"front": 0.0, "left": self.left_deg, "right": self.right_deg}[view]


def turned(cam_from_world: Floats, yaw_deg: float) -> Floats:
    """Rotation (3, 3) of a camera that is turned clockwise about the front camera's down axis."""
    c, s = np.cos(np.radians(yaw_deg)), np.sin(np.radians(yaw_deg))
    side_from_front = np.array([[c, 0.0, -s], [0.0, 1.0, 0.0], [s, 0.0, c]])
    return side_from_front @ cam_from_world


def side_intrinsics(front: Intrinsics, width_px: int, height_px: int) -> Intrinsics:
    """Intrinsics of a side view of another size, with the same field of view down the image."""
    if (width_px, height_px) == (front.width_px, front.height_px):
        return front
    return Intrinsics.centred(width_px, height_px, front.focal_px * height_px / front.height_px)


def beside(front: Intrinsics, view: str, width_px: int, height_px: int) -> Intrinsics:
    """Intrinsics of a side view that goes on in the front view's plane (section 3.2.3).

    The study lays the three images side by side and takes the front view's parameters for all.

    Raises
    ------
    InputError : the view is not as large as the front view.
    """
    if (width_px, height_px) != (front.width_px, front.height_px):
        raise InputError(
            "a stitched side view must be as large as the front view",
            where=f"sightings.side_views: {view} view",
            found=f"{width_px} x {height_px} px",
            allowed=f"{front.width_px} x {front.height_px} px",
            hint="side_views: found or given takes views of any size",
        )
    shift = {"left": front.width_px, "front": 0, "right": -front.width_px}[view]
    return replace(front, cx_px=front.cx_px + shift)


def merge_views(sightings: pd.DataFrame) -> pd.DataFrame:
    """One sighting of what two views of a place show; the other is no longer kept.

    Two kept sightings of one image and kind in different views are one object if their bearings
    agree within three sigmas and their own width, or half a degree if the frame cuts both. The one
    that is not cut stays; of two cut ones the front view stays and takes the bearing of both
    together, each weighed by its width.

    Parameters
    ----------
    sightings : image, view, kind, bearing_grid_deg, sigma_bearing_deg, width_deg, depth_m,
        sigma_depth_m, cut_side (bool), kept, reason; depth_lidar_m and sigma_place_m (error of the
        camera's place along the ray, which the distance of a column has not) where they are known.

    Returns
    -------
    the same rows in the same order, with bearing_grid_deg, kept and reason changed
    """
    merged = sightings.copy()
    for _, group in merged[merged["kept"]].groupby(["image", "kind"], sort=True):
        if group["view"].nunique() > 1:
            _merge_group(merged, group)
    return merged


def _merge_group(merged: pd.DataFrame, group: pd.DataFrame) -> None:
    pairs = []
    for i in group.index[group["view"] == "front"]:
        for j in group.index[group["view"] != "front"]:
            apart = _apart_deg(merged.loc[i], merged.loc[j])
            if apart is not None:
                pairs.append((apart, i, j))
    used: set[int] = set()
    for _, i, j in sorted(pairs):
        if i in used or j in used:
            continue
        used |= {i, j}
        cut = merged["cut_side"]
        stays, goes = (j, i) if cut[i] and not cut[j] else (i, j)
        if cut[i] and cut[j]:
            width = merged.loc[[i, j], "width_deg"].to_numpy(np.float64)
            base, other = merged.loc[[i, j], "bearing_grid_deg"].to_numpy(np.float64)
            turn = float(wrap_deg(other - base))
            merged.at[stays, "bearing_grid_deg"] = (base + turn * width[1] / width.sum()) % 360.0
        merged.at[goes, "kept"] = False
        merged.at[goes, "reason"] = f"same as in the {merged['view'][stays]!s} view"


def _apart_deg(front: pd.Series, side: pd.Series) -> float | None:
    """Angle between two sightings, None if they are two objects."""
    apart = abs(float(wrap_deg(front["bearing_grid_deg"] - side["bearing_grid_deg"])))
    sigma = np.hypot(front["sigma_bearing_deg"], side["sigma_bearing_deg"])
    reach = _SIGMAS * sigma + 0.5 * (front["width_deg"] + side["width_deg"])
    if front["cut_side"] and side["cut_side"]:
        reach = max(reach, _SEAM_DEG)
    depth_sigma = np.hypot(front["sigma_depth_m"], side["sigma_depth_m"])
    ends = [np.isfinite(one.get("depth_lidar_m", np.nan)) for one in (front, side)]
    if ends[0] != ends[1]:
        depth_sigma = np.hypot(depth_sigma, side.get("sigma_place_m", 0.0))
    depths_differ = abs(front["depth_m"] - side["depth_m"]) > max(_SIGMAS * depth_sigma, 1.0)
    return None if apart > reach or depths_differ else apart
