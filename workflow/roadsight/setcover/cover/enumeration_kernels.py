"""Compiled search for sets of rows that stay within a slack, see `enumeration`."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from roadsight.base.arrays import Floats, Ints, Ints32
from roadsight.setcover.common.kernels import Bits

UNDECIDED, EXCLUDED, FOUND = 0, 1, 2


class Prices(NamedTuple):
    """What rows use of the slack.

    Parameters
    ----------
    cost : (n,) cost of each row. reduced : (n,) its reduced cost, at least 0.
    start, constraint : constraints of each row, CSR (n, constraints).
    value, bits : (constraints, n) how much of each constraint a row is, and where it is above 0.
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
    """What rows cover.

    Parameters
    ----------
    start, target : targets of each row, CSR (n, targets). bits : (targets, words) rows of each.
    need : (targets,) how often each is still to be covered.
    first : so many of them are looked at before the others.
    """

    start: Ints32
    target: Ints32
    bits: Bits
    need: Ints32
    first: int


class _Stack(NamedTuple):
    """State at each depth: rows that may be taken, what they would use, and those left to try."""

    alive: Bits
    price: Floats
    branch: Bits
    target: Ints
    taken: Ints
    need: Ints32
    spare: Floats
    slack: Floats
    money: Floats


@njit(cache=True)
def affordable_pairs(prices: Prices, group: Ints, slack: float) -> Bits:
    """Bits (n, words) of the rows that each row can be taken together with."""
    count = len(prices.reduced)
    bits = np.zeros((count, (count + 63) // 64), np.uint64)
    for i in range(count):
        price = prices.reduced[i] + prices.reduced
        for p in range(prices.start[i], prices.start[i + 1]):
            r = prices.constraint[p]
            spare = prices.low[r] - prices.value[r, i]
            _charge(price, prices, r, prices.bits[r], prices.low[r], spare)
        for j in range(count):
            apart = j != i and (group[i] < 0 or group[i] != group[j])
            if apart and price[j] <= slack:
                bits[i, j >> 6] |= np.uint64(1) << np.uint64(j & 63)
    return bits


@njit(cache=True)
def _charge(price: Floats, prices: Prices, r: int, rows: Bits, before: float, spare: float) -> int:
    """Make rows dearer by what they are of a constraint beyond the spare room that is left.

    ``before`` is the room that there was. Returns how many rows there are.
    """
    value, dual, count = prices.value[r], prices.dual[r], 0
    for w in range(len(rows)):
        rest = rows[w]
        while rest:
            k = w * 64 + _lowest(rest)
            rest &= rest - np.uint64(1)
            price[k] += dual * (_beyond(value[k], spare) - _beyond(value[k], before))
            count += 1
    return count


@njit(cache=True)
def _beyond(value: float, spare: float) -> float:
    return min(max(value - spare, 0.0), value)


@njit(cache=True)
def enumerate_rows(
    prices: Prices,
    targets: Targets,
    pairs: Bits,
    slack: float,
    money: float,
    depths: int,
    most_moves: float,
) -> tuple[int, Ints, float]:
    """Rows that cover all targets within slack and money, or that there are none.

    Parameters
    ----------
    depths : more than rows that can be paid, by two at least.

    Returns
    -------
    one of the answers above, the rows that were found, words and entries looked at
    """
    stack = _new_stack(prices, targets, pairs, slack, money, depths)
    _drop_dear_rows(stack, prices, 0)
    depth, moves = 0, _choose_target(stack, targets, 0)
    while depth >= 0:
        if stack.target[depth] < 0:
            return FOUND, stack.taken[:depth].copy(), moves
        if moves > most_moves:
            return UNDECIDED, stack.taken[:0].copy(), moves
        row = _next_row(stack, depth)
        if row < 0:
            depth -= 1
            continue
        depth += 1
        moves += _take(stack, prices, targets, pairs, depth, row)
        if stack.money[depth] < 2 * prices.cost.min():
            moves += _keep_those_that_cover_all(stack, targets, depth)
        _drop_dear_rows(stack, prices, depth)
        moves += _choose_target(stack, targets, depth)
    return EXCLUDED, stack.taken[:0].copy(), moves


@njit(cache=True)
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


@njit(cache=True)
def _choose_target(stack: _Stack, targets: Targets, depth: int) -> float:
    """Set the open target with the fewest rows, -1 where none is open; its rows are to be tried.

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


@njit(cache=True)
def _ones(word: np.uint64) -> int:
    """Number of bits that are set."""
    word -= (word >> np.uint64(1)) & np.uint64(0x5555555555555555)
    pairs = np.uint64(0x3333333333333333)
    word = (word & pairs) + ((word >> np.uint64(2)) & pairs)
    word = (word + (word >> np.uint64(4))) & np.uint64(0x0F0F0F0F0F0F0F0F)
    return int((word * np.uint64(0x0101010101010101)) >> np.uint64(56))


@njit(cache=True)
def _lowest(word: np.uint64) -> int:
    """Place of the lowest bit of a word that has one."""
    return _ones((word & (~word + np.uint64(1))) - np.uint64(1))


@njit(cache=True)
def _next_row(stack: _Stack, depth: int) -> int:
    """Take the next row off those that are left to try, -1 where they are too few."""
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


@njit(cache=True)
def _take(
    stack: _Stack, prices: Prices, targets: Targets, pairs: Bits, depth: int, row: int
) -> float:
    """State at a depth, with a row more than at the one before; words and entries looked at."""
    above = depth - 1
    stack.taken[above] = row
    stack.slack[depth] = stack.slack[above] - stack.price[above, row]
    stack.money[depth] = stack.money[above] - prices.cost[row]
    stack.alive[depth] = stack.alive[above] & pairs[row]
    stack.need[depth] = stack.need[above]
    need, start, end = stack.need[depth], targets.start[row], targets.start[row + 1]
    for p in range(start, end):
        need[targets.target[p]] -= 1
    return end - start + len(need) // 8 + _charge_others(stack, prices, depth, row)


@njit(cache=True)
def _charge_others(stack: _Stack, prices: Prices, depth: int, row: int) -> float:
    """Make the rows that can be taken after a row dearer; words and entries looked at."""
    stack.spare[depth], stack.price[depth] = stack.spare[depth - 1], stack.price[depth - 1]
    spare, alive = stack.spare[depth], stack.alive[depth]
    price, moves = stack.price[depth], 0
    for p in range(prices.start[row], prices.start[row + 1]):
        r = prices.constraint[p]
        before = spare[r]
        spare[r] -= prices.value[r, row]
        rows = alive & prices.bits[r]
        moves += len(alive) + _charge(price, prices, r, rows, before, spare[r])
    return float(moves)


@njit(cache=True)
def _drop_dear_rows(stack: _Stack, prices: Prices, depth: int) -> None:
    """Switch off rows that are too dear beside those that are taken."""
    alive, price, cost = stack.alive[depth], stack.price[depth], prices.cost
    slack, money = stack.slack[depth], stack.money[depth]
    for w in range(len(alive)):
        rest = alive[w]
        while rest:
            bit = _lowest(rest)
            rest &= rest - np.uint64(1)
            if price[w * 64 + bit] > slack or cost[w * 64 + bit] > money:
                alive[w] ^= np.uint64(1) << np.uint64(bit)


@njit(cache=True)
def _keep_those_that_cover_all(stack: _Stack, targets: Targets, depth: int) -> float:
    """Where one more row can be paid, it has to cover all that is open; words looked at."""
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
