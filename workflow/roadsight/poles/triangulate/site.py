"""Poles of a whole site: each kind of object by itself, rows named, with what a person decided."""

from __future__ import annotations

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from roadsight.base.arrays import Ints
from roadsight.poles.images.kinds import KINDS
from roadsight.poles.sightings.confirm import joined
from roadsight.poles.sightings.sighting_bearing import OWN_COLUMN, TURNED_COLUMNS
from roadsight.poles.triangulate.locate import triangulate
from roadsight.poles.triangulate.pole_doubts import FAR_SIGMA_M, far_reaching
from roadsight.poles.triangulate.rays import Rays, TriangulationSettings, make_rays

SIGHTING_COLUMNS = (
    "image",
    "route",
    "sequence",
    "kind",
    "x",
    "y",
    "bearing_grid_deg",
    "depth_m",
    "sigma_bearing_deg",
    "sigma_depth_m",
    "kept",
)
# Columns of the errors that near images share, and of a ray's own, by their name in `Rays`.
SHARED_COLUMNS = {
    "drift_m": ("drift_east_m", "drift_north_m"),
    "aside_m": ("aside_east_m", "aside_north_m"),
    "turned_deg": TURNED_COLUMNS,
    "own_deg": (OWN_COLUMN,),
}
POLE_COLUMNS = (
    "id",
    "kind",
    "x",
    "y",
    "z",
    "latitude",
    "longitude",
    "score",
    "sigma_major_m",
    "sigma_minor_m",
    "sigma_azimuth_deg",
    "condition",
    "evidence",
    "images",
    "routes",
    "kept",
    "reason",
)
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
