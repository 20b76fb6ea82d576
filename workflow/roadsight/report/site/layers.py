"""The layers that map and 3D view share, packed for the page; all in local metres."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import geopandas as gpd
import numpy as np
import pandas as pd
import shapely
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt

from roadsight.base.arrays import Bools, Bytes, Floats
from roadsight.report.packing import pack, pack_points, to_byte

UNKNOWN_HEIGHT = 255  # Step that says that a point's height above ground is not known
_HEIGHT_STEP_M = 0.1  # Heights above ground are stored in bytes: up to 25.4 m
_DRAWN_WITHIN_M = 0.05  # Drawn lines may be so far off; smaller values make the page larger
_MOST_RELIEF_CELLS = 900  # Cells along the longer side of the shaded relief


@dataclass(frozen=True)
class CloudSample:
    """Points of a cloud that stand for all of it.

    Parameters
    ----------
    total : number of points of the whole cloud.
    xyz_m : (n, 3) local metres.
    above_ground_m : (n,) height above the terrain model, NaN where it has none.
    intensity : (n,) uint16.
    colour : (n, 3) uint8, or None.
    """

    total: int
    xyz_m: NDArray
    above_ground_m: NDArray
    intensity: NDArray
    colour: NDArray | None


def cloud_layer(sample: CloudSample) -> dict[str, Any]:
    """Points with height above ground (steps of 0.1 m, 255 = unknown), intensity and colour."""
    steps = np.rint(np.clip(sample.above_ground_m / _HEIGHT_STEP_M, 0, UNKNOWN_HEIGHT - 1))
    heights = np.where(np.isfinite(steps), steps, UNKNOWN_HEIGHT)
    intensity = to_byte(sample.intensity)
    return {
        "total": sample.total,
        **pack_points(sample.xyz_m),
        "height_step_m": _HEIGHT_STEP_M,
        "height": pack(heights, "u1"),
        "intensity": None if intensity is None else pack(intensity, "u1"),
        "colour": None if sample.colour is None else pack(sample.colour, "u1"),
    }


def relief_layer(
    heights_m: NDArray, west_m: float, north_m: float, cell_size_m: float
) -> dict[str, Any]:
    """Shaded relief of a terrain model.

    Parameters
    ----------
    heights_m : (rows, columns), first row north, NaN = no data.
    west_m, north_m : outer corner of the first cell, local metres.
    """
    coarse, cell = block_mean(heights_m, cell_size_m, _MOST_RELIEF_CELLS)
    return {
        "west_m": west_m,
        "north_m": north_m,
        "cell_size_m": cell,
        "rows": coarse.shape[0],
        "columns": coarse.shape[1],
        "shade": pack(hillshade(coarse, cell), "u1"),
    }


def polygon_layer(polygons: gpd.GeoDataFrame) -> list[list[dict[str, Any]]]:
    """Polygons as lists of rings (outer first), simplified by less than a line's width."""
    drawn = shapely.simplify(polygons.geometry.to_numpy(), _DRAWN_WITHIN_M)
    return [
        [_vertices(ring) for ring in (part.exterior, *part.interiors)]
        for part in shapely.get_parts(drawn)
        if isinstance(part, shapely.Polygon) and not part.is_empty
    ]


def edge_layer(edges: gpd.GeoDataFrame) -> list[dict[str, Any]]:
    """Lines with name, kind and source."""
    named = zip(edges["edge"], edges["kind"], edges["source"], edges.geometry, strict=True)
    return [
        {
            "edge": str(edge),
            "kind": str(kind),
            "source": str(source),
            "length_m": float(line.length),
            "xy": _vertices(shapely.simplify(line, _DRAWN_WITHIN_M)),
        }
        for edge, kind, source, line in named
    ]


def _vertices(line: shapely.Geometry) -> dict[str, Any]:
    return pack(shapely.get_coordinates(line), "f4")


def candidate_layer(rounds: Sequence[pd.DataFrame]) -> dict[str, Any]:
    """Positions of candidates in plan: how many heights each has, and its first round.

    Parameters
    ----------
    rounds : candidates of each round, in order; a later round may repeat a position.
    """
    numbered = [table.assign(round=number) for number, table in enumerate(rounds)]
    columns = ["x", "y", "height_m", "key", "round"]
    table = pd.concat([part[columns] for part in numbered], ignore_index=True)
    grouped = table.groupby("key", sort=False)
    first = grouped.first()
    return {
        "total": len(table),
        "xy": pack(first[["x", "y"]].to_numpy(), "f4"),
        "heights": pack(grouped.size().to_numpy(), "u2"),
        "lowest_m": pack(grouped["height_m"].min().to_numpy(), "f4"),
        "highest_m": pack(grouped["height_m"].max().to_numpy(), "f4"),
        "round": pack(grouped["round"].min().to_numpy(), "u1"),
    }


def target_layer(targets: pd.DataFrame) -> dict[str, Any]:
    """Targets: names and positions on the pavement."""
    return {
        "names": [str(name) for name in targets["target"]],
        "xyz": pack(targets[["x", "y", "z"]].to_numpy(), "f4"),
    }


# A terrain model as shaded relief.

# Light from the north-west, as maps have it: from the south, hills would look like hollows
_SUN_AZIMUTH_DEG = 315.0
_SUN_ALTITUDE_DEG = 45.0  # Height of the light above the horizon
_EXAGGERATION = 2.0  # Slopes are drawn this much steeper: roadsides are too flat to show otherwise
_NEAR_M = 2.0  # Filled cells within this of measured ones are shown: gaps between scan lines
NO_DATA = 0  # Byte of cells without a height; shades go from 1 to 255


def block_mean(heights_m: NDArray, cell_size_m: float, most_cells: int) -> tuple[Floats, float]:
    """Coarser raster with at most ``most_cells`` along its longer side.

    Parameters
    ----------
    heights_m : (rows, columns), NaN = no data.

    Returns
    -------
    means of blocks (NaN where a block is empty) and their cell size
    """
    rows, columns = heights_m.shape
    factor = -(-max(rows, columns) // most_cells)
    padding = ((0, -rows % factor), (0, -columns % factor))
    padded = np.pad(heights_m.astype(np.float64), padding, constant_values=np.nan)
    blocks = padded.reshape(padded.shape[0] // factor, factor, -1, factor)
    known = np.isfinite(blocks)
    count = known.sum(axis=(1, 3))
    total = np.where(known, blocks, 0.0).sum(axis=(1, 3))
    means = np.where(count > 0, total / np.maximum(count, 1), np.nan)
    return means, cell_size_m * factor


def near_measured(heights_m: NDArray, measured: Bools | None, cell_size_m: float) -> NDArray:
    """Heights that are measured or within 2 m of measured ones; NaN elsewhere.

    Wide gaps are filled by long triangles, which say nothing of the ground and look like ridges.

    Parameters
    ----------
    heights_m, measured : (rows, columns); None where a raster does not tell: all stay.
    """
    if measured is None or not measured.any():
        return heights_m
    away_m = distance_transform_edt(~measured, sampling=cell_size_m)
    return np.where(away_m <= _NEAR_M, heights_m, np.nan)


def hillshade(heights_m: NDArray, cell_size_m: float) -> Bytes:
    """Brightness of a surface lit from the north-west, 45 degrees high (Lambert's law).

    Slopes are doubled, because roads are flat. Beside cells without data the slope counts as zero.

    Parameters
    ----------
    heights_m : (rows, columns), first row north, NaN = no data.

    Returns
    -------
    (rows, columns), 1 = dark to 255 = bright, 0 = no data
    """
    known = np.isfinite(heights_m)
    east = _EXAGGERATION * _slope(heights_m, cell_size_m, axis=1)
    north = -_EXAGGERATION * _slope(heights_m, cell_size_m, axis=0)
    azimuth, altitude = np.radians([_SUN_AZIMUTH_DEG, _SUN_ALTITUDE_DEG])
    sun_east, sun_north = np.sin(azimuth) * np.cos(altitude), np.cos(azimuth) * np.cos(altitude)
    facing = np.sin(altitude) - sun_east * east - sun_north * north
    light = np.clip(facing / np.sqrt(1 + east**2 + north**2), 0, 1)
    return np.where(known, 1 + np.rint(254 * light), NO_DATA).astype(np.uint8)


def _slope(heights_m: NDArray, cell_size_m: float, axis: int) -> Floats:
    """Central differences along an axis; 0 where a neighbour is missing."""
    if heights_m.shape[axis] < 3:
        return np.zeros(heights_m.shape)
    slope = np.gradient(heights_m.astype(np.float64), cell_size_m, axis=axis)
    return np.where(np.isfinite(slope), slope, 0.0)
