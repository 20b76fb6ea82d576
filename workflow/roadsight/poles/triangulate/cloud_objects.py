"""Trees, guardrails and buildings of the cloud as objects of a site, which images confirm.

A camera that knows where it stands and looks sees each point of an object at one pixel. What is
there is the object, something nearer that hides it, or something else in its stead. Only the last
speaks against it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd

from roadsight.base.arrays import Bytes, Floats, Ints
from roadsight.geometry.cameras import project
from roadsight.poles.images.kinds import KINDS
from roadsight.poles.risk.roads import RouteTracks
from roadsight.poles.sightings.sighting_bearing import ViewCamera

# What a view says about an object: that it is there, that something else is, neither of both (it
# may be hidden), nothing.
SEEN, AGAINST, UNDECIDED, OUT_OF_VIEW = 1, -1, 0, 2
# Why an object is dropped that lies far from the road that was driven.
UNSEEN = "no image looks at it"
_SHOWN = 0.5  # from this share of its points in the image on, a class is what stands there
_FEWEST = 3  # points of an object in the image, so that one at its edge is not judged by a corner
_BESIDE_M = 3.0  # objects nearer to the camera are beside the vehicle
# Heights of the points on a tree, as shares of its own: below is the trunk, which bushes hide.
_CROWN_SHARES = np.linspace(0.35, 0.95, 7)
_BLOCK_SHARES = np.linspace(0.3, 0.8, 3)  # the same of the points on the outline of a building
_RAIL_M = 0.6  # height of the points on a rail
_SHARES = {"crown": _CROWN_SHARES, "block": _BLOCK_SHARES, "line": np.ones(1)}


@dataclass(frozen=True)
class Objects:
    """Objects of one kind by points on them.

    Parameters
    ----------
    kind : of `KINDS`. xyz_m : (m, 3) points, local metres. owner : (m,) number of the object of
    each, ascending from 0.
    """

    kind: str
    xyz_m: Floats
    owner: Ints


def objects_of(table: pd.DataFrame) -> list[Objects]:
    """Objects of a table of the cloud's, by kind.

    Parameters
    ----------
    table : kind, object (number within its kind), x, y, z_ground, top_m; a row a tree, and a row
    for each place of a rail and of an outline.
    """
    found = []
    for kind, own in table.groupby("kind", sort=True):
        rows = own.sort_values("object", kind="stable")
        shares = _SHARES[KINDS[str(kind)].shape]
        places = np.repeat(rows[["x", "y", "z_ground"]].to_numpy(np.float64), len(shares), axis=0)
        tall = rows["top_m"].to_numpy(np.float64)
        places[:, 2] += (tall[:, None] * shares).ravel() if len(shares) > 1 else _RAIL_M
        owner = np.repeat(rows["object"].to_numpy(np.int64), len(shares))
        found.append(Objects(str(kind), places, owner))
    return found


def show(camera: ViewCamera, mask: Bytes, objects: Objects, farthest_m: float) -> Ints:
    """What a view says about each object (n,): `SEEN`, `AGAINST`, `UNDECIDED`, `OUT_OF_VIEW`.

    Parameters
    ----------
    mask : project classes (rows, columns). farthest_m : farther points are not asked.
    """
    count = int(objects.owner[-1]) + 1 if len(objects.owner) else 0
    away = np.hypot(*(objects.xyz_m[:, :2] - np.asarray(camera.position_m[:2])).T)
    near = (away > _BESIDE_M) & (away <= farthest_m)
    uv, _ = project(camera.intrinsics, camera.rotation(), camera.position_m, objects.xyz_m[near])
    inside = camera.intrinsics.contains(uv)
    owner = objects.owner[near][inside]
    column, row = np.floor(uv[inside] + 0.5).astype(np.int64).T
    shown = mask[np.minimum(row, mask.shape[0] - 1), np.minimum(column, mask.shape[1] - 1)]
    asked = np.bincount(owner, minlength=count)
    own, instead = (
        np.bincount(owner, np.isin(shown, classes), count)
        for classes in (KINDS[objects.kind].classes, KINDS[objects.kind].instead)
    )
    enough = asked >= _FEWEST
    answer = np.where(enough, UNDECIDED, OUT_OF_VIEW).astype(np.int64)
    answer[enough & (instead > _SHOWN * asked)] = AGAINST
    answer[enough & (own >= _SHOWN * asked)] = SEEN
    return answer


def confirmed(table: pd.DataFrame, seen: pd.DataFrame) -> pd.DataFrame:
    """What all views together say about each object: kept or not, and why.

    An object is dropped that more views contradict than show, and one whose kind needs it that none
    shows; what no view looks at is not beside the road.

    Parameters
    ----------
    table : as of `objects_of`. seen : kind, object, image, route and answer of each view that looks
        at it.

    Returns
    -------
    kind, object, score (views that show it), images, routes (parted by semicolons), kept, reason
    """
    keys = ["kind", "object"]
    found = table[keys].drop_duplicates().sort_values(keys, ignore_index=True)
    votes = seen.assign(shown=seen["answer"] == SEEN, against=seen["answer"] == AGAINST, asked=True)
    count = votes.groupby(keys, as_index=False)[["shown", "against", "asked"]].sum()
    named = votes[votes["shown"]].groupby(keys, as_index=False)[["image", "route"]].agg(joined)
    found = found.merge(count, on=keys, how="left").merge(named, on=keys, how="left")
    shown, against, asked = (
        found[n].fillna(0).to_numpy(np.int64) for n in ("shown", "against", "asked")
    )
    needed = np.array([KINDS[kind].needs_mask for kind in found["kind"]], bool)
    reason = np.where(needed & (shown == 0), "no image shows it", "")
    reason = np.where(against > shown, "images show something else in its place", reason)
    reason = np.where(asked == 0, UNSEEN, reason)
    return pd.DataFrame(
        {
            "kind": found["kind"],
            "object": found["object"],
            "score": shown,
            "images": found["image"].fillna(""),
            "routes": found["route"].fillna(""),
            "kept": reason == "",
            "reason": reason.astype(object),
        }
    )


def joined(names: pd.Series) -> str:
    """Each name once, in order, parted by semicolons."""
    return ";".join(sorted(set(names.astype(str))))


# Buildings farther from a track are not beside its road: the widest clear zones, of fast roads on
# the outside of bends, end 21 m from the travelled way.
BESIDE_M = 40.0
_TOLD = ["score", "images", "routes", "kept", "reason"]  # what images say of an object
# What the cloud shows under a crown, see `find_trunks`; empty for other objects.
TRUNK_COLUMNS = ("trunk_x", "trunk_y", "trunk_sigma_m", "cloud_shows")
# An outline with a place each metre that a track crosses comes so near to it; no house does.
_OVER_M = 1.0
OVER_ROAD = "over the road: a bridge, no building"  # reason of what is withheld so


def trees_of(objects: pd.DataFrame, told: pd.DataFrame) -> pd.DataFrame:
    """Trees as rows of poles, at their trunks where the cloud shows them.

    Those that no image looks at are left out.

    Parameters
    ----------
    objects : kind, object, x, y, top_m, width_m, sigma_m, `TRUNK_COLUMNS`. told : of each object,
    see `confirmed`.
    """
    own = objects[objects["kind"] == "tree"]
    if own.empty:
        return pd.DataFrame()
    table = own.merge(told, on=["kind", "object"])
    table = table[table["reason"] != UNSEEN]
    table = table.sort_values(["x", "y"], kind="stable", ignore_index=True)
    for name in ("x", "y", "sigma_m"):
        table[name] = table[f"trunk_{name}"].fillna(table[name])
    sigma = {"sigma_major_m": table["sigma_m"], "sigma_minor_m": table["sigma_m"]}
    shape = {"height_m": table["top_m"], "crown_width_m": table["width_m"]}
    names = [f"tree-{number:05d}" for number in range(len(table))]
    columns = ["kind", "x", "y", "cloud_shows", *_TOLD]
    table = table[columns].assign(**shape)
    return table.assign(**sigma, sigma_azimuth_deg=0.0, condition=1.0, id=names)


def blocks_of(objects: pd.DataFrame, told: pd.DataFrame, tracks: RouteTracks) -> pd.DataFrame:
    """Buildings and headwalls as rows of poles, each at its place that is nearest to a track.

    The cloud says what they are: those that no image looks at stay, those farther from the road
    than any clear zone are left out, and so are all where no image has a place. What a track runs
    under is withheld.

    Parameters
    ----------
    objects : kind, object, x, y, z_ground, top_m, sigma_m, a row a place of an outline. told : of
    each object, see `confirmed`. tracks : of the vehicles.
    """
    own = objects[[KINDS[kind].shape == "block" for kind in objects["kind"]]]
    if own.empty:
        return pd.DataFrame()
    xy = own[["x", "y"]].to_numpy(np.float64)
    nearest = own.assign(away=tracks.away_m(xy)).sort_values("away", kind="stable")
    nearest = nearest.drop_duplicates(["kind", "object"])
    table = nearest[nearest["away"] <= BESIDE_M].merge(told, on=["kind", "object"])
    table = table.sort_values(["kind", "object"], ignore_index=True)
    unseen = table["reason"] == UNSEEN
    table = table.assign(kept=table["kept"] | unseen, reason=table["reason"].mask(unseen, ""))
    over = (table["kind"] == "building") & (table["away"] < _OVER_M)
    table = table.assign(kept=table["kept"] & ~over, reason=table["reason"].mask(over, OVER_ROAD))
    sigma = {"sigma_major_m": table["sigma_m"], "sigma_minor_m": table["sigma_m"]}
    number = table.groupby("kind").cumcount()
    names = [f"{kind}-{n:05d}" for kind, n in zip(table["kind"], number, strict=True)]
    table = table[["kind", "x", "y", *_TOLD]].assign(height_m=table["top_m"], **sigma)
    return table.assign(sigma_azimuth_deg=0.0, condition=1.0, id=names)


def guardrails_of(objects: pd.DataFrame, told: pd.DataFrame) -> pd.DataFrame:
    """Guardrails with their places; those that no image looks at are left out.

    Returns
    -------
    id, score, images, routes, kept, reason, length_m, places_m (each (n, 3), on the ground)
    """
    columns = ["id", *_TOLD, "length_m", "places_m"]
    if objects.empty:
        return pd.DataFrame(columns=columns)
    rows = []
    looked_at = told[(told["kind"] == "guardrail") & (told["reason"] != UNSEEN)]
    for one in looked_at.itertuples(index=False):
        own = (objects["kind"] == one.kind) & (objects["object"] == one.object)
        places = objects.loc[own, ["x", "y", "z_ground"]].to_numpy(np.float64)
        length_m = float(np.hypot(*np.diff(places[:, :2], axis=0).T).sum())
        values = [getattr(one, name) for name in _TOLD]
        rows.append((f"guardrail-{one.object:05d}", *values, length_m, places))
    return pd.DataFrame(rows, columns=columns)
