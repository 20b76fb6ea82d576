"""Coverage of the targets by all candidates of a plan (paper 1, section 2.5)."""

from __future__ import annotations

import numpy as np
import pandas as pd
from scipy import sparse

from roadsight.base.arrays import Floats, Ints


def detection_matrix(
    detections: pd.DataFrame, choices: pd.MultiIndex, targets: pd.Index
) -> sparse.csr_matrix:
    """Boolean matrix, rows = choices (sensor, candidate), columns = targets.

    Parameters
    ----------
    detections : columns sensor, candidate, target; one row per seen target.
    """
    # Names are looked up once per category, not once per detection.
    sensor, candidate, target = (
        detections[name].astype("category").cat for name in ("sensor", "candidate", "target")
    )
    pairs = pd.MultiIndex.from_product([sensor.categories, candidate.categories])
    pair = sensor.codes.to_numpy(np.int64) * len(candidate.categories) + candidate.codes
    rows = choices.get_indexer(pairs)[pair] if len(pair) else np.empty(0, np.int64)
    columns = targets.get_indexer(target.categories)[target.codes]
    known = (rows >= 0) & (columns >= 0)
    ones = np.ones(int(known.sum()), dtype=bool)
    shape = (len(choices), len(targets))
    return sparse.csr_matrix((ones, (rows[known], columns[known])), shape=shape, dtype=bool)


def times_seen(matrix: sparse.csr_matrix, chosen: Ints) -> Ints:
    """How many of the chosen rows see each target (n,)."""
    return np.asarray(matrix[chosen].sum(axis=0, dtype=np.int64)).ravel()


def availability(
    detections: pd.DataFrame, chosen: set[tuple[str, str]], targets: pd.Series
) -> Floats:
    """Share of the time (n,) in which at least one chosen sensor sees each target past traffic.

    Sensors at different places look past different vehicles, so that their shares are taken as
    independent: 1 - prod(1 - p). A target that none of them sees has 0.

    Parameters
    ----------
    detections : columns sensor, candidate, target, availability. chosen : sensor and candidate.
    """
    pairs = pd.MultiIndex.from_frame(detections[["sensor", "candidate"]])
    used = detections[pairs.isin(chosen)]
    never = (1 - used["availability"].astype(np.float64)).groupby(used["target"].astype(str)).prod()
    hidden = never.reindex(targets.astype(str), fill_value=1.0).to_numpy(np.float64)
    return np.asarray(1 - hidden)
