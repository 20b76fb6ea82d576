"""Choices that stand too near each other, as few sets of which at most one is taken."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from roadsight.base.arrays import Floats, Ints


def spacing_cliques(xy_m: Floats, spacing_m: float) -> tuple[Ints, ...]:
    """Sets of positions that lie nearer to each other than a spacing, or at one place.

    Every two positions nearer than the spacing share a set, and a set holds no others. Sets grow
    until no position can join, so that there are few of them and relaxations are tight.

    Parameters
    ----------
    xy_m : (n, 2) positions, local metres; equal ones stand at one place.
    """
    places, member = np.unique(np.asarray(xy_m, np.float64), axis=0, return_inverse=True)
    member = member.reshape(-1)
    order = np.argsort(member, kind="stable")
    choices_at = np.split(order, np.cumsum(np.bincount(member, minlength=len(places)))[:-1])
    near = _neighbours(places, spacing_m)
    cliques = _edge_cliques(near)
    lonely = [{p} for p in range(len(places)) if not near[p] and len(choices_at[p]) > 1]
    sets = [*cliques, *lonely]
    return tuple(np.sort(np.concatenate([choices_at[p] for p in sorted(s)])) for s in sets)


def _neighbours(places: Floats, spacing_m: float) -> list[set[int]]:
    """Places nearer than the spacing to each; exactly the spacing is far enough."""
    near: list[set[int]] = [set() for _ in range(len(places))]
    if len(places) < 2:
        return near
    pairs = cKDTree(places).query_pairs(spacing_m, output_type="ndarray")
    length_m = np.linalg.norm(places[pairs[:, 0]] - places[pairs[:, 1]], axis=1)
    for a, b in pairs[length_m < spacing_m * (1 - 1e-9)].tolist():
        near[a].add(b)
        near[b].add(a)
    return near


def _edge_cliques(near: list[set[int]]) -> list[set[int]]:
    """Maximal cliques that hold every edge of a graph at least once."""
    done: set[tuple[int, int]] = set()
    cliques = []
    for a in range(len(near)):
        for b in sorted(near[a]):
            if b < a or (a, b) in done:
                continue
            clique, common = {a, b}, near[a] & near[b]
            while common:
                # The member that holds most edges that are still open, the first of equals.
                best = max(sorted(common), key=lambda c: _open_edges(c, clique, done))
                clique.add(best)
                common = common & near[best]
            done |= {(p, q) for p in clique for q in clique if p < q}
            cliques.append(clique)
    return cliques


def _open_edges(place: int, clique: set[int], done: set[tuple[int, int]]) -> int:
    return sum((min(place, c), max(place, c)) not in done for c in clique)
