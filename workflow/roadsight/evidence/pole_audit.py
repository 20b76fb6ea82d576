"""How far simulating an effect changes the answer of the pole job."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd
from scipy.optimize import linear_sum_assignment

from roadsight.base.arrays import Floats, Ints
from roadsight.geometry.cameras import wrap_deg

MOVED_M = 0.5
"""Poles of two answers that lie further apart are not the same pole."""


@dataclass(frozen=True)
class PoleAnswer:
    """What the pole job says about a site.

    Parameters
    ----------
    poles : x, y and kept of each pole. sightings : image, view, u_foot, v_foot, bearing_deg,
    sigma_bearing_deg and kept. hazard : x, y and rating of the kept poles.
    cpu_s : processor time of the jobs behind it, s.
    """

    poles: pd.DataFrame
    sightings: pd.DataFrame
    hazard: pd.DataFrame
    cpu_s: float = 0.0

    @property
    def found(self) -> int:
        """Number of kept poles."""
        return int(self.poles["kept"].sum())

    @property
    def seen(self) -> int:
        """Number of kept sightings."""
        return int(self.sightings["kept"].sum())


def answer_change(one: PoleAnswer, other: PoleAnswer) -> float:
    """Largest share of the answer that differs: of poles, of true bearings or of ratings."""
    return max(
        pole_change(kept_places(one.poles), kept_places(other.poles)),
        bearing_change(one.sightings, other.sightings),
        rating_change(one.hazard, other.hazard),
    )


def kept_places(poles: pd.DataFrame) -> Floats:
    """Places (n, 2) of the kept poles."""
    return poles.loc[poles["kept"].astype(bool), ["x", "y"]].to_numpy(np.float64)


def matches(one_m: Floats, other_m: Floats, within_m: float = MOVED_M) -> Ints:
    """Pairs (k, 2) of places that are one pole: as many as there can be, then the nearest."""
    away_m = np.hypot(*np.moveaxis(one_m[:, None] - other_m[None], -1, 0))
    near = away_m <= within_m
    pairs = np.column_stack(linear_sum_assignment(np.where(near, away_m / within_m - 2.0, 0.0)))
    return pairs[near[pairs[:, 0], pairs[:, 1]]]


def pole_change(one_m: Floats, other_m: Floats) -> float:
    """Share of poles that appear, vanish or move by more than half a metre; 0 without any."""
    most = max(len(one_m), len(other_m))
    return 1.0 - len(matches(one_m, other_m)) / most if most else 0.0


def bearing_change(one: pd.DataFrame, other: pd.DataFrame) -> float:
    """Share of sightings in both whose bearing from true north moves by more than its sigma."""
    keys = ["image", "view", "u_foot", "v_foot"]
    kept = [table[table["kept"].astype(bool)] for table in (one, other)]
    both = kept[0].merge(kept[1], on=keys, suffixes=("", "_other"))
    if both.empty:
        return 0.0
    moved = np.abs(wrap_deg(both["bearing_deg"] - both["bearing_deg_other"]))
    return float((moved > both["sigma_bearing_deg"].to_numpy(np.float64)).mean())


def rating_change(one: pd.DataFrame, other: pd.DataFrame) -> float:
    """Share of poles in both whose hazard is rated otherwise."""
    plan = ["x", "y"]
    pairs = matches(one[plan].to_numpy(np.float64), other[plan].to_numpy(np.float64))
    if not len(pairs):
        return 0.0
    ratings = [table["rating"].to_numpy()[pairs[:, k]] for k, table in enumerate((one, other))]
    return float((ratings[0] != ratings[1]).mean())
