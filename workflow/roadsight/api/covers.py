"""Covers with proof, from a matrix of SciPy, NumPy or pandas."""

from __future__ import annotations

import os
from typing import Any, Literal

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike
from scipy import sparse

from roadsight.base import SEED
from roadsight.io.records.matrices import read_matrix
from roadsight.setcover import Cover, CoverProblem, solve_cover_problem
from roadsight.setcover.common.problem import HIGHS, OWN
from roadsight.setcover.plans.deployment import Deployment
from roadsight.setcover.plans.whole import solve_whole


def cover(
    matrix: Any,
    costs: ArrayLike | None = None,
    *,
    at_least: ArrayLike = 1,
    groups: ArrayLike | None = None,
    mandatory: ArrayLike = (),
    forbidden: ArrayLike = (),
    seconds: float | None = None,
    gap: float = 0.0,
    seed: int = SEED,
    solver: Literal["own", "highs"] = OWN,
) -> Cover:
    """Cheapest choices that cover every target, with the bound that proves it (paper 1, Eqs. 5-7).

    Parameters
    ----------
    matrix : (choices, targets), positive = covers: sparse, an array, or a DataFrame such as the
        service areas of spopt, or the path of such a sparse matrix (.npz). Rows are choices; of a
        model in columns give the transpose.
    costs : (choices,) positive; None = 1 each.
    at_least : how often each target is covered, one number or (targets,).
    groups : (choices,) at most one choice of a group; negative = none.
    mandatory, forbidden : numbers of choices.
    seconds : limit by the clock; None = until it is proven.
    gap : leave so near to the bound, as a share of the cost.
    seed : of the search. With the same seed and no limit by the clock, the cover is the same.
    solver : "own", or "highs" for HiGHS on the whole integer program, with a gap of 1e-5 or more.

    Returns
    -------
    ``status``, ``chosen`` (numbers of rows), ``objective``, ``bound``, ``gap``, ``uncoverable``

    Raises
    ------
    InputError : a shape, type or value that cannot be used.

    Examples
    --------
    >>> import roadsight
    >>> best = roadsight.cover([[1, 1, 0], [0, 1, 1], [1, 1, 1]], costs=[1, 1, 3])
    >>> best.status, best.chosen.tolist(), best.objective
    ('optimal', [0, 1], 2.0)
    """
    if isinstance(matrix, (str, os.PathLike)):
        matrix = read_matrix(str(matrix))
    if isinstance(matrix, pd.DataFrame):
        matrix = matrix.to_numpy()
    if not sparse.issparse(matrix):
        matrix = sparse.csr_matrix(np.asarray(matrix))
    problem = CoverProblem(matrix, costs, groups, at_least, mandatory, forbidden)
    if solver == HIGHS:
        return solve_whole(Deployment(problem), seconds, gap)
    return solve_cover_problem(problem, seconds, seed, gap)
