"""Compiled loops over sparse 0/1 matrices: packing, dominance, propagation."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from roadsight.base.arrays import Bools, Floats, Ints, Ints32
from roadsight.base.kernels import compiled, compiled_part

Bits = NDArray[np.uint64]


@compiled()
def pack_bits(start: Ints32, index: Ints32, members: int) -> Bits:
    """Bits (sets, words of 64 members) of sets in CSR form: targets by choice, or the reverse."""
    bits = np.zeros((len(start) - 1, (members + 63) // 64), np.uint64)
    for i in range(len(start) - 1):
        for p in range(start[i], start[i + 1]):
            bits[i, index[p] >> 6] |= np.uint64(1) << np.uint64(index[p] & 63)
    return bits


@compiled_part()
def _is_subset(bits: Bits, i: int, j: int, mask: Bits) -> bool:
    for w in range(bits.shape[1]):  # noqa: SIM110 (compiled)
        if bits[i, w] & mask[w] & ~bits[j, w]:
            return False
    return True


@compiled()
def drop_implied_targets(
    start: Ints32,
    index: Ints32,
    choice_start: Ints32,
    choice_index: Ints32,
    bits: Bits,
    need: Ints32,
) -> Bools:
    """Targets to keep: those that no kept target with fewer choices and as great a need implies.

    ``start, index`` is the matrix by target, ``choice_*`` by choice, ``bits`` packed by target.
    Of equal targets the lowest number stays.
    """
    count = len(start) - 1
    keep = np.ones(count, np.bool_)
    mask = np.full(bits.shape[1], ~np.uint64(0))
    for i in range(count):
        if not keep[i]:
            continue
        rarest = index[start[i]]
        for p in range(start[i], start[i + 1]):
            choice = index[p]
            width = choice_start[choice + 1] - choice_start[choice]
            if width < choice_start[rarest + 1] - choice_start[rarest]:
                rarest = choice
        size_i = start[i + 1] - start[i]
        for q in range(choice_start[rarest], choice_start[rarest + 1]):
            j = choice_index[q]
            size_j = start[j + 1] - start[j]
            if j == i or not keep[j] or size_j < size_i or need[j] > need[i]:
                continue
            if size_j == size_i and need[j] == need[i] and j < i:
                continue
            if _is_subset(bits, i, j, mask):
                keep[j] = False
    return keep


@compiled()
def residual_needs(
    start: Ints32, index: Ints32, need: Ints32, alive: Bools, fixed: Bools
) -> tuple[Ints32, Ints32]:
    """How often each target is still to be covered, and by how many free choices it can be."""
    left = need.copy()
    free = np.zeros(len(need), np.int32)
    for i in range(len(start) - 1):
        if fixed[i]:
            for p in range(start[i], start[i + 1]):
                left[index[p]] -= 1
        elif alive[i]:
            for p in range(start[i], start[i + 1]):
                free[index[p]] += 1
    return left, free


@compiled()
def drop_dominated_choices(
    start: Ints32,
    index: Ints32,
    target_start: Ints32,
    target_index: Ints32,
    bits: Bits,
    cost: Floats,
    group: Ints,
    left: Ints32,
    free: Ints32,
    alive: Bools,
    fixed: Bools,
    extra: Bools,
) -> int:
    """Switch off choices that others replace at no greater cost; returns how many.

    Choice i goes if a choice j of its own group covers all that i still covers, or if k such
    choices outside all groups do. k is the greatest need left among the targets of i: were they
    fewer, all of them might be taken beside i. A choice of another group cannot stand in, because
    its group may be taken. Choices go one at a time, the highest number first, so that of equal
    ones the lowest stay. ``extra`` (constraints, choices): further sets of which whatever stands
    in for a member must be one.
    """
    mask = np.zeros(bits.shape[1], np.uint64)
    for t in range(len(left)):
        if left[t] > 0:
            mask[t >> 6] |= np.uint64(1) << np.uint64(t & 63)
    gone = 0
    for i in range(len(start) - 2, -1, -1):
        if not alive[i] or fixed[i]:
            continue
        rarest, wanted = _rarest_open(i, start, index, left, free)
        if rarest < 0:
            dominated = not _is_member(extra, i)
        else:
            found = 0
            for q in range(target_start[rarest], target_start[rarest + 1]):
                j = target_index[q]
                if j == i or not alive[j] or fixed[j] or cost[j] > cost[i]:
                    continue
                same = group[j] >= 0 and group[j] == group[i]
                if (group[j] < 0 or same) and _stands_in(bits, i, j, mask, extra):
                    found += wanted if same else 1
                if found >= wanted:
                    break
            dominated = found >= wanted
        if dominated:
            alive[i] = False
            gone += 1
    return gone


@compiled_part()
def _rarest_open(
    i: int, start: Ints32, index: Ints32, left: Ints32, free: Ints32
) -> tuple[int, int]:
    """Open target of choice i with the fewest free choices (-1: none), the greatest need left."""
    rarest = -1
    wanted = 1
    for p in range(start[i], start[i + 1]):
        t = index[p]
        if left[t] > 0:
            wanted = max(wanted, left[t])
            if rarest < 0 or free[t] < free[rarest]:
                rarest = t
    return rarest, wanted


@compiled_part()
def _is_member(extra: Bools, i: int) -> bool:
    for k in range(extra.shape[0]):  # noqa: SIM110 (compiled)
        if extra[k, i]:
            return True
    return False


@compiled_part()
def _stands_in(bits: Bits, i: int, j: int, mask: Bits, extra: Bools) -> bool:
    """Whether choice j covers all that i covers in ``mask`` and is in all its extra sets."""
    for k in range(extra.shape[0]):
        if extra[k, i] and not extra[k, j]:
            return False
    return _is_subset(bits, i, j, mask)


@compiled()
def propagate(
    start: Ints32,
    index: Ints32,
    target_start: Ints32,
    target_index: Ints32,
    need: Ints32,
    group: Ints,
    alive: Bools,
    fixed: Bools,
    extra: Bools,
) -> tuple[bool, Ints32, Ints32]:
    """Fix choices without alternative and switch off group mates, until nothing changes.

    Returns
    -------
    feasible so far, needs left (n,), free choices of each target (n,); alive, fixed change in
    place.
    """
    while True:
        if not _close_groups(group, alive, fixed):
            return False, need, need
        left, free = residual_needs(start, index, need, alive, fixed)
        changed = False
        for t in range(len(need)):
            if left[t] > free[t]:
                return False, left, free
            if left[t] > 0 and left[t] == free[t]:
                for q in range(target_start[t], target_start[t + 1]):
                    choice = target_index[q]
                    changed = changed or (alive[choice] and not fixed[choice])
                    fixed[choice] = fixed[choice] or alive[choice]
        for k in range(extra.shape[0]):
            state = _fix_last_member(extra[k], alive, fixed)
            if state < 0:
                return False, left, free
            changed = changed or state > 0
        if not changed:
            return True, left, free


@compiled_part()
def _close_groups(group: Ints, alive: Bools, fixed: Bools) -> bool:
    """Switch off the mates of fixed choices; False where two of a group are fixed."""
    taken = np.zeros(len(group), np.bool_)  # indexed by group: there are no more than choices
    for i in range(len(group)):
        if fixed[i] and group[i] >= 0:
            if taken[group[i]]:
                return False
            taken[group[i]] = True
    for i in range(len(group)):
        if not fixed[i] and group[i] >= 0 and taken[group[i]]:
            alive[i] = False
    return True


@compiled_part()
def _fix_last_member(members: Bools, alive: Bools, fixed: Bools) -> int:
    """Take a set's only free choice: 1 if there was one, 0 if nothing to do, -1 if none left."""
    free = 0
    last = -1
    for i in range(len(members)):
        if members[i] and fixed[i]:
            return 0
        if members[i] and alive[i]:
            free += 1
            last = i
    if free == 1:
        fixed[last] = True
        return 1
    return 0 if free else -1


@compiled()
def coverage(start: Ints32, index: Ints32, x: Floats, targets: int) -> Floats:
    """Sum of the shares x of the choices that cover each target."""
    total = np.zeros(targets)
    for i in range(len(x)):
        if x[i] > 1e-9:
            for p in range(start[i], start[i + 1]):
                total[index[p]] += x[i]
    return total


@compiled()
def reduced_costs(start: Ints32, index: Ints32, cost: Floats, dual: Floats) -> Floats:
    """Costs of the choices less the duals of the targets that they cover."""
    reduced = cost.copy()
    for i in range(len(cost)):
        for p in range(start[i], start[i + 1]):
            reduced[i] -= dual[index[p]]
    return reduced


@compiled()
def count_of_rows(start: Ints32, index: Ints32, rows: Ints, columns: int) -> Ints:
    """How many of some rows have an entry in each column."""
    count = np.zeros(columns, np.int64)
    for row in rows:
        for p in range(start[row], start[row + 1]):
            count[index[p]] += 1
    return count


@compiled()
def sums_of_rows(start: Ints32, index: Ints32, rows: Ints, value: Floats) -> Floats:
    """Sum over the columns of each of some rows of a value by column."""
    total = np.zeros(len(rows))
    for k in range(len(rows)):
        for p in range(start[rows[k]], start[rows[k] + 1]):
            total[k] += value[index[p]]
    return total
