"""Poles that are withheld, and what the others rest on beside the errors that are stated of each.

What is withheld stays in the table, with the first reason that speaks against it: seen too seldom,
under a crown, beside a structure, no panel by its height.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from roadsight.base.arrays import Bools, Floats, Ints
from roadsight.base.doubts import Doubt, Severity
from roadsight.poles.images.kinds import KINDS
from roadsight.poles.sightings.metric_depth import NetworkScale
from roadsight.poles.triangulate.rays import TriangulationSettings


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


# Share of sightings that end at a column of the cloud below which it shows no poles. With columns
# it is half or more.
LEAST_ANCHORED = 0.1
# The same share below which far sightings count and stated errors are doubted. On the generated
# rural road 0.51 to 0.59 of the sightings end at a column at 24 pulses/m2; at 8 it is 0.25, at 2
# 0.04, where the ellipses for 95 % hold 91 % of the poles of twelve roads, and 63 and 71 % on two
# of which one drive each is off by three and more of its sigmas.
FEW_ANCHORED = 0.4
# Where a cloud has no returns on poles, far sightings are all there is of some: on the generated
# rural road 28 of 30 poles are found with this and 24 with 40 m, and without side views, as a
# camera of 20 degrees sees a pole from no nearer than 30 m, 22 and 4. Where it has, far rays add
# groups of other things: 6 beside 31.
FAR_M = 60.0
# Longest error ellipse of a pole that may rest on far rays: on that road at 8 pulses/m2, once what
# stands under crowns is left out, 28 of 30 poles and nothing else stay with this, 27 with 0.75 m,
# 28 and 2 other things with the usual 5 m.
FAR_SIGMA_M = 1.0
# Reason why a sighting is left out: a side view at a guessed yaw gives bearings that are off by as
# much as the guess is.
UNTURNED = "yaw of the side view not found"
_LARGE = 0.2  # logarithm of a network's scale from which it is a doubt: a fifth of the distance


def anchored_share(sightings: pd.DataFrame) -> float:
    """Share of the kept sightings that end at something of the cloud; 1 without any.

    Parameters
    ----------
    sightings : columns kept and anchored.
    """
    kept = sightings["kept"].to_numpy(bool)
    return float(sightings["anchored"].to_numpy(bool)[kept].mean()) if kept.any() else 1.0


def far_reaching(
    sightings: pd.DataFrame, settings: TriangulationSettings, most_m: float = FAR_SIGMA_M
) -> TriangulationSettings:
    """Settings by which far sightings count too, where the cloud shows few poles.

    Their groups are more often of other things, so that a pole must be told more sharply, to
    ``most_m``.
    """
    if anchored_share(sightings) >= FEW_ANCHORED or settings.max_distance_m >= FAR_M:
        return settings
    sharp_m = min(settings.max_sigma_m, most_m)
    return settings.model_copy(update={"max_distance_m": FAR_M, "max_sigma_m": sharp_m})


def network_doubts(own: Sequence[str]) -> list[Doubt]:
    """Doubts where the project's ``own`` networks, of classes or depth, read photographs."""
    if not own:
        return []
    text = (
        "images are read by the project's own networks, which were trained on rendered roads and"
        " never saw a photograph (of pole pixels on photographs they overlap the true ones by"
        " 0.06): name networks that did in poles.masks and poles.depth (docs/poles/models.md)"
    )
    return [Doubt("networks_saw_no_photograph", "doubt", text, " and ".join(own), None)]


def crown_doubts(poles: pd.DataFrame) -> list[Doubt]:
    """Note on poles that were withheld as trunks, see `withhold_under_crowns`."""
    withheld = int((poles["reason"] == UNDER_CROWN).sum())
    if not withheld:
        return []
    text = (
        "stand under a crown and not clearly in the cloud, and are withheld as trunks; a lamp among"
        " branches would be one of them (poles.decisions accepts it): poles withheld so"
    )
    return [Doubt("under_crowns", "note", text, withheld)]


def pole_doubts(
    sightings: pd.DataFrame, network: Sequence[NetworkScale], settings: TriangulationSettings
) -> list[Doubt]:
    """Doubts about the poles of a site.

    Parameters
    ----------
    sightings : columns kept, kind, anchored, reason; the cloud is asked for poles alone.
    network : cameras whose network was scaled.
    settings : by which they are triangulated, see `far_reaching`.
    """
    found = []
    for one in network:
        text = (
            f"route {one.route}, {one.view} view: distances of the depth network over those of"
            f" {one.pairs} feet on the ground, by which they are divided"
        )
        severity: Severity = "doubt" if abs(np.log(one.ratio)) > _LARGE else "note"
        found.append(Doubt("network_scale", severity, text, round(one.ratio, 3)))
    # The published sweep takes nothing from the cloud and states no errors.
    evident = settings.method != "sweep"
    share = anchored_share(sightings[sightings["kind"] == "pole"]) if evident else 1.0
    if share < LEAST_ANCHORED:
        text = (
            "the cloud shows next to no poles, so that their places rest on rays alone (a denser"
            " survey places them better): share of sightings that end at one"
        )
        found.append(Doubt("poles_not_in_cloud", "doubt", text, round(share, 3), LEAST_ANCHORED))
    if share < FEW_ANCHORED:
        text = (
            "few poles show in the cloud, so that sightings up to"
            f" {settings.max_distance_m:g} m count, what is not known to {settings.max_sigma_m:g} m"
            " is withheld, and errors that a whole drive shares can be larger than"
            " stated (a denser survey mends that): share of sightings that end at a pole of it"
        )
        found.append(Doubt("sigmas_too_small", "doubt", text, round(share, 3), FEW_ANCHORED))
    lost = int((sightings["reason"] == UNTURNED).sum())
    if lost:
        text = (
            "nothing tells the yaw of side views (give sightings.left_yaw_deg, right_yaw_deg and"
            " side_views: given, if it is known): sightings left out"
        )
        found.append(Doubt("side_views_left_out", "doubt", text, lost, 0))
    return found
