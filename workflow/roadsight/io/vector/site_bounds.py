"""Whether features of a user lie at the site, and whether their axes are swapped if none does."""

from __future__ import annotations

import logging
import os
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray

from roadsight.base.arrays import AnyPath, Bools, Floats
from roadsight.base.doubts import FEW, Doubt, tell_matches
from roadsight.base.errors import InputError
from roadsight.geometry.frames import Frame
from roadsight.geometry.north import SiteNorth
from roadsight.io.images.videologs import read_positions
from roadsight.io.vector.vector_sources import EXCHANGED
from roadsight.io.vector.vectors import read_lines, read_polygons

# Features this far off the cloud still belong to the site, such as poles beside its road.
_REACH_M = 100.0


def tell_near(
    log: logging.Logger,
    what: str,
    geometries: NDArray | Floats,
    about: dict[str, Any],
    where: AnyPath,
) -> list[Doubt]:
    """Say how many features lie at the site.

    Parameters
    ----------
    geometries : shapely geometries (n,), or places (n, 2), local metres.
    about : content of ``scene/frame.json``. where : the file.

    Returns
    -------
    a doubt where few do, as `tell_matches`

    Raises
    ------
    InputError : there are some and none does; a swap of axes is told where it would help.
    """
    bounds = about.get("bounds_m")
    if bounds is None:
        return []
    shapes = np.asarray(geometries)
    shapes = shapes if shapes.ndim == 1 else shapely.points(shapes[:, :2])
    box = shapely.box(bounds[0], bounds[1], bounds[3], bounds[4])
    near = shapely.dwithin(shapes, box, _REACH_M)
    hint = ""
    if near.sum() < FEW * len(shapes):
        hint = _hint(shapes[~near], Frame.from_dict(about), box)
    count = int(near.sum())
    return tell_matches(log, f"{what} lie at the site", count, len(shapes), os.fspath(where), hint)


def _hint(shapes: NDArray, frame: Frame, box: shapely.Geometry) -> str:
    """What would bring features (n,) that lie elsewhere to the site."""
    middles = shapely.get_coordinates(shapely.centroid(shapes))
    swapped = [frame.to_local(frame.to_native(middles)[:, ::-1])]
    if frame.crs_wkt is not None:
        north = SiteNorth(frame)
        latitude, longitude = north.to_geographic(middles)
        possible = np.abs(longitude) <= 90
        swapped.append(north.to_local(longitude[possible], latitude[possible]))
    for places in swapped:
        known = places[np.isfinite(places).all(axis=1)]
        if len(known) and shapely.dwithin(shapely.points(known), box, _REACH_M).any():
            return EXCHANGED
    return "check its coordinates and its CRS"


# The part of its clouds that a site is about: a box, a polygon, or a distance from lines.

Within = Callable[[Floats], Bools]  # which places (n, 2), local metres, lie in the extent (n,)


def read_extent(
    kind: str, value: str, frame: Frame, files: Sequence[Path] = (), crs: str | None = None
) -> Within:
    """Extent that a site file asks for.

    Parameters
    ----------
    kind : ``box`` (native west, south, east, north), ``polygon`` (file), ``edges_m`` or
        ``track_m`` (distance in metres from digitised edges, or from a videolog's positions).
    value : as the site file has it. files : edges or videolog for the last two.
    frame : local frame of the site.
    crs : of a file that names none.

    Raises
    ------
    InputError : the box is empty, a file cannot be used, or the lines are not given.
    """
    where = f"extent.{kind}"
    if kind == "box":
        west, south, east, north = (float(part) for part in value.split(","))
        if not (west < east and south < north):
            raise InputError(
                "is empty", where=where, found=value, allowed="west < east and south < north"
            )
        area = shapely.box(*frame.to_local([[west, south], [east, north]]).ravel())
    elif kind == "polygon":
        area = shapely.union_all(read_polygons(value, frame, crs).geometry.to_numpy())
    else:
        area = shapely.buffer(_lines(kind, where, frame, files, crs), float(value))
    shapely.prepare(area)

    def within(xy_m: Floats) -> Bools:
        return np.asarray(shapely.contains_xy(area, xy_m[:, 0], xy_m[:, 1]))

    return within


def _lines(
    kind: str, where: str, frame: Frame, files: Sequence[Path], crs: str | None
) -> shapely.Geometry:
    """Edges, or the positions of a videolog one after the other."""
    if not files:
        needed = "placement.edges" if kind == "edges_m" else "poles.videolog"
        raise InputError(f"needs {needed}", where=where, hint="give it, or use a box or a polygon")
    if kind == "edges_m":
        lines = [read_lines(path, frame, crs).geometry.to_numpy() for path in files]
        return shapely.union_all(np.concatenate(lines))
    north = SiteNorth(frame)
    places = [north.to_local(*read_positions(path)) for path in files]
    return shapely.union_all([shapely.multipoints(part) for part in places])
