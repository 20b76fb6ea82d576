"""Clicked pairs of a pixel and a place, as a user's CSV table."""

from __future__ import annotations

import os

import numpy as np
import pandas as pd

from roadsight.base.errors import InputError
from roadsight.geometry.frames import Frame
from roadsight.geometry.north import SiteNorth
from roadsight.io.records.sighting_tables import read_text_table

_PLACES = (("x", "y"), ("lon", "lat"), ("longitude", "latitude"))
"""Names of the columns of a place: in the site's CRS, or in degrees."""


def read_pairs(path: str | os.PathLike[str], frame: Frame) -> pd.DataFrame:
    """Pairs: image, u and v (pixels), x, y, z in local metres; z is NaN where it is left empty.

    Parameters
    ----------
    path : CSV with image, pixel_x, pixel_y; x, y in the cloud's CRS or lon, lat; and z in the
        cloud's vertical unit, where it is known.

    Raises
    ------
    InputError : the file cannot be read, lacks a column, or a number is missing or impossible.
    """
    table = read_text_table(path)
    place = next((pair for pair in _PLACES if set(pair) <= set(table.columns)), None)
    missing = [name for name in ("image", "pixel_x", "pixel_y") if name not in table]
    if missing or place is None:
        raise InputError(
            f"lacks the column {', '.join(missing) or 'x, y or lon, lat'}",
            where=str(path),
            found=", ".join(table.columns),
            allowed="image, pixel_x, pixel_y; x, y or lon, lat; z if known",
        )
    numbers = table[["pixel_x", "pixel_y", *place]].apply(pd.to_numeric, errors="coerce")
    given = numbers.to_numpy(np.float64)
    height = _heights(path, table)
    if place[0] == "x":
        xyz = frame.to_local(np.column_stack([given[:, 2:], height]))
    elif frame.crs_wkt is None:
        raise InputError("lon, lat need a cloud with a CRS", where=str(path), hint="give x, y")
    else:
        xy = SiteNorth(frame).to_local(given[:, 3], given[:, 2])
        z = frame.to_local(np.column_stack([np.zeros((len(table), 2)), height]))[:, 2]
        xyz = np.column_stack([xy, z])
    wrong = ~np.isfinite(np.column_stack([given[:, :2], xyz[:, :2]])).all(axis=1)
    if wrong.any():
        row = int(np.argmax(wrong))
        raise InputError(
            "a number is missing or not finite",
            where=f"{path}, line {row + 2}",
            found=table.iloc[row].tolist(),
        )
    columns = {"u": given[:, 0], "v": given[:, 1], "x": xyz[:, 0], "y": xyz[:, 1], "z": xyz[:, 2]}
    return pd.DataFrame({"image": table["image"].str.strip(), **columns})


def _heights(path: str | os.PathLike[str], table: pd.DataFrame) -> np.ndarray:
    """Heights (n,) as given, NaN where left empty."""
    if "z" not in table:
        return np.full(len(table), np.nan)
    text = table["z"].str.strip()
    height = pd.to_numeric(text.where(text != ""), errors="coerce").to_numpy(np.float64)
    wrong = (text != "").to_numpy() & ~np.isfinite(height)
    if wrong.any():
        row = int(np.argmax(wrong))
        raise InputError("z is no number", where=f"{path}, line {row + 2}", found=text.iloc[row])
    return height
