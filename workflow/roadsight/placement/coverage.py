"""Coverage of the targets by all candidates of a plan (paper 1, section 2.5)."""

from __future__ import annotations

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy import sparse


def detection_matrix(
    detections: pd.DataFrame, choices: pd.MultiIndex, targets: pd.Index
) -> sparse.csr_matrix:
    """Boolean matrix, rows = choices (sensor, candidate), columns = targets.

    Parameters
    ----------
    detections : columns sensor, candidate, target; one row per seen target.
    """
    pairs = pd.MultiIndex.from_frame(detections[["sensor", "candidate"]])
    rows = choices.get_indexer(pairs)
    columns = targets.get_indexer(pd.Index(detections["target"]))
    known = (rows >= 0) & (columns >= 0)
    ones = np.ones(int(known.sum()), dtype=bool)
    shape = (len(choices), len(targets))
    return sparse.csr_matrix((ones, (rows[known], columns[known])), shape=shape, dtype=bool)


def uncovered(targets: pd.Index, detections: pd.DataFrame) -> pd.Index:
    """Targets that no row of the detections names, in the order of ``targets``."""
    return targets[~targets.isin(detections["target"])]


def times_seen(matrix: sparse.csr_matrix, chosen: NDArray[np.int64]) -> NDArray[np.int64]:
    """How many of the chosen rows see each target (n,)."""
    return np.asarray(matrix[chosen].sum(axis=0, dtype=np.int64)).ravel()
