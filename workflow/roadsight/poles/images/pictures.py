"""Pictures of single objects, cut out of the image that shows each best; what moves is hidden."""

from __future__ import annotations

import cv2
import numpy as np
import pandas as pd

from roadsight.base.arrays import Bytes, Floats, Ints
from roadsight.geometry.cameras import project
from roadsight.poles.images.kinds import PixelClass
from roadsight.poles.sightings.sighting_bearing import ViewCamera

_MARGIN = 0.15  # Margin around an object, as a share of its height
# Width of a picture at least, as a share of its height: what stands beside it tells the place
_LEAST_WIDTH = 0.6
# What a view counts whose foot is hidden, or whose top the image cuts off, against a whole one
_HALF = 0.5
_LEAST_AWAY_M = 2.0  # What is nearer to the camera than this is beside it
_SHOWN = 0.6  # Share of an object's width, and of its height, that an image must hold
_CUT_PX = 1.0  # So near the image's upper end an object is cut off
# Blocks across the longer side of an image that is made unrecognisable: a plate 20 m away, or a
# face, then lies in one of them
_BLOCKS = 60


def best_views(sightings: pd.DataFrame, owner: Ints, objects: int) -> Ints:
    """Row of the sighting that shows each object best (objects,), -1 for none.

    The tallest one counts; one whose foot is hidden or whose top is cut off counts half as much.

    Parameters
    ----------
    sightings : v_min, v_max (pixels), foot_visible. owner : (n,) row of the object of each, or -1.
    """
    height_px = (sightings["v_max"] - sightings["v_min"]).to_numpy(np.float64)
    foot = sightings["foot_visible"].to_numpy(bool)
    top = sightings["v_min"].to_numpy(np.float64) > _CUT_PX
    worth = np.where(foot, 1.0, _HALF) * np.where(top, 1.0, _HALF) * height_px
    best = np.full(objects, -1, np.int64)
    for row in np.argsort(worth, kind="stable"):
        if owner[row] >= 0:
            best[owner[row]] = row
    return best


def projected_box(
    camera: ViewCamera, place_m: Floats, height_m: float, width_m: float
) -> tuple[float, float, float, float] | None:
    """Box of an object that stands at a place, as far as it is in the image; None if most is not.

    Parameters
    ----------
    place_m : x, y, z of its foot, local metres.

    Returns
    -------
    least u and v, greatest u and v, pixels
    """
    half = 0.5 * width_m
    corners = np.array(
        [[x, y, z] for x in (-half, half) for y in (-half, half) for z in (0.0, height_m)]
    )
    if np.hypot(*(place_m[:2] - np.asarray(camera.position_m[:2]))) <= half + _LEAST_AWAY_M:
        return None
    lens = camera.intrinsics
    uv, ahead_m = project(lens, camera.rotation(), camera.position_m, place_m + corners)
    if not (ahead_m > 0).all():
        return None
    low, high = uv.min(axis=0), uv.max(axis=0)
    size = np.array([lens.width_px, lens.height_px], np.float64)
    shown = np.clip(high, 0.0, size - 1) - np.clip(low, 0.0, size - 1)
    if (shown < _SHOWN * (high - low)).any():
        return None
    (u_min, v_min), (u_max, v_max) = np.clip([low, high], 0.0, size - 1).tolist()
    return u_min, v_min, u_max, v_max


def cut_out(image: Bytes, box_px: tuple[float, float, float, float]) -> Bytes:
    """The part of an image around an object, with a margin; at least one pixel.

    Parameters
    ----------
    image : (rows, columns, 3). box_px : least u and v, greatest u and v of the object.
    """
    u_min, v_min, u_max, v_max = box_px
    margin = _MARGIN * (v_max - v_min)
    half = max(0.5 * (u_max - u_min) + margin, 0.5 * _LEAST_WIDTH * (v_max - v_min + 2 * margin))
    middle = 0.5 * (u_min + u_max)
    rows = _span(v_min - margin, v_max + margin, image.shape[0])
    return np.ascontiguousarray(image[rows, _span(middle - half, middle + half, image.shape[1])])


def _span(low: float, high: float, size: int) -> slice:
    start = int(np.clip(np.floor(low), 0, size - 1))
    return slice(start, int(np.clip(np.ceil(high) + 1, start + 1, size)))


def unrecognisable(image: Bytes, mask: Bytes) -> Bytes:
    """The image with whatever moves (vehicles, people: their plates and faces) in coarse blocks.

    Parameters
    ----------
    image : (rows, columns, 3). mask : `PixelClass` (rows, columns), of any size.
    """
    rows, columns = image.shape[:2]
    moving = (mask == PixelClass.VEHICLE).astype(np.uint8)
    if not moving.any():
        return image
    block = max(max(rows, columns) // _BLOCKS, 1)
    size = max(columns // block, 1), max(rows // block, 1)
    coarse = cv2.resize(
        cv2.resize(image, size, interpolation=cv2.INTER_AREA),
        (columns, rows),
        interpolation=cv2.INTER_NEAREST,
    )
    moving = cv2.resize(moving, (columns, rows), interpolation=cv2.INTER_NEAREST)
    # Masks end a few pixels inside of what they show.
    moving = cv2.dilate(moving, np.ones((block, block), np.uint8))
    return np.asarray(np.where(moving[:, :, None] > 0, coarse, image), np.uint8)
