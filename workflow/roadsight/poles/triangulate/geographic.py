"""Poles in latitude and longitude from sightings in latitude and longitude."""

from __future__ import annotations

import numpy as np
import pandas as pd

from roadsight.poles.triangulate.earth import TangentFrame, neighbourhoods
from roadsight.poles.triangulate.locate import triangulate
from roadsight.poles.triangulate.published import published_poles
from roadsight.poles.triangulate.rays import (
    FURTHEST_CAMERAS,
    Rays,
    TriangulationSettings,
    make_rays,
)

COLUMNS = ["lat", "lon", "score", "sigma_m"]
_DECIMALS = 9
"""Of latitude and longitude in degrees: a tenth of a millimetre."""


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
