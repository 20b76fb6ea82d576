"""Where a map is: what turns its local metres into native coordinates and degrees."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from roadsight.base.arrays import Floats
from roadsight.geometry.frames import Frame
from roadsight.geometry.places import longitudes_latitudes

_SIDE = 5
"""Places a side at which the projection is asked; six coefficients need no more."""
_LEAST_SPAN_M = 100.0
"""The box is at least so wide, so that the coefficients are determined."""


def map_place(frame: Frame, bounds_m: ArrayLike, unit: str) -> dict[str, Any]:
    """What a page needs to tell the coordinates at a place of its map.

    Longitude and latitude are polynomials of second degree of the local x and y over a box: within
    10 km they differ from the projection by less than a millimetre for each kilometre.

    Parameters
    ----------
    bounds_m : west, south, east, north of what the map shows, local metres.
    unit : sign of the native horizontal unit.

    Returns
    -------
    ``origin`` (native units), ``unit_m``, ``unit``; ``centre_m``, ``span_m`` and ``lon_lat``, two
    rows of coefficients of 1, u, v, u², uv, v² with u, v = (x, y - centre) / span, or None for a
    site without CRS
    """
    west, south, east, north = np.asarray(bounds_m, np.float64)
    centre = np.array([(west + east) / 2, (south + north) / 2])
    span = max(east - west, north - south, _LEAST_SPAN_M)
    u, v = (part.ravel() for part in np.meshgrid(*[np.linspace(-0.5, 0.5, _SIDE)] * 2))
    degrees = longitudes_latitudes(frame, centre + span * np.column_stack([u, v]))
    return {
        "origin": [float(value) for value in frame.origin[:2]],
        "unit_m": frame.unit_m,
        "unit": unit,
        "centre_m": centre.tolist(),
        "span_m": float(span),
        "lon_lat": None if degrees is None else _fitted(u, v, degrees).T.tolist(),
    }


def _fitted(u: Floats, v: Floats, degrees: Floats) -> Floats:
    """Coefficients (6, 2) by least squares."""
    terms = np.column_stack([np.ones(len(u)), u, v, u * u, u * v, v * v])
    return np.asarray(np.linalg.lstsq(terms, degrees, rcond=None)[0])
