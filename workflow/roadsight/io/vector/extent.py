"""The part of its clouds that a site is about: a box, a polygon, or a distance from lines."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import shapely

from roadsight.base.arrays import Bools, Floats
from roadsight.base.errors import InputError
from roadsight.geometry.frames import Frame
from roadsight.geometry.north import SiteNorth
from roadsight.io.images.videologs import read_positions
from roadsight.io.vector.vectors import read_lines, read_polygons

Within = Callable[[Floats], Bools]
"""Which places (n, 2), local metres, lie in the extent (n,)."""


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
