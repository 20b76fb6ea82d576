"""Poles from rays with their errors, and those that are withheld."""

from __future__ import annotations

import numpy as np
import pandas as pd
from scipy.optimize import Bounds, LinearConstraint, milp
from scipy.sparse import block_array, csr_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from roadsight.base.arrays import Bools, Floats, Ints
from roadsight.poles.images.kinds import KINDS
from roadsight.poles.triangulate.explain import depth_scale, explain_rays
from roadsight.poles.triangulate.merging import (
    build_groups,
    gains,
    locate_points,
    merge_groups,
    places_of,
    weighted_mean,
)
from roadsight.poles.triangulate.pole_doubts import UNDER_CROWN
from roadsight.poles.triangulate.published import swept_poles
from roadsight.poles.triangulate.rays import Rays, TriangulationSettings

POLE_COLUMNS = [
    "x",
    "y",
    "score",
    "sigma_major_m",
    "sigma_minor_m",
    "sigma_azimuth_deg",
    "condition",
    "kept",
    "reason",
]
# Around a place, what the cloud shows this near to it tells whether a crown is over it.
_CROWN_M = 1.5
_OWN_M = 0.4  # what is this near to a place is the pole's own
# What is this high above the ground belongs to a crown, a roof or a wire, not to grass or cars.
_CROWN_FROM_M = 2.0
# Share of the occupied voxels around a place that are so high, from which a crown is over it. On
# two generated roads with 8 and 24 pulses/m2, wires and own returns make it up to 0.33 at poles; at
# trunks that a network took for poles it is 0.79 to 0.91.
_CROWN_SHARE = 0.5


def triangulate(rays: Rays, settings: TriangulationSettings) -> tuple[pd.DataFrame, Ints, float]:
    """Poles with their errors.

    Parameters
    ----------
    settings : their method is ``listing``: all groups, by their misfit alone, slower and less sure;
        ``sweep``: the pole study's, which states no errors (NaN) and withholds nothing; else groups
        by the evidence for them.

    Returns
    -------
    poles : one row each, columns `POLE_COLUMNS` and ``evidence`` (log odds that its rays show a
        pole and not strays, NaN where listed), local metres; ``score`` is the number of views,
        ``condition`` the ratio of the error ellipse's variances; poles too weak to use have
        ``kept`` False and a reason.
    pole of each ray : row in ``poles``, -1 for none; shape (n,).
    scale : what depths were multiplied by; 1 if not calibrated.
    """
    if settings.method == "sweep":
        labels, places = swept_poles(rays, settings)
        order = np.lexsort((places[:, 1], places[:, 0]))
        number = np.append(np.argsort(order), -1)
        unknown = dict.fromkeys(POLE_COLUMNS[3:-2], np.nan)
        views = np.bincount(labels[labels >= 0], minlength=len(places))
        poles = pd.DataFrame({"x": places[:, 0], "y": places[:, 1], "score": views}).iloc[order]
        poles = poles.reset_index(drop=True).assign(**unknown, kept=True, reason="")
        poles = poles.assign(evidence=np.nan).astype({"kept": bool, "reason": object})
        return poles, number[labels], 1.0
    if settings.method == "listing":
        groups, places, covariances, scale = choose_listed(rays, settings)
        evidence = np.full(len(groups), np.nan)
    else:
        found = explain_rays(rays, settings)
        groups, scale = found.groups, found.scale
        places, covariances = found.place_m, found.covariance
        evidence = found.gain + settings.pole_evidence
    pole = np.full(len(rays), -1, np.int64)
    for number, members in enumerate(groups):
        pole[members] = number
    poles = describe_groups(groups, places, covariances, settings)
    return poles.assign(evidence=evidence), pole, scale


def error_ellipse(covariance: Floats) -> tuple[Floats, Floats, Floats]:
    """Semi-axes of the 1-sigma ellipse and the bearing of the longer one.

    Parameters
    ----------
    covariance : of x and y, m2, shape (n, 2, 2).

    Returns
    -------
    longer and shorter semi-axis, m; bearing clockwise from grid north, degrees in [0, 180)
    """
    variances, axes = np.linalg.eigh(covariance)
    minor, major = np.sqrt(np.maximum(variances, 0.0)).T
    azimuth = np.degrees(np.arctan2(axes[:, 0, 1], axes[:, 1, 1])) % 180.0
    return major, minor, np.where(azimuth >= 180.0, 0.0, azimuth)


def describe_groups(
    groups: list[Ints], places: Floats, covariances: Floats, settings: TriangulationSettings
) -> pd.DataFrame:
    """Poles of groups of rays with their errors; columns `POLE_COLUMNS`.

    Parameters
    ----------
    places : (g, 2), metres. covariances : (g, 2, 2), m2.
    """
    major, minor, azimuth = error_ellipse(covariances)
    weak = major > settings.max_sigma_m
    columns = [
        *places.T,
        np.array([len(members) for members in groups], np.int64),
        major,
        minor,
        azimuth,
        (major / minor) ** 2,
        ~weak,
        np.where(weak, f"error ellipse longer than {settings.max_sigma_m:g} m", "").astype(object),
    ]
    return pd.DataFrame(dict(zip(POLE_COLUMNS, columns, strict=True)))


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
    thin = poles["score"].to_numpy() < min_views
    thin = thin & ~_in_cloud(poles, pole_of, in_cloud) & poles["kept"].to_numpy(bool)
    reason = f"seen in fewer than {min_views} images and not in the cloud"
    return poles.assign(
        kept=poles["kept"] & ~thin, reason=np.where(thin, reason, poles["reason"]).astype(object)
    )


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
    under = (share_above >= _CROWN_SHARE) & stem & ~confirmed & poles["kept"].to_numpy(bool)
    reason = np.where(under, UNDER_CROWN, poles["reason"]).astype(object)
    return poles.assign(kept=poles["kept"] & ~under, reason=reason)


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
    near = (gap_m <= distance_m) & poles["kept"].to_numpy(bool)
    limits_m = np.broadcast_to(distance_m, len(poles))
    reasons = [f"within {limit:.3g} m of a road, bridge or building" for limit in limits_m]
    return poles.assign(
        kept=poles["kept"] & ~near, reason=np.where(near, reasons, poles["reason"]).astype(object)
    )


# Poles as the best set of groups of rays: every group is listed, the choice is exact.
#
# The number of groups grows with the views of a pole and with how densely poles stand, so that
# 400 sightings take seconds; `explain` has replaced it. It is kept to compare with, as
# ``listing``.

_ROUNDS = 10  # rounds of grouping and scaling at most, should the factor go to and fro
_SETTLED = 0.01  # the factor is found when it changes by less than this share


def choose_listed(
    rays: Rays, settings: TriangulationSettings
) -> tuple[list[Ints], Floats, Floats, float]:
    """Groups from west to east, their places (g, 2), covariances (g, 2, 2), and depth scale."""
    # The factor of the depths is found by turns of grouping and scaling.
    scale = 1.0
    for _ in range(_ROUNDS if settings.calibrate_depth else 0):
        latest = depth_scale(rays, group_rays(rays.scaled(scale), settings), 1.0)
        settled = abs(latest / scale - 1) < _SETTLED
        scale = latest
        if settled:
            break
    scaled = rays.scaled(scale)
    groups = group_rays(scaled, settings)
    return groups, *places_of(locate_points(scaled, settings), groups), scale


def group_rays(rays: Rays, settings: TriangulationSettings) -> list[Ints]:
    """Ray numbers of each pole, poles from west to east and south to north."""
    levels = build_groups(rays, settings)
    members = [row for level in levels for row in level.members]
    if not members:
        return []
    gain = np.concatenate([gains(level, settings) for level in levels])
    chosen = [members[number] for number in choose_groups(members, gain, len(rays))]
    points = locate_points(rays, settings)
    merged = merge_groups(rays, points, chosen, settings)
    return sorted(merged, key=lambda group: tuple(weighted_mean(points, group)[0]))


# Which groups of rays are poles: the most valuable set in which every ray is used at most once.
#
# Maximise sum of gains, subject to every ray in at most one chosen group: weighted set packing,
# solved by HiGHS, one connected part of the route at a time. A part that needs more branch and
# bound nodes than allowed keeps the best found: a count, not a time, so that every machine
# answers alike.

_LARGEST = 20_000  # groups of a connected part up to which it is solved exactly
# Nodes of branch and bound for a part; more come nearer to the best choice, and take longer.
_NODES = 1000


def choose_groups(members: list[Ints], gain: Floats, rays: int, largest: int = _LARGEST) -> Ints:
    """Numbers of the chosen groups, ascending.

    Parameters
    ----------
    members : ray numbers of each group. gain : of each group; groups without gain are left out.
    rays : number of rays.
    largest : connected parts with more groups than this are solved greedily, best gain first, so
        that time stays bounded whatever the input.
    """
    useful = np.flatnonzero(gain > 0)
    if len(useful) == 0:
        return useful
    table = _incidence([members[group] for group in useful], rays)
    # Rays and groups as one graph: group by group it would be quadratic.
    _, part = connected_components(block_array([[None, table], [table.T, None]]), directed=False)
    part = part[rays:]
    order = np.argsort(part, kind="stable")
    chosen = []
    for block in np.split(order, np.flatnonzero(np.diff(part[order])) + 1):
        own = [members[group] for group in useful[block]]
        known, row = np.unique(np.concatenate(own), return_inverse=True)
        cuts = np.cumsum([len(rows) for rows in own])[:-1]
        few = _incidence(np.split(row, cuts), len(known))
        solve = _exact if len(block) <= largest else _greedy
        chosen.append(block[solve(few, gain[useful[block]])])
    return np.sort(useful[np.concatenate(chosen)])


def _incidence(members: list[Ints], rays: int) -> csr_array:
    """Rays by groups."""
    group = np.repeat(np.arange(len(members)), [len(rows) for rows in members])
    ones = np.ones(len(group))
    return csr_array((ones, (np.concatenate(members), group)), shape=(rays, len(members)))


def _exact(table: csr_array, gain: Floats) -> Bools:
    if len(gain) == 1:
        return np.ones(1, bool)
    used = table[np.flatnonzero(table.sum(axis=1) > 1)]
    result = milp(
        -gain,
        integrality=np.ones(len(gain)),
        bounds=Bounds(0, 1),
        constraints=LinearConstraint(used, -np.inf, 1),
        options={"mip_rel_gap": 0.0, "node_limit": _NODES},
    )
    return _greedy(table, gain) if result.x is None else result.x > 0.5


def _greedy(table: csr_array, gain: Floats) -> Bools:
    columns = table.tocsc()
    free = np.ones(table.shape[0], bool)
    chosen = np.zeros(len(gain), bool)
    for group in np.argsort(-gain, kind="stable"):
        rows = columns.indices[columns.indptr[group] : columns.indptr[group + 1]]
        if free[rows].all():
            free[rows] = False
            chosen[group] = True
    return chosen
