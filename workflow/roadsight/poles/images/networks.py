"""Networks on images: before and after the network, on arrays (paper 2, sections 3.1 and 3.3.1)."""

from __future__ import annotations

from collections.abc import Callable
from typing import Annotated, Literal

import cv2
import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, model_validator

from roadsight.base.arrays import Bytes, Floats32
from roadsight.base.errors import InputError
from roadsight.poles.images.kinds import PixelClass

# The network: input tensor (1, 3, h, w) to its used outputs
Run = Callable[[Floats32], list[NDArray]]
# OpenCV's numbers of the ways to resize that a manifest may name
_RESIZE = {
    "linear": cv2.INTER_LINEAR,
    "area": cv2.INTER_AREA,
    "cubic": cv2.INTER_CUBIC,
    "nearest": cv2.INTER_NEAREST,
}
FULL_SCALE = 65535  # Greatest value of a 16-bit map
# Metric inverse depth is stored in steps of 1 / (0.5 m x 65535): 0.3 % at 100 m
METRIC_NEAREST_M = 0.5
_LEAST_CONTRAST = 1e-3  # A map that varies by less than this share of its values is constant
# Logarithms of proportions nearer than this are equal: a square image fits either way
_SAME_PROPORTION = 1e-9


def tensor_of(image: Bytes, spec: Input, wanted_height_px: int = 0) -> Floats32:
    """Input tensor (1, 3, h, w) of a BGR image (rows, columns, 3)."""
    height, width = spec.size.of(image.shape[0], image.shape[1], wanted_height_px)
    pixels: NDArray = image
    if image.shape[:2] != (height, width):
        pixels = cv2.resize(image, (width, height), interpolation=_RESIZE[spec.resize])
    if spec.colour == "RGB":
        pixels = cv2.cvtColor(pixels, cv2.COLOR_BGR2RGB)
    scale = 1.0 / (spec.divide_by * np.array(spec.std))
    shift = np.array(spec.mean) / np.array(spec.std)
    values = pixels * scale.astype(np.float32) - shift.astype(np.float32)
    return np.ascontiguousarray(values.transpose(2, 0, 1)[None], np.float32)


def class_mask(
    outputs: list[NDArray], manifest: Manifest, shape: tuple[int, int], where: str
) -> Bytes:
    """Project classes (rows, columns) of an image from a network's outputs, `SILENT` if none.

    Parameters
    ----------
    outputs : class logits (1, L, h, w); labels (1, [1,] h, w); or query class logits
        (1, Q, L + 1) and mask logits (1, Q, h, w), combined as softmax without the last (no
        object), times sigmoid, summed over queries. shape : rows, columns of the image.

    Raises
    ------
    InputError : a label or number of labels that the manifest does not have.
    """
    if manifest.output.kind == "labels":
        found = np.squeeze(outputs[0])
        labels = cv2.resize(_checked(found, manifest, where), shape[::-1], interpolation=0)
        return manifest.lookup()[labels]
    scores = outputs[0][0]
    if manifest.output.kind == "query_masks":
        shifted = np.exp(scores - scores.max(axis=1, keepdims=True))
        shares = (shifted / shifted.sum(axis=1, keepdims=True))[:, :-1]
        inside = 1.0 / (1.0 + np.exp(-np.clip(outputs[1][0], -60.0, 60.0)))
        scores = np.tensordot(shares.T, inside, axes=1)
    if len(scores) != manifest.labels:
        raise InputError(
            "does not state as many labels as the network gives",
            where=f"{where}: labels",
            found=manifest.labels,
            allowed=len(scores),
        )
    return manifest.lookup()[_largest(scores, shape)]


def _checked(found: NDArray, labels: Labels, where: str) -> NDArray[np.uint16]:
    low, high = (found.min(), found.max()) if found.size else (0, 0)
    if found.ndim != 2 or low < 0 or high >= (labels.labels or 0):
        raise InputError(
            "holds a label that is not stated",
            where=where,
            found=f"{high if low >= 0 else low}, {found.ndim} axes",
            allowed=f"0 to {(labels.labels or 0) - 1}, 2 axes",
        )
    return found.astype(np.uint16)


def _largest(scores: Floats32, shape: tuple[int, int]) -> NDArray[np.uint16]:
    """Label of the largest score at the image's own size; the first of equals.

    One label at a time, because all labels at full size may not fit into memory.
    """
    best: NDArray | None = None
    labels = np.zeros(shape, np.uint16)
    for label, score in enumerate(scores):
        full: NDArray = np.ascontiguousarray(score, np.float32)
        if full.shape != shape:
            full = cv2.resize(full, shape[::-1], interpolation=cv2.INTER_LINEAR)
        if best is None:
            best = full.copy()
            continue
        better = full > best
        labels[better] = label
        np.copyto(best, full, where=better)
    return labels


def is_stretched(found: tuple[int, int], image: tuple[int, int], where: str) -> bool:
    """Whether a label or depth image has other proportions than its image, beyond rounding.

    Networks of a fixed size stretch images, and their outputs stretch back.

    Parameters
    ----------
    found, image : rows and columns.

    Raises
    ------
    InputError : it fits better when it is turned by a quarter.
    """
    (rows, columns), (height, width) = found, image
    if abs(columns * height - rows * width) <= max(rows + columns, height + width):
        return False
    direct = abs(np.log(columns * height / (rows * width)))
    if direct > abs(np.log(columns * width / (rows * height))) + _SAME_PROPORTION:
        raise InputError(
            "lies on its side: it is higher than wide where its image is wider than high, or the"
            " other way round",
            where=where,
            found=f"{columns} x {rows} px",
            allowed=f"proportions of {width} x {height} px",
            hint="turn it as the EXIF orientation turns the image",
        )
    return True


def folder_mask(image: NDArray, labels: Labels, shape: tuple[int, int], where: str) -> Bytes:
    """Project classes (rows, columns) from a label image made elsewhere.

    Raises
    ------
    InputError : more than one channel, a label that the map does not have, or as `is_stretched`.
    """
    found: NDArray = _checked(image, labels, where)
    is_stretched((found.shape[0], found.shape[1]), shape, where)
    if found.shape != shape:
        found = cv2.resize(found, shape[::-1], interpolation=cv2.INTER_NEAREST)
    return labels.lookup()[found]


def merge_masks(masks: list[Bytes], sources: list[Labels]) -> Bytes:
    """One mask of several (rows, columns): later ones replace only where they say something."""
    merged = np.full(masks[0].shape, int(PixelClass.OTHER), np.uint8)
    for mask, source in zip(masks, sources, strict=True):
        says = mask != SILENT
        if source.over is not None:
            says &= np.isin(merged, [_PROJECT_CLASSES[name] for name in source.over])
        np.copyto(merged, mask, where=says)
    return merged


def inverse_depth(outputs: list[NDArray], manifest: Manifest) -> Floats32:
    """Inverse depth (h, w), larger = nearer, NaN where unknown; any scale unless metric."""
    values = np.asarray(outputs[0], np.float32)
    values = values.reshape(values.shape[-2:])
    values = np.where(np.isfinite(values), values, np.nan)
    if manifest.output.kind == "depth":
        with np.errstate(divide="ignore"):
            values = np.where(values > 0, 1.0 / values, np.nan)
    return values


def packed_depth(inverse: Floats32, metric: bool) -> NDArray[np.uint16]:
    """Inverse depth as 16 bit, 0 = unknown; all zero where the map is constant.

    Parameters
    ----------
    metric : keep the scale (see `METRIC_NEAREST_M`) instead of stretching to the full range.
    """
    known = np.isfinite(inverse)
    if not known.any():
        return np.zeros(inverse.shape, np.uint16)
    low, high = np.percentile(inverse[known], (0.0, 100.0))
    if high - low <= _LEAST_CONTRAST * max(abs(high), abs(low)):
        return np.zeros(inverse.shape, np.uint16)
    if metric:
        low, high = 0.0, 1.0 / METRIC_NEAREST_M
    steps = 1.0 + (inverse.astype(np.float64) - low) / (high - low) * (FULL_SCALE - 1)
    return np.where(known, np.clip(np.nan_to_num(steps), 1, FULL_SCALE), 0).astype(np.uint16)


def downward_trend(packed: NDArray[np.uint16]) -> float:
    """Correlation of inverse depth with the row in the lower half, where the ground is.

    On the ground lower rows are nearer, so this is well above 0; NaN where nothing is known.
    """
    lower = packed[packed.shape[0] // 2 :].astype(np.float64)
    known = (lower > 0).any(axis=1)
    if np.count_nonzero(known) < 3:
        return float("nan")
    rows = np.flatnonzero(known)
    middle = np.array([np.median(line[line > 0]) for line in lower[known]])
    if np.ptp(middle) == 0:
        return 0.0
    return float(np.corrcoef(rows, middle)[0, 1])


# Manifests: what a network file expects and what its numbers mean (docs/poles/models.md).
# A manifest is a YAML file beside a model. A label map is its little sister for label images that
# somebody else made.

Label = Annotated[int, Field(ge=0, le=65534)]
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
Number = Annotated[float, Field(allow_inf_nan=False)]
Pixels = Annotated[int, Field(ge=1, le=16384)]
Triple = tuple[Number, Number, Number]
SILENT = np.uint8(255)  # Pixel about which a source says nothing
# Kinds of output that fit each task
_KINDS = {
    "classes": ("logits", "labels", "query_masks"),
    "relative_depth": ("inverse_depth", "depth"),
    "metric_depth": ("inverse_depth", "depth"),
}
# Numbers of the project classes by name
_PROJECT_CLASSES = {entry.name.lower(): int(entry) for entry in PixelClass}


class _Section(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class Labels(_Section):
    """Which label numbers there are and which class each one shows."""

    labels: int | None = Field(None, ge=1, le=65535, description="how many labels there are")
    classes: dict[Label, str] = Field({}, description="project class of a label; others say none")
    over: tuple[str, ...] | None = Field(
        None, description="project classes of earlier sources that this one may replace; all if not"
    )

    @model_validator(mode="after")
    def _known_classes(self) -> Labels:
        for name in (*self.classes.values(), *(self.over or ())):
            if name not in _PROJECT_CLASSES:
                raise ValueError(f"unknown class {name!r}; allowed: {', '.join(_PROJECT_CLASSES)}")
        beyond = [label for label in self.classes if self.labels and label >= self.labels]
        if beyond:
            raise ValueError(f"label {beyond[0]} is not below labels ({self.labels})")
        return self

    def lookup(self) -> Bytes:
        """Project class of each label (labels,), `SILENT` where it says nothing."""
        table = np.full(self.labels or max(self.classes, default=0) + 1, SILENT, np.uint8)
        for label, name in self.classes.items():
            table[label] = _PROJECT_CLASSES[name]
        return table


class LabelMap(Labels):
    """What a folder of label images (8 or 16 bit PNG) shows."""

    labels: int = Field(ge=1, le=65535, description="how many labels there are")
    classes: dict[Label, str] = Field(min_length=1, description="project class of a label")


class Size(_Section):
    """Size of the network's input: fixed, or a multiple with the image's own shape."""

    height_px: Pixels | None = Field(None, description="fixed height, or wanted height, px")
    width_px: Pixels | None = Field(None, description="fixed width, px")
    multiple_of: Pixels | None = Field(None, description="both sides are multiples of this, px")

    @model_validator(mode="after")
    def _one_way(self) -> Size:
        if self.multiple_of is None and (self.height_px is None or self.width_px is None):
            raise ValueError("needs height_px and width_px, or multiple_of")
        if self.multiple_of is not None and self.width_px is not None:
            raise ValueError("width_px follows from the image where multiple_of is given")
        return self

    def of(self, height_px: int, width_px: int, wanted_height_px: int = 0) -> tuple[int, int]:
        """Input height and width for an image; ``wanted_height_px`` 0 leaves it to the manifest."""
        multiple = self.multiple_of
        if multiple is None:
            return int(self.height_px or 0), int(self.width_px or 0)
        scale = (wanted_height_px or self.height_px or height_px) / height_px

        def rounded(length_px: int) -> int:
            return max(round(length_px * scale / multiple), 1) * multiple

        return rounded(height_px), rounded(width_px)


class Input(_Section):
    """How an image becomes the network's input."""

    name: str | None = Field(None, description="name of the input; the only one if not given")
    layout: Literal["NCHW"] = Field("NCHW", description="order of the axes")
    colour: Literal["BGR", "RGB"] = Field(description="order of the channels")
    size: Size = Field(description="height and width")
    resize: Literal["linear", "area", "cubic", "nearest"] = Field("linear")
    divide_by: Positive = Field(1.0, description="values 0 to 255 are divided by this first")
    mean: Triple = Field((0.0, 0.0, 0.0), description="then this is taken off, by channel")
    std: tuple[Positive, Positive, Positive] = Field((1.0, 1.0, 1.0), description="then divided by")


class Output(_Section):
    """Which outputs are used and what they hold."""

    kind: Literal["logits", "labels", "query_masks", "inverse_depth", "depth"]
    names: tuple[str, ...] = Field((), description="outputs used; the only ones if not given")

    @property
    def needed(self) -> int:
        """How many outputs are used: query masks are class logits and mask logits."""
        return 2 if self.kind == "query_masks" else 1

    @model_validator(mode="after")
    def _enough(self) -> Output:
        if self.names and len(self.names) != self.needed:
            raise ValueError(f"{self.kind} needs {self.needed} names, not {len(self.names)}")
        return self


class Manifest(Labels):
    """A network file and how to use it."""

    task: Literal["classes", "relative_depth", "metric_depth"]
    file: str = Field(min_length=1, description="ONNX file, relative to the manifest")
    sha256: str | None = Field(None, pattern="^[0-9a-f]{64}$", description="checksum of the file")
    about: str = Field("", description="what it is, its licence and where it comes from")
    input: Input
    output: Output

    @model_validator(mode="after")
    def _consistent(self) -> Manifest:
        kinds = _KINDS[self.task]
        if self.output.kind not in kinds:
            raise ValueError(
                f"output.kind {self.output.kind} does not fit task {self.task};"
                f" allowed: {', '.join(kinds)}"
            )
        if self.task == "classes" and not (self.labels and self.classes):
            raise ValueError("task classes needs labels (how many) and classes (which is what)")
        if self.task != "classes" and (self.labels or self.classes or self.over):
            raise ValueError("labels, classes and over belong to task classes only")
        return self
