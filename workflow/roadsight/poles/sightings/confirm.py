"""Objects of the cloud in masks: whether images show at their place what they are taken for.

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
