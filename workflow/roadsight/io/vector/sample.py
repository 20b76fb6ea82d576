"""Lines digitised in the cloud's own CRS, as a user's GIS writes them."""

from __future__ import annotations

import os

import geopandas as gpd
import numpy as np
import shapely

from roadsight.geometry.frames import Frame
from roadsight.io.records.atomic import write_json

_DECIMALS = 3
"""Of written coordinates in the cloud's unit, a millimetre in metres."""


def write_native_lines(
    path: str | os.PathLike[str], lines: gpd.GeoDataFrame, frame: Frame, epsg: int
) -> None:
    """Write lines as GeoJSON of the 2008 kind: native coordinates and a ``crs`` member.

    The same lines give the same bytes.

    Parameters
    ----------
    lines : LineStrings in local metres with their properties.
    epsg : code of the native CRS, whose unit is the metre.
    """
    features = []
    for row in lines.itertuples(index=False):
        properties = row._asdict()
        vertices = frame.to_native(shapely.get_coordinates(properties.pop("geometry")))
        geometry = {"type": "LineString", "coordinates": np.round(vertices, _DECIMALS).tolist()}
        features.append({"type": "Feature", "properties": properties, "geometry": geometry})
    crs = {"type": "name", "properties": {"name": f"urn:ogc:def:crs:EPSG::{epsg}"}}
    write_json(path, {"type": "FeatureCollection", "crs": crs, "features": features})
