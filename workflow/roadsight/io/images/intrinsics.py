"""Known lenses of a videolog's images: a table, or the numbers of a site file."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
import pandas as pd

from roadsight.base.errors import InputError
from roadsight.io.records.text_tables import read_cells
from roadsight.poles.alignment.dense import GivenLens

_FOCAL = ("fx_px", "focal_px")  # names that the focal length may have
_SIGMAS = ("sigma_fx_px", "sigma_cx_px", "sigma_cy_px")
# Shares by which fx and fy may differ: at the edge of 375 rows that is half a pixel. Nothing behind
# the alignment knows pixels that are not square.
_SQUARE = 0.005
# Share of the image's size by which a principal point may lie off the middle. Real ones do by 5 %;
# those of an image of half the size by half of it.
_OFF_CENTRE = 0.25
# Horizontal fields of view that a camera on a vehicle may have, as for a calibration.
_HFOV_DEG = (8.0, 130.0)


def read_intrinsics(source: str, images: Iterable[tuple[str, int, int]]) -> dict[str, GivenLens]:
    """Lens of each image.

    Parameters
    ----------
    source : CSV with fx_px, cx_px, cy_px, and perhaps fy_px, width_px, height_px, sigma_fx_px,
        sigma_cx_px, sigma_cy_px: one row for all images, or one for each with its ``image``; or
        JSON text of such a row.
    images : name, width and height of each.

    Raises
    ------
    InputError : the table cannot be read, lacks a column or some images, holds what is no lens, or
        belongs to images of another size.
    """
    if source.lstrip().startswith("{"):
        content: Mapping[str, Any] = json.loads(source)
        given = {name: str(value) for name, value in content.items() if value is not None}
        where, rows = "poles.intrinsics", pd.DataFrame([given])
    else:
        where, rows = source, read_cells(source)
        if not len(rows):
            raise InputError("has no row", where=where)
    wanted = list(images)
    if "image" not in rows:
        if len(rows) != 1:
            raise InputError(
                "has several rows but no column image",
                where=where,
                found=f"{len(rows)} rows",
                allowed="one row for all images, or one for each with its name in image",
            )
        return {name: _lens(rows.iloc[0], name, (w, h), where) for name, w, h in wanted}
    named = {str(row["image"]): row for _, row in rows.iterrows()}
    if len(named) < len(rows):
        twice = rows["image"][rows["image"].duplicated()].iloc[0]
        raise InputError("lists an image twice", where=where, found=twice)
    if missing := [name for name, _, _ in wanted if name not in named]:
        raise InputError(
            "has the lens of some images only",
            where=where,
            found=f"{len(wanted) - len(missing)} of {len(wanted)} images; {missing[0]} is missing",
            allowed="one row for each image of the videolog, or one for all without image",
            hint="leave out poles.intrinsics where not all lenses are known",
        )
    return {name: _lens(named[name], name, (w, h), where) for name, w, h in wanted}


def _lens(row: pd.Series, image: str, size_px: tuple[int, int], where: str) -> GivenLens:
    name = next((name for name in _FOCAL if name in row), None)
    if name is None:
        raise InputError(
            "lacks a column", where=where, found=", ".join(map(str, row.index)), allowed="fx_px"
        )
    focal, cx, cy = (_number(row, column, where) for column in (name, "cx_px", "cy_px"))
    focal_y = _number(row, "fy_px", where) if "fy_px" in row else focal
    sigma = [_number(row, column, where) if column in row else 0.0 for column in _SIGMAS]
    if min(focal, focal_y) <= 0 or min(sigma) < 0:
        raise InputError(
            "must be positive",
            where=f"{where}: {image}",
            found=f"{name} {focal:g}, fy_px {focal_y:g}, least sigma {min(sigma):g}",
        )
    if abs(focal_y / focal - 1.0) > _SQUARE:
        raise InputError(
            "pixels are not square",
            where=f"{where}: {image}",
            found=f"fx_px {focal:g}, fy_px {focal_y:g}",
            allowed=f"a difference of {100 * _SQUARE:g} %",
            hint="resample the images to square pixels",
        )
    _check_size(row, (focal, cx, cy), image, size_px, where)
    return GivenLens(float(np.sqrt(focal * focal_y)), cx, cy, *sigma)


def _check_size(
    row: pd.Series,
    lens: tuple[float, float, float],
    image: str,
    size_px: tuple[int, int],
    where: str,
) -> None:
    """Refuse a lens that belongs to images of another size."""
    focal, *centre = lens
    hint = "scale the numbers to the size of the images"
    if "width_px" in row and "height_px" in row:
        stated = tuple(int(_number(row, column, where)) for column in ("width_px", "height_px"))
        if stated != size_px:
            raise InputError(
                "the lens is that of images of another size",
                where=f"{where}: {image}",
                found=f"{stated[0]} x {stated[1]} px",
                allowed=f"{size_px[0]} x {size_px[1]} px",
                hint=hint,
            )
    middle = [(size - 1) / 2 for size in size_px]
    away = [abs(c - m) / size for c, m, size in zip(centre, middle, size_px, strict=True)]
    if max(away) > _OFF_CENTRE:
        raise InputError(
            "the principal point contradicts the image's size",
            where=f"{where}: {image}",
            found=f"{centre[0]:g}, {centre[1]:g} in {size_px[0]} x {size_px[1]} px",
            allowed=f"near the middle, {middle[0]:g}, {middle[1]:g}",
            hint=hint,
        )
    hfov_deg = float(np.degrees(2 * np.arctan2(0.5 * size_px[0], focal)))
    if not _HFOV_DEG[0] <= hfov_deg <= _HFOV_DEG[1]:
        raise InputError(
            "the focal length contradicts the image's size",
            where=f"{where}: {image}",
            found=f"a field of view of {hfov_deg:.1f} degrees",
            allowed=f"{_HFOV_DEG[0]:g} to {_HFOV_DEG[1]:g} degrees",
            hint=hint,
        )


def _number(row: pd.Series, column: str, where: str) -> float:
    if column not in row:
        raise InputError(
            "lacks a column", where=where, found=", ".join(map(str, row.index)), allowed=column
        )
    value = float(pd.to_numeric(row[column], errors="coerce"))
    if not np.isfinite(value):
        raise InputError("is no finite number", where=f"{where}: {column}", found=row[column])
    return value
