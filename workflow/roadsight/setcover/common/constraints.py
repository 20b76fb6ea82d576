"""Rows of a relaxation, and how the shares of a solution lie in them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse

from roadsight.base.arrays import Bools, Floats, Ints, Ints32


@dataclass(frozen=True)
class Row:
    """``sum value_k x_index_k >= low``, all of them whole numbers."""

    index: Ints32
    value: Floats
    low: float


def stacked(rows: list[Row], choices: int) -> sparse.csr_matrix:
    """Left sides of some rows, (rows, choices)."""
    start = np.cumsum([0] + [len(row.index) for row in rows])
    index = np.concatenate([np.empty(0, np.int32), *(row.index for row in rows)])
    value = np.concatenate([np.empty(0), *(row.value for row in rows)])
    return sparse.csr_matrix((value, index, start), shape=(len(rows), choices))


def common_shares(pattern: Bools, x: Floats) -> Floats:
    """Sum of the shares of the columns that each two rows of a pattern have in common."""
    # Sparse, because the order of sums in a dense product depends on the number of threads.
    entries = sparse.csr_matrix(pattern.astype(np.float64))
    return np.asarray((entries @ sparse.diags_array(x) @ entries.T).toarray())


def distinct(pattern: Bools) -> Ints:
    """Numbers of the first rows of each kind in a pattern, in their order."""
    _, first = np.unique(np.packbits(pattern, axis=1), axis=0, return_index=True)
    return np.sort(first)
