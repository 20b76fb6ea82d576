"""Covers that cost no more than asked, found or excluded by what the duals leave.

Whatever a cover costs above the bound of a relaxation, it pays in reduced costs of its choices and
in constraints with a dual that it meets by more than they ask for (complementary slackness). Where
little is left to pay, few choices go together. So choices are tried one after the other, those of
the target that fewest of them cover first, and one is out as soon as it is too dear beside those
that are taken. No linear program is solved on the way.
"""

from __future__ import annotations

import math
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
    enumerate_choices,
)

_MOST_CHOICES = 4_096
"""Pairs of more choices would take more than 2 MiB of bits."""
_MOST_WORDS = 2**23
"""Most words of 64 bits that targets and depths may take: 64 MiB."""
_PRICED = 1e-9
"""Targets of a dual above this have a price."""
_TIGHT = 0.02
"""Targets that the shares cover by less than this above their need are looked at before others."""
_TOLERANCE = 1e-7
"""Room for rounding in slack and money: a cover of exactly the goal must be found."""
_MOVE_S = 2e-9
"""Work by word or entry that is looked at, in seconds, measured."""
_ENTRY_S = 1e-8
"""Work by entry that is set up, in seconds, measured."""


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
    room = min(_TOLERANCE * max(1.0, abs(goal)), 0.25 if instance.integral else math.inf)
    slack = goal - solution.bound + room
    dear = np.maximum(solution.reduced_cost, 0.0) > slack
    choices = np.flatnonzero(node.alive & ~node.fixed & ~dear)
    fixed = np.flatnonzero(node.fixed)
    money = goal - float(instance.cost[fixed].sum()) + room
    depths = 2 + int(np.searchsorted(np.sort(instance.cost[choices]).cumsum(), money, "right"))
    if not _is_small(instance, len(choices), depths):
        return Enumeration(False, None, 0.0)
    choices = choices[np.argsort(-solution.x[choices], kind="stable")]
    prices, slack = _prices(instance, solution, choices, fixed, slack)
    targets = _targets(instance, solution, choices, fixed)
    work_s = _ENTRY_S * (prices.value.size + 2 * len(targets.target))
    pairs = affordable_pairs(prices, instance.group[choices], slack)
    answer, taken, moves = enumerate_choices(
        prices, targets, pairs, slack, money, depths, (most_work_s - work_s) / _MOVE_S
    )
    cover = None
    if answer == FOUND:
        cover = node.fixed.copy()
        cover[choices[taken]] = True
    return Enumeration(answer == EXCLUDED, cover, work_s + _MOVE_S * moves)


def _is_small(instance: Instance, choices: int, depths: int) -> bool:
    """Whether bits of all targets, and needs and prices at all depths, find room."""
    words = (choices + 63) // 64 * instance.shape[1] + depths * (choices + instance.shape[1])
    return 0 < choices <= _MOST_CHOICES and words <= _MOST_WORDS


def _prices(
    instance: Instance,
    solution: Solution,
    choices: Ints,
    fixed: Ints,
    slack: float,
) -> tuple[Prices, float]:
    """What choices use of the slack, and what fixed ones leave of it.

    Constraints that the fixed choices meet make each choice that is in them dearer, whatever else
    is taken.
    """
    priced = np.flatnonzero(solution.target_dual > _PRICED)
    more = [one for one, _ in solution.priced]
    every = sparse.vstack(
        [instance.by_target[:, priced].T, stacked(more, instance.shape[0])], format="csr"
    ).astype(np.float64)
    dual = np.concatenate([solution.target_dual[priced], [price for _, price in solution.priced]])
    low = np.concatenate([instance.need[priced], [one.low for one in more]])
    low = low - np.asarray(every[:, fixed].sum(axis=1)).ravel()
    met, value = low <= 0, every[:, choices].toarray()
    slack += float(dual[met] @ low[met])
    reduced = np.maximum(solution.reduced_cost[choices], 0.0)
    beyond = np.maximum(value - np.maximum(low, 0.0)[:, None], 0.0)
    reduced += (dual[:, None] * beyond).sum(axis=0)
    left = every[~met][:, choices]
    bits = pack_bits(left.indptr, left.indices, len(choices))
    by_choice = left.T.tocsr()
    prices = Prices(
        instance.cost[choices],
        reduced,
        by_choice.indptr,
        by_choice.indices,
        value[~met],
        bits,
        low[~met],
        dual[~met],
    )
    return prices, slack


def _targets(
    instance: Instance,
    solution: Solution,
    choices: Ints,
    fixed: Ints,
) -> Targets:
    """What choices cover of the targets that are open, those that the shares cover least first."""
    need = instance.need - np.asarray(instance.by_choice[fixed].sum(axis=0, dtype=np.int32)).ravel()
    spare = instance.by_choice.T @ solution.x - instance.need
    is_open = np.flatnonzero(need > 0)
    is_open = is_open[np.argsort(spare[is_open], kind="stable")]
    covers = instance.by_choice[choices][:, is_open].tocsr()
    covered_by = covers.T.tocsr()
    first = int(np.searchsorted(spare[is_open], _TIGHT, "right"))
    return Targets(
        covers.indptr,
        covers.indices,
        pack_bits(covered_by.indptr, covered_by.indices, len(choices)),
        need[is_open].astype(np.int32),
        first,
    )
