"""Lines as CSV tables: one vertex a row, columns edge, x, y or edge, lon, lat; further z, kind."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import geopandas as gpd
import numpy as np
import pandas as pd
from pyproj import CRS
from shapely import LineString

from roadsight.base.errors import InputError
from roadsight.io.records.text_tables import read_cells


def read_line_table(path: Path) -> tuple[gpd.GeoDataFrame, CRS | None]:
    """Lines of a CSV file, vertices in the order of the rows, and WGS 84 if they are lon, lat.

    Raises
    ------
    InputError : the file or a column is missing, a number or name is missing or wrong, a line has
        fewer than two vertices, or its rows differ in kind.
    """
    table = _table(path)
    axes = next((pair for pair in (["x", "y"], ["lon", "lat"]) if set(pair) <= set(table)), [])
    if not axes or "edge" not in table:
        raise InputError(
            "lacks columns",
            where=str(path),
            found=", ".join(table.columns),
            allowed="edge, x, y or edge, lon, lat; further z, kind",
        )
    names = [*axes, "z"] if "z" in table and (table["z"].str.strip() != "").any() else axes
    vertices = _numbers(path, table, names)
    edges = table["edge"].str.strip()
    if (edges == "").any():
        raise InputError(
            "has no edge name", where=f"{path}, line {int(np.argmax(edges == '')) + 2}"
        )
    rows = [_line(path, table, vertices, name, edges) for name in dict.fromkeys(edges)]
    lines = gpd.GeoDataFrame(rows, columns=["edge", "kind", "geometry"], geometry="geometry")
    if "kind" not in table:
        lines = lines.drop(columns="kind")
    return lines, CRS.from_epsg(4326) if axes == ["lon", "lat"] else None


def _table(path: Path) -> pd.DataFrame:
    """Cells of the file as text."""
    table = read_cells(path)
    table.columns = table.columns.str.strip().str.lower()
    if len(table) == 0:
        raise InputError("holds no vertices", where=str(path))
    return table


def _numbers(path: Path, table: pd.DataFrame, names: list[str]) -> np.ndarray:
    """Coordinates of every row, shape (rows, 2 or 3)."""
    numbers = table[names].apply(pd.to_numeric, errors="coerce").to_numpy(np.float64)
    wrong = np.argwhere(~np.isfinite(numbers))
    if len(wrong):
        row, column = wrong[0]
        raise InputError(
            f"{names[column]} is no finite number",
            where=f"{path}, line {row + 2}",
            found=repr(table[names[column]].iloc[row]),
        )
    return numbers


def _line(
    path: Path, table: pd.DataFrame, vertices: np.ndarray, name: str, edges: pd.Series
) -> tuple[Any, ...]:
    """Name, kind and geometry of one line."""
    own = (edges == name).to_numpy()
    kinds = sorted(set(table["kind"][own].str.strip())) if "kind" in table else [""]
    if len(kinds) > 1:
        raise InputError("its rows differ in kind", where=f"{path}, edge {name}", found=kinds)
    if own.sum() < 2:
        raise InputError("has fewer than two vertices", where=f"{path}, edge {name}")
    return name, kinds[0], LineString(vertices[own])
