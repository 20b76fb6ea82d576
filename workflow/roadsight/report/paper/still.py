"""A still of the 3D view: points of the cloud in perspective, nearer ones before farther ones."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from roadsight.base.arrays import Bytes, Floats

_WIDTH_PX = 1800
_HEIGHT_PX = 900
"""Size of the still: 180 mm on paper at 250 dots per inch."""
_FIELD_DEG = 40.0
"""Horizontal field of view, about that of a camera with a normal lens."""
_ELEVATION_DEG = 35.0
"""The eye looks down so steeply: lower, cars hide the road; higher, posts have no length."""
_POINT_M = 0.35
"""Points are drawn this large, so that a sample of 150,000 closes a road of some hundred metres."""
_LARGEST_PX = 7
_BACKGROUND = (252, 250, 248)
"""Almost white, blue first."""


@dataclass(frozen=True)
class View:
    """Perspective from outside.

    Parameters
    ----------
    eye_m : (3,) local metres. axes : (3, 3) rows right, down, forward. focal_px : focal length.
    """

    eye_m: Floats
    axes: Floats
    focal_px: float

    def project(self, xyz_m: NDArray) -> tuple[Floats, Floats]:
        """Pixels (n, 2) and depths (n,) in metres; depth is not positive behind the eye."""
        seen = (np.asarray(xyz_m, np.float64).reshape(-1, 3) - self.eye_m) @ self.axes.T
        depth = seen[:, 2]
        ahead = np.where(depth > 0, depth, np.nan)
        centre = np.array([_WIDTH_PX / 2, _HEIGHT_PX / 2])
        return centre + self.focal_px * seen[:, :2] / ahead[:, None], depth


def view_of(xyz_m: NDArray) -> View:
    """View along the shorter side of a cloud (n, 3), so that its longer side spans the still."""
    centre = xyz_m.mean(axis=0)
    spread = np.linalg.svd(xyz_m[:, :2] - centre[:2], full_matrices=False)[2]
    along = spread[0] if spread[0][0] >= 0 else -spread[0]
    away = np.array([-along[1], along[0]])
    elevation = np.radians(_ELEVATION_DEG)
    forward = np.array([*(away * np.cos(elevation)), -np.sin(elevation)])
    right = np.array([*along, 0.0])
    down = np.cross(forward, right)
    focal = _WIDTH_PX / 2 / np.tan(np.radians(_FIELD_DEG / 2))
    axes = np.array([right, down, forward])
    inside = (xyz_m - centre) @ axes.T
    # The eye goes back until every point is in the field, whichever way it lies.
    needed = np.abs(inside[:, :2]) * focal / np.array([_WIDTH_PX / 2, _HEIGHT_PX / 2])
    back = float((needed.max(axis=1) - inside[:, 2]).max())
    return View(centre - max(back, 1.0) * forward, axes, focal)


def still(xyz_m: NDArray, colours: Bytes, sensors_m: NDArray, grounds_m: NDArray) -> bytes:
    """PNG of a cloud with its sensors.

    Parameters
    ----------
    xyz_m : (n, 3) local metres, n at least 1. colours : (n, 3) red, green, blue.
    sensors_m : (k, 3) sensors. grounds_m : (k, 3) feet of their masts.
    """
    view = view_of(xyz_m)
    picture = np.full((_HEIGHT_PX, _WIDTH_PX, 3), _BACKGROUND, np.uint8)
    _paint(picture, view, xyz_m, colours[:, ::-1])
    _masts(picture, view, sensors_m, grounds_m)
    return bytes(cv2.imencode(".png", picture)[1])


def _paint(picture: Bytes, view: View, xyz_m: NDArray, blue_first: Bytes) -> None:
    """Paint points as squares of their size in the world, farther ones first."""
    pixels, depth = view.project(xyz_m)
    ahead = np.flatnonzero(depth > 0)
    size = np.clip(np.rint(view.focal_px * _POINT_M / depth[ahead]), 1, _LARGEST_PX).astype(int)
    owners = np.repeat(ahead, size**2)
    number = np.arange(len(owners)) - np.repeat(np.cumsum(size**2) - size**2, size**2)
    rows, columns = np.divmod(number, np.repeat(size, size**2))
    columns = columns + np.rint(pixels[owners, 0]).astype(np.int64)
    rows = rows + np.rint(pixels[owners, 1]).astype(np.int64)
    inside = (columns >= 0) & (columns < _WIDTH_PX) & (rows >= 0) & (rows < _HEIGHT_PX)
    order = np.flatnonzero(inside)[np.argsort(-depth[owners[inside]], kind="stable")]
    picture[rows[order], columns[order]] = blue_first[owners[order]]


def _masts(picture: Bytes, view: View, sensors_m: NDArray, grounds_m: NDArray) -> None:
    tops, _ = view.project(sensors_m)
    feet, _ = view.project(grounds_m)
    for top, foot in zip(np.rint(tops).astype(int), np.rint(feet).astype(int), strict=True):
        cv2.line(picture, tuple(map(int, foot)), tuple(map(int, top)), (20, 20, 20), 2, cv2.LINE_AA)
        cv2.circle(picture, tuple(map(int, top)), 9, (255, 255, 255), -1, cv2.LINE_AA)
        cv2.circle(picture, tuple(map(int, top)), 7, (38, 38, 220), -1, cv2.LINE_AA)
