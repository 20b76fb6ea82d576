"""Covers that cost no more than asked, found or excluded by what the duals leave.

Whatever a cover costs above the bound of a relaxation, it pays in reduced costs of its rows and in
constraints with a dual that it meets by more than they ask for (complementary slackness). Where
little is left to pay, few rows go together. So rows are tried one after the other, those of the
target that fewest of them cover first, and a row is out as soon as it is too dear beside those
that are taken. No linear program is solved on the way.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse

from roadsight.base.arrays import Bools, Ints
from roadsight.setcover.common.constraints import stacked
from roadsight.setcover.common.kernels import pack_bits
from roadsight.setcover.common.problem import Instance
from roadsight.setcover.common.relaxation import Node, Solution
from roadsight.setcover.cover.enumeration_kernels import (
    EXCLUDED,
    FOUND,
    Prices,
    Targets,
    affordable_pairs,
    enumerate_rows,
)

_MOST_ROWS, _MOST_WORDS = 4_096, 2**23
_PRICED, _TIGHT, _TOLERANCE = 1e-9, 0.02, 1e-7
_MOVE_S, _ENTRY_S = 2e-9, 1e-8  # work, measured: a word or entry looked at, one set up


@dataclass(frozen=True)
class Enumeration:
    """Answer of an enumeration.

    Parameters
    ----------
    excluded : no cover of the node costs as little as asked.
    cover : (m,) a cover that does, or None.
    work_s : what it took, in seconds.
    """

    excluded: bool
    cover: Bools | None
    work_s: float


def enumerate_covers(
    instance: Instance, node: Node, solution: Solution, goal: float, most_work_s: float
) -> Enumeration:
    """Look for a cover below a node that costs at most ``goal``, in steps.

    Where one is neither excluded nor found, the work was not enough.

    Parameters
    ----------
    solution : of the node's relaxation, complete. most_work_s : seconds it may take, about.
    """
    slack = goal - solution.bound + _TOLERANCE * max(1.0, abs(goal))
    dear = np.maximum(solution.reduced_cost, 0.0) > slack
    rows = np.flatnonzero(node.alive & ~node.fixed & ~dear)
    fixed = np.flatnonzero(node.fixed)
    money = goal - float(instance.cost[fixed].sum()) + _TOLERANCE
    depths = 2 + int(np.searchsorted(np.sort(instance.cost[rows]).cumsum(), money, "right"))
    if not _is_small(instance, len(rows), depths):
        return Enumeration(False, None, 0.0)
    rows = rows[np.argsort(-solution.x[rows], kind="stable")]
    prices, slack = _prices(instance, solution, rows, fixed, slack)
    targets = _targets(instance, solution, rows, fixed)
    work_s = _ENTRY_S * (prices.value.size + 2 * len(targets.target))
    pairs = affordable_pairs(prices, instance.group[rows], slack)
    answer, taken, moves = enumerate_rows(
        prices, targets, pairs, slack, money, depths, (most_work_s - work_s) / _MOVE_S
    )
    cover = None
    if answer == FOUND:
        cover = node.fixed.copy()
        cover[rows[taken]] = True
    return Enumeration(answer == EXCLUDED, cover, work_s + _MOVE_S * moves)


def _is_small(instance: Instance, rows: int, depths: int) -> bool:
    """Whether bits of all targets, and needs and prices at all depths, find room."""
    words = (rows + 63) // 64 * instance.shape[1] + depths * (rows + instance.shape[1])
    return 0 < rows <= _MOST_ROWS and words <= _MOST_WORDS


def _prices(
    instance: Instance,
    solution: Solution,
    rows: Ints,
    fixed: Ints,
    slack: float,
) -> tuple[Prices, float]:
    """What rows use of the slack, and what fixed rows leave of it.

    Constraints that the fixed rows meet make each row that is in them dearer, whatever else is
    taken.
    """
    priced = np.flatnonzero(solution.target_dual > _PRICED)
    more = [row for row, _ in solution.priced]
    every = sparse.vstack(
        [instance.by_target[:, priced].T, stacked(more, instance.shape[0])], format="csr"
    ).astype(np.float64)
    dual = np.concatenate([solution.target_dual[priced], [price for _, price in solution.priced]])
    low = np.concatenate([instance.need[priced], [row.low for row in more]])
    low = low - np.asarray(every[:, fixed].sum(axis=1)).ravel()
    met, value = low <= 0, every[:, rows].toarray()
    slack += float(dual[met] @ low[met])
    reduced = np.maximum(solution.reduced_cost[rows], 0.0)
    beyond = np.maximum(value - np.maximum(low, 0.0)[:, None], 0.0)
    reduced += (dual[:, None] * beyond).sum(axis=0)
    left = every[~met][:, rows]
    bits = pack_bits(left.indptr, left.indices, len(rows))
    by_row = left.T.tocsr()
    prices = Prices(
        instance.cost[rows],
        reduced,
        by_row.indptr,
        by_row.indices,
        value[~met],
        bits,
        low[~met],
        dual[~met],
    )
    return prices, slack


def _targets(
    instance: Instance,
    solution: Solution,
    rows: Ints,
    fixed: Ints,
) -> Targets:
    """What rows cover of the targets that are open, those that the shares cover least first."""
    need = instance.need - np.asarray(instance.by_choice[fixed].sum(axis=0, dtype=np.int32)).ravel()
    spare = instance.by_choice.T @ solution.x - instance.need
    is_open = np.flatnonzero(need > 0)
    is_open = is_open[np.argsort(spare[is_open], kind="stable")]
    covers = instance.by_choice[rows][:, is_open].tocsr()
    covered_by = covers.T.tocsr()
    first = int(np.searchsorted(spare[is_open], _TIGHT, "right"))
    return Targets(
        covers.indptr,
        covers.indices,
        pack_bits(covered_by.indptr, covered_by.indices, len(rows)),
        need[is_open].astype(np.int32),
        first,
    )
