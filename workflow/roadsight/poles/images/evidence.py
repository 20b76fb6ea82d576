"""What an image says about where edges and surfaces of a cloud are seen, as fields.

A field gives, for each pixel, how much likelier a LiDAR sample is there under "this is where its
edge or surface is seen" than under "anywhere nearby", as the log of the ratio. Edges: a mixture of
an edge within a blur of the pixel and of chance, against the density of edges around. Surfaces: the
share of pixels of the right class within the blur, against that of the whole image.
"""

from __future__ import annotations

import cv2
import numpy as np

from roadsight.base.arrays import Bools, Bytes, Floats32
from roadsight.poles.images.kinds import PixelClass

# Fields: upright edges, level edges, markings, ground, things above it
UPRIGHT, LEVEL, MARKED, GROUND, RAISED = range(5)
FIELDS = 5  # How many fields there are
_GROUND = (PixelClass.ROAD, PixelClass.MARKING, PixelClass.KERB)  # Classes that are always ground
# Classes that always stand above ground; vegetation may be a lawn
_RAISED = (
    PixelClass.POLE,
    PixelClass.SIGN,
    PixelClass.BUILDING,
    PixelClass.VEHICLE,
    PixelClass.GUARDRAIL,
    PixelClass.TREE,
)
# Wider images are looked at in this width. All scales were measured on 1,242 px images; memory and
# time of wider ones would only grow.
_WIDEST_PX = 1400
# Share of samples whose edge the image does not show (shadow side, leaves); not tuned
_CHANCE = 0.5
# The neighbourhood of an edge is this many blurs wide: in clutter an edge then tells nothing
_AROUND = 6.0
# Share of pixels with a wrong class that a surface allows for; networks err by about that
_WRONG_CLASS = 0.1
# Edges count up to this multiple of the mean gradient around: neither a sunlit facade nor the
# border of a shadow then outweighs the rest
_STRONGEST = 4.0
# Width of the neighbourhood that an edge's strength is relative to, one standard deviation
_LOCAL_PX = 20.0
# Wider blurs are made on a smaller image, which is faster and differs by less than 1 %
_SMALL_PX = 6.0


class ImageEvidence:
    """Fields of one image at any blur; each is computed once.

    Attributes
    ----------
    shape : rows and columns of the fields. scale : their pixels per pixel of the image, at most 1.

    Parameters
    ----------
    grey : (h, w) photograph. classes : (h, w) `PixelClass`.
    """

    def __init__(self, grey: Bytes, classes: Bytes) -> None:
        self.scale = min(_WIDEST_PX / grey.shape[1], 1.0)
        if self.scale < 1.0:
            size = _WIDEST_PX, max(round(grey.shape[0] * self.scale), 1)
            grey = cv2.resize(grey, size, interpolation=cv2.INTER_AREA).astype(np.uint8)
            classes = cv2.resize(classes, size, interpolation=cv2.INTER_NEAREST).astype(np.uint8)
        self.shape: tuple[int, int] = (grey.shape[0], grey.shape[1])
        marked = (classes == PixelClass.MARKING).astype(np.float32)
        self._edges = (*edge_maps(grey), marked)
        ground, raised = np.isin(classes, _GROUND), np.isin(classes, _RAISED)
        self._surfaces = ground, raised
        self._known = ground | raised | (classes == PixelClass.SKY)
        self._fields: dict[float, Floats32] = {}

    def at(self, sigma_px: float) -> Floats32:
        """Fields (`FIELDS`, h, w) at a blur of one standard deviation ``sigma_px``."""
        if sigma_px not in self._fields:
            edges = [edge_field(values, sigma_px) for values in self._edges]
            surfaces = [surface_field(mask, self._known, sigma_px) for mask in self._surfaces]
            self._fields[sigma_px] = np.stack([*edges, *surfaces])
        return self._fields[sigma_px]


def edge_maps(grey: Bytes) -> tuple[Floats32, Floats32]:
    """Thin edges of a photograph, split by the squared cosine into upright and level ones.

    Parameters
    ----------
    grey : (h, w).

    Returns
    -------
    strengths (h, w) of upright and of level edges, relative to the mean gradient around, 0 to 4
    """
    root = cv2.GaussianBlur(np.sqrt(grey.astype(np.float32) + 1.0), (0, 0), 1.0)
    right = cv2.Sobel(root, cv2.CV_32F, 1, 0, ksize=3, scale=0.125)
    down = cv2.Sobel(root, cv2.CV_32F, 0, 1, ksize=3, scale=0.125)
    size = np.hypot(right, down)
    direction = (np.round(np.arctan2(down, right) / (np.pi / 4)) % 4).astype(int)
    wide = np.pad(size, 1)
    high, broad = size.shape
    peak = np.zeros(size.shape, bool)
    for k, (dy, dx) in enumerate([(0, 1), (1, 1), (1, 0), (1, -1)]):
        ahead = wide[1 + dy : 1 + dy + high, 1 + dx : 1 + dx + broad]
        back = wide[1 - dy : 1 - dy + high, 1 - dx : 1 - dx + broad]
        peak |= (direction == k) & (size > ahead) & (size >= back)
    local = cv2.GaussianBlur(size, (0, 0), _LOCAL_PX) + 0.3 * size.mean() + 1e-12
    strength = np.where(peak, np.minimum(size / local, _STRONGEST), 0.0).astype(np.float32)
    strength[strength < 1.0] = 0.0
    length = np.maximum(size, 1e-9)
    upright = strength * np.square(right / length)
    return upright.astype(np.float32), (strength * np.square(down / length)).astype(np.float32)


def edge_field(edges: Floats32, sigma_px: float) -> Floats32:
    """log(1 - q + q B / L) (h, w): density of edges within the blur against that around."""
    near = _blurred(edges, sigma_px)
    around = _blurred(edges, _AROUND * sigma_px) + 0.2 * edges.mean() + 1e-6
    return np.log(1.0 - _CHANCE + _CHANCE * near / around).astype(np.float32)


def surface_field(mask: Bools, known: Bools, sigma_px: float) -> Floats32:
    """log (h, w) of the share of a class within the blur against its share of the image.

    Parameters
    ----------
    mask : (h, w) pixels of the class. known : (h, w) pixels that say whether they are.
    """
    among = _blurred(known.astype(np.float32), sigma_px)
    mean = float(np.clip(mask.sum() / max(known.sum(), 1), 0.02, 0.98))
    # Where nothing is known, the share is that of the image: the field is 0.
    share = _blurred(mask.astype(np.float32), sigma_px) + mean * np.maximum(1.0 - among, 0.0)
    right = 1.0 - _WRONG_CLASS
    field = np.log((_WRONG_CLASS + right * share) / (_WRONG_CLASS + right * mean))
    return field.astype(np.float32)


def _blurred(values: Floats32, sigma_px: float) -> Floats32:
    if sigma_px < _SMALL_PX:
        return cv2.GaussianBlur(values, (0, 0), sigma_px).astype(np.float32)
    step = int(sigma_px // 3)
    high, broad = values.shape
    size = max(broad // step, 8), max(high // step, 8)
    small = cv2.resize(values, size, interpolation=cv2.INTER_AREA)
    small = cv2.GaussianBlur(small, (0, 0), sigma_px / step)
    return cv2.resize(small, (broad, high), interpolation=cv2.INTER_LINEAR).astype(np.float32)
