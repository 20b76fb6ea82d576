"""Random crops, scales and camera faults, so that a network learns roads and not the renderer."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from roadsight.base.arrays import Bytes, Floats32, Ints
from roadsight.poles.images.kinds import PixelClass
from roadsight_training.pasted_panels import with_panels
from roadsight_training.samples import DEPTH_SCALE, Sample

# Weights of blue, green and red in grey (ITU-R BT.601).
_GREY_BGR = np.array([0.114, 0.587, 0.299], np.float32)


@dataclass(frozen=True)
class Crops:
    """What part of an image a training crop shows.

    Parameters
    ----------
    height_px, width_px : of the crop. scale : smallest and largest enlargement of the image.
    wanted_share : share of the crops that hold a chosen pixel of one of the ``wanted`` classes,
        which have few pixels; a class that is there twice is chosen twice as often.
    panels : signs drawn into a crop, in the mean.
    """

    height_px: int = 256
    width_px: int = 352
    scale: tuple[float, float] = (0.7, 1.6)
    wanted_share: float = 0.6
    wanted: tuple[PixelClass, ...] = (PixelClass.POLE, PixelClass.SIGN, PixelClass.MARKING)
    panels: float = 0.0


@dataclass(frozen=True)
class Batch:
    """Crops as a network sees them.

    Parameters
    ----------
    images : (n, 3, h, w) RGB in 0 to 1. classes : (n, h, w). inverse_depth : (n, h, w), 1 / m.
    """

    images: Floats32
    classes: Ints
    inverse_depth: Floats32


def random_batch(
    samples: list[Sample], count: int, crops: Crops, rng: np.random.Generator
) -> Batch:
    """Crops of ``count`` images drawn at random; the same ``rng`` gives the same crops."""
    drawn = [_random_crop(samples[rng.integers(len(samples))], crops, rng) for _ in range(count)]
    if crops.panels > 0.0:
        drawn = [
            Sample(*with_panels(one.colour, one.classes, crops.panels, rng), one.depth)
            for one in drawn
        ]
    faulty = [with_camera_faults(sample.colour, rng) for sample in drawn]
    rgb = np.stack(faulty)[..., ::-1].transpose(0, 3, 1, 2)
    depth = np.stack([sample.depth for sample in drawn]).astype(np.float32)
    return Batch(
        np.ascontiguousarray(rgb, np.float32) / np.float32(255.0),
        np.stack([sample.classes for sample in drawn]).astype(np.int64),
        depth / np.float32(DEPTH_SCALE),
    )


def _random_crop(sample: Sample, crops: Crops, rng: np.random.Generator) -> Sample:
    """Part of the image, enlarged to the crop's size and mirrored every other time."""
    rows, columns = sample.classes.shape
    low, high = np.log(crops.scale)
    least = max(crops.height_px / rows, crops.width_px / columns)
    scale = max(float(np.exp(rng.uniform(low, high))), least)
    height, width = (
        min(round(crops.height_px / scale), rows),
        min(round(crops.width_px / scale), columns),
    )
    top, left = _random_corner(sample.classes, (height, width), crops, rng)
    part = np.s_[top : top + height, left : left + width]
    mirrored = rng.random() < 0.5
    smooth = cv2.INTER_AREA if scale < 1.0 else cv2.INTER_LINEAR

    def resized(pixels: NDArray, how: int) -> NDArray:
        size = (crops.width_px, crops.height_px)
        found = cv2.resize(np.ascontiguousarray(pixels[part]), size, interpolation=how)
        return found[:, ::-1] if mirrored else found

    # NEAREST_EXACT and not NEAREST, which moves labels by half a pixel against the colours
    return Sample(
        resized(sample.colour, smooth),
        resized(sample.classes, cv2.INTER_NEAREST_EXACT),
        resized(sample.depth, cv2.INTER_NEAREST_EXACT),
    )


def _random_corner(
    classes: Bytes, size: tuple[int, int], crops: Crops, rng: np.random.Generator
) -> tuple[int, int]:
    """Top row and left column of a part of ``size`` rows and columns."""
    last = np.array(classes.shape, np.int64) - np.array(size, np.int64)
    corner = rng.integers(0, last + 1)
    kind = crops.wanted[rng.integers(len(crops.wanted))]
    if rng.random() < crops.wanted_share:
        pixels = np.flatnonzero(classes == kind)
        if len(pixels):
            chosen = np.unravel_index(pixels[rng.integers(len(pixels))], classes.shape)
            inside = (rng.random(2) * size).astype(int)
            corner = np.clip(np.array(chosen) - inside, 0, last)
    return int(corner[0]), int(corner[1])


def with_camera_faults(colour: Bytes, rng: np.random.Generator) -> Bytes:
    """Another exposure, cast, contrast, saturation, haze, sharpness, noise and JPEG quality."""
    gain = np.exp(rng.normal(0.0, 0.2) + rng.normal(0.0, 0.06, 3)).astype(np.float32)
    pixels: NDArray = colour.astype(np.float32) * gain
    grey = (pixels @ _GREY_BGR)[..., None]
    pixels = grey + (pixels - grey) * np.float32(np.exp(rng.normal(0.0, 0.3)))
    middle = np.float32(pixels.mean())
    pixels = middle + (pixels - middle) * np.float32(np.exp(rng.normal(0.0, 0.15)))
    if rng.random() < 0.2:  # mist, or a wet windscreen in the sun
        pixels = pixels + (np.float32(rng.uniform(150.0, 235.0)) - pixels) * np.float32(
            rng.uniform(0.05, 0.4)
        )
    if rng.random() < 0.3:
        # What a sensor of fewer pixels each way saw, enlarged.
        factor = rng.uniform(1.2, 2.2)
        height, width = pixels.shape[:2]
        coarse = (max(round(width / factor), 1), max(round(height / factor), 1))
        few = cv2.resize(pixels, coarse, interpolation=cv2.INTER_AREA)
        pixels = cv2.resize(few, (width, height), interpolation=cv2.INTER_LINEAR)
    if rng.random() < 0.5:
        blurred = cv2.GaussianBlur(pixels, (0, 0), rng.uniform(0.3, 1.3))
        # half of the cameras sharpen instead, which rings at edges
        over = 0.0 if rng.random() < 0.5 else rng.uniform(1.2, 2.0)
        pixels = (blurred + (pixels - blurred) * np.float32(over)).astype(np.float32)
    if rng.random() < 0.5:
        noise = rng.standard_normal(pixels.shape, np.float32)
        pixels = pixels + noise * np.float32(rng.uniform(1.0, 8.0))
    finished = np.clip(pixels, 0.0, 255.0).astype(np.uint8)
    if rng.random() < 0.5:
        quality = [cv2.IMWRITE_JPEG_QUALITY, int(rng.integers(25, 96))]
        decoded = cv2.imdecode(cv2.imencode(".jpg", finished, quality)[1], cv2.IMREAD_COLOR)
        finished = np.asarray(decoded, np.uint8)
    return finished
