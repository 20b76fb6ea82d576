"""Trees, guardrails and buildings of the cloud as objects of a site, beside those of rays."""

from __future__ import annotations

import numpy as np
import pandas as pd

from roadsight.poles.images.kinds import KINDS
from roadsight.poles.risk.roads import RouteTracks
from roadsight.poles.sightings.confirm import UNSEEN

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
    see `confirm.confirmed`.
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
    each object, see `confirm.confirmed`. tracks : of the vehicles.
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
