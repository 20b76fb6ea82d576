"""Poles in latitude and longitude from sightings in latitude and longitude."""

from __future__ import annotations

import numpy as np
import pandas as pd
from pyproj import Geod, Proj, Transformer
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from roadsight.base.arrays import Floats, Ints
from roadsight.poles.triangulate.explain import triangulate
from roadsight.poles.triangulate.published import published_poles
from roadsight.poles.triangulate.rays import (
    FURTHEST_CAMERAS,
    Rays,
    TriangulationSettings,
    make_rays,
)

COLUMNS = ["lat", "lon", "score", "sigma_m"]
_DECIMALS = 9  # of latitude and longitude in degrees: a tenth of a millimetre


def triangulate_geographic(
    sightings: pd.DataFrame, settings: TriangulationSettings
) -> pd.DataFrame:
    """Poles by the method that the settings name, kept ones only.

    Parameters
    ----------
    sightings : lat, lon, bearing (true) in degrees; depth in metres (not positive = unknown);
        optionally image, sigma_bearing_deg, sigma_depth_m.

    Returns
    -------
    columns `COLUMNS`; ``sigma_m`` is the longer semi-axis of the 1-sigma error ellipse
    """
    rows: list[np.ndarray] = []
    sweep = settings.method == "sweep"
    farthest_m = settings.sweep_distance_m if sweep else settings.max_distance_m
    reach_m = FURTHEST_CAMERAS * farthest_m
    lat, lon = sightings["lat"].to_numpy(np.float64), sightings["lon"].to_numpy(np.float64)
    for part in neighbourhoods(lat, lon, reach_m):
        frame = TangentFrame(lat[part], lon[part])
        poles, _, _ = triangulate(_rays(sightings.iloc[part], frame), settings)
        poles = poles[poles["kept"].to_numpy(bool)]
        latitude, longitude = frame.to_degrees(poles[["x", "y"]].to_numpy(np.float64))
        figures = poles[["score", "sigma_major_m"]].to_numpy(np.float64)
        rows.append(np.column_stack([latitude, longitude, figures]))
    return _sorted(np.concatenate(rows))


def triangulate_published(
    sightings: pd.DataFrame, settings: TriangulationSettings, seed: int
) -> pd.DataFrame:
    """Poles as the published code finds them; as `triangulate_geographic`.

    ``sigma_m`` is NaN, since that method has no errors.
    """
    lat, lon = sightings["lat"].to_numpy(np.float64), sightings["lon"].to_numpy(np.float64)
    frame = TangentFrame(lat, lon)
    rays = _rays(sightings, frame)
    labels, places = published_poles(rays, settings, frame.latitude_deg, seed)
    latitude, longitude = frame.to_degrees(places)
    views = np.bincount(labels[labels >= 0], minlength=len(places))
    return _sorted(np.column_stack([latitude, longitude, views, np.full(len(places), np.nan)]))


def _rays(sightings: pd.DataFrame, frame: TangentFrame) -> Rays:
    lat, lon = sightings["lat"].to_numpy(np.float64), sightings["lon"].to_numpy(np.float64)
    bearing = frame.to_grid_bearing(lat, lon, sightings["bearing"].to_numpy(np.float64))
    optional = {
        name: sightings[column].to_numpy() if column in sightings else None
        for name, column in (
            ("depth_m", "depth"),
            ("sigma_bearing_deg", "sigma_bearing_deg"),
            ("sigma_depth_m", "sigma_depth_m"),
            ("image", "image"),
        )
    }
    return make_rays(frame.to_metres(lat, lon), bearing, **optional)


def _sorted(rows: np.ndarray) -> pd.DataFrame:
    """Table from south to north, west to east."""
    poles = pd.DataFrame(rows, columns=COLUMNS).astype({"score": np.int64})
    poles = poles.round({"lat": _DECIMALS, "lon": _DECIMALS, "sigma_m": 3})
    return poles.sort_values(["lat", "lon"], ignore_index=True)


# Sightings anywhere on Earth in local metres: a tangent frame for each neighbourhood of cameras.
#
# Cameras that cannot share a pole need no common frame, so a file may span continents, the
# antimeridian and a pole of the Earth without distortion.

_WGS84 = Geod(ellps="WGS84")
# Step that turns a bearing into a direction: short against the Earth, long against rounding.
_STEP_M = 10.0


class TangentFrame:
    """Azimuthal equidistant frame around a place: metres, x east and y north there.

    Parameters
    ----------
    latitude_deg, longitude_deg : of the places; their middle is the origin.
    """

    def __init__(self, latitude_deg: Floats, longitude_deg: Floats) -> None:
        latitude, longitude = np.radians(latitude_deg), np.radians(longitude_deg)
        level = np.cos(latitude)
        xyz = [level * np.cos(longitude), level * np.sin(longitude), np.sin(latitude)]
        middle = np.column_stack(xyz).mean(axis=0)
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


# Why a table of sightings gives no pole.


def reasons_for_none(sightings: pd.DataFrame, settings: TriangulationSettings) -> list[str]:
    """What stands against poles in a table that gave none; the likeliest first, never empty.

    Parameters
    ----------
    sightings : as of `triangulate_geographic`.
    """
    found = []
    if looks_exchanged(sightings, settings):
        found.append("lat and lon look exchanged: the other way round there are poles")
    if "depth" in sightings:
        depth = sightings["depth"].to_numpy(np.float64)
        far = int((depth > settings.max_distance_m).sum())
        if 2 * far > len(depth):
            found.append(
                f"{far} of {len(depth)} depths are beyond {settings.max_distance_m:g} m:"
                " are they metres?"
            )
    reach_m = FURTHEST_CAMERAS * settings.max_distance_m
    places = sightings[["lat", "lon"]].to_numpy(np.float64)
    parts = neighbourhoods(places[:, 0], places[:, 1], reach_m)
    if all(len(np.unique(places[part], axis=0)) < 2 for part in parts):
        found.append(f"too few sightings: no two cameras lie within {reach_m:g} m of each other")
    return found or ["no two sightings agree on a place within their errors"]


def looks_exchanged(sightings: pd.DataFrame, settings: TriangulationSettings) -> bool:
    """Whether poles appear when latitude and longitude change places."""
    if not sightings["lon"].abs().le(90.0).all():
        return False
    other = sightings.rename(columns={"lat": "lon", "lon": "lat"})
    return len(triangulate_geographic(other, settings)) > 0
