"""Lane markings of an image on the ground."""

from __future__ import annotations

import numpy as np

from roadsight.base.arrays import Bytes, Floats
from roadsight.poles.images.classes import PixelClass
from roadsight.poles.images.lanes import centre_lines
from roadsight.poles.sightings.metric_depth import HeightAt, ground_distance_m
from roadsight.poles.sightings.sighting_bearing import ViewCamera

FARTHEST_M = 40.0
"""Farther markings are not used: with 0.1 degrees of heading they are 7 cm off. Narrow lenses (20
degrees) see no road nearer than 17 m."""
_THINNED_M = 0.2
"""One point of an image a cell of this width: more tell the same."""


def markings_on_ground(
    camera: ViewCamera, mask: Bytes, height_at: HeightAt, min_marking_px: float
) -> Floats:
    """Middles of the markings that a view shows, (n, 2) local metres, thinned.

    Parameters
    ----------
    mask : project classes (rows, columns). min_marking_px : see `centre_lines`.
    """
    uv = centre_lines(mask == PixelClass.MARKING, min_marking_px)
    if not len(uv):
        return np.empty((0, 2))
    rays = camera.rays(uv)
    position = np.asarray(camera.position_m, np.float64)
    away = ground_distance_m(position, rays, height_at, farthest_m=FARTHEST_M)
    met = np.isfinite(away)
    way = rays[met, :2] / np.hypot(rays[met, 0], rays[met, 1])[:, None]
    places = position[:2] + way * away[met, None]
    _, first = np.unique(np.floor(places / _THINNED_M), axis=0, return_index=True)
    return np.asarray(places[np.sort(first)], np.float64)
