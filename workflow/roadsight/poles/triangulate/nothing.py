"""Why a table of sightings gives no pole."""

from __future__ import annotations

import numpy as np
import pandas as pd

from roadsight.poles.triangulate.earth import neighbourhoods
from roadsight.poles.triangulate.geographic import triangulate_geographic
from roadsight.poles.triangulate.rays import FURTHEST_CAMERAS, TriangulationSettings


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
