"""Poles that are withheld: seen too seldom, under crowns, beside structures, no panels by height.

What is withheld stays in the table, with the first reason that speaks against it.
"""

from __future__ import annotations

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from roadsight.base.arrays import Bools, Floats, Ints
from roadsight.poles.images.kinds import KINDS


def withhold_thin(
    poles: pd.DataFrame, pole_of: Ints, in_cloud: Bools, min_views: int
) -> pd.DataFrame:
    """Poles with those withheld that too few images show and the cloud does not confirm.

    Two rays cross by chance far more often than three; a trunk or a post that one image takes for
    a pole is rarely taken for one again from elsewhere.

    Parameters
    ----------
    pole_of : (n,) row in ``poles`` of each sighting, -1 for none.
    in_cloud : (n,) whether a pole-like column of the cloud stands where the sighting points.
    min_views : how many views a pole needs that no sighting of it finds in the cloud.
    """
    thin = (poles["score"].to_numpy() < min_views) & ~_in_cloud(poles, pole_of, in_cloud)
    reason = f"seen in fewer than {min_views} images and not in the cloud"
    return _withheld(poles, thin, reason)


UNDER_CROWN = "under a crown, and not clearly in the cloud"
# Around a place, what the cloud shows this near to it tells whether a crown is over it.
_CROWN_M = 1.5
_OWN_M = 0.4  # what is this near to a place is the pole's own
# What is this high above the ground belongs to a crown, a roof or a wire, not to grass or cars.
_CROWN_FROM_M = 2.0
# Share of the occupied voxels around a place that are so high, from which a crown is over it. On
# two generated roads with 8 and 24 pulses/m2, wires and own returns make it up to 0.33 at poles; at
# trunks that a network took for poles it is 0.79 to 0.91.
_CROWN_SHARE = 0.5


def shares_above(places_m: Floats, ground_m: Floats, voxels_m: Floats) -> Floats:
    """Share (n,) of the occupied voxels beside places that are higher than grass and cars.

    0 where the cloud shows nothing or the ground is unknown.

    Parameters
    ----------
    places_m : (n, 2), local metres. ground_m : (n,) height of the ground there. voxels_m : (m, 3)
    middles of voxels.
    """
    around = cKDTree(voxels_m[:, :2]).query_ball_point(places_m, _CROWN_M)
    shares = np.zeros(len(places_m))
    for number, (place_m, rows) in enumerate(zip(places_m, around, strict=True)):
        beside = voxels_m[rows]
        beside = beside[np.hypot(*(beside[:, :2] - place_m).T) > _OWN_M]
        if len(beside):
            shares[number] = np.mean(beside[:, 2] - ground_m[number] > _CROWN_FROM_M)
    return shares


def withhold_under_crowns(
    poles: pd.DataFrame, pole_of: Ints, in_cloud: Bools, min_views: int, share_above: Floats
) -> pd.DataFrame:
    """Poles with those withheld that stand under a crown, unless cloud and images both show them.

    A trunk that a network takes for a pole is a real thing, seen from everywhere: its rays meet as
    a pole's do. But its crown is over it, and a line's poles are kept clear of crowns.

    Parameters
    ----------
    pole_of, in_cloud : as `withhold_thin`. min_views : how many views a pole needs that a sighting
        finds in the cloud, where crowns are columns too. share_above : (n,), see `shares_above`.
    """
    confirmed = _in_cloud(poles, pole_of, in_cloud) & (poles["score"].to_numpy() >= min_views)
    stem = np.array([KINDS[kind].shape == "stem" for kind in poles["kind"]], bool)
    return _withheld(poles, (share_above >= _CROWN_SHARE) & stem & ~confirmed, UNDER_CROWN)


def _in_cloud(poles: pd.DataFrame, pole_of: Ints, in_cloud: Bools) -> Bools:
    """Whether a sighting of each pole ends at a column of the cloud."""
    return np.bincount(pole_of[(pole_of >= 0) & in_cloud], minlength=len(poles)) > 0


def drop_near_structures(
    poles: pd.DataFrame, structures: cKDTree | None, distance_m: float | Floats = 1.524
) -> pd.DataFrame:
    """Poles with those near a road, bridge or building point withheld.

    Parameters
    ----------
    structures : tree of such points, (n, 2) local metres; None switches the filter off.
    distance_m : of all or of each (n,), 5 ft by default; a pole exactly that far is withheld.
    """
    if structures is None or structures.n == 0 or len(poles) == 0:
        return poles
    gap_m, _ = structures.query(poles[["x", "y"]].to_numpy(np.float64))
    limits_m = np.broadcast_to(distance_m, len(poles))
    reasons = [f"within {limit:.3g} m of a road, bridge or building" for limit in limits_m]
    return _withheld(poles, gap_m <= distance_m, reasons)


# What speaks against panels of signs: their heights, and what the cloud shows in their place.
STANDING = "stands on the ground as no panel does"
LOW = "its upper edge is lower than a sign's"
UNEVEN = "its edges are not at one height in as many images as a panel needs"
FILLED = "the cloud shows something that fills its place"
# Height of a lower edge over the ground below which a thing stands on it. On a generated road signs
# have 0.9 m or more, and parked cars that a network takes for signs 0 to 0.67.
_STANDS_BELOW_M = 0.7
# Edges of one panel are this near to its usual ones: three pixels of the sample's front view at 60
# m.
_ONE_HEIGHT_M = 0.3
# Height over the ground of the lowest upper edge: signs hang 1.5 m high and more beside rural
# roads, object markers, 0.3 m high, at 1.2 m (MUTCD 2009, 2A.18 and 2C.63); letter boxes end below,
# for their floor is at 1.04 to 1.14 m (USPS), and so do cars.
_TOP_M = 1.5
# What is this near to a panel's place tells whether something fills it: half a car's width.
_PLACE_M = 1.0
# Heights over the ground between which there is air below and beside a panel: above grass.
_FILLED_M = (0.4, 2.0)
# Share of the columns of voxels around a place that hold something at these heights. At cars it is
# 0.9 and more (24 pulses/m2); a hedge beside a sign takes half of the disc at most.
_FILLED_SHARE = 0.6
# So many columns do so: a post and its panel are five where nothing else was scanned. Of voxels
# above 0.6 m the disc has fewer: they are too coarse to tell, and withhold nothing.
_FILLED_COLUMNS = 8
# Width of a column, of which finer voxels are parts: of voxels of 0.05 m a panel alone fills 8.
_COLUMN_M = 0.3048


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
        poles = _withheld(poles, _panels(poles) & against.to_numpy(bool), reason)
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
    return _withheld(poles, _panels(poles) & filled, FILLED)


def _withheld(poles: pd.DataFrame, against: Bools, reason: str | list[str]) -> pd.DataFrame:
    """Poles without those that something speaks against; who is withheld keeps its reason."""
    lost = against & poles["kept"].to_numpy(bool)
    reasons = np.where(lost, reason, poles["reason"]).astype(object)
    return poles.assign(kept=poles["kept"] & ~lost, reason=reasons)


def _panels(poles: pd.DataFrame) -> NDArray[np.bool_]:
    return np.array([KINDS[kind].shape == "panel" for kind in poles["kind"]], bool)
