"""Manifests: what a network file expects and what its numbers mean (docs/poles/models.md).

A manifest is a YAML file beside a model. A label map is its little sister for label images that
somebody else made.
"""

from __future__ import annotations

from typing import Annotated, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, model_validator

from roadsight.base.arrays import Bools, Bytes
from roadsight.poles.images.classes import PixelClass

Label = Annotated[int, Field(ge=0, le=65534)]
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
Number = Annotated[float, Field(allow_inf_nan=False)]
Pixels = Annotated[int, Field(ge=1, le=16384)]
Triple = tuple[Number, Number, Number]

SILENT = np.uint8(255)
"""Pixel about which a source says nothing."""

_KINDS = {
    "classes": ("logits", "labels", "query_masks"),
    "relative_depth": ("inverse_depth", "depth"),
    "metric_depth": ("inverse_depth", "depth"),
}
"""Kinds of output that fit each task."""
_PROJECT_CLASSES = {entry.name.lower(): int(entry) for entry in PixelClass}
"""Numbers of the project classes by name."""


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

    def replaceable(self) -> Bools:
        """Whether a project class of an earlier source may be replaced, by class number."""
        if self.over is None:
            return np.ones(256, bool)
        table = np.zeros(256, bool)
        table[[_PROJECT_CLASSES[name] for name in self.over]] = True
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
