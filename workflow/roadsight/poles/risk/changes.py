"""What changed between two surveys: objects that are the same, moved, new or gone."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Annotated

import numpy as np
import pandas as pd

from roadsight.poles.risk.validation import match_points

COLUMNS = ("status", "id", "old_id", "new_id", "kind", "moved_m", "limit_m", "x", "y")
STATUSES = ("same", "moved", "new", "gone")
_NUMBERED = re.compile(r"(.*?)(\d+)$")


@dataclass(frozen=True)
class ChangeSettings:
    """What counts as the same object.

    Parameters
    ----------
    reach_m : objects further apart are two: one gone, one new.
    sigmas : farther apart than so many standard deviations of both places, an object has moved.
        3.03 is exceeded by chance in one of a hundred (two axes).
    sigma_m : error of a place that states none, one axis.
    """

    reach_m: Annotated[float, "objects further apart are two, m"] = 5.0
    sigmas: Annotated[
        float, "farther apart than so many standard deviations, an object has moved"
    ] = 3.03
    sigma_m: Annotated[float, "error of a place that states none, one axis, m"] = 0.5


def changes(
    old: pd.DataFrame, new: pd.DataFrame, settings: ChangeSettings | None = None
) -> pd.DataFrame:
    """Objects of two surveys side by side.

    Objects of one kind are paired so that as many as can be find a partner within reach, and of all
    such pairings the one with the least sum of squared distances counts.

    Parameters
    ----------
    old, new : id, kind, x, y (the same metres for both), sigma_m (one axis, NaN unknown).

    Returns
    -------
    columns `COLUMNS`, by status, then id. ``id`` stays that of the old survey; new objects whose id
    is taken get the next free number. ``limit_m`` : further apart counts as moved.
    """
    own = settings or ChangeSettings()
    found_pairs: list[tuple[int, int]] = []
    for kind in sorted(set(old["kind"]) & set(new["kind"])):
        a, b = (np.flatnonzero((table["kind"] == kind).to_numpy()) for table in (old, new))
        before, after = (table[["x", "y"]].to_numpy(np.float64) for table in (old, new))
        matches = match_points(before[a], after[b], own.reach_m, power=2)
        found_pairs += [(int(a[i]), int(b[j])) for i, j in matches]
    pairs = np.array(sorted(found_pairs), np.int64).reshape(-1, 2)
    rows: list[tuple] = []
    for a, b in pairs:
        first, second = old.iloc[a], new.iloc[b]
        gap = float(np.hypot(second["x"] - first["x"], second["y"] - first["y"]))
        limit = own.sigmas * float(np.hypot(_sigma(first, own), _sigma(second, own)))
        status = "moved" if gap > limit else "same"
        rows.append((status, first, second, gap, limit))
    alone_old, alone_new = (
        np.setdiff1d(np.arange(len(table)), used).tolist()
        for table, used in zip((old, new), pairs.T, strict=True)
    )
    rows += [("gone", old.iloc[a], None, np.nan, np.nan) for a in alone_old]
    rows += [("new", None, new.iloc[b], np.nan, np.nan) for b in alone_new]
    taken = {str(name) for name in old["id"]}
    found = []
    for status, first, second, gap, limit in rows:
        place = first if second is None else second
        name = _free(str(second["id"]), taken) if first is None else str(first["id"])
        taken.add(name)
        ids = ["" if row is None else str(row["id"]) for row in (first, second)]
        found.append((status, name, *ids, place["kind"], gap, limit, place["x"], place["y"]))
    table = pd.DataFrame(found, columns=list(COLUMNS))
    order = table["status"].map({name: n for n, name in enumerate(STATUSES)})
    keys = table.assign(order=order).sort_values(["order", "id"], kind="stable").index
    return table.loc[keys].reset_index(drop=True)


def _sigma(row: pd.Series, settings: ChangeSettings) -> float:
    sigma = float(row["sigma_m"])
    return sigma if np.isfinite(sigma) and sigma > 0 else settings.sigma_m


def _free(name: str, taken: set[str]) -> str:
    """A name that is not taken: itself, or with the next free number at its end."""
    if name not in taken:
        return name
    parts = _NUMBERED.match(name)
    stem, digits = (parts[1], parts[2]) if parts else (f"{name}-", "1")
    numbers = [
        int(found[2])
        for found in map(_NUMBERED.match, taken)
        if found is not None and found[1] == stem
    ]
    return f"{stem}{max(numbers, default=0) + 1:0{len(digits)}d}"
