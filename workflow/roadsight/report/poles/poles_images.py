"""A few images of the route with what was projected onto them and what was found in them."""

from __future__ import annotations

import base64
from typing import Any

import cv2
import numpy as np
import pandas as pd
from numpy.typing import NDArray

from roadsight.base.arrays import Bytes, Floats, Ints
from roadsight.geometry.cameras import Intrinsics, cam_from_world, project
from roadsight.report.packing import pack
from roadsight.report.poles.poles_layers import ACCEPTED, REJECTED, finite

MOST_IMAGES = 24
"""Images in the page, which holds them itself: each adds its bytes."""
WIDTH_PX = 640
"""Width to which larger images are reduced."""
_JPEG_QUALITY = 74
"""Of reduced images: small, and edges still stand out."""
_MOST_POINTS = 1200
"""Points of each kind that are drawn on an image."""
_NEAR_M = 3.0
"""Points nearer to the camera are not drawn: they are under the vehicle or far out of the image."""
_FAR_M = 80.0
"""Points further from the camera are not drawn: they would crowd at the horizon."""
_STEPS_PER_PX = 8
"""Places of drawn points are stored in eighths of a pixel."""


def choose_images(cameras: pd.DataFrame, most: int = MOST_IMAGES) -> list[int]:
    """Rows of the images to show, in order of the route.

    A third are rejected ones, a third those with the largest residuals, each spread evenly where
    there are too many; the rest, and what these leave free, are accepted ones at even distances.

    Parameters
    ----------
    cameras : of `cameras_of`. most : how many.
    """
    share = most // 3
    state = cameras["state"].to_numpy()
    rejected = _spread(np.flatnonzero(state == REJECTED), share)
    accepted = np.flatnonzero(state == ACCEPTED)
    residual = np.nan_to_num(cameras["residual_px"].to_numpy()[accepted], nan=-1.0)
    worst = accepted[np.argsort(-residual, kind="stable")][: min(share, len(accepted) // 4)]
    rest = accepted[~np.isin(accepted, worst)]
    even = _spread(rest, most - len(rejected) - len(worst))
    chosen = np.concatenate([rejected, worst, even])
    if len(chosen) < most:
        left = np.flatnonzero((state == REJECTED) & ~np.isin(np.arange(len(state)), chosen))
        chosen = np.concatenate([chosen, _spread(left, most - len(chosen))])
    return np.sort(chosen).astype(int).tolist()


def _spread(rows: Ints, most: int) -> Ints:
    """At most so many of the rows, evenly, first and last among them."""
    if len(rows) <= most:
        return rows
    return rows[np.unique(np.rint(np.linspace(0, len(rows) - 1, most)).astype(int))]


def picture(image: Bytes) -> dict[str, Any]:
    """JPEG in base64, at most 640 px wide.

    Parameters
    ----------
    image : (rows, columns, 3) blue, green, red.
    """
    rows, columns = image.shape[:2]
    scale = min(1.0, WIDTH_PX / columns)
    size = max(1, round(columns * scale)), max(1, round(rows * scale))
    small = cv2.resize(image, size, interpolation=cv2.INTER_AREA)
    _, jpeg = cv2.imencode(".jpg", small, [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])
    return {"jpeg": base64.b64encode(jpeg.tobytes()).decode("ascii")}


def overlay(
    pose: pd.Series | None,
    size_px: tuple[int, int],
    lidar_edges_m: NDArray,
    edges: pd.DataFrame,
    sightings: pd.DataFrame,
    poles_of_sightings: list[int],
) -> dict[str, Any]:
    """What is drawn over one image, in pixels of a copy 640 px wide.

    Parameters
    ----------
    pose : row of the camera, None if it has none. size_px : width and height of the image.
    lidar_edges_m : road edge (n, 3). edges : u, v of its segmented edges.
    sightings : in its front view. poles_of_sightings : row of the pole of each, -1 if none.
    """
    scale = min(1.0, WIDTH_PX / size_px[0])
    projected = np.empty((0, 2)) if pose is None else _projected(pose, lidar_edges_m)
    return {
        "width_px": round(size_px[0] * scale),
        "height_px": round(size_px[1] * scale),
        "steps_per_px": _STEPS_PER_PX,
        "lidar": _pixels(projected, scale, size_px),
        "edges": _pixels(edges[["u", "v"]].to_numpy(np.float64), scale, size_px),
        "axes": [
            {
                "line": [round(float(value * scale), 1) for value in _axis(row)],
                "kept": bool(row["kept"]),
                "pole": pole,
                "reason": str(row["reason"] or ""),
                "depth_m": finite(row["depth_m"]),
            }
            for row, pole in zip(sightings.to_dict("records"), poles_of_sightings, strict=True)
        ],
    }


def _projected(pose: pd.Series, points_m: NDArray) -> Floats:
    """Pixels of what lies in front of a camera, no nearer than 3 m and no further than 80 m."""
    names = ("x", "y", "z", "heading_deg", "pitch_deg", "roll_deg", "focal_px", "cx_px", "cy_px")
    values = [float(pose[name]) for name in names]
    if not np.isfinite(values).all():
        return np.empty((0, 2))
    near = np.hypot(points_m[:, 0] - values[0], points_m[:, 1] - values[1]) <= _FAR_M
    camera = Intrinsics(int(pose["width_px"]), int(pose["height_px"]), *values[6:])
    uv, depth_m = project(camera, cam_from_world(*values[3:6]), values[:3], points_m[near])
    uv = uv[depth_m >= _NEAR_M]
    return uv[camera.contains(uv)]


def _pixels(uv_px: Floats, scale: float, size_px: tuple[int, int]) -> dict[str, Any]:
    """Pixels in eighths of the copy's, thinned by leaving out evenly."""
    limit = np.array(size_px, np.float64) - 1.0
    known = np.isfinite(uv_px).all(axis=1)
    uv = uv_px[known].clip(0.0, limit) * scale
    order = np.lexsort((uv[:, 0], uv[:, 1]))
    return pack(np.rint(uv[_spread(order, _MOST_POINTS)] * _STEPS_PER_PX), "u2")


def _axis(row: dict[Any, Any]) -> tuple[float, float, float, float]:
    """From the foot to the opposite end of the object's box."""
    top_u = row["u_min"] + row["u_max"] - row["u_foot"]
    return row["u_foot"], row["v_foot"], top_u, row["v_min"]
