"""Sightings as a user's CSV table, and poles back."""

from __future__ import annotations

import os

import numpy as np
import pandas as pd

from roadsight.base.errors import InputError
from roadsight.geometry.crs import counted_in
from roadsight.geometry.frames import Frame
from roadsight.io.records.atomic import atomic_path
from roadsight.io.records.text_tables import read_cells

_NEEDED = {"lat": (-90.0, 90.0), "lon": (-180.0, 360.0), "bearing": (-360.0, 720.0)}
"""Columns that a table must have, with the least and greatest value; both ways of counting angles
are taken."""
_DECIMALS = 4
"""Of written coordinates in the cloud's unit, a tenth of a millimetre in metres."""
_OPTIONAL = ("depth", "sigma_bearing_deg", "sigma_depth_m")


def read_sightings(path: str | os.PathLike[str]) -> pd.DataFrame:
    """Sightings of a CSV file: lat, lon, bearing; further depth, image and sigmas where stated.

    An empty depth or sigma is NaN (unknown).

    Raises
    ------
    InputError : the file cannot be read, lacks a column, or a number is missing or impossible.
    """
    return checked_sightings(read_text_table(path), os.fspath(path))


def checked_sightings(table: pd.DataFrame, path: str) -> pd.DataFrame:
    """Sightings of a table of texts, as `read_sightings`; ``path`` is named in messages."""
    table = table.copy()
    missing = [name for name in _NEEDED if name not in table]
    if missing:
        raise InputError(
            f"lacks the column {', '.join(missing)}",
            where=str(path),
            found=", ".join(table.columns),
            allowed="lat, lon, bearing; further depth, image, sigma_bearing_deg, sigma_depth_m",
        )
    for name, (least, most) in _NEEDED.items():
        numbers = _numbers(path, table, name, empty_allowed=False)
        wrong = np.flatnonzero(~((numbers >= least) & (numbers <= most)))
        if len(wrong):
            raise InputError(
                f"{name} is out of range",
                where=f"{path}, line {wrong[0] + 2}",
                found=table[name].iloc[wrong[0]],
                allowed=f"{least:g} to {most:g} degrees",
            )
        table[name] = numbers
    for name in set(_OPTIONAL) & set(table):
        table[name] = _numbers(path, table, name, empty_allowed=True)
    return table


def read_text_table(path: str | os.PathLike[str]) -> pd.DataFrame:
    """Cells of a CSV file as text, column names in lower case without blanks around them.

    Raises
    ------
    InputError : the file cannot be read, is no CSV table or is empty.
    """
    table = read_cells(path)
    table.columns = table.columns.str.strip().str.lower()
    return table


def write_csv(path: str | os.PathLike[str], table: pd.DataFrame) -> None:
    """Write a table as CSV; NaN becomes an empty cell."""
    with atomic_path(path) as temporary:
        table.to_csv(temporary, index=False, lineterminator="\n")


def in_native(table: pd.DataFrame, frame: Frame) -> pd.DataFrame:
    """Table with columns x, y and, if there, z in native coordinates instead of local metres.

    What these are counted in stands in columns of its own, as in every table for people: headers
    with units would name the column anew in each CRS.
    """
    names = [name for name in ("x", "y", "z") if name in table]
    native = frame.to_native(table[names].to_numpy(np.float64))
    told = counted_in(frame)
    if "z" not in names:
        told = {name: told[name] for name in ("crs", "unit")}
    places = dict(zip(names, native.T.round(_DECIMALS), strict=True))
    return table.assign(**places, **told)


def _numbers(
    path: str | os.PathLike[str], table: pd.DataFrame, name: str, empty_allowed: bool
) -> np.ndarray:
    text = table[name].str.strip()
    numbers = pd.to_numeric(text, errors="coerce").to_numpy(np.float64)
    wrong = ~np.isfinite(numbers) & ~((text == "").to_numpy() & empty_allowed)
    if wrong.any():
        row = int(np.argmax(wrong))
        raise InputError(
            f"{name} is no finite number",
            where=f"{path}, line {row + 2}",
            found=repr(table[name].iloc[row]),
        )
    return numbers
