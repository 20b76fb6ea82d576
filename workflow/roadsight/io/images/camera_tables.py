"""Known cameras from CSV tables, in the local frame of a site."""

from __future__ import annotations

import os
import re
from collections.abc import Collection, Iterable
from typing import Annotated, Any

import numpy as np
import pandas as pd
from pydantic import Field, RootModel

from roadsight.base.arrays import AnyPath
from roadsight.base.errors import InputError
from roadsight.base.section import Degrees, Section, validated
from roadsight.geometry.frames import Frame
from roadsight.io.records.atomic import read_json
from roadsight.io.records.text_tables import read_cells

_ANGLES = {"heading_grid_deg": "heading_deg", "pitch_deg": "pitch_deg", "roll_deg": "roll_deg"}
_LENS = ("focal_px", "cx_px", "cy_px")
_SIGMAS = ("sigma_heading_deg", "sigma_pitch_deg", "sigma_lateral_m", "sigma_along_m")


def read_cameras(path: AnyPath, frame: Frame, intrinsics: AnyPath | None = None) -> pd.DataFrame:
    """Poses of cameras: image, x, y, z (local metres), heading_deg (grid), pitch, roll, lens.

    Parameters
    ----------
    path : CSV with image, easting_*, northing_* and height_* in the CRS and units of the site,
        heading_grid_deg, pitch_deg, roll_deg, and focal_px, cx_px, cy_px unless ``intrinsics`` is
        given: a CSV with one row fx_px, cx_px, cy_px for all images. Columns sigma_heading_deg,
        sigma_pitch_deg, sigma_lateral_m, sigma_along_m are taken along where there are any.

    Raises
    ------
    InputError : a table cannot be read, lacks a column or holds what is no number.
    """
    table = read_cells(path)
    native = [
        _column(table, rf"{name}_(?!above|px)\w+", path)
        for name in ("easting", "northing", "height")
    ]
    numbers = table[[*native, *_present(table, _ANGLES, path)]].apply(
        pd.to_numeric, errors="coerce"
    )
    found = pd.DataFrame({"image": table[_present(table, ("image",), path)[0]].astype(str)})
    found[["x", "y", "z"]] = frame.to_local(numbers[native].to_numpy(np.float64))
    for name, own in _ANGLES.items():
        found[own] = numbers[name]
    lens = table
    if intrinsics is not None:
        lens = read_cells(intrinsics).rename(columns={"fx_px": "focal_px"})
    for name in _present(lens, _LENS, intrinsics or path):
        values = pd.to_numeric(lens[name], errors="coerce")
        found[name] = values if intrinsics is None else float(values.iloc[0])
    for name in set(_SIGMAS) & set(table.columns):
        found[name] = pd.to_numeric(table[name], errors="coerce")
    if not np.isfinite(found.drop(columns="image").to_numpy(np.float64)).all():
        raise InputError("holds what is no finite number", where=os.fspath(path))
    return found


def posed_images(path: AnyPath) -> set[str]:
    """Names of the images whose camera a table has.

    Raises
    ------
    InputError : it cannot be read or names no images.
    """
    table = read_cells(path)
    return set(table[_present(table, ("image",), path)[0]].astype(str))


def corrections_of(path: AnyPath, images: Collection[str]) -> list[str]:
    """Rows of a table of corrections, as texts, of some images.

    Raises
    ------
    InputError : it cannot be read or names no images.
    """
    table = read_cells(path)
    names = table[_present(table, ("image",), path)[0]].astype(str)
    return [",".join(map(str, row)) for row in table[names.isin(images)].to_numpy().tolist()]


def _column(table: pd.DataFrame, pattern: str, path: AnyPath) -> str:
    for name in table.columns:
        if re.fullmatch(pattern, name):
            return str(name)
    raise InputError(
        "lacks a column", where=os.fspath(path), found=", ".join(table.columns), allowed=pattern
    )


def _present(table: pd.DataFrame, names: Iterable[str], path: AnyPath) -> list[str]:
    wanted = list(names)
    for name in wanted:
        _column(table, re.escape(name), path)
    return wanted


# Registered cameras by image size: a JSON file that `roadsight register` or a user writes.

_Metres = Annotated[float | None, Field(ge=-100, le=100)]
_Sigma = Annotated[float | None, Field(gt=0, le=1e3)]
_Count = Annotated[int | None, Field(ge=1)]


class Sigmas(Section):
    """Standard deviation of each number."""

    along_m: _Sigma = None
    lateral_m: _Sigma = None
    height_m: _Sigma = None
    yaw_deg: _Sigma = None
    pitch_deg: _Sigma = None
    roll_deg: _Sigma = None
    log_focal: _Sigma = None


class Baseline(Section):
    """Where the camera of one image size sits on its vehicle, and its lens."""

    focal_px: float | None = Field(None, gt=0, le=1e6)
    hfov_deg: float | None = Field(None, gt=0, lt=180)
    along_m: _Metres = None
    lateral_m: _Metres = None
    height_m: _Metres = None
    yaw_deg: Degrees | None = None
    pitch_deg: Degrees | None = None
    roll_deg: Degrees | None = None
    sigma: Sigmas = Sigmas()
    images: _Count = None
    pairs: _Count = None
    rms_px: float | None = Field(None, ge=0)


class Baselines(RootModel[dict[Annotated[str, Field(pattern=r"^(all|\d+x\d+)$")], Baseline]]):
    """Baselines by image size, ``<width>x<height>`` or ``all``."""


def read_baselines(path: AnyPath) -> dict[str, dict[str, Any]]:
    """Numbers of each baseline that the file states, by image size.

    Raises
    ------
    InputError : the file cannot be read, names what there is not, or a number is out of range.
    """
    content = validated(Baselines, read_json(path), str(path))
    return {size: baseline.model_dump(exclude_none=True) for size, baseline in content.root.items()}
