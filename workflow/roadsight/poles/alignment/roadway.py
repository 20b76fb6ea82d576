"""Direction and tilt of the road under the vehicle, from the LiDAR's road edges around it.

Vehicles keep to their road within a degree, while the direction between two satellite positions
8 m apart may be wrong by several; and a camera tilts with the road.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from roadsight.base.arrays import Floats
from roadsight.geometry.cameras import wrap_deg
from roadsight.poles.alignment.roadside import RoadEdges

_TURN_DEG = 25.0
"""Edges that run at a greater angle to the track are of side roads and drives."""
_FEWEST = 12
"""With fewer edge points the track alone has to do."""
# As if height (m), grade, bank and bend of the grade (1/m) were known beforehand this well.
_TILT_SIGMA = np.array([0.5, 0.03, 0.04, 0.002])
_HEIGHT_SIGMA_M = 0.1
"""One standard deviation of an edge point's height."""


@dataclass(frozen=True)
class Roadway:
    """Direction and tilt of the road at one place.

    Heading in degrees from grid north, rise per metre ahead and to the right; turn to the right
    in radians per metre and change of the grade per metre. ``from_edges`` is false where too few
    edges lie around and the track alone had to do.
    """

    heading_deg: float
    grade: float
    bank: float
    bend: float
    hump: float
    from_edges: bool


def roadway_at(
    edges: RoadEdges,
    place_xyz_m: ArrayLike,
    heading_deg: float,
    grade: float,
    radius_m: float = 20.0,
) -> Roadway:
    """Road under a place.

    Parameters
    ----------
    place_xyz_m : on the road, local metres. heading_deg, grade : of the track there.
    radius_m : how far around edges are used.
    """
    place = np.asarray(place_xyz_m, np.float64)
    index = edges.near(place, radius_m)
    along = edges.along[index]
    turn = wrap_deg(np.degrees(np.arctan2(along[:, 0], along[:, 1])) - heading_deg)
    turn = (turn + 90.0) % 180.0 - 90.0  # Edges run either way.
    like = np.abs(turn) < _TURN_DEG
    if like.sum() < _FEWEST:
        return Roadway(heading_deg, grade, 0.0, 0.0, 0.0, False)
    offset, turn = edges.xyz_m[index[like]] - place, turn[like]
    right, heading = _aside(offset, heading_deg), heading_deg
    sides = [turn[right < 0], turn[right >= 0]]
    heading += float(np.mean([np.median(part) for part in sides if len(part)]))
    tilt = _tilt(offset, heading, grade)
    bank = tilt[2] if min(map(len, sides)) >= 3 else 0.0
    bend = _bend(offset, turn, heading_deg)
    return Roadway(heading % 360.0, tilt[1], bank, bend, 2.0 * tilt[3], True)


def _aside(offset: Floats, heading_deg: float) -> Floats:
    heading = np.radians(heading_deg)
    return offset[:, 0] * np.cos(heading) - offset[:, 1] * np.sin(heading)


def _bend(offset: Floats, turn_deg: Floats, heading_deg: float) -> float:
    """Turn per metre ahead; as if radii below some 30 m were unlikely, and noise of 2 degrees."""
    heading = np.radians(heading_deg)
    ahead = offset[:, 0] * np.sin(heading) + offset[:, 1] * np.cos(heading)
    ahead, turn = ahead - ahead.mean(), np.radians(turn_deg - turn_deg.mean())
    return float(ahead @ turn / (ahead @ ahead + 10.0 * (0.035 / 0.03) ** 2))


def _tilt(offset: Floats, heading_deg: float, grade: float) -> Floats:
    """Height, grade, bank and bend of the surface through the edges."""
    heading = np.radians(heading_deg)
    ahead = offset[:, 0] * np.sin(heading) + offset[:, 1] * np.cos(heading)
    right = _aside(offset, heading_deg)
    terms = np.column_stack([np.ones_like(ahead), ahead, right, ahead**2])
    # Neighbours err alike: about one in ten tells something new.
    weight = 0.1 / _HEIGHT_SIGMA_M**2
    known = np.diag(1.0 / _TILT_SIGMA**2)
    expected = np.array([0.0, grade, 0.0, 0.0])
    return np.linalg.solve(
        weight * terms.T @ terms + known, weight * terms.T @ offset[:, 2] + known @ expected
    )
