"""Inequalities of Balas and Ng: targets that no single choice covers need two.

For targets S that are asked for once each, the choices that cover some of S and once more those
that cover all of S add up to 2 at least: one choice covers all, or two are needed. All facets with
the right side 2 are of this form (Balas and Ng 1989). Where the shares meet each target exactly,
one and two targets add up to 2; sets are found by descent from pairs that share half a choice.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy import sparse

from roadsight.base.arrays import Bools, Floats, Ints, Ints32
from roadsight.base.kernels import compiled, compiled_part

_PARTNERS = 5  # descents begin at each target with so many others; more of them take time
_CUTS = 60  # most cuts of a round; 100 were tried and did not pay
_LONGEST = 20  # most targets of a set: longer cuts slow the relaxation's steps
_BROKEN = 0.02  # least that a cut is broken by, of its right side of 2: less hardly moves the bound
# A step of a descent must gain this. The first may lose as much, since pairs begin level, and the
# rounding of sums must not let a descent go in circles.
_EVEN = 1e-4
_APART = 0.05  # least distance of a pair's common share from 0 and 1: nearer is next to decided
_MOST_MOVES = 3e9  # entries that all descents of a round may look at, about a second of work
_STEPS = 6  # of a descent, about: with `_MOST_MOVES` they say how many pairs can begin
_MOVE_S = 3e-10  # work by entry that a descent looks at, in seconds, measured
_READ_S = 1.5e-7  # work by entry of the constraints, in seconds, measured


def balas_ng_cuts(sources: list[Constraint], x: Floats) -> tuple[list[Constraint], float]:
    """Cuts that a solution breaks, the most broken first, and the work in seconds.

    Parameters
    ----------
    sources : constraints that hold for all covers and that x meets exactly; only those of targets
        that are asked for once are used. x : (m,) shares.
    """
    sources = [one for one in sources if one.low == 1 and one.value.max() == 1]
    support = np.flatnonzero(x > 1e-9)
    if not sources or not len(support):
        return [], 0.0
    matrix = stacked(sources, len(x)).astype(bool)
    pattern = matrix[:, support].toarray()
    kept = distinct(pattern)
    pattern, share = pattern[kept], x[support]
    # Pairs of targets to start from, (p, 2): those that share about half a choice.
    uneven = np.round(np.abs(common_shares(pattern, share) - 0.5), 9)
    np.fill_diagonal(uneven, np.inf)
    near = np.argsort(uneven, axis=1, kind="stable")[:, :_PARTNERS]
    pairs = np.column_stack([np.repeat(np.arange(len(uneven)), near.shape[1]), near.ravel()])
    pairs = np.unique(np.sort(pairs, axis=1), axis=0)
    pairs = pairs[uneven[pairs[:, 0], pairs[:, 1]] < 0.5 - _APART]
    most = max(int(_MOST_MOVES / _STEPS / pattern.size), 1)
    if len(pairs) > most:
        pairs = pairs[np.linspace(0, len(pairs) - 1, most).astype(np.int64)]
    sets, left, moves = _descend(np.ascontiguousarray(pattern.T, np.float64), share, pairs)
    found: dict[bytes, Ints] = {}
    for k in np.argsort(left, kind="stable"):
        if left[k] > 2 - _BROKEN or len(found) == _CUTS:
            break
        found.setdefault(sets[k].tobytes(), kept[sets[k]])
    cuts = []
    for chosen in found.values():
        count = np.asarray(matrix[chosen].sum(axis=0)).ravel()  # targets that each choice covers
        index = np.flatnonzero(count)
        value = np.where(count[index] == len(chosen), 2.0, 1.0)
        cuts.append(Constraint(index.astype(np.int32), value, 2.0))
    return cuts, _MOVE_S * moves + _READ_S * matrix.nnz


@compiled()
def _descend(pattern: Floats, x: Floats, pairs: Ints) -> tuple[Bools, Floats, float]:
    """From each pair of targets down to where none that joins or leaves lessens the left side.

    ``pattern`` has choices first, (choices, targets), and is 1 where a choice covers a target; its
    targets are the constraints that cuts are made of. Returns the sets (pairs, targets), their left
    sides, and how many entries were looked at.
    """
    targets = pattern.shape[1]
    sets = np.zeros((len(pairs), targets), np.bool_)
    left = np.full(len(pairs), 2.0)
    joins, leaves = np.zeros(targets), np.zeros(targets)
    moves = 0.0
    for s in range(len(pairs)):
        member, count = sets[s], pattern[:, pairs[s, 0]] + pattern[:, pairs[s, 1]]
        member[pairs[s]] = True
        size = 2
        while size < _LONGEST:
            moves += _try(pattern, x, count, size, joins, leaves)
            best, least = -1, left[s] + (_EVEN if size == 2 else -_EVEN)
            for t in range(targets):
                total = leaves[t] if member[t] else joins[t]
                if total < least:
                    best, least = t, total
            if best < 0:
                break
            step = -1 if member[best] else 1
            member[best] = not member[best]
            count += step * pattern[:, best]
            size += step
            left[s] = least
    return sets, left, moves


@compiled_part()
def _try(
    pattern: Floats, x: Floats, count: Floats, size: int, joins: Floats, leaves: Floats
) -> float:
    """Left sides once each target joins or leaves a set; how many entries were looked at.

    ``count`` tells how many targets of the set each choice covers. Targets leave sets of more than
    three.
    """
    joins[:], leaves[:] = 0.0, 0.0
    some = nearly_all = moves = 0.0
    for i in range(len(x)):
        if count[i] > 0:
            some += x[i]
        if count[i] >= size - 1:
            nearly_all += x[i]
        if count[i] == 0 or count[i] == size:
            moves += len(joins)
            for t in range(len(joins)):
                joins[t] += x[i] * pattern[i, t]
        if size > 3 and (count[i] == 1 or count[i] == size - 1):
            moves += len(joins)
            for t in range(len(joins)):
                leaves[t] -= x[i] * pattern[i, t]
    for t in range(len(joins)):
        joins[t] += some
        leaves[t] += some + nearly_all if size > 3 else np.inf
    return moves


# Inequalities that whole covers keep and shares break: half a sum of constraints, rounded up.
#
# Constraints ``a x >= b`` with an odd sum of b give ``ceil(sum a / 2) x >= (sum b + 1) / 2`` for
# whole x (zero-half cuts, Caprara and Fischetti 1996). Where all of them hold exactly, the cut is
# broken as soon as the choices with an odd sum have shares of less than 1 together, by half of
# what is missing.

_NEIGHBOURS = 10  # those that differ from a constraint least may join or leave a set with it
_STARTS = 250  # most constraints that a descent begins at, spread over all: what they find overlaps
_LONGEST_SUM = 40  # most constraints of a set: longer cuts slow the relaxation's steps
_LARGEST_LOW = 1000.0  # sum of right sides that no set may reach: cuts are made of cuts
_ODD_SHARE = 0.95  # choices of odd sum share less than this: cuts are broken by 0.025
_LEVEL = 1e-3  # moves that change the odd share by less than this neither gain nor lose
_CHANGE_S = 7e-10  # work by choice that a move changes, in seconds, measured


def parity_cuts(sources: list[Constraint], x: Floats) -> tuple[list[Constraint], float]:
    """Cuts that a solution breaks, the most broken first, and the work in seconds.

    Parameters
    ----------
    sources : constraints that hold for all covers and that x meets exactly. x : (m,) shares.
    """
    if not sources:
        return [], 0.0
    matrix, low = stacked(sources, len(x)), np.array([one.low for one in sources])
    support = np.flatnonzero(x > 1e-9)
    odd = np.asarray(matrix[:, support].toarray() % 2, bool)
    kept = distinct(np.column_stack([odd, low % 2]).astype(bool))
    odd, odd_low = odd[kept], (low[kept] % 2).astype(bool)
    starts = np.flatnonzero(odd_low)
    if not len(starts) or not len(support):
        return [], _READ_S * matrix.nnz
    if len(starts) > _STARTS:
        starts = starts[np.linspace(0, len(starts) - 1, _STARTS).astype(np.int64)]
    moves = _moves(odd, odd_low, x[support])
    sets, share, tried = _descend_by_parity(odd, x[support], *moves, starts, False)
    if share.min() >= _ODD_SHARE:
        sets, share, more = _descend_by_parity(odd, x[support], *moves, starts, True)
        tried += more
    work_s = _CHANGE_S * tried * len(moves[2]) + _READ_S * matrix.nnz
    found: dict[bytes, Ints] = {}
    for k in np.argsort(share, kind="stable"):
        if share[k] >= _ODD_SHARE or len(found) == _CUTS:
            break
        chosen = kept[sets[k]]
        if low[chosen].sum() < _LARGEST_LOW:
            found.setdefault(chosen.tobytes(), chosen)
    return _rounded(list(found.values()), matrix, low), work_s


def _rounded(sets: list[Ints], matrix: sparse.csr_matrix, low: Floats) -> list[Constraint]:
    """Half the sum of each set of constraints, rounded up."""
    if not sets:
        return []
    start = np.cumsum([0] + [len(chosen) for chosen in sets])
    member = sparse.csr_matrix(
        (np.ones(start[-1]), np.concatenate(sets), start), shape=(len(sets), len(low))
    )
    total = (member @ matrix).tocsr()
    total.sort_indices()
    right = np.ceil(member @ low / 2)
    value = np.minimum(np.ceil(total.data / 2), np.repeat(right, np.diff(total.indptr)))
    parts = [slice(a, b) for a, b in pairwise(total.indptr.tolist())]
    index = total.indices.astype(np.int32)
    return [
        Constraint(index[part], value[part], float(least))
        for part, least in zip(parts, right, strict=True)
    ]


def _moves(odd: Bools, odd_low: Bools, x: Floats) -> tuple[Ints, Ints, Ints]:
    """What keeps the sum of right sides odd: near pairs of constraints, and single ones.

    Returns pairs (p, 2) of constraints, twice the same for one; where the choices of each that
    change parity begin, (p + 1,); and these choices.
    """
    common = common_shares(odd, x)
    size = common.diagonal()
    apart = np.round(size[:, None] + size - 2 * common, 9)
    np.fill_diagonal(apart, np.inf)
    near = np.argsort(apart, axis=1, kind="stable")[:, :_NEIGHBOURS]
    every = np.arange(len(odd))
    pairs = np.column_stack([np.repeat(every, near.shape[1]), near.ravel()])
    pairs = np.unique(np.sort(pairs, axis=1), axis=0)
    pairs = pairs[pairs[:, 0] != pairs[:, 1]]
    pairs = pairs[odd_low[pairs[:, 0]] == odd_low[pairs[:, 1]]]
    even = np.flatnonzero(~odd_low)
    changed = np.vstack([odd[pairs[:, 0]] ^ odd[pairs[:, 1]], odd[even]])
    first = np.append(0, np.cumsum(changed.sum(axis=1)))
    return np.vstack([pairs, np.column_stack([even, even])]), first, np.nonzero(changed)[1]


@compiled()
def _descend_by_parity(
    odd: Bools, x: Floats, pairs: Ints, first: Ints, index: Ints, starts: Ints, level: bool
) -> tuple[Bools, Floats, int]:
    """From each single constraint down to where no move lessens the shares of odd choices.

    With ``level``, a move that neither lessens nor adds may let the set grow: along an odd ring,
    only the last one pays. Returns the sets (starts, constraints), the shares, and how often all
    moves were tried.
    """
    tried = 0
    sets = np.zeros((len(starts), len(odd)), np.bool_)
    share = np.zeros(len(starts))
    for s in range(len(starts)):
        member, gain = sets[s], x.copy()  # what a choice's change of parity adds
        member[starts[s]] = True
        size = 1
        for i in range(len(x)):
            if odd[starts[s], i]:
                share[s] += x[i]
                gain[i] = -x[i]
        while size < _LONGEST_SUM:
            best, least = -1, _LEVEL if level else -_LEVEL
            tried += 1
            for k in range(len(pairs)):
                total = 0.0
                for p in range(first[k], first[k + 1]):
                    total += gain[index[p]]
                if total < least and (
                    total < -_LEVEL or not (member[pairs[k, 0]] or member[pairs[k, 1]])
                ):
                    best, least = k, total
            if best < 0:
                break
            share[s] += least
            for p in range(first[best], first[best + 1]):
                gain[index[p]] = -gain[index[p]]
            for end in range(1 if pairs[best, 0] == pairs[best, 1] else 2):
                r = pairs[best, end]
                member[r] = not member[r]
                size += 1 if member[r] else -1
    return sets, share, tried


_USUAL = 2.0**10  # coefficients between this and its inverse are taken as they are


@dataclass(frozen=True)
class Constraint:
    """``sum value_k x_index_k >= low``; of covers, all of them are whole numbers."""

    index: Ints32
    value: Floats
    low: float

    def scaled(self) -> Constraint:
        """The same in coefficients of the size of 1: smaller ones drown in solvers' tolerances."""
        size = float(np.abs(self.value).max(initial=0.0))
        if not size or 1 / _USUAL < size < _USUAL:
            return self
        return Constraint(self.index, self.value / size, self.low / size)


def stacked(constraints: list[Constraint], choices: int) -> sparse.csr_matrix:
    """Left sides of some constraints, (constraints, choices)."""
    start = np.cumsum([0] + [len(one.index) for one in constraints])
    index = np.concatenate([np.empty(0, np.int32), *(one.index for one in constraints)])
    value = np.concatenate([np.empty(0), *(one.value for one in constraints)])
    return sparse.csr_matrix((value, index, start), shape=(len(constraints), choices))


def common_shares(pattern: Bools, x: Floats) -> Floats:
    """Sum of the shares of the choices that each two constraints have in common.

    Parameters
    ----------
    pattern : (constraints, choices) which choices are in each. x : (choices,) shares.

    Returns
    -------
    (constraints, constraints)
    """
    # Sparse, because the order of sums in a dense product depends on the number of threads.
    entries = sparse.csr_matrix(pattern.astype(np.float64))
    return np.asarray((entries @ sparse.diags_array(x) @ entries.T).toarray())


def distinct(pattern: Bools) -> Ints:
    """Numbers of the first constraints of each kind in a pattern (constraints, choices), sorted."""
    _, first = np.unique(np.packbits(pattern, axis=1), axis=0, return_index=True)
    return np.sort(first)
