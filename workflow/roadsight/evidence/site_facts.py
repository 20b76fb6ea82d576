"""Facts of a placement site, those of the first study's Table 2."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import shapely
from scipy.spatial import cKDTree

from roadsight.base.arrays import Floats
from roadsight.base.errors import InputError
from roadsight.geometry.areas import inside
from roadsight.placement.sight.carriageways import lanes_abreast
from roadsight.placement.sight.lanes import trace_lanes
from roadsight.scene.profile import mean_spacing_m

REACH_M = 30.0
"""Points farther from the road's edges do not count: 20 m at the study's Site 1, else 30 m."""
_EVERY_M = 1.0
"""Spacing of the edge's points through which a circle is laid."""
_STRAIGHT_M = 10_000.0
"""Radii beyond are straight: over 250 m the middle of such an arc is 0.8 m off its chord."""


class SiteFacts(NamedTuple):
    """A row of Table 2.

    Parameters
    ----------
    points : of the cloud, on the road and up to `REACH_M` beside it.
    spacing_m : median distance of these to their nearest neighbours.
    length_m : of the longest edge. width_m : pavement over that length, all carriageways.
    lanes : abreast on the widest road, 0 where none fits. lane_width_m : as given.
    radius_m : of the circle that fits the longest edge best; infinite where it is straight.
    """

    points: int
    spacing_m: float
    length_m: float
    width_m: float
    lanes: int
    lane_width_m: float
    radius_m: float


def site_facts(
    xyz_m: Floats,
    edges: Sequence[shapely.LineString],
    pavement: shapely.MultiPolygon,
    lane_width_m: float,
    reach_m: float = REACH_M,
) -> SiteFacts:
    """Table 2 of a site, computed from its geometry (paper 1, section 3.1).

    Parameters
    ----------
    xyz_m : (n, 3) cloud. edges : of the road. All local metres.

    Raises
    ------
    InputError : there is no edge, or no point near one.
    """
    if not edges:
        raise InputError("has no road edge, along which a site is measured")
    longest = max(edges, key=lambda line: line.length)
    along = shapely.get_coordinates(shapely.segmentize(list(edges), _EVERY_M))
    # The nearest vertex is at most a centimetre farther than the edge, 20 m away.
    away_m, _ = cKDTree(along).query(xyz_m[:, :2], distance_upper_bound=reach_m)
    near = np.isfinite(away_m) | inside(pavement, xyz_m[:, 0], xyz_m[:, 1])
    if not near.any():
        raise InputError("no point of the cloud lies near the road's edges")
    lanes = trace_lanes(list(edges), pavement, lane_width_m)
    return SiteFacts(
        points=int(near.sum()),
        spacing_m=mean_spacing_m(xyz_m[near]),
        length_m=float(longest.length),
        width_m=float(pavement.area / longest.length),
        lanes=int(lanes_abreast(lanes).max()) if len(lanes) else 0,
        lane_width_m=lane_width_m,
        radius_m=radius_of(shapely.get_coordinates(shapely.segmentize(longest, _EVERY_M))),
    )


def radius_of(xy_m: Floats) -> float:
    """Radius of the circle through points (n, 2) by least squares (Kasa 1976); infinite: straight.

    A road that turns both ways has no one radius; the circle is that of its whole course.
    """
    if len(xy_m) < 3:
        return float("inf")
    offset = xy_m - xy_m.mean(axis=0)
    scale = max(float(np.abs(offset).max()), 1e-9)
    x, y = (offset / scale).T
    design = np.column_stack([2 * x, 2 * y, np.ones(len(x))])
    (a, b, c), _, rank, _ = np.linalg.lstsq(design, x * x + y * y, rcond=1e-10)
    radius_m = scale * float(np.sqrt(max(c + a * a + b * b, 0.0)))
    return radius_m if rank == 3 and radius_m <= _STRAIGHT_M else float("inf")
