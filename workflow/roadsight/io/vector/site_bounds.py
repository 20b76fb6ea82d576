"""Whether features of a user lie at the site, and whether their axes are swapped if none does."""

from __future__ import annotations

import logging
import os
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray

from roadsight.base.arrays import Floats
from roadsight.base.doubts import Doubt
from roadsight.base.matches import FEW, tell_matches
from roadsight.geometry.frames import Frame
from roadsight.geometry.north import SiteNorth
from roadsight.io.vector.vector_sources import EXCHANGED

_REACH_M = 100.0
"""Features this far off the cloud still belong to the site, such as poles beside its road."""


def tell_near(
    log: logging.Logger,
    what: str,
    geometries: NDArray | Floats,
    about: dict[str, Any],
    where: str | os.PathLike[str],
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
