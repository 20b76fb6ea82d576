"""Places and directions of the local frame as maps and crews name them."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from pyproj import CRS, Transformer

from roadsight.base.arrays import Floats
from roadsight.geometry.crs import horizontal
from roadsight.geometry.frames import Frame


def longitudes_latitudes(frame: Frame, xy_m: NDArray) -> Floats | None:
    """WGS 84 degrees (n, 2) of local positions (n, 2); None for a site without CRS."""
    if frame.crs_wkt is None:
        return None
    x, y = frame.to_native(xy_m).T
    return np.column_stack(_to_wgs84(frame.crs_wkt).transform(x, y))


@lru_cache(maxsize=4)
def _to_wgs84(crs_wkt: str) -> Transformer:
    """Transformer from the horizontal part of a CRS; made once, for it takes milliseconds."""
    crs = horizontal(CRS.from_wkt(crs_wkt))
    return Transformer.from_crs(crs, "EPSG:4326", always_xy=True)


def bearing_deg(yaw_deg: float) -> float:
    """Bearing clockwise from grid north of an angle counter-clockwise from east, [0, 360)."""
    return (90.0 - yaw_deg) % 360.0
