"""Signs that are drawn into training crops, so that each shows some before whatever is there."""

from __future__ import annotations

import math

import cv2
import numpy as np

from roadsight.base.arrays import Bytes, Floats, Floats32
from roadsight.poles.images.kinds import PixelClass

_FINER = 4  # Sub-pixels of a pixel each way, so that edges are mixed as a camera mixes them.
# Of panels seen from before: 0.75 m at 270 m and at 36 m in a view of 20 degrees, 768 px wide.
_ACROSS_PX = (6.0, 45.0)
_FOOT_ON = (PixelClass.VEGETATION, PixelClass.OTHER)  # Posts stand on grass and on shoulders.
# Reflectances of the sheets of signs, those of the renderer and the other usual ones.
_HUES_BGR = np.array(
    [
        [0.8, 0.8, 0.8],  # white
        [0.02, 0.5, 0.8],  # yellow
        [0.13, 0.3, 0.02],  # green
        [0.05, 0.04, 0.55],  # red
        [0.5, 0.16, 0.02],  # blue
        [0.04, 0.1, 0.22],  # brown
        [0.03, 0.25, 0.8],  # orange
        [0.02, 0.02, 0.02],  # black
    ]
)
_METAL = np.array([0.4, 0.4, 0.39])  # Of backs and steel posts.
_WOOD = np.array([0.16, 0.2, 0.25])
_GAMMA = 1.0 / 2.2  # From light to the values of an image.
# Triangle, diamond, hexagon, octagon, disc; as many panels again are rectangles.
_CORNERS = (3, 4, 6, 8, 16)


def with_panels(
    colour: Bytes, classes: Bytes, mean: float, rng: np.random.Generator
) -> tuple[Bytes, Bytes]:
    """Colours (h, w, 3) and classes (h, w) with some ``mean`` more signs on posts."""
    feet = np.flatnonzero(np.isin(classes, _FOOT_ON))
    if not len(feet):
        return colour, classes
    pixels, kinds = colour.astype(np.float32), classes.copy()
    for _ in range(rng.poisson(mean)):
        row, column = np.unravel_index(feet[rng.integers(len(feet))], classes.shape)
        _draw(pixels, kinds, np.array([column, row], np.float64), rng)
    return pixels.round().astype(np.uint8), kinds


def _draw(pixels: Floats32, kinds: Bytes, foot_px: Floats, rng: np.random.Generator) -> None:
    """Draw one sign whose post ends at ``foot_px`` (column, row), from before or behind."""
    across = float(np.exp(rng.uniform(*np.log(_ACROSS_PX))))
    outline = _outline(rng) * across
    # most are met head on, some from aside and a few from their edge
    outline[:, 0] *= 1.0 if rng.random() < 0.6 else rng.uniform(0.1, 1.0)
    low = float(outline[:, 1].max())
    middle = foot_px - [0.0, low + across * rng.uniform(0.8, 3.0)]
    if middle[1] + outline[:, 1].min() < 0.0:
        return
    light = float(np.exp(rng.normal(-0.7, 0.5)))
    haze, veil = rng.uniform(0.0, 0.45), pixels.mean(axis=(0, 1))
    back = rng.random() < 0.45
    post = _WOOD if rng.random() < 0.25 else _METAL * rng.uniform(0.6, 1.1)

    def paint(corners: Floats, reflectance: Floats, kind: PixelClass) -> None:
        value = 255.0 * np.clip(light * reflectance, 0.0, 1.0) ** _GAMMA
        _fill(pixels, kinds, corners, value + haze * (veil - value), kind)

    half = 0.5 * max(across * rng.uniform(0.06, 0.14), 0.7)
    top = middle[1] + (outline[:, 1].min() if back or rng.random() < 0.3 else low)
    stem = _box(foot_px[0] - half, top, foot_px[0] + half, foot_px[1])
    if not back:
        paint(stem, post, PixelClass.POLE)
    if back:
        paint(outline + middle, _METAL * rng.uniform(0.8, 1.1), PixelClass.SIGN)
        paint(stem, post, PixelClass.POLE)
        return
    ground, ink = _HUES_BGR[rng.choice(len(_HUES_BGR), 2, replace=False)]
    paint(outline + middle, ink if rng.random() < 0.5 else ground, PixelClass.SIGN)
    paint(0.86 * outline + middle, ground, PixelClass.SIGN)
    size = 0.5 * np.ptp(outline, axis=0)
    for _ in range(int(rng.integers(0, 5))):
        wide, high = size * rng.uniform([0.05, 0.04], [0.5, 0.2])
        x, y = middle + size * rng.uniform(-0.4, 0.4, 2)
        paint(_box(x - wide, y - high, x + wide, y + high), ink, PixelClass.SIGN)


def _outline(rng: np.random.Generator) -> Floats:
    """Corners (k, 2) of a panel of width 1 about its middle, right and down."""
    if rng.random() < 0.5:
        high = float(np.exp(rng.uniform(-0.8, 0.6)))
        return _box(-0.5, -0.5 * high, 0.5, 0.5 * high)
    corners = int(rng.choice(_CORNERS))
    turn = 0.5 * math.pi * (1.0 if corners != 3 else rng.choice([-1.0, 1.0]))
    turn += math.pi / corners if corners in (6, 8) else 0.0
    angle = turn + 2.0 * math.pi * np.arange(corners) / corners
    return 0.5 * np.stack([np.cos(angle), np.sin(angle)], axis=1)


def _box(left: float, top: float, right: float, bottom: float) -> Floats:
    return np.array([[left, top], [right, top], [right, bottom], [left, bottom]])


def _fill(pixels: Floats32, kinds: Bytes, corners: Floats, value: Floats, kind: PixelClass) -> None:
    """Mix ``value`` into what a convex polygon covers; what it covers half of is of ``kind``."""
    last = np.array(kinds.shape[::-1], np.int64)
    first = np.clip(np.floor(corners.min(axis=0)).astype(np.int64), 0, last)
    end = np.clip(np.ceil(corners.max(axis=0)).astype(np.int64) + 1, 0, last)
    wide, high = end - first
    if wide < 1 or high < 1:
        return
    fine = np.zeros((high * _FINER, wide * _FINER), np.uint8)
    inside = np.round((corners - first) * _FINER - 0.5).astype(np.int32)
    cv2.fillConvexPoly(fine, inside, 255)
    share = cv2.resize(fine, (int(wide), int(high)), interpolation=cv2.INTER_AREA) / 255.0
    part = np.s_[first[1] : end[1], first[0] : end[0]]
    pixels[part] += share[..., None].astype(np.float32) * (value.astype(np.float32) - pixels[part])
    kinds[part][share >= 0.5] = int(kind)
