"""Poles with what a person decided on them."""

from __future__ import annotations

import numpy as np
import pandas as pd

from roadsight.base.arrays import Ints

REACH_M = 2.0
"""A decision is on the nearest pole of its kind within this distance of where it was made: a pole
that is computed again from other settings moves less, and two poles are seldom as near."""
_WORDS = {"accept": "accepted", "reject": "rejected", "move": "moved"}
"""What each decision makes of a pole."""
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
