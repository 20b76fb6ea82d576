"""Poles from sightings, as tables or layers."""

from __future__ import annotations

import os

import geopandas as gpd
import pandas as pd

from roadsight.io.records.text_tables import checked_sightings, read_sightings
from roadsight.poles.triangulate.geographic import triangulate_geographic
from roadsight.poles.triangulate.rays import UNAIDED, TriangulationSettings

_WGS84 = "EPSG:4326"


def triangulate(
    sightings: gpd.GeoDataFrame | pd.DataFrame | str | os.PathLike[str],
    settings: TriangulationSettings | None = None,
) -> gpd.GeoDataFrame:
    """Places of poles from what images saw of them (paper 2, section 3.4; deterministic).

    Parameters
    ----------
    sightings : columns lat, lon (WGS 84, of the camera), bearing (true, degrees) and depth (m;
        missing = unknown), further image, sigma_bearing_deg, sigma_depth_m; or the path of such a
        CSV; or a layer with a CRS, whose points stand for lat and lon.
    settings : what a sighting is worth and what a pole takes; None: for positions and depths of
        which nobody says how good they are.

    Returns
    -------
    columns lat, lon, score (images), sigma_m (longer semi-axis of the 1-sigma ellipse); points in
    the CRS of a given layer, else WGS 84

    Raises
    ------
    InputError : a column is missing, or a value is impossible.

    Examples
    --------
    >>> import pandas as pd, roadsight
    >>> seen = pd.DataFrame({"lat": [51.5, 51.5, 51.5], "lon": [-0.1, -0.1001, -0.1002],
    ...                      "bearing": [315.0, 0.0, 45.0], "depth": [9.8, 6.9, 9.8]})
    >>> poles = roadsight.triangulate(seen)
    >>> len(poles), poles.crs.to_epsg()
    (1, 4326)
    """
    settings = settings or UNAIDED
    crs = _WGS84
    if isinstance(sightings, (str, os.PathLike)):
        table = read_sightings(sightings)
    else:
        table = pd.DataFrame(sightings)
        if isinstance(sightings, gpd.GeoDataFrame) and sightings.crs is not None:
            table = table.drop(columns=sightings.geometry.name)
        table.columns = table.columns.str.strip().str.lower()
        if isinstance(sightings, gpd.GeoDataFrame) and sightings.crs is not None:
            crs = sightings.crs
            places = sightings.geometry.to_crs(_WGS84)
            table = table.assign(lat=places.y.to_numpy(), lon=places.x.to_numpy())
        texts = table.astype(object).where(table.notna(), "").astype(str)
        table = checked_sightings(texts, "sightings")
    poles = triangulate_geographic(table, settings)
    points = gpd.points_from_xy(poles["lon"], poles["lat"], crs=_WGS84)
    return gpd.GeoDataFrame(poles, geometry=points).to_crs(crs)
