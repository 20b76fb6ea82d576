"""Which roadside the front view of a drive leaves out."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from roadsight.base.arrays import Ints
from roadsight.geometry.cameras import wrap_deg


def views_of_places(
    places_m: ArrayLike,
    cameras_m: ArrayLike,
    heading_deg: ArrayLike,
    half_angle_deg: float,
    reach_m: float,
) -> Ints:
    """How many cameras have each place (n, 2) within reach and within an angle of their heading.

    Parameters
    ----------
    cameras_m : (k, 2), heading_deg : (k,) clockwise from grid north.
    """
    places = np.asarray(places_m, np.float64).reshape(-1, 2)
    count = np.zeros(len(places), np.int64)
    headings = np.asarray(heading_deg, np.float64)
    for camera, heading in zip(np.asarray(cameras_m, np.float64), headings, strict=True):
        east, north = (places - camera).T
        turn = wrap_deg(np.degrees(np.arctan2(east, north)) - heading)
        away_m = np.hypot(east, north)
        count += (away_m <= reach_m) & (away_m > 0) & (np.abs(turn) <= half_angle_deg)
    return count


def left_out_share(
    places_m: ArrayLike,
    cameras_m: ArrayLike,
    heading_deg: ArrayLike,
    hfov_deg: float,
    reach_m: float,
    views: int,
) -> float:
    """Share of the places beside a drive that its front view shows in too few images.

    A place ``o`` metres aside enters the frame at ``o / tan(hfov / 2)``: nearer images show it no
    more, farther ones than ``reach_m`` are too far to measure it.

    Parameters
    ----------
    places_m : (n, 2) where poles may stand; those that no direction of view could show in
        ``views`` images within ``reach_m`` do not count. views : images that a pole needs.

    Returns
    -------
    share between 0 and 1; NaN where no place counts
    """
    anyhow = views_of_places(places_m, cameras_m, heading_deg, 90.0, reach_m) >= views
    if not anyhow.any():
        return float("nan")
    seen = views_of_places(places_m, cameras_m, heading_deg, 0.5 * hfov_deg, reach_m)
    return float((seen[anyhow] < views).mean())
