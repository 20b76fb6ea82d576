"""Points, seeds, tracks and mounts of a user in the local frame."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import geopandas as gpd
import numpy as np
import pandas as pd
import shapely

from roadsight.base.arrays import AnyPath, Floats
from roadsight.base.errors import InputError
from roadsight.geometry.frames import Frame
from roadsight.geometry.north import SiteNorth
from roadsight.io.records.text_tables import read_text_table
from roadsight.io.vector.vector_sources import EXCHANGED, is_near, load_local
from roadsight.io.vector.vectors import read_lines

_AXES = (("latitude", "longitude"), ("lat", "lon"), ("x", "y"))
_NAMES = ("id", "name")


def read_points(
    path: AnyPath,
    frame: Frame,
    default_crs: str | None = None,
    attributes: Sequence[str] = (),
    texts: Sequence[str] = (),
) -> pd.DataFrame:
    """Points of a CSV table (lat, lon or native x, y) or of any vector file, in local metres.

    Polygons and lines of a vector file count by their middle.

    Parameters
    ----------
    default_crs : CRS of a vector file that names none, see `load_local`.
    attributes : further columns that are numbers where they are given. texts : and of text.

    Returns
    -------
    columns id (text), kind (text, "" if not given), x, y, the attributes (NaN if not given) and
    the texts ("" if not given)

    Raises
    ------
    InputError : the file cannot be read or holds no points, or a coordinate is no finite number,
        or an attribute no number.
    """
    if Path(path).suffix.lower() != ".csv":
        features = load_local(Path(path), frame, default_crs)
        middle = shapely.get_coordinates(shapely.centroid(features.geometry.to_numpy()))
        return _named(middle, features, attributes, texts, path)
    table = read_text_table(path)
    axes = next((pair for pair in _AXES if set(pair) <= set(table.columns)), None)
    if axes is None:
        raise InputError(
            "lacks columns",
            where=str(path),
            found=", ".join(table.columns),
            allowed="lat, lon (or latitude, longitude) or x, y in the site's CRS",
        )
    if len(table) == 0:
        raise InputError("holds no points", where=str(path))
    numbers = table[list(axes)].apply(pd.to_numeric, errors="coerce").to_numpy(np.float64)
    local = frame.to_local(numbers) if axes[0] == "x" else SiteNorth(frame).to_local(*numbers.T)
    wrong = ~np.isfinite(local).all(axis=1)
    if wrong.any():
        row = int(np.argmax(wrong))
        hint = ""
        if axes[0] != "x" and np.isfinite(numbers[row]).all():
            exchanged = SiteNorth(frame).to_local(*numbers[row, ::-1, None])
            hint = EXCHANGED if is_near(exchanged).any() else ""
        raise InputError(
            "holds a place that is no finite number or that the site's CRS cannot hold",
            where=f"{path}, line {row + 2}",
            found=table[list(axes)].iloc[row].tolist(),
            hint=hint,
        )
    return _named(local, table, attributes, texts, path)


def _named(
    xy_m: np.ndarray,
    table: pd.DataFrame | gpd.GeoDataFrame,
    attributes: Sequence[str],
    texts: Sequence[str],
    path: AnyPath,
) -> pd.DataFrame:
    column = next((name for name in _NAMES if name in table), None)
    names = [f"t{n}" for n in range(1, len(xy_m) + 1)]
    if column is not None:
        names = table[column].astype(str).tolist()
    kinds = table["kind"].astype(str).tolist() if "kind" in table else [""] * len(names)
    points = pd.DataFrame({"id": names, "kind": kinds, "x": xy_m[:, 0], "y": xy_m[:, 1]})
    for name in attributes:
        points[name] = attribute_numbers(table, name, path)
    for name in texts:
        points[name] = table[name].fillna("").astype(str).to_numpy() if name in table else ""
    return points


def attribute_numbers(
    table: pd.DataFrame | gpd.GeoDataFrame, name: str, where: AnyPath
) -> np.ndarray:
    """Values of an attribute, NaN where it is not given.

    Raises
    ------
    InputError : a value that is given is no finite number of 0 or more.
    """
    if name not in table:
        return np.full(len(table), np.nan)
    given = table[name].notna() & (table[name].astype(str).str.strip() != "")
    numbers = pd.to_numeric(table[name], errors="coerce").to_numpy(np.float64)
    wrong = given.to_numpy() & ~(np.isfinite(numbers) & (numbers >= 0))
    if wrong.any():
        row = int(np.argmax(wrong))
        raise InputError(
            f"{name} is no number of 0 or more",
            where=f"{where}, feature {row + 1}",
            found=table[name].iloc[row],
        )
    return numbers


def read_seeds(text: str | None, frame: Frame, where: str) -> Floats | None:
    """Places on the road (k, 2), local metres, of ``x,y;x,y`` in the cloud's coordinates.

    None without any. ``where`` names what gave them.

    Raises
    ------
    InputError : one is no pair of numbers, or not finite; its number is told.
    """
    given = [place for place in (text or "").split(";") if place.strip()]
    pairs = []
    for number, place in enumerate(given, 1):
        try:
            x, y = (float(value) for value in place.split(","))
        except ValueError:
            x = y = np.nan
        if not np.isfinite([x, y]).all():
            raise InputError(
                f"seed {number} of {len(given)} is no place",
                where=where,
                found=place.strip(),
                allowed="x,y;x,y, finite numbers in the cloud's coordinates",
            )
        pairs.append((x, y))
    return frame.to_local(np.array(pairs)) if pairs else None


def read_track(path: AnyPath | None, frame: Frame, crs: str | None = None) -> Floats | None:
    """Where a vehicle drove (k, 2), local metres: the longest line of a file; None without one.

    ``crs`` is that of a file that names none.

    Raises
    ------
    InputError : the file cannot be read, or holds no line.
    """
    if not path:
        return None
    lines = read_lines(path, frame, crs).geometry
    return shapely.get_coordinates(max(lines, key=lambda line: line.length))


_HEIGHT = "height_m"
_HIGHEST_M = 100.0  # a mount that is said to be higher is taken for a mistake of unit or column


def read_mounts(path: AnyPath, frame: Frame) -> pd.DataFrame:
    """Poles: name (unique), x, y (local metres), top_m (metres; NaN where height_m is not given).

    Parameters
    ----------
    path : CSV (lat, lon or native x, y) or any vector file; further id or name, height_m.

    Raises
    ------
    InputError : as `read_points`, or two share a name, or a height is impossible.
    """
    points = read_points(path, frame)
    names = points["id"].str.strip()
    if (repeated := names[names.duplicated()]).size:
        raise InputError("two poles share a name", where=str(path), found=repeated.iloc[0])
    is_table = Path(path).suffix.lower() == ".csv"
    source = read_text_table(path) if is_table else load_local(Path(path), frame)
    given = source[_HEIGHT] if _HEIGHT in source else pd.Series(np.nan, index=source.index)
    top = pd.to_numeric(given, errors="coerce").to_numpy(np.float64)
    blank = given.isna().to_numpy() | (given.astype(str).str.strip() == "").to_numpy()
    wrong = ~blank & ~((top > 0) & (top <= _HIGHEST_M))
    if wrong.any():
        row = int(np.argmax(wrong))
        raise InputError(
            "has an impossible height",
            where=f"{path}: {names.iloc[row]}",
            found=given.iloc[row],
            allowed=f"above 0 and at most {_HIGHEST_M:g} m, or empty",
        )
    return pd.DataFrame({"name": names, "x": points["x"], "y": points["y"], "top_m": top})
