"""Inequalities that whole covers keep and shares break: half a sum of constraints, rounded up.

Constraints ``a x >= b`` with an odd sum of b give ``ceil(sum a / 2) x >= (sum b + 1) / 2`` for
whole x (zero-half cuts, Caprara and Fischetti 1996). Where all of them hold exactly, the cut is
broken as soon as the choices with an odd sum have shares of less than 1 together, by half of what
is missing.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from scipy import sparse

from roadsight.base.arrays import Bools, Floats, Ints
from roadsight.base.kernels import compiled
from roadsight.setcover.common.constraints import Constraint, common_shares, distinct, stacked

_NEIGHBOURS = 10
"""Each constraint may join or leave a set together with so many that differ from it least."""
_STARTS = 250
"""Most constraints that a descent begins at, spread over all: what they find overlaps."""
_CUTS = 60
"""Most cuts of a round; 100 were tried and did not pay."""
_LONGEST = 40
"""Most constraints of a set: longer cuts have more entries, and the relaxation's steps take longer.
"""
_LARGEST_LOW = 1000.0
"""Sum of right sides that no set may reach: cuts are made of cuts, and values must not grow."""
_ODD_SHARE = 0.95
"""Cuts count where choices of odd sum share less than this, so that they are broken by 0.025."""
_EVEN = 1e-3
"""Moves that change the odd share by less than this are level: they neither gain nor lose."""
_MOVE_S = 7e-10
"""Work by choice that a move changes, in seconds, measured."""
_READ_S = 1.5e-7
"""Work by entry of the constraints, in seconds, measured."""


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
    sets, share, tried = _descend(odd, x[support], *moves, starts, False)
    if share.min() >= _ODD_SHARE:
        sets, share, more = _descend(odd, x[support], *moves, starts, True)
        tried += more
    work_s = _MOVE_S * tried * len(moves[2]) + _READ_S * matrix.nnz
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
def _descend(
    odd: Bools,
    x: Floats,
    pairs: Ints,
    first: Ints,
    index: Ints,
    starts: Ints,
    level: bool,
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
        while size < _LONGEST:
            best, least = -1, _EVEN if level else -_EVEN
            tried += 1
            for k in range(len(pairs)):
                total = 0.0
                for p in range(first[k], first[k + 1]):
                    total += gain[index[p]]
                if total < least and (
                    total < -_EVEN or not (member[pairs[k, 0]] or member[pairs[k, 1]])
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
