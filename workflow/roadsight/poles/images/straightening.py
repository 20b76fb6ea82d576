"""Images of a lens turned into those of a pinhole camera."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from roadsight.base.arrays import Floats
from roadsight.geometry.lens import RadialLens


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
