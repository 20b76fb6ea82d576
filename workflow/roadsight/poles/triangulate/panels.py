"""What speaks against panels of signs: their heights, and what the cloud shows in their place."""

from __future__ import annotations

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from roadsight.base.arrays import Bools, Floats, Ints
from roadsight.poles.images.kinds import KINDS

STANDING = "stands on the ground as no panel does"
"""Reason of what is withheld so."""
_STANDS_BELOW_M = 0.7
"""Height of a lower edge over the ground below which a thing stands on it. On a generated road
signs have 0.9 m or more, and parked cars that a network takes for signs 0 to 0.67."""
UNEVEN = "its edges are not at one height in as many images as a panel needs"
"""Reason of what is withheld so."""
_ONE_HEIGHT_M = 0.3
"""Edges of one panel are this near to its usual ones: three pixels of the sample's front view at
60 m."""
LOW = "its upper edge is lower than a sign's"
"""Reason of what is withheld so."""
_TOP_M = 1.5
"""Height over the ground of the lowest upper edge: signs hang 1.5 m high and more beside rural
roads, object markers, 0.3 m high, at 1.2 m (MUTCD 2009, 2A.18 and 2C.63); letter boxes end below,
for their floor is at 1.04 to 1.14 m (USPS), and so do cars."""
FILLED = "the cloud shows something that fills its place"
"""Reason of panels that are withheld so."""
_PLACE_M = 1.0
"""What is this near to a panel's place tells whether something fills it: half a car's width."""
_FILLED_M = (0.4, 2.0)
"""Heights over the ground between which there is air below and beside a panel: above grass."""
_FILLED_SHARE = 0.6
"""Share of the columns of voxels around a place that hold something at these heights. At cars it is
0.9 and more (24 pulses/m2); a hedge beside a sign takes half of the disc at most."""
_FILLED_COLUMNS = 8
"""So many columns do so: a post and its panel are five where nothing else was scanned. Of voxels
above 0.6 m the disc has fewer: they are too coarse to tell, and withhold nothing."""
_COLUMN_M = 0.3048
"""Width of a column, of which finer voxels are parts: of voxels of 0.05 m a panel alone fills 8."""


def panel_edges(
    poles: pd.DataFrame, pole_of: Ints, sightings: pd.DataFrame, ground_m: Floats
) -> pd.DataFrame:
    """Heights over the ground at which sightings of panels show their edges, each at its place.

    Parameters
    ----------
    pole_of : (n,) row in ``poles`` of each sighting, -1 for none. sightings : x, y and z of the
    camera, ``lower_edge_rise`` and ``upper_edge_rise`` of what it saw, m per m of plan. ground_m :
    (p,) at the poles, NaN where it is unknown.

    Returns
    -------
    row in ``poles``, lower_m and upper_m; a row for each sighting of a panel whose ground is known
    """
    own = np.flatnonzero(pole_of >= 0)
    row = pole_of[own]
    x, y, z, *rises = (
        sightings[["x", "y", "z", "lower_edge_rise", "upper_edge_rise"]].to_numpy(np.float64)[own].T
    )
    at_m = poles[["x", "y"]].to_numpy(np.float64)[row]
    away_m = np.hypot(at_m[:, 0] - x, at_m[:, 1] - y)
    lower_m, upper_m = (z + rise * away_m - ground_m[row] for rise in rises)
    edges = pd.DataFrame({"row": row, "lower_m": lower_m, "upper_m": upper_m})
    return edges[_panels(poles)[row]].dropna()


def withhold_by_height(poles: pd.DataFrame, edges: pd.DataFrame, min_views: int) -> pd.DataFrame:
    """Panels withheld that stand on the ground, end below a sign, or have no one height.

    Vehicles, boxes and walls stand on it, letter boxes are low. Rays to several things that meet
    by chance show them at several heights there; the place of a panel does not depend on heights,
    so that they are a test of it.

    Parameters
    ----------
    edges : see `panel_edges`. min_views : images that must agree about both edges, and more than
    half of them.
    """
    by_row = edges.groupby("row")[["lower_m", "upper_m"]]
    usual = by_row.median().reindex(range(len(poles)))
    off_m = (edges[["lower_m", "upper_m"]] - by_row.transform("median")).abs().max(axis=1)
    agree = (off_m <= _ONE_HEIGHT_M).groupby(edges["row"]).agg(["sum", "mean"])
    agree = agree.reindex(range(len(poles)))
    uneven = (agree["sum"] < min_views) | (agree["mean"] <= 0.5)
    for against, reason in (
        (usual["lower_m"] < _STANDS_BELOW_M, STANDING),
        (usual["upper_m"] < _TOP_M, LOW),
        (uneven, UNEVEN),
    ):
        poles = _withheld(poles, against.to_numpy(bool), reason)
    return poles


def are_filled(places_m: Floats, ground_m: Floats, voxels_m: Floats) -> Bools:
    """Whether something that is no panel on a post fills places (n,): a vehicle, a box.

    Parameters
    ----------
    places_m : (n, 2), local metres. ground_m : (n,) height of the ground there. voxels_m : (m, 3)
    middles of voxels of the ground and of what is firm; plants may stand around a sign.
    """
    around = cKDTree(voxels_m[:, :2]).query_ball_point(places_m, _PLACE_M)
    # A quarter keeps middles of whole, half and third columns off the borders, where they would
    # go by rounding.
    from_first = (voxels_m[:, :2] - voxels_m[:, :2].min(axis=0)) / _COLUMN_M
    column = np.floor(from_first + 0.25)
    filled = np.zeros(len(places_m), bool)
    for number, rows in enumerate(around):
        height = voxels_m[rows, 2] - ground_m[number]
        low = height < _FILLED_M[1]
        within = low & (height > _FILLED_M[0])
        shown, full = (len(np.unique(column[rows][part], axis=0)) for part in (low, within))
        filled[number] = full >= max(_FILLED_COLUMNS, _FILLED_SHARE * shown)
    return filled


def withhold_filled(poles: pd.DataFrame, filled: Bools) -> pd.DataFrame:
    """Panels withheld whose places something else fills, see `are_filled`."""
    return _withheld(poles, filled, FILLED)


def _panels(poles: pd.DataFrame) -> NDArray[np.bool_]:
    return np.array([KINDS[kind].shape == "panel" for kind in poles["kind"]], bool)


def _withheld(poles: pd.DataFrame, against: Bools, reason: str) -> pd.DataFrame:
    """Poles with the panels withheld that something speaks against."""
    other = _panels(poles) & against & poles["kept"].to_numpy(bool)
    return poles.assign(
        kept=poles["kept"] & ~other,
        reason=np.where(other, reason, poles["reason"]).astype(object),
    )
