"""Compiled search among the covers of one cost, see `second`."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from roadsight.base.arrays import Bools, Floats, Ints, Ints32
from roadsight.base.kernels import compiled, compiled_part

LEVELS = 2  # further times that are counted: once more than asked, twice more
_DIVIDED, _CLOSED = -1, -2  # what a node of the search is that is no leaf
# Work of a node, in entries that are added or removed. This and the next four are a fit to 12
# cases: plans of the generated highway, and roads of 10 to 1,000 sensors that see 4 to 80 targets.
_NODE_WORK = 150
_CHOICE_WORK = 20  # work of adding or removing a choice, beside its entries
_FIT_WORK = 5  # work of looking whether a choice fits
_LAST_WORK = 4  # work of looking at a target for the last choice
_READ_PER_ENTRY = 10  # so many numbers are read or zeroed in a row at the work of one entry


class Rules(NamedTuple):
    """What covers are made of.

    Costs, prices and refund are in the unit of the costs; weights, gains and base in that of the
    weights.

    Parameters
    ----------
    start, target : targets of each choice, CSR (choices, targets), sorted.
    tstart, choice : choices of each target, CSC.
    need : (targets,) how often each is to be covered. weight : (targets,) 0 where need is 0.
    cost : (choices,). set_start, sets : sets of each choice of which at most one is taken, CSR.
    price : (targets,) what covering a target once costs at least, by a dual of the cover.
    refund : most that prices may exceed costs by, in all; 0 or less.
    gain : (choices,) how much a choice adds to a bound of the first level; base : the bound
        without any.
    most_gain, cost_of_most : gains in the order of gain by cost, and costs, summed up from 0.
    stretch : (targets,) stretch of road of each target, -1 for none; stretches : how many.
    order : (targets,) the rarest first.
    allowed : (choices,) which may be taken.
    """

    start: Ints32
    target: Ints32
    tstart: Ints32
    choice: Ints32
    need: Ints
    weight: Floats
    cost: Floats
    set_start: Ints32
    sets: Ints32
    price: Floats
    refund: float
    gain: Floats
    base: float
    most_gain: Floats
    cost_of_most: Floats
    stretch: Ints
    stretches: int
    order: Ints
    allowed: Bools


class _State(NamedTuple):
    """``times`` (targets,) that each target is covered, ``used`` sets, values, work done.

    ``order`` : targets that are to be covered, the rarest first.
    ``banned`` : (choices,) one more than the depth whose branches left it out, 0 for none.
    ``value`` : (4,) weight seen once more and twice more, price of what is uncovered, gain taken.
    ``work`` : (1,) in entries that are added or removed.
    """

    order: Ints
    times: Ints
    used: Bools
    banned: Ints
    value: Floats
    work: Ints


class _Stack(NamedTuple):
    """By depth: place of the target that is divided, its next choice, choice taken, money left."""

    place: Ints
    turn: Ints
    taken: Ints
    left: Floats


@compiled()
def complete_covers(
    inside: Bools,
    money: float,
    least_cost: float,
    slack: float,
    r: Rules,
    best: Floats,
    most_work: int,
) -> tuple[Bools, bool, bool, int]:
    """The best completion of some choices to a cover, if it is better than the best known.

    Branches over the choices of the rarest target that is not covered; each choice is left out of
    the branches behind it, so that no set comes up twice.

    Parameters
    ----------
    inside : (choices,) taken for certain. money : what the others may cost.
    least_cost : of any choice, above 0. slack : costs that differ by less are alike.
    best : (4,) weight seen once more, twice more, stretches, what it leaves of the money; of the
        best cover, changed in place. Where none is known, -1 each, and 0 left.
    most_work : work after which it stops, in entries.

    Returns
    -------
    the cover found (choices,), whether one was, whether all were looked at, work done. Where the
    cover found leaves more of the money than the best did, not all of its cost were looked at.
    """
    depths = int(money / least_cost + 1e-9) + 2
    s, k = (
        _begin(inside, r),
        _Stack(
            np.zeros(depths, np.int64),
            np.zeros(depths, np.int64),
            np.full(depths, -1, np.int64),
            np.full(depths, money),
        ),
    )
    cover, is_found = inside.copy(), False
    found = np.empty(len(r.cost), np.int64)
    depth = 0
    while depth >= 0:
        if s.work[0] > most_work:
            return cover, is_found, False, s.work[0]
        last = _enter(depth, least_cost, best, r, s, k, found)
        if last >= 0:
            # A leaf: nothing is missing (last = 0), or one of the choices found.
            for c in range(max(last, 1)):
                j = found[c] if last else -1
                first, second = _value_with(j, r, s)
                spare = k.left[depth] - (r.cost[j] if j >= 0 else 0.0)
                if _is_better(first, second, spare, slack, j, best, r, s):
                    is_found = True
                    for i in range(len(cover)):
                        cover[i] = inside[i]
                    for d in range(depth):
                        cover[k.taken[d]] = True
                    if j >= 0:
                        cover[j] = True
        if last != _DIVIDED:
            depth = _leave(depth, r, s, k)
        while depth >= 0 and not _next_branch(depth, r, s, k):
            depth = _leave_divided(depth, r, s, k)
        depth += depth >= 0
    return cover, is_found, True, s.work[0]


@compiled_part()
def _add(j: int, r: Rules, s: _State) -> None:
    for p in range(r.start[j], r.start[j + 1]):
        t = r.target[p]
        spare = s.times[t] - r.need[t]
        if spare < 0:
            s.value[2] -= r.price[t]
        elif spare < LEVELS:
            s.value[spare] += r.weight[t]
        s.times[t] += 1
    for p in range(r.set_start[j], r.set_start[j + 1]):
        s.used[r.sets[p]] = True
    s.value[3] += r.gain[j]
    s.work[0] += _CHOICE_WORK + r.start[j + 1] - r.start[j]


@compiled_part()
def _remove(j: int, r: Rules, s: _State) -> None:
    for p in range(r.start[j], r.start[j + 1]):
        t = r.target[p]
        s.times[t] -= 1
        spare = s.times[t] - r.need[t]
        if spare < 0:
            s.value[2] += r.price[t]
        elif spare < LEVELS:
            s.value[spare] -= r.weight[t]
    for p in range(r.set_start[j], r.set_start[j + 1]):
        s.used[r.sets[p]] = False
    s.value[3] -= r.gain[j]
    s.work[0] += _CHOICE_WORK + r.start[j + 1] - r.start[j]


@compiled_part()
def _fits(j: int, money: float, r: Rules, s: _State) -> bool:
    if not r.allowed[j] or s.banned[j] or r.cost[j] > money:
        return False
    taken = 0
    for p in range(r.set_start[j], r.set_start[j + 1]):
        taken += s.used[r.sets[p]]
    return taken == 0


@compiled_part()
def _stretches_seen(r: Rules, s: _State, j: int) -> int:
    """Stretches with a target that is seen once more than asked; with choice j added, if any."""
    seen = np.zeros(r.stretches, np.bool_)
    for t in range(len(r.need)):
        k = r.stretch[t]
        if k >= 0 and r.need[t] > 0 and s.times[t] > r.need[t]:
            seen[k] = True
    if j >= 0:
        for p in range(r.start[j], r.start[j + 1]):
            t = r.target[p]
            k = r.stretch[t]
            if k >= 0 and r.need[t] > 0 and s.times[t] >= r.need[t]:
                seen[k] = True
        s.work[0] += r.start[j + 1] - r.start[j]
    s.work[0] += len(r.need) + r.stretches // _READ_PER_ENTRY
    return int(seen.sum())


@compiled_part()
def _is_better(
    first: float,
    second: float,
    spare: float,
    slack: float,
    j: int,
    best: Floats,
    r: Rules,
    s: _State,
) -> bool:
    """Whether a cover is better than the best; if so, it becomes the best's value.

    A cover that costs less (by more than ``slack``) is better, whatever it sees.
    """
    if spare < best[3] - slack:
        return False
    alike = spare <= best[3] + slack
    near = 1e-9 * max(1.0, best[0])
    if alike and first < best[0] - near:
        return False
    level = alike and first <= best[0] + near
    if level and second < best[1] - near:
        return False
    stretches = _stretches_seen(r, s, j)
    if level and second <= best[1] + near and stretches <= best[2]:
        return False
    best[0], best[1], best[2], best[3] = first, second, stretches, max(spare, best[3])
    return True


@compiled_part()
def _kept(found: Ints, count: int, choice: Ints32, first: int, end: int) -> int:
    """Number of the found choices, sorted, that are among those of a target, sorted as well."""
    kept, q = 0, first
    for c in range(count):
        low, high = q, end
        while low < high:
            middle = (low + high) >> 1
            if choice[middle] < found[c]:
                low = middle + 1
            else:
                high = middle
        q = low
        if q == end:
            break
        if choice[q] == found[c]:
            found[kept] = found[c]
            kept += 1
    return kept


@compiled_part()
def _last_choices(first: int, money: float, r: Rules, s: _State, found: Ints) -> int:
    """Number of choices, into ``found``, that cover alone all that is left uncovered.

    first : place of the first target left in the order.
    """
    tstart, choice, order, need, seen = r.tstart, r.choice, s.order, r.need, s.times
    count, t, work = 0, order[first], 0
    for q in range(r.tstart[t], r.tstart[t + 1]):
        if _fits(r.choice[q], money, r, s):
            found[count] = r.choice[q]
            count += 1
    s.work[0] += _FIT_WORK * (r.tstart[t + 1] - r.tstart[t])
    if s.times[t] + 1 < r.need[t]:
        return 0
    for k in range(first + 1, len(order)):
        other = order[k]
        work += _LAST_WORK
        lacking = need[other] - seen[other]
        if lacking <= 0:
            continue
        if lacking > 1:
            count = 0
            break
        kept = _kept(found, count, choice, tstart[other], tstart[other + 1])
        work += count
        count = kept
        if not count:
            break
    s.work[0] += work
    return count


@compiled_part()
def _begin(inside: Bools, r: Rules) -> _State:
    count = np.zeros(len(r.need), np.int64)
    for j in range(len(inside)):
        if inside[j]:
            for p in range(r.start[j], r.start[j + 1]):
                count[r.target[p]] += 1
    missing, order = 0, np.empty(len(r.order), r.order.dtype)
    for t in r.order:
        if count[t] < r.need[t]:
            order[missing] = t
            missing += 1
    sets = 0
    for number in r.sets:
        sets = max(sets, number + 1)
    s = _State(
        order[:missing],
        np.zeros(len(r.need), np.int64),
        np.zeros(sets, np.bool_),
        np.zeros(len(r.cost), np.int64),
        np.zeros(4),
        np.zeros(1, np.int64),
    )
    s.value[2] = (r.price * r.need).sum()
    read = 2 * len(r.cost) + 4 * len(r.need)
    for choice in range(len(inside)):
        if inside[choice]:
            _add(choice, r, s)
            s.banned[choice] = -1
            read += r.start[choice + 1] - r.start[choice]
    s.work[0] += read // _READ_PER_ENTRY
    return s


@compiled_part()
def _enter(
    depth: int, least_cost: float, best: Floats, r: Rules, s: _State, k: _Stack, found: Ints
) -> int:
    """What a node is: `_DIVIDED`, `_CLOSED`, or a leaf with so many choices that complete it."""
    if _is_hopeless(k.left[depth], best[0], r, s):
        return _CLOSED
    place = k.place[depth]
    while place < len(s.order) and s.times[s.order[place]] >= r.need[s.order[place]]:
        place += 1
    s.work[0] += _NODE_WORK + place - k.place[depth]
    if place == len(s.order):
        return 0
    if k.left[depth] < 2 * least_cost * (1 - 1e-9):
        return _last_choices(place, k.left[depth], r, s, found) or _CLOSED
    k.place[depth], k.turn[depth] = place, r.tstart[s.order[place]]
    return _DIVIDED


@compiled_part()
def _value_with(j: int, r: Rules, s: _State) -> tuple[float, float]:
    """Weight seen once more and twice more with choice j added, if any."""
    first, second = s.value[0], s.value[1]
    if j < 0:
        return first, second
    for p in range(r.start[j], r.start[j + 1]):
        t = r.target[p]
        spare = s.times[t] - r.need[t]
        if spare == 0:
            first += r.weight[t]
        elif spare == 1:
            second += r.weight[t]
    s.work[0] += r.start[j + 1] - r.start[j]
    return first, second


@compiled_part()
def _next_branch(depth: int, r: Rules, s: _State, k: _Stack) -> bool:
    """Take the next choice of a node's target, for the node below; False where none is left."""
    end = r.tstart[s.order[k.place[depth]] + 1]
    while k.turn[depth] < end:
        j = r.choice[k.turn[depth]]
        k.turn[depth] += 1
        s.work[0] += _FIT_WORK
        if _fits(j, k.left[depth], r, s):
            _add(j, r, s)
            s.banned[j] = depth + 1
            k.taken[depth] = j
            k.left[depth + 1] = k.left[depth] - r.cost[j]
            k.place[depth + 1] = k.place[depth]
            return True
    return False


@compiled_part()
def _leave(depth: int, r: Rules, s: _State, k: _Stack) -> int:
    """Take out the choice that led to a node; the depth above."""
    if depth:
        _remove(k.taken[depth - 1], r, s)
    return depth - 1


@compiled_part()
def _leave_divided(depth: int, r: Rules, s: _State, k: _Stack) -> int:
    """The same; the choices that its branches left out may be taken again."""
    first = r.tstart[s.order[k.place[depth]]]
    for q in range(first, k.turn[depth]):
        if s.banned[r.choice[q]] == depth + 1:
            s.banned[r.choice[q]] = 0
    s.work[0] += _FIT_WORK * (k.turn[depth] - first)
    return _leave(depth, r, s, k)


@compiled_part()
def _is_hopeless(money: float, best: float, r: Rules, s: _State) -> bool:
    """Whether what is uncovered costs too much, or the best cannot be reached any more."""
    if s.value[2] + r.refund > money + 1e-7 * max(1.0, money):
        return True
    k = np.searchsorted(r.cost_of_most, money, side="right") - 1
    more = r.most_gain[k]
    if k + 1 < len(r.most_gain):
        step = r.cost_of_most[k + 1] - r.cost_of_most[k]
        more += (money - r.cost_of_most[k]) / step * (r.most_gain[k + 1] - r.most_gain[k])
    return r.base + s.value[3] + more < best - 1e-6 * max(1.0, best)
