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
from typing import NamedTuple

import numpy as np
from scipy import sparse

from roadsight.base.arrays import Bools, Floats, Ints, Ints32
from roadsight.base.kernels import compiled, compiled_part
from roadsight.setcover.common.cuts import stacked
from roadsight.setcover.common.kernels import Bits, pack_bits
from roadsight.setcover.common.problem import Instance
from roadsight.setcover.common.relaxation import Node, Solution

_MOST_CHOICES = 4_096  # pairs of more choices would take more than 2 MiB of bits
_MOST_WORDS = 2**23  # most words of 64 bits that targets and depths may take: 64 MiB
_PRICED = 1e-9  # targets of a dual above this have a price
_TIGHT = 0.02  # targets that shares cover by less than this above their need come first
_TOLERANCE = 1e-7  # room for rounding in slack and money: a cover of exactly the goal must be found
_MOVE_S = 2e-9  # work by word or entry that is looked at, in seconds, measured
_ENTRY_S = 1e-8  # work by entry that is set up, in seconds, measured


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
    # Bits of all targets, and needs and prices at all depths, must find room.
    words = (len(choices) + 63) // 64 * instance.shape[1]
    words += depths * (len(choices) + instance.shape[1])
    if not (0 < len(choices) <= _MOST_CHOICES and words <= _MOST_WORDS):
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


def _prices(
    instance: Instance, solution: Solution, choices: Ints, fixed: Ints, slack: float
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


def _targets(instance: Instance, solution: Solution, choices: Ints, fixed: Ints) -> Targets:
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


UNDECIDED, EXCLUDED, FOUND = 0, 1, 2


class Prices(NamedTuple):
    """What choices use of the slack.

    Parameters
    ----------
    cost : (n,) cost of each choice. reduced : (n,) its reduced cost, at least 0.
    start, constraint : constraints of each choice, CSR (n, constraints).
    value, bits : (constraints, n) how much of each constraint a choice is, and where that is above
        0.
    low, dual : (constraints,) what each asks for, above 0, and the price of each unit above it.
    """

    cost: Floats
    reduced: Floats
    start: Ints32
    constraint: Ints32
    value: Floats
    bits: Bits
    low: Floats
    dual: Floats


class Targets(NamedTuple):
    """What choices cover.

    Parameters
    ----------
    start, target : targets of each choice, CSR (n, targets). bits : (targets, words) choices of
        each.
    need : (targets,) how often each is still to be covered.
    first : so many of them are looked at before the others.
    """

    start: Ints32
    target: Ints32
    bits: Bits
    need: Ints32
    first: int


class _Stack(NamedTuple):
    """State at each depth: choices that may be taken, what they would use, those left to try."""

    alive: Bits
    price: Floats
    branch: Bits
    target: Ints
    taken: Ints
    need: Ints32
    spare: Floats
    slack: Floats
    money: Floats


@compiled()
def affordable_pairs(prices: Prices, group: Ints, slack: float) -> Bits:
    """Bits (n, words) of the choices that each choice can be taken together with."""
    count = len(prices.reduced)
    bits = np.zeros((count, (count + 63) // 64), np.uint64)
    for i in range(count):
        price = prices.reduced[i] + prices.reduced
        for p in range(prices.start[i], prices.start[i + 1]):
            c = prices.constraint[p]
            spare = prices.low[c] - prices.value[c, i]
            _charge(price, prices, c, prices.bits[c], prices.low[c], spare)
        for j in range(count):
            apart = j != i and (group[i] < 0 or group[i] != group[j])
            if apart and price[j] <= slack:
                bits[i, j >> 6] |= np.uint64(1) << np.uint64(j & 63)
    return bits


@compiled_part()
def _charge(
    price: Floats, prices: Prices, c: int, choices: Bits, before: float, spare: float
) -> int:
    """Make choices dearer by what they are of constraint c beyond the spare room that is left.

    ``before`` is the room that there was. Returns how many choices there are.
    """
    value, dual, count = prices.value[c], prices.dual[c], 0
    for w in range(len(choices)):
        rest = choices[w]
        while rest:
            k = w * 64 + _lowest(rest)
            rest &= rest - np.uint64(1)
            price[k] += dual * (_beyond(value[k], spare) - _beyond(value[k], before))
            count += 1
    return count


@compiled_part()
def _beyond(value: float, spare: float) -> float:
    return min(max(value - spare, 0.0), value)


@compiled()
def enumerate_choices(
    prices: Prices,
    targets: Targets,
    pairs: Bits,
    slack: float,
    money: float,
    depths: int,
    most_moves: float,
) -> tuple[int, Ints, float]:
    """Choices that cover all targets within slack and money, or that there are none.

    Parameters
    ----------
    depths : more than choices that can be paid, by two at least.

    Returns
    -------
    one of the answers above, the choices that were found, words and entries looked at
    """
    stack = _new_stack(prices, targets, pairs, slack, money, depths)
    _drop_dear(stack, prices, 0)
    depth, moves = 0, _choose_target(stack, targets, 0)
    while depth >= 0:
        if stack.target[depth] < 0:
            return FOUND, stack.taken[:depth].copy(), moves
        if moves > most_moves:
            return UNDECIDED, stack.taken[:0].copy(), moves
        choice = _next_choice(stack, depth)
        if choice < 0:
            depth -= 1
            continue
        depth += 1
        moves += _take(stack, prices, targets, pairs, depth, choice)
        if stack.money[depth] < 2 * prices.cost.min():
            moves += _keep_those_that_cover_all(stack, targets, depth)
        _drop_dear(stack, prices, depth)
        moves += _choose_target(stack, targets, depth)
    return EXCLUDED, stack.taken[:0].copy(), moves


@compiled_part()
def _new_stack(
    prices: Prices, targets: Targets, pairs: Bits, slack: float, money: float, depths: int
) -> _Stack:
    count, words = pairs.shape
    stack = _Stack(
        np.zeros((depths, words), np.uint64),
        np.zeros((depths, count)),
        np.zeros((depths, words), np.uint64),
        np.zeros(depths, np.int64),
        np.zeros(depths, np.int64),
        np.zeros((depths, len(targets.need)), np.int32),
        np.zeros((depths, len(prices.low))),
        np.zeros(depths),
        np.zeros(depths),
    )
    for i in range(count):
        stack.alive[0, i >> 6] |= np.uint64(1) << np.uint64(i & 63)
    stack.price[0], stack.spare[0], stack.need[0] = prices.reduced, prices.low, targets.need
    stack.slack[0], stack.money[0] = slack, money
    return stack


@compiled_part()
def _choose_target(stack: _Stack, targets: Targets, depth: int) -> float:
    """Set the open target with the fewest choices (-1: none is open), which are to be tried.

    Returns the words looked at.
    """
    alive, need, bits = stack.alive[depth], stack.need[depth], targets.bits
    best, fewest, moves = -1, 1 << 30, 0.0
    for t in range(len(need)):
        if need[t] <= 0:
            continue
        if t >= targets.first and best >= 0:
            break
        few = 0
        for w in range(len(alive)):
            few += _ones(alive[w] & bits[t, w])
        moves += len(alive)
        if few < fewest:
            best, fewest = t, few
            if few < need[t]:
                break
    stack.target[depth] = best
    if best >= 0:
        stack.branch[depth] = alive & bits[best]
    return moves


@compiled()
def _ones(word: np.uint64) -> int:
    """Number of bits that are set."""
    word -= (word >> np.uint64(1)) & np.uint64(0x5555555555555555)
    pairs = np.uint64(0x3333333333333333)
    word = (word & pairs) + ((word >> np.uint64(2)) & pairs)
    word = (word + (word >> np.uint64(4))) & np.uint64(0x0F0F0F0F0F0F0F0F)
    return int((word * np.uint64(0x0101010101010101)) >> np.uint64(56))


@compiled()
def _lowest(word: np.uint64) -> int:
    """Place of the lowest bit of a word that has one."""
    return _ones((word & (~word + np.uint64(1))) - np.uint64(1))


@compiled_part()
def _next_choice(stack: _Stack, depth: int) -> int:
    """Take the next choice off those that are left to try, -1 where they are too few."""
    branch, left = stack.branch[depth], 0
    for word in branch:
        left += _ones(word)
    if left < stack.need[depth, stack.target[depth]]:
        return -1
    w = 0
    while not branch[w]:
        w += 1
    bit = _lowest(branch[w])
    branch[w] ^= np.uint64(1) << np.uint64(bit)
    stack.alive[depth, w] ^= np.uint64(1) << np.uint64(bit)
    return w * 64 + bit


@compiled_part()
def _take(
    stack: _Stack, prices: Prices, targets: Targets, pairs: Bits, depth: int, choice: int
) -> float:
    """State at a depth, with a choice more than above it; words and entries looked at."""
    above = depth - 1
    stack.taken[above] = choice
    stack.slack[depth] = stack.slack[above] - stack.price[above, choice]
    stack.money[depth] = stack.money[above] - prices.cost[choice]
    stack.alive[depth] = stack.alive[above] & pairs[choice]
    stack.need[depth] = stack.need[above]
    need, start, end = stack.need[depth], targets.start[choice], targets.start[choice + 1]
    for p in range(start, end):
        need[targets.target[p]] -= 1
    return end - start + len(need) // 8 + _charge_others(stack, prices, depth, choice)


@compiled_part()
def _charge_others(stack: _Stack, prices: Prices, depth: int, choice: int) -> float:
    """Make what can be taken after a choice dearer; words and entries looked at."""
    stack.spare[depth], stack.price[depth] = stack.spare[depth - 1], stack.price[depth - 1]
    spare, alive = stack.spare[depth], stack.alive[depth]
    price, moves = stack.price[depth], 0
    for p in range(prices.start[choice], prices.start[choice + 1]):
        c = prices.constraint[p]
        before = spare[c]
        spare[c] -= prices.value[c, choice]
        others = alive & prices.bits[c]
        moves += len(alive) + _charge(price, prices, c, others, before, spare[c])
    return float(moves)


@compiled_part()
def _drop_dear(stack: _Stack, prices: Prices, depth: int) -> None:
    """Switch off choices that are too dear beside those that are taken."""
    alive, price, cost = stack.alive[depth], stack.price[depth], prices.cost
    slack, money = stack.slack[depth], stack.money[depth]
    for w in range(len(alive)):
        rest = alive[w]
        while rest:
            bit = _lowest(rest)
            rest &= rest - np.uint64(1)
            if price[w * 64 + bit] > slack or cost[w * 64 + bit] > money:
                alive[w] ^= np.uint64(1) << np.uint64(bit)


@compiled_part()
def _keep_those_that_cover_all(stack: _Stack, targets: Targets, depth: int) -> float:
    """Where one more choice can be paid, it has to cover all that is open; words looked at."""
    alive, need, bits = stack.alive[depth], stack.need[depth], targets.bits
    moves = 0.0
    for t in range(targets.first):
        if need[t] > 0:
            some = np.uint64(0)
            for w in range(len(alive)):
                alive[w] &= bits[t, w]
                some |= alive[w]
            moves += len(alive)
            if not some:
                break
    return moves
