"""Inequalities of Balas and Ng: targets that no single choice covers need two.

For targets S that are asked for once each, the choices that cover some of S and once more those
that cover all of S add up to 2 at least: one choice covers all, or two are needed. All facets with
the right side 2 are of this form (Balas and Ng 1989). Where the shares meet each target exactly,
one and two targets add up to 2; sets are found by descent from pairs that share half a choice.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from roadsight.base.arrays import Bools, Floats, Ints
from roadsight.base.kernels import compiled, compiled_part
from roadsight.setcover.common.constraints import Constraint, common_shares, distinct, stacked

_PARTNERS = 5
"""Descents begin at each target with so many others; more of them take time."""
_CUTS = 60
"""Most cuts of a round; 100 were tried and did not pay."""
_LONGEST = 20
"""Most targets of a set: longer cuts have more entries, and the relaxation's steps take longer."""
_BROKEN = 0.02
"""Least that a cut is broken by, of its right side of 2: less hardly moves the bound."""
_EVEN = 1e-4
"""A step of a descent must gain this. The first may lose as much, since pairs begin level, and the
rounding of sums must not let a descent go in circles."""
_APART = 0.05
"""Least distance of a pair's common share from 0 and 1: one nearer is next to decided already."""
_MOST_MOVES = 3e9
"""Entries of the pattern that all descents of a round may look at, about a second of work."""
_STEPS = 6
"""Steps of a descent, about: by them and `_MOST_MOVES` it is told how many pairs can begin."""
_MOVE_S = 3e-10
"""Work by entry that a descent looks at, in seconds, measured."""
_READ_S = 1.5e-7
"""Work by entry of the constraints, in seconds, measured."""


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
    pairs = _pairs(common_shares(pattern, share), pattern.size)
    sets, left, moves = _descend(np.ascontiguousarray(pattern.T, np.float64), share, pairs)
    found: dict[bytes, Ints] = {}
    for k in np.argsort(left, kind="stable"):
        if left[k] > 2 - _BROKEN or len(found) == _CUTS:
            break
        found.setdefault(sets[k].tobytes(), kept[sets[k]])
    cuts = [_cut(matrix[chosen].sum(axis=0), len(chosen)) for chosen in found.values()]
    return cuts, _MOVE_S * moves + _READ_S * matrix.nnz


def _pairs(common: Floats, entries: int) -> Ints:
    """Pairs of targets to start from, (p, 2): those that share about half a choice."""
    uneven = np.round(np.abs(common - 0.5), 9)
    np.fill_diagonal(uneven, np.inf)
    near = np.argsort(uneven, axis=1, kind="stable")[:, :_PARTNERS]
    pairs = np.column_stack([np.repeat(np.arange(len(common)), near.shape[1]), near.ravel()])
    pairs = np.unique(np.sort(pairs, axis=1), axis=0)
    pairs = pairs[uneven[pairs[:, 0], pairs[:, 1]] < 0.5 - _APART]
    most = max(int(_MOST_MOVES / _STEPS / entries), 1)
    if len(pairs) > most:
        pairs = pairs[np.linspace(0, len(pairs) - 1, most).astype(np.int64)]
    return pairs


def _cut(count: NDArray[np.integer], size: int) -> Constraint:
    """Cut of a set of targets, given how many of them each choice covers."""
    count = np.asarray(count).ravel()
    index = np.flatnonzero(count)
    return Constraint(index.astype(np.int32), np.where(count[index] == size, 2.0, 1.0), 2.0)


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
