"""Which groups of rays are poles: the most valuable set in which every ray is used at most once.

Maximise sum of gains, subject to every ray in at most one chosen group: weighted set packing,
solved by HiGHS, one connected part of the route at a time. A part that needs more branch and bound
nodes than allowed keeps the best found: a count, not a time, so that every machine answers alike.
"""

from __future__ import annotations

import numpy as np
from scipy.optimize import Bounds, LinearConstraint, milp
from scipy.sparse import block_array, csr_array
from scipy.sparse.csgraph import connected_components

from roadsight.base.arrays import Bools, Floats, Ints

_LARGEST = 20_000
"""Groups of a connected part up to which it is solved exactly."""
_NODES = 1000
"""Nodes of branch and bound for a part; more come nearer to the best choice, and take longer."""


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
