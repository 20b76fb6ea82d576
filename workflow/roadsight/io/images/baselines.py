"""Registered cameras by image size: a JSON file that `roadsight register` or a user writes."""

from __future__ import annotations

import os
from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field, RootModel

from roadsight.base.validation import validated
from roadsight.io.records.atomic import read_json

Angle = Annotated[float, Field(ge=-180, le=180, allow_inf_nan=False)]
Metres = Annotated[float, Field(ge=-100, le=100, allow_inf_nan=False)]
Sigma = Annotated[float | None, Field(gt=0, le=1e3, allow_inf_nan=False)]
Count = Annotated[int | None, Field(ge=1)]


class _Section(BaseModel):
    model_config = ConfigDict(extra="forbid")


class Sigmas(_Section):
    """Standard deviation of each number."""

    along_m: Sigma = None
    lateral_m: Sigma = None
    height_m: Sigma = None
    yaw_deg: Sigma = None
    pitch_deg: Sigma = None
    roll_deg: Sigma = None
    log_focal: Sigma = None


class Baseline(_Section):
    """Where the camera of one image size sits on its vehicle, and its lens."""

    focal_px: float | None = Field(None, gt=0, le=1e6, allow_inf_nan=False)
    hfov_deg: float | None = Field(None, gt=0, lt=180, allow_inf_nan=False)
    along_m: Metres | None = None
    lateral_m: Metres | None = None
    height_m: Metres | None = None
    yaw_deg: Angle | None = None
    pitch_deg: Angle | None = None
    roll_deg: Angle | None = None
    sigma: Sigmas = Sigmas()
    images: Count = None
    pairs: Count = None
    rms_px: float | None = Field(None, ge=0, allow_inf_nan=False)


class Baselines(RootModel[dict[Annotated[str, Field(pattern=r"^(all|\d+x\d+)$")], Baseline]]):
    """Baselines by image size, ``<width>x<height>`` or ``all``."""


def read_baselines(path: str | os.PathLike[str]) -> dict[str, dict[str, Any]]:
    """Numbers of each baseline that the file states, by image size.

    Raises
    ------
    InputError : the file cannot be read, names what there is not, or a number is out of range.
    """
    content = validated(Baselines, read_json(path), str(path))
    return {size: baseline.model_dump(exclude_none=True) for size, baseline in content.root.items()}
