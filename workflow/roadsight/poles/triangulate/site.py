"""Poles of a whole site: each kind by itself, with what a person decided, shapes, probabilities.

Height, lean, arms and crown are the cloud's; probabilities are calibrated on generated roads.
"""

from __future__ import annotations

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from scipy.special import expit, logit

from roadsight.base.arrays import Floats, Ints
from roadsight.poles.images.kinds import KINDS
from roadsight.poles.sightings.sighting_bearing import OWN_COLUMN, TURNED_COLUMNS
from roadsight.poles.sightings.trees import CROWN, NO_TRUNK, TRUNK
from roadsight.poles.triangulate.cloud_objects import joined
from roadsight.poles.triangulate.explain import triangulate
from roadsight.poles.triangulate.pole_doubts import FAR_SIGMA_M, far_reaching
from roadsight.poles.triangulate.rays import Rays, TriangulationSettings, make_rays

SIGHTING_COLUMNS = (
    "image", "route", "sequence", "kind", "x", "y", "bearing_grid_deg", "depth_m",
    "sigma_bearing_deg", "sigma_depth_m", "kept",
)  # fmt: skip
# Columns of the errors that near images share, and of a ray's own, by their name in `Rays`.
SHARED_COLUMNS = {
    "drift_m": ("drift_east_m", "drift_north_m"),
    "aside_m": ("aside_east_m", "aside_north_m"),
    "turned_deg": TURNED_COLUMNS,
    "own_deg": (OWN_COLUMN,),
}
POLE_COLUMNS = (
    "id", "kind", "x", "y", "z", "latitude", "longitude", "score", "sigma_major_m", "sigma_minor_m",
    "sigma_azimuth_deg", "condition", "evidence", "images", "routes", "kept", "reason",
)  # fmt: skip
# Log evidence that a panel needs beyond what a pole needs: its distance is known to half of it, so
# that rays to walls meet as well. With a pole's 3, signs of two generated roads have 8.4 to 32,
# other things 4.2, 6.6 and (a parked car) 37; signs of two roads with which it was not chosen 8.3
# to 49.
_PANEL_EVIDENCE = 4.0
_ERRORS = ("sigma_major_m", "sigma_minor_m", "sigma_azimuth_deg", "condition", "evidence")


def site_poles(
    sightings: pd.DataFrame, settings: TriangulationSettings
) -> tuple[pd.DataFrame, Ints, dict[str, float]]:
    """Poles of all kinds.

    Parameters
    ----------
    sightings : columns `SIGHTING_COLUMNS`, local metres; those not kept are left out. Optionally
        ``anchored``: whether a sighting ends at something of the cloud (kinds of which few do take
        far sightings too, `far_reaching`); `SHARED_COLUMNS`.

    Returns
    -------
    poles : as `POLE_COLUMNS` without z, latitude and longitude; images and routes are parted by
        semicolons; ids number the poles of a kind from west to east.
    pole of each sighting : row in ``poles``, -1 for none; shape (n,).
    scale by kind : what depths were multiplied by.
    """
    pole_of = np.full(len(sightings), -1, np.int64)
    types: dict[str, type] = {"x": float, "y": float, "score": np.int64}
    types |= dict.fromkeys(_ERRORS, float) | {"kept": bool}
    types |= dict.fromkeys(("reason", "id", "kind"), object)
    empty = pd.DataFrame({name: pd.Series(dtype=kind) for name, kind in types.items()})
    tables, scales, before = [empty], {}, 0
    usable = sightings["kept"].to_numpy(bool)
    for kind in sorted(set(sightings["kind"][usable])):
        rows = np.flatnonzero(usable & (sightings["kind"] == kind).to_numpy())
        rays = _rays(sightings.iloc[rows])
        reaching = settings
        panel = kind in KINDS and KINDS[kind].shape == "panel"
        if "anchored" in sightings and settings.method != "sweep":
            # Few other things look like panels: groups of their far rays are mostly signs.
            most_m = settings.max_sigma_m if panel else FAR_SIGMA_M
            reaching = far_reaching(sightings.iloc[rows], settings, most_m)
            if panel:
                needed = settings.pole_evidence + _PANEL_EVIDENCE
                reaching = reaching.model_copy(update={"pole_evidence": needed})
        if panel and settings.method != "sweep":
            poles, own, scales[kind] = near_and_far(rays, reaching)
        else:
            poles, own, scales[kind] = triangulate(rays, reaching)
        pole_of[rows[rays.row[own >= 0]]] = own[own >= 0] + before
        before += len(poles)
        tables.append(poles.assign(kind=kind, id=[f"{kind}-{n:05d}" for n in range(len(poles))]))
    poles = pd.concat([table for table in tables if len(table)] or tables, ignore_index=True)
    # Names of the images and routes that show each pole.
    shown = sightings.loc[pole_of >= 0, ["image", "route"]].astype(str)
    named = shown.groupby(pole_of[pole_of >= 0]).agg(joined)
    named = named.reindex(range(len(poles)), fill_value="")
    poles = poles.assign(images=named["image"].to_numpy(), routes=named["route"].to_numpy())
    return poles, pole_of, scales


def near_and_far(rays: Rays, settings: TriangulationSettings) -> tuple[pd.DataFrame, Ints, float]:
    """Panels, as `triangulate` gives them: of near rays, and of all where near ones show none.

    A panel's size tells its distance to half of it, so that some that seem beyond the reach are
    within it. But most such rays end at other things, and so many strays would cost near panels
    their evidence. From west to east.
    """
    near = ~(rays.depth_m > settings.max_distance_m)
    poles, own_near, scale = triangulate(rays.take(near), settings)
    own = np.full(len(rays), -1, np.int64)
    own[near] = own_near
    if near.all():
        return poles, own, scale
    more, own_all, _ = triangulate(rays, settings)
    known = np.isin(np.arange(len(more)), own_all[own >= 0])
    added = own_all >= 0
    added[added] = ~known[own_all[added]]
    own[added] = (np.cumsum(~known) - 1 + len(poles))[own_all[added]]
    found = pd.concat([table for table in (poles, more[~known]) if len(table)] or [poles])
    order = np.lexsort([found["y"], found["x"]])
    number = np.append(np.argsort(order), -1)
    return found.iloc[order].reset_index(drop=True), number[own], scale


def _rays(sightings: pd.DataFrame) -> Rays:
    names = ("depth_m", "sigma_bearing_deg", "sigma_depth_m", "image", "route", "sequence")
    columns: dict[str, NDArray] = {name: sightings[name].to_numpy() for name in names}
    places = sightings[["x", "y"]].to_numpy(np.float64)
    if "anchored" in sightings:
        columns["anchored"] = sightings["anchored"].to_numpy(bool)
    for name, parts in SHARED_COLUMNS.items():
        if set(parts) <= set(sightings):
            columns[name] = sightings[list(parts)].to_numpy(np.float64)
    return make_rays(places, sightings["bearing_grid_deg"].to_numpy(np.float64), **columns)


# A decision is on the nearest pole of its kind within this distance of where it was made: a pole
# that is computed again from other settings moves less, and two poles are seldom as near.
REACH_M = 2.0
# What each decision makes of a pole.
_WORDS = {"accept": "accepted", "reject": "rejected", "move": "moved"}
REJECTED = "rejected by a person"


def apply_decisions(poles: pd.DataFrame, decisions: pd.DataFrame) -> tuple[pd.DataFrame, Ints]:
    """Poles with a column decided: accepted, rejected, moved, or empty.

    An accepted or moved pole is kept, a rejected one is not. The error ellipse stays that of the
    computed place.

    Parameters
    ----------
    poles : x, y (local metres), kind, kept, reason. decisions : decision, kind, x, y, to_x, to_y.

    Returns
    -------
    poles, and the row of the pole that each decision is on; -1: there is none (any more).
    """
    table = poles.reset_index(drop=True).assign(decided="")
    found = nearest_poles(table, decisions)
    for row, decision in zip(found.tolist(), decisions.to_dict("records"), strict=True):
        if row < 0:
            continue
        rejected = decision["decision"] == "reject"
        table.loc[row, "decided"] = _WORDS[decision["decision"]]
        table.loc[row, "kept"] = not rejected
        table.loc[row, "reason"] = REJECTED if rejected else ""
        if decision["decision"] == "move":
            table.loc[row, ["x", "y"]] = [decision["to_x"], decision["to_y"]]
    return table, found


def nearest_poles(poles: pd.DataFrame, decisions: pd.DataFrame) -> Ints:
    """Row of the pole that each decision (n,) is on, -1 for none; the nearest pairs first.

    No pole has two decisions. Of pairs equally far apart, the earlier decision and pole come first.
    """
    found = np.full(len(decisions), -1)
    if not len(poles) or not len(decisions):
        return found
    place, at = (table[["x", "y"]].to_numpy(np.float64) for table in (decisions, poles))
    apart = np.linalg.norm(place[:, None] - at[None], axis=2)
    apart[decisions["kind"].to_numpy(str)[:, None] != poles["kind"].to_numpy(str)[None]] = np.inf
    order = np.argsort(apart, axis=None, kind="stable")
    taken: set[int] = set()
    for number, row in zip(*np.unravel_index(order, apart.shape), strict=True):
        if apart[number, row] > REACH_M:
            break
        if found[number] < 0 and int(row) not in taken:
            found[number] = row
            taken.add(int(row))
    return found


# Columns of poles; NaN where the cloud does not tell, and where the kind has no such thing. Heights
# by images are not among them: frames and wires cut poles, which were 2 to 5 m too low.
SHAPE_COLUMNS = (
    "height_m", "lean_deg", "sigma_lean_deg", "lean_azimuth_deg", "arm_m", "arm_sides",
    "crown_width_m",
)  # fmt: skip
# What the cloud shows of a pole (`cloud_shows`), where it does; of trees see `find_trunks`.
COLUMN = "column"
# A column of the cloud this near to a pole, and by twice the pole's own error, is the pole.
_SAME_M = 1.0
_FARTHEST_M = 3.0  # the same at most: columns may stand so near to each other


def with_shapes(poles: pd.DataFrame, columns: pd.DataFrame | None) -> pd.DataFrame:
    """Poles with `SHAPE_COLUMNS` and `cloud_shows`, from the cloud's columns at their places.

    Parameters
    ----------
    poles : kind, x, y, sigma_major_m, and what objects of the cloud have already, such as
        `cloud_shows` of trees.
    columns : x, y, top_m, open_top (1 where the cloud does not show how high it is) and shapes of
        the columns of the cloud, see `stem_shapes`; None where no one looked for them.
    """
    nothing = pd.Series(np.nan, index=poles.index)
    poles = poles.assign(**{name: poles.get(name, nothing) for name in SHAPE_COLUMNS})
    shows = poles.get("cloud_shows", pd.Series("", index=poles.index))
    poles["cloud_shows"] = shows.astype(object).fillna("").astype(str)
    rows = np.flatnonzero(poles["kind"] == "pole")
    if columns is None or columns.empty or not len(rows):
        return poles
    own = poles.iloc[rows]
    away, nearest = cKDTree(columns[["x", "y"]].to_numpy(np.float64)).query(
        own[["x", "y"]].to_numpy(np.float64)
    )
    limit = np.minimum(_SAME_M + 2.0 * own["sigma_major_m"].to_numpy(np.float64), _FARTHEST_M)
    same = away <= limit
    found = columns.iloc[nearest[same]].set_index(poles.index[rows[same]])
    found = found.assign(height_m=found["top_m"].where(found["open_top"] == 0))
    names = [name for name in SHAPE_COLUMNS if name != "crown_width_m"]
    poles.loc[found.index, names] = found[names]
    poles.loc[found.index, "cloud_shows"] = COLUMN
    return poles


# Log odds that the rays of a group show one thing, and not strays that meet: so much, and so much
# of the evidence. Views of one pole share errors, and of all groups that rays allow the best are
# taken, so that the evidence itself says too much. Fitted on 8,243 groups of 210 simulated drives
# with up to one stray an image, of which 94 % are real.
_ONE_THING = (-0.402, 0.585)
# Log odds that this thing is a pole: so much, of the logarithm of its error (m), of the logarithm
# of one more than its evidence. Trunks and posts that a network takes for poles are real things,
# seen less often and less alike. Fitted on 109 groups of one generated road (seed 1) in clouds of
# 2, 8 and 24 pulses a square metre, with the shipped network's masks; 20 are none. On three other
# roads (seeds 3, 5, 7) in such clouds, of 194 groups, of which 167 are real, the sum of the
# probabilities is 157.9.
_IS_A_POLE = (-5.64, -0.72, 2.34)
# Of a tree that images show. Of 270 on that road in these clouds, 266 stand within 3 m of a trunk;
# of 677 on the others, 671. How many images show it and how tall it is does not tell them apart.
_TREE = 0.98
# Times its odds where the cloud shows a trunk, or that there is none: shares of 56 trunks that
# people labelled in five real streets (no one of them contradicted, which counts as 1 of 58), over
# those of 277 places there without one. A crown alone has the odds times the share of the trees
# that have no more: the more trunks a cloud shows, the more does one tell that is not there.
_SHOWN = {TRUNK: 24 / 56 * 277 / 8, NO_TRUNK: 1 / 58 * 277 / 95}
# Of a panel that is kept: of 38 on two generated roads (seeds 3 and 5) in three clouds, 36 are
# within 3 m of a sign; one more of either is counted, for 38 are few. Of the 43 on two others
# (seeds 1 and 7) 41 are. What is wrong has evidence of 10.1 to 14.6, signs of 10.4 and more.
_PANEL = 37 / 40
# What tells a probability, in words: how often what looks so is real on generated roads.
CALIBRATED = "generated roads"
_DECIDED = "a person's decision"
# Why there is no probability, by the shape of a kind.
UNKNOWN = {
    "stem": "none: its evidence is unknown",
    "panel": "none: withheld, of which generated roads have few, or of unknown evidence",
    "crown": "none: no image shows it, or more show something else",
    "line": "none: generated roads have nothing that is taken for a guardrail",
    "block": "none: the cloud's class or planes tell it, and how often they err was not counted",
}


def real_probability(poles: pd.DataFrame) -> Floats:
    """Probability (n,) that an object is real and of its kind; NaN where nothing tells.

    What a person decided is certain.

    Parameters
    ----------
    poles : kind, evidence (see `triangulate`), sigma_major_m, score (views), kept, decided,
    cloud_shows (of trees, see `find_trunks`).
    """
    evidence = poles["evidence"].to_numpy(np.float64)
    sigma_m = poles["sigma_major_m"].to_numpy(np.float64)
    first, by_error, by_evidence = _IS_A_POLE
    with np.errstate(invalid="ignore", divide="ignore"):
        told = by_error * np.log(sigma_m) + by_evidence * np.log1p(np.maximum(evidence, 0.0))
    shape = _shapes(poles)
    found = one_thing_probability(evidence) * expit(first + told)
    found = np.where(shape == "stem", found, np.nan)
    found = np.where((shape == "panel") & poles["kept"] & np.isfinite(evidence), _PANEL, found)
    tree = (poles["kind"] == "tree") & (poles["score"] > 0) & poles["kept"]
    shows = poles["cloud_shows"].where(tree, "")
    count = shows.value_counts()
    # Nothing is known of a cloud before its first tree.
    trunks = count.get(TRUNK, 0) / (count.get(TRUNK, 0) + count.get(CROWN, 0) + 1)
    times = shows.map({**_SHOWN, CROWN: 1.0 - trunks}).fillna(1.0).to_numpy(np.float64)
    found = np.where(tree, expit(logit(_TREE) + np.log(times)), found)
    certain = poles["decided"].map({"accepted": 1.0, "moved": 1.0, "rejected": 0.0})
    return np.asarray(certain.fillna(pd.Series(found, index=poles.index)), np.float64)


def one_thing_probability(evidence: Floats) -> Floats:
    """Probability (n,) that the rays of a group show one thing, not strays that meet."""
    return np.asarray(expit(_ONE_THING[0] + _ONE_THING[1] * evidence), np.float64)


def probability_source(poles: pd.DataFrame, probability: Floats) -> NDArray[np.object_]:
    """What tells each probability (n,), or why there is none.

    Parameters
    ----------
    poles : kind, decided. probability : as `real_probability` gives it.
    """
    why = np.array([UNKNOWN[shape] for shape in _shapes(poles)], object)
    found = np.where(np.isnan(probability), why, CALIBRATED)
    return np.where(poles["decided"] != "", _DECIDED, found).astype(object)


def _shapes(poles: pd.DataFrame) -> NDArray[np.str_]:
    return np.array([KINDS[kind].shape for kind in poles["kind"]], str)
