"""Small random covers and deployments of all units, types and layouts, and all their subsets."""

import numpy as np
from scipy import sparse

from roadsight.setcover import CoverProblem
from roadsight.setcover.common.problem import NEAR
from roadsight.setcover.plans.deployment import Deployment

DTYPES = (
    "bool", "int8", "int16", "int32", "int64", "uint8", "uint16", "uint32", "uint64",
    "float16", "float32", "float64",
)  # fmt: skip
LAYOUTS = ("dense", "coo", "csr", "csc", "repeated coo", "repeated csr", "unsorted csr")
GOALS = ("cover", "budget", "price", "overlap")
COSTS = ("ones", "whole", "fractions", "mixed", "mixed whole", "nearly equal")


def costs_of(rng, kind, choices, span=12):
    """Positive costs; those of one size in a unit of 1e-12 to 1e12."""
    unit = 10.0 ** rng.integers(-span, span + 1)
    return {
        "ones": lambda: np.full(choices, unit),
        "whole": lambda: rng.integers(1, 9, choices) * unit,
        "fractions": lambda: rng.uniform(0.5, 3, choices) * unit,
        "mixed": lambda: 10.0 ** rng.uniform(-12, 12, choices),
        "mixed whole": lambda: rng.integers(1, 4, choices) * 10.0 ** rng.integers(0, 13, choices),
        "nearly equal": lambda: unit * (1 + 1e-5 * rng.random(choices)),
    }[kind]()


def stored(rng, covers, dtype, layout):
    """A matrix of one type and layout that covers what ``covers`` (m, n) says."""
    whole = np.dtype(dtype).kind in "iu"
    positive = rng.integers(1, 100, covers.shape) if whole else rng.uniform(0.1, 3, covers.shape)
    values = np.where(covers, positive, 0).astype(dtype)
    if layout == "dense":
        return values
    if np.dtype(dtype) == np.float16:  # no layout of SciPy holds it
        values = values.astype(np.float32)
    row, col = np.nonzero(covers | (rng.random(covers.shape) < 0.2))  # some zeros are stored
    data = values[row, col]
    if layout.startswith("repeated"):
        # So often that sums of the type wrap: to 0 where all are 1.
        times = 256 if rng.random() < 0.1 else 2
        row, col = np.tile(row, times), np.tile(col, times)
        data = np.tile(data if times == 2 else np.minimum(data, data.dtype.type(1)), times)
    order = rng.permutation(len(row))
    entries = sparse.coo_matrix((data[order], (row[order], col[order])), shape=covers.shape)
    if layout.endswith("coo"):
        return entries
    if layout == "csc":
        return sparse.csc_matrix(values)
    if layout == "csr":
        return sparse.csr_matrix(values)
    by_row = np.argsort(entries.row, kind="stable")
    start = np.searchsorted(entries.row[by_row], np.arange(covers.shape[0] + 1))
    parts = entries.data[by_row], entries.col[by_row], start
    return sparse.csr_matrix(parts, shape=covers.shape)


def posed(rng):
    """Parts of a cover problem of up to 12 choices and 30 targets, and what it covers."""
    choices, targets = rng.integers(1, 13), rng.integers(1, 31)
    covers = rng.random((choices, targets)) < rng.uniform(0.1, 0.7)
    covers[rng.integers(0, choices, targets), np.arange(targets)] = True
    kind = COSTS[rng.integers(len(COSTS))]
    must = rng.random(choices) < 0.03
    parts = {
        "matrix": stored(rng, covers, rng.choice(DTYPES), rng.choice(LAYOUTS)),
        "costs": None if rng.random() < 0.1 else costs_of(rng, kind, choices),
        "groups": rng.integers(-1, 5, choices) if rng.random() < 0.3 else None,
        "at_least": rng.integers(0, 3, targets) if rng.random() < 0.3 else 1,
        "mandatory": np.flatnonzero(must),
        "forbidden": np.flatnonzero((rng.random(choices) < 0.03) & ~must),
    }
    return parts, covers, kind


def subsets(choices):
    """All subsets as masks, (2 ** choices, choices)."""
    return (np.arange(2**choices)[:, None] >> np.arange(choices) & 1).astype(bool)


def allowed(problem, every, covers):
    """Which subsets cover everything and keep to groups, mandatory and forbidden choices."""
    fine = (every @ covers.astype(np.int64) >= problem.at_least).all(axis=1)
    fine &= every[:, problem.mandatory].all(axis=1) & ~every[:, problem.forbidden].any(axis=1)
    for group in np.unique(problem.groups[problem.groups >= 0]):
        fine &= every[:, problem.groups == group].sum(axis=1) <= 1
    return fine


def least_cost(problem, covers):
    """Cost of the best of all subsets, infinite where none is allowed."""
    every = subsets(len(problem.costs))
    fine = every[allowed(problem, every, covers)]
    return float((fine @ problem.costs).min(initial=np.inf))


def posed_deployment(rng, goal=None, span=12):
    """A deployment of up to 8 choices and 12 targets with one of four aims, in any units.

    Without a span costs and weights are of one size.
    """
    goal = goal or GOALS[rng.integers(4)]
    choices, targets = rng.integers(2, 9), rng.integers(1, 13)
    seen = rng.random((choices, targets)) < rng.uniform(0.2, 0.7)
    costs = costs_of(rng, COSTS[rng.integers(len(COSTS) if span else 3)], choices, span)
    unit = 10.0 ** rng.integers(-span, span + 1)
    kinds = [
        np.full(targets, unit),
        rng.integers(0, 4, targets) * unit,
        10.0 ** rng.uniform(-6, 6, targets),
    ]
    weights = kinds[rng.integers(3 if span else 2)]
    must = rng.random(choices) < 0.04
    problem = CoverProblem(
        seen,
        costs,
        rng.integers(-1, 3, choices) if rng.random() < 0.3 else None,
        rng.integers(0, 3, targets) if rng.random() < 0.3 else 1,
        np.flatnonzero(must),
        np.flatnonzero((rng.random(choices) < 0.04) & ~must),
    )
    budget = float(rng.uniform(0, costs.sum()))
    price = float(rng.choice([0.2, 0.5, 0.37])) * np.median(costs) / (weights.max() or 1.0)
    aims = {
        "cover": {},
        "budget": {"complete": False, "worth": 1.0, "cost": np.zeros(choices), "budget": budget},
        "price": {"complete": False, "worth": price},
        "overlap": {
            "complete": bool(rng.integers(2)),
            "cost": rng.integers(0, 2, choices) * 1.0,
            "budget": budget,
            "floor": float(rng.uniform(0, 0.8)) * weights[problem.at_least > 0].sum(),
        },
    }
    cliques = tuple(np.sort(rng.choice(choices, 2, replace=False)) for _ in range(rng.integers(3)))
    keep = float(rng.choice([0, 0, 0.5, 0.8, 1.0]))
    return Deployment(problem, weights, cliques=cliques, keep=keep, charge=costs, **aims[goal])


def objectives(deployment):
    """Objective of each subset, infinite where it is not allowed, and its guaranteed coverage."""
    problem, weights = deployment.problem, np.asarray(deployment.weights)
    matrix, need = problem.matrix.toarray().astype(int), problem.at_least
    every = subsets(len(problem.costs))
    count = every @ matrix
    value = _weight(count, need, weights)
    if deployment.keep:
        for choice in range(len(matrix)):
            left = _weight(count - matrix[choice], need, weights) / deployment.keep
            value = np.where(every[:, choice], np.minimum(value, left), value)
    fine = every @ deployment.charge <= deployment.budget * (1 + 1e-12)
    fine &= every[:, problem.mandatory].all(axis=1) & ~every[:, problem.forbidden].any(axis=1)
    groups = [np.flatnonzero(problem.groups == g) for g in range(problem.groups.max() + 1)]
    for together in (*groups, *deployment.cliques):
        fine &= every[:, together].sum(axis=1) <= 1
    least = deployment.floor
    if deployment.complete:
        fine &= (count >= need).all(axis=1)
        least = max(least, weights[need > 0].sum())
    fine &= value >= least * (1 - 1e-9)
    return np.where(fine, every @ deployment.cost - deployment.worth * value, np.inf), value


def number(chosen):
    """Row of some choices among all subsets."""
    return int((1 << np.asarray(chosen, np.int64)).sum())


def least_objective(deployment):
    """Objective of the best of all subsets, and how near to it a proof has to be."""
    best, weights = objectives(deployment)[0].min(), np.asarray(deployment.weights)
    shift = deployment.worth * weights[deployment.problem.at_least > 0].sum()
    full = shift if deployment.cost.any() else 0.0
    return best, 1.01 * NEAR * abs(best + full) + 1e-12 * (abs(best) + shift)


def _weight(count, need, weights):
    return ((count >= need) & (need > 0)) @ weights
