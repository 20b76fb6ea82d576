"""Road edges in the overhead view of the cloud (paper 2, section 3.2.1)."""

from __future__ import annotations

import logging
import sys
from pathlib import Path
from typing import Annotated

import geopandas as gpd
import numpy as np
import pandas as pd
import shapely

from roadsight.base.arrays import Bools, Floats, Floats32, Ints
from roadsight.base.errors import InputError
from roadsight.base.sections.poles import RoadEdges
from roadsight.geometry.frames import Frame
from roadsight.io.cloud.tiles import CloudTiles
from roadsight.io.raster.top_rasters import TopRaster, read_top
from roadsight.io.records.atomic import read_json
from roadsight.io.records.tables import read_table, write_table
from roadsight.io.vector.vectors import write_layers
from roadsight.scene.classes import ROAD, is_road
from roadsight.scene.road_edges import (
    BORDER_CELLS,
    EdgeLines,
    RoadImage,
    clean_road,
    edge_level,
    edge_lines,
    edge_pixels,
    outlines,
    points_per_cell,
    smoothing_cells,
)
from roadsight.stages.command import Command

log = logging.getLogger("extract_road_edges")

_BESIDE_M = 45.0
"""Tiles this near to the track are read for curbs, which are followed 30 m beyond its ends and
looked for 12 m aside."""

METHODS = ("contours", "pixels", "curbs")
"""Ways to road edges, as the setting names them."""


def extract_road_edges(
    top: Path,
    frame_path: Path,
    settings: RoadEdges,
    cloud: Annotated[Path | None, "curbs: where they are looked for"] = None,
    frames: Annotated[Path | None, "curbs: the track that they lie beside"] = None,
    *,
    edges_path: Path,
    lines: Path,
) -> None:
    """Write the edge points as a table and as lines."""
    frame = Frame.from_dict(read_json(frame_path))
    if settings.method == "curbs":
        edges, about = _curbs(cloud, frames)
    else:
        edges, about = _outlined(top, settings, frame)
    write_table(edges_path, edges, about)
    write_layers(lines, {"road_edges": _layer(edges)}, frame)


def _curbs(
    cloud_path: Path | None, frames_path: Path | None
) -> tuple[pd.DataFrame, dict[str, object]]:
    """Curbs beside the track of each route, and how they were found."""
    from roadsight.scene.curbs import CurbSettings, find_curbs  # noqa: PLC0415  # slow to load

    if not (cloud_path and frames_path):
        raise InputError(
            "curbs are looked for in the cloud, beside the track", found="no --cloud, --frames"
        )
    cloud = CloudTiles(cloud_path)
    frames = read_table(frames_path, ["route", "sequence", "x", "y"])
    frames = frames.dropna(subset=["x", "y"])
    tables: list[pd.DataFrame] = []
    first = 0
    for route, rows in frames.groupby("route", sort=True):
        track = rows.sort_values("sequence", kind="stable")[["x", "y"]].to_numpy(np.float64)
        curbs = find_curbs(_beside(cloud, track), track)
        columns = dict(zip("xyz", curbs.xyz_m.T, strict=True))
        columns |= {"polyline": (curbs.polyline + first).astype(np.int32)}
        columns |= {"tangent_x": curbs.tangent[:, 0], "tangent_y": curbs.tangent[:, 1]}
        tables.append(pd.DataFrame(columns))
        first += int(curbs.polyline.max(initial=-1)) + 1
        log.info(
            "%s: %d curb points, steps of %.3f m (median)",
            route,
            len(tables[-1]),
            np.median(curbs.step_m) if len(curbs.step_m) else np.nan,
        )
    edges = pd.concat(tables, ignore_index=True)
    if edges.empty:
        raise InputError(
            "no curb found beside the track",
            where=str(cloud_path),
            hint="use road_edges.method contours; curbs need some hundred points per m2",
        )
    return edges, {"method": "curbs", "settings": vars(CurbSettings())}


def _beside(cloud: CloudTiles, track_xy_m: Floats) -> Floats:
    """Points (n, 3) of the tiles around a track."""
    low, high = track_xy_m.min(axis=0) - _BESIDE_M, track_xy_m.max(axis=0) + _BESIDE_M
    bounds = np.array([tile.bounds_m for tile in cloud.tiles])
    near = ((bounds[:, :2] <= high) & (bounds[:, 3:5] >= low)).all(axis=1)
    points = cloud.read(("x", "y", "z"), np.flatnonzero(near).tolist())
    return np.column_stack([points[axis] for axis in "xyz"]).astype(np.float64)


def _outlined(
    top_path: Path, settings: RoadEdges, frame: Frame
) -> tuple[pd.DataFrame, dict[str, object]]:
    """Edges of the road class in the overhead view, and how they were made."""
    top = read_top(top_path, frame, ["road_share"])
    image = clean_road(is_road(top.cls), top.cls > 0, top.cell_size_m, settings)
    lines = (_pixels if settings.method == "pixels" else _lines)(top, image, settings)
    # Heights only now, in the memory that the lines took.
    edges = _table(read_top(top_path, frame, ["height_m"]), lines)
    road_m2 = np.count_nonzero(image.road) * top.cell_size_m**2
    if len(edges) == 0:
        raise InputError(
            "no road edge found",
            where=str(top_path),
            found=f"{road_m2:.0f} m2 of road after cleaning",
            hint="lower smallest_road_m2, or check the road class of the cloud",
        )
    log.info(
        "%d edge points of %.0f m2 of road, closed by %d cells", len(edges), road_m2, image.closing
    )
    about: dict[str, object] = {
        "cell_size_m": top.cell_size_m,
        "spacing_m": top.cell_size_m / np.sqrt(points_per_cell(top.cls > 0, is_road(top.cls))),
        "method": settings.method,
        "settings": settings.model_dump(),
    }
    return edges, about


def _lines(top: TopRaster, image: RoadImage, settings: RoadEdges) -> EdgeLines:
    """Edge points between the pixels, along polylines with the direction of each."""
    level = edge_level(top.road_share, top.cls > 0, image)
    rings = outlines(image, level, smoothing_cells(image, top.cell_size_m, settings))
    return edge_lines(rings, image, top.cell_size_m, settings)


def _pixels(_: TopRaster, image: RoadImage, __: RoadEdges) -> EdgeLines:
    """Edge pixels' centres; they belong to no line and have no direction."""
    place = np.argwhere(edge_pixels(image, BORDER_CELLS)).astype(np.float64)
    no_line = np.full(len(place), -1, np.int32)
    return EdgeLines(place, np.full(place.shape, np.nan), no_line)


def _table(top: TopRaster, lines: EdgeLines) -> pd.DataFrame:
    """Edge points in local metres, without those that have no road near."""
    x, y = top.xy_m(*lines.place.T).T
    z = surface_heights(lines.place, top.height_m, is_road(top.cls))
    columns = {"x": x, "y": y, "z": z, "polyline": lines.polyline}
    columns |= {"tangent_x": lines.tangent[:, 1], "tangent_y": -lines.tangent[:, 0]}
    edges = pd.DataFrame(columns)
    bare = edges["z"].isna()
    if bare.any():
        log.warning("%d edge points without road near are left out", bare.sum())
    return edges[~bare].reset_index(drop=True)


def _layer(edges: pd.DataFrame) -> gpd.GeoDataFrame:
    """Lines, or points where there are none."""
    xyz = edges[["x", "y", "z"]].to_numpy()
    if (edges["polyline"] < 0).all():
        return gpd.GeoDataFrame({"cls": ROAD}, geometry=shapely.points(xyz), index=range(len(xyz)))
    numbers, first = np.unique(edges["polyline"], return_index=True)
    parts = zip(numbers, np.split(xyz, first[1:]), strict=True)
    lines = {number: shapely.LineString(part) for number, part in parts if len(part) > 1}
    return gpd.GeoDataFrame(
        {"polyline": list(lines), "length_m": [line.length for line in lines.values()]},
        geometry=list(lines.values()),
    )


# Heights of the road at places between the pixels of an overhead view.

_BATCH = 1_000
"""Places worked on together: their windows of pixels stay in the processor's cache."""

_FAR_M = 0.3
"""Road pixels farther from the median around them, up or down, are of something else."""


def surface_heights(
    place: Floats, height_m: Floats32, road: Bools, radius_cells: int = 4
) -> Floats:
    """Height of the road surface at places (n, 2) in rows and columns, NaN without road near.

    A plane through the road pixels around, without those far from their median.
    """
    heights = np.empty(len(place))
    for start in range(0, len(place), _BATCH):
        part = place[start : start + _BATCH]
        heights[start : start + len(part)] = _planes(part, height_m, road, radius_cells)
    return heights


def _planes(place: Floats, height_m: Floats32, road: Bools, radius_cells: int) -> Floats:
    """Heights at places (n, 2) of planes through the road pixels around each."""
    offsets = np.arange(-radius_cells, radius_cells + 1)
    nearest = np.round(place)
    row, column = nearest.astype(np.int64).T[:, :, None] + offsets
    inside_row, inside_column = (
        np.clip(at, 0, size - 1) for at, size in zip((row, column), road.shape, strict=True)
    )
    window = inside_row[:, :, None] * road.shape[1] + inside_column[:, None, :]
    valid = road.take(window)
    valid &= (row == inside_row)[:, :, None] & (column == inside_column)[:, None, :]
    valid, z = valid.reshape(len(place), -1), height_m.take(window).reshape(len(place), -1)
    z = z.astype(np.float64)
    valid &= np.isfinite(z)
    middle = medians(z, valid)
    apart = np.where(valid, z - middle[:, None], 0.0)
    weight = (valid & (np.abs(apart) <= _FAR_M)).astype(np.float64)
    plane = _planes_through(weight, apart, offsets)
    return np.asarray(middle + plane[:, 0] + (plane[:, 1:] * (place - nearest)).sum(axis=1))


def _planes_through(weight: Floats, height: Floats, offsets: Ints) -> Floats:
    """Height in the middle and slopes down and right (n, 3) of planes through windows of pixels.

    Parameters
    ----------
    weight, height : (n, k * k) by pixel, row by row. offsets : (k,) of its rows and columns.
    """
    down, right = (grid.ravel() for grid in np.meshgrid(offsets, offsets, indexing="ij"))
    terms = np.stack([np.ones(len(down)), down, right], axis=1)
    products = (terms[:, :, None] * terms[:, None, :]).reshape(len(terms), 9)
    # As if the slope were known to be some 5 cm a cell, so that few or collinear pixels do. The
    # tiny weight on the height keeps a window without any road pixel solvable; its median is NaN.
    square = (weight @ products).reshape(-1, 3, 3) + np.diag([1e-9, 0.3, 0.3])
    plane = np.linalg.solve(square, ((weight * height) @ terms)[..., None])
    return np.asarray(plane[:, :, 0], np.float64)


def medians(values: Floats, valid: Bools) -> Floats:
    """Median (n,) of the valid among each row's values (n, k), NaN where none is."""
    rising = np.sort(np.where(valid, values, np.inf), axis=1)
    count = valid.sum(axis=1)
    pair = np.stack([np.maximum(count - 1, 0) // 2, count // 2], axis=1)
    pair = np.minimum(pair, values.shape[1] - 1)
    middle = np.take_along_axis(rising, pair, axis=1).mean(axis=1)
    return np.where(count > 0, middle, np.nan)


main = Command(extract_road_edges)


if __name__ == "__main__":
    sys.exit(main())
