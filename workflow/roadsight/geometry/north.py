"""True north and geographic coordinates of places in a site's local frame."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pyproj import CRS, Proj, Transformer

from roadsight.base.arrays import Floats
from roadsight.base.errors import InputError
from roadsight.geometry.crs import horizontal
from roadsight.geometry.frames import Frame


class SiteNorth:
    """Between the local frame, latitude and longitude (WGS 84), and true north.

    Parameters
    ----------
    frame : local frame of a site that has a CRS.

    Raises
    ------
    InputError : the site has no CRS.
    """

    def __init__(self, frame: Frame) -> None:
        if frame.crs_wkt is None:
            raise InputError(
                "a local system has no latitude and longitude",
                where="crs",
                hint="state the cloud's CRS in the site file",
            )
        self._frame = frame
        crs = horizontal(CRS.from_wkt(frame.crs_wkt))
        self._to_geographic = Transformer.from_crs(crs, CRS.from_epsg(4326), always_xy=True)
        self._from_geographic = Transformer.from_crs(CRS.from_epsg(4326), crs, always_xy=True)
        self._projection = Proj(crs)
        self._geodetic = Transformer.from_crs(crs, crs.geodetic_crs, always_xy=True)

    def to_local(self, latitude_deg: ArrayLike, longitude_deg: ArrayLike) -> Floats:
        """Local x, y (n, 2) in metres; infinite where the CRS cannot hold the place."""
        x, y = self._from_geographic.transform(
            np.asarray(longitude_deg, float), np.asarray(latitude_deg, float)
        )
        return self._frame.to_local(np.stack([x, y], axis=-1))

    def to_geographic(self, xy_m: ArrayLike) -> tuple[Floats, Floats]:
        """Latitude and longitude in degrees of local places (n, 2)."""
        native = self._frame.to_native(np.asarray(xy_m, float)[..., :2])
        longitude, latitude = self._to_geographic.transform(native[..., 0], native[..., 1])
        return np.asarray(latitude), np.asarray(longitude)

    def convergence_deg(self, xy_m: ArrayLike) -> Floats:
        """Grid north clockwise from true north at local places (n, 2).

        A direction's true bearing is its grid bearing plus this.
        """
        return self._factor("meridian_convergence", xy_m)

    def scale(self, xy_m: ArrayLike) -> Floats:
        """Metres of the grid for each metre on the ellipsoid at local places (n, 2).

        The root of the factor of areas: the factor itself where the projection is conformal, the
        mean over all directions to second order elsewhere.
        """
        return np.sqrt(self._factor("areal_scale", xy_m))

    def _factor(self, name: str, xy_m: ArrayLike) -> Floats:
        """A factor of the projection at local places (n, 2)."""
        native = self._frame.to_native(np.asarray(xy_m, float)[..., :2])
        if native.size == 0:  # PROJ takes no empty arrays
            return np.empty(native.shape[:-1])
        longitude, latitude = self._geodetic.transform(native[..., 0], native[..., 1])
        return np.asarray(getattr(self._projection.get_factors(longitude, latitude), name), float)


# Places and directions of the local frame as maps and crews name them.


def longitudes_latitudes(frame: Frame, xy_m: NDArray) -> Floats | None:
    """WGS 84 degrees (n, 2) of local positions (n, 2); None for a site without CRS."""
    if frame.crs_wkt is None:
        return None
    latitude, longitude = _site_north(frame).to_geographic(xy_m)
    return np.column_stack([longitude, latitude])


@lru_cache(maxsize=4)
def _site_north(frame: Frame) -> SiteNorth:
    """Made once, for it takes milliseconds."""
    return SiteNorth(frame)


def bearing_deg(yaw_deg: float) -> float:
    """Bearing clockwise from grid north of an angle counter-clockwise from east, [0, 360)."""
    return (90.0 - yaw_deg) % 360.0
