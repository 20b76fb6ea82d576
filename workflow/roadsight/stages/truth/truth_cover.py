"""Public covering instances on real data, one data set at a time."""

from __future__ import annotations

import sys
import time
from collections.abc import Sequence
from pathlib import Path

import highspy
import numpy as np
from scipy import sparse

from roadsight.base.arrays import Floats
from roadsight.evidence.truth_catalogue import Figure
from roadsight.io.records.matrices import read_element_list, read_set_list
from roadsight.setcover import CoverProblem, solve_cover_problem
from roadsight.stages.truth.truth_stage import measuring

# Public covering instances: our covers and bounds beside plain HiGHS in the same time.

LIMIT_S = 60.0
"""Processor time of either solver."""

BEST_KNOWN = {
    "camera_placement_ac01": 7,
    "sc_157_0": 94_400,
    "sc_1000_11": 146,
    "rail507": 174,
    "scpnrg1": 176,
    "scpcyc09": 772,
}
"""Costs from the literature, or proven by HiGHS; the other instances are open."""


def measure_cover(dataset: str, files: Sequence[Path]) -> list[Figure]:
    """Cost, bound, and how far the cost lies over the best known."""
    matrix, costs = _read(files[0])
    started = time.process_time()
    cover = solve_cover_problem(CoverProblem(matrix, costs), LIMIT_S, 1)
    used_s = time.process_time() - started
    peer_cost, peer_bound = highs_cover(matrix, costs)
    figures = [
        Figure("objective", cover.objective, peer_cost, used_s),
        Figure("bound", cover.bound, peer_bound, used_s),
    ]
    if dataset in BEST_KNOWN:
        best = BEST_KNOWN[dataset]
        over = [100 * (value / best - 1) for value in (cover.objective, peer_cost)]
        figures.append(Figure("over_best_known", over[0], over[1], used_s))
    return figures


def _read(path: Path) -> tuple[sparse.csr_matrix, Floats]:
    if path.stem.startswith("camera_placement"):
        matrix = read_element_list(path)
        return matrix, np.ones(matrix.shape[0])
    matrix, costs = read_set_list(path)
    if path.stem == "scpcyc09":  # the literature's optimum counts sets
        costs = np.ones(len(costs))
    return matrix, np.asarray(costs, np.float64)


def highs_cover(matrix: sparse.csr_matrix, costs: Floats) -> tuple[float, float]:
    """Best cost and bound of HiGHS as it comes, with an absolute gap below one step of the cost.

    HiGHS limits time by the clock; on one thread that is its processor time or more.
    """
    choices, targets = matrix.shape
    highs = highspy.Highs()  # type: ignore[no-untyped-call]
    highs.silent()
    for name, value in (("time_limit", LIMIT_S), ("threads", 1), ("mip_abs_gap", 0.999)):
        highs.setOptionValue(name, value)
    by_target = sparse.csr_matrix(matrix.T)
    program = highspy.HighsLp()
    program.num_col_ = choices
    program.num_row_ = targets
    program.col_cost_ = costs
    program.col_lower_ = np.zeros(choices)
    program.col_upper_ = np.ones(choices)
    program.row_lower_ = np.ones(targets)
    program.row_upper_ = np.full(targets, highspy.kHighsInf)
    program.a_matrix_.format_ = highspy.MatrixFormat.kRowwise
    program.a_matrix_.start_ = by_target.indptr
    program.a_matrix_.index_ = by_target.indices
    program.a_matrix_.value_ = np.ones(by_target.nnz)
    program.integrality_ = [highspy.HighsVarType.kInteger] * choices
    highs.passModel(program)
    highs.run()
    info = highs.getInfo()
    return float(info.objective_function_value), float(info.mip_dual_bound)


main = measuring(measure_cover, __doc__)


if __name__ == "__main__":
    sys.exit(main())
