"""Constraints of a relaxation, and how the shares of a solution lie in them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse

from roadsight.base.arrays import Bools, Floats, Ints, Ints32


@dataclass(frozen=True)
class Constraint:
    """``sum value_k x_index_k >= low``, all of them whole numbers."""

    index: Ints32
    value: Floats
    low: float


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
