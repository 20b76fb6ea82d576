"""Integer programs, handed whole to HiGHS."""

from __future__ import annotations

import math
from dataclasses import dataclass

import highspy
import numpy as np
from scipy import sparse

from roadsight import __version__
from roadsight.base.arrays import Bools, Floats
from roadsight.setcover.common.deadline import Deadline, Patience
from roadsight.setcover.common.problem import HIGHS
from roadsight.setcover.common.relaxation import quiet_highs

_FEASIBLE = 1e-9  # tolerance of the solver: what it lets pass is looked at again with exact sums
# Work between two looks of the solver at its limit, in seconds. Looks are the only steps that it
# tells of while it runs, and they are the same on every machine: on instances of 900, 10,000 and
# 85,000 entries each took 2, 19 and 10 ms.
_LOOK_S = 0.01


@dataclass(frozen=True)
class Program:
    """minimise ``price x`` subject to ``low <= rows x <= high``, ``least <= x <= most``.

    Parameters
    ----------
    price, least, most : (variables,). rows : (constraints, variables). low, high : (constraints,).
    whole : (variables,) which are whole numbers.
    """

    price: Floats
    rows: sparse.csr_matrix
    low: Floats
    high: Floats
    least: Floats
    most: Floats
    whole: Bools


@dataclass(frozen=True)
class Programmed:
    """Answer of the solver.

    Parameters
    ----------
    x : (variables,) the best found, or None. bound : proven; infinite where nothing is feasible.
    nodes : of its tree.
    """

    x: Floats | None
    bound: float
    nodes: int


def version(solver: str = HIGHS) -> str:
    """Name and version of a solver; ours solves linear programs by HiGHS."""
    highs = f"HiGHS {highspy.Highs().version()}"
    return highs if solver == HIGHS else f"roadsight {__version__}, {highs}"


def run_program(
    program: Program,
    limit: Deadline,
    gap: float = 0.0,
    step: float = 0.0,
    enough: float = math.inf,
    tolerance: float = _FEASIBLE,
) -> Programmed:
    """Solve a program with one thread and a fixed seed.

    By a `WorkLimit` the answer is the same on any machine: the limit counts how often the solver
    looks whether it should stop. It also stops where neither bound nor answer move (`Patience`).

    Parameters
    ----------
    gap : share of the objective that is near enough. step : objectives are multiples of it, and a
        gap below one is no gap. enough : bound at which to stop. tolerance : of constraints and of
        whole numbers; looser ones can only lower the bound.
    """
    highs = quiet_highs(
        random_seed=0,
        mip_feasibility_tolerance=tolerance,
        primal_feasibility_tolerance=tolerance,
        mip_rel_gap=gap,
        mip_abs_gap=step * (1 - 1e-6) if step else 0.0,
    )
    clock_s = limit.clock_left_s()
    if math.isfinite(clock_s):
        highs.setOptionValue("time_limit", clock_s)
    model = highspy.HighsLp()
    model.num_row_, model.num_col_ = program.rows.shape
    model.col_cost_, model.col_lower_, model.col_upper_ = program.price, program.least, program.most
    model.row_lower_, model.row_upper_ = program.low, program.high
    model.a_matrix_.format_ = highspy.MatrixFormat.kRowwise
    model.a_matrix_.start_ = program.rows.indptr
    model.a_matrix_.index_ = program.rows.indices
    model.a_matrix_.value_ = program.rows.data.astype(np.float64)
    kinds = highspy.HighsVarType
    model.integrality_ = [kinds.kInteger if one else kinds.kContinuous for one in program.whole]
    highs.passModel(model)
    patience = Patience(limit)

    def look(event: highspy.HighsCallbackEvent) -> None:
        limit.spend(_LOOK_S)
        bound, best = event.data_out.mip_dual_bound, event.data_out.mip_primal_bound
        moved = math.ceil(bound / step - 1e-6) if step and math.isfinite(bound) else bound
        over = limit.passed() or bound >= enough or patience.is_over((moved, best))
        if over and event.data_in is not None:
            event.data_in.user_interrupt = True

    highs.cbMipInterrupt.subscribe(look)
    highs.run()
    info = highs.getInfo()
    if highs.getModelStatus() == highspy.HighsModelStatus.kInfeasible:
        return Programmed(None, math.inf, max(int(info.mip_node_count), 0))
    found = info.primal_solution_status == 2
    x = np.array(highs.getSolution().col_value) if found else None
    return Programmed(x, float(info.mip_dual_bound), max(int(info.mip_node_count), 0))
