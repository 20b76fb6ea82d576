"""Sightings anywhere on Earth in local metres: a tangent frame for each neighbourhood of cameras.

Cameras that cannot share a pole need no common frame, so a file may span continents, the
antimeridian and a pole of the Earth without distortion.
"""

from __future__ import annotations

import numpy as np
from pyproj import Geod, Proj, Transformer
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from roadsight.base.arrays import Floats, Ints

_WGS84 = Geod(ellps="WGS84")
_STEP_M = 10.0
"""Step that turns a bearing into a direction: short against the Earth, long against rounding."""


class TangentFrame:
    """Azimuthal equidistant frame around a place: metres, x east and y north there.

    Parameters
    ----------
    latitude_deg, longitude_deg : of the places; their middle is the origin.
    """

    def __init__(self, latitude_deg: Floats, longitude_deg: Floats) -> None:
        middle = _unit_vectors(latitude_deg, longitude_deg).mean(axis=0)
        self.latitude_deg = float(np.degrees(np.arctan2(middle[2], np.hypot(*middle[:2]))))
        self.longitude_deg = float(np.degrees(np.arctan2(middle[1], middle[0])))
        self._project = Proj(
            proj="aeqd", lat_0=self.latitude_deg, lon_0=self.longitude_deg, ellps="WGS84", units="m"
        )

    def to_metres(self, latitude_deg: Floats, longitude_deg: Floats) -> Floats:
        """Places (n, 2) in the frame."""
        return np.column_stack(self._project(longitude_deg, latitude_deg))

    def to_degrees(self, xy_m: Floats) -> tuple[Floats, Floats]:
        """Latitude and longitude of places (n, 2)."""
        longitude, latitude = self._project(xy_m[:, 0], xy_m[:, 1], inverse=True)
        return np.asarray(latitude), np.asarray(longitude)

    def to_grid_bearing(
        self, latitude_deg: Floats, longitude_deg: Floats, bearing_deg: Floats
    ) -> Floats:
        """Directions in the frame of true bearings at places, degrees clockwise from +y."""
        step = np.full(len(latitude_deg), _STEP_M)
        longitude, latitude, _ = _WGS84.fwd(longitude_deg, latitude_deg, bearing_deg, step)
        there = self.to_metres(np.asarray(latitude), np.asarray(longitude))
        ahead = there - self.to_metres(latitude_deg, longitude_deg)
        return np.degrees(np.arctan2(ahead[:, 0], ahead[:, 1])) % 360.0


def neighbourhoods(latitude_deg: Floats, longitude_deg: Floats, reach_m: float) -> list[Ints]:
    """Rows of places that hang together by steps of at most ``reach_m``."""
    to_space = Transformer.from_crs("EPSG:4979", "EPSG:4978", always_xy=True)
    height = np.zeros(len(latitude_deg))
    space = np.column_stack(to_space.transform(longitude_deg, latitude_deg, height))
    pairs = cKDTree(space).query_pairs(reach_m, output_type="ndarray")
    graph = csr_array((np.ones(len(pairs)), pairs.T), shape=(len(space), len(space)))
    _, label = connected_components(graph, directed=False)
    order = np.argsort(label, kind="stable")
    return np.split(order, np.flatnonzero(np.diff(label[order])) + 1)


def _unit_vectors(latitude_deg: Floats, longitude_deg: Floats) -> Floats:
    latitude, longitude = np.radians(latitude_deg), np.radians(longitude_deg)
    level = np.cos(latitude)
    return np.column_stack([level * np.cos(longitude), level * np.sin(longitude), np.sin(latitude)])
