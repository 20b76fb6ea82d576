"""Smaller instances with the same optimum: forced choices, dominance, components."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import connected_components

from roadsight.base.arrays import Bools, Ints, Ints32
from roadsight.setcover.common.kernels import (
    drop_dominated_choices,
    drop_implied_targets,
    pack_bits,
    propagate,
    residual_needs,
)
from roadsight.setcover.common.problem import (
    CoverProblem,
    Instance,
    alone_to_none,
    objective_step,
    power_of_two,
)

MAX_BITS = 2**33  # most choices x targets for which dominance is searched: 1 GiB of bits


@dataclass
class Reduced:
    """What is left of a problem.

    Parameters
    ----------
    parts : instances that can be solved one by one.
    taken : choices of the problem that every remaining solution takes.
    uncoverable : targets that too few choices can cover, sorted.
    counts : numbers of choices ("rows") and targets ("columns") before and after each step.
    feasible : False where the mandatory and forced choices already contradict the groups.
    """

    parts: list[Instance]
    taken: Ints
    uncoverable: Ints
    counts: dict[str, int] = field(default_factory=dict)
    feasible: bool = True


def reduce_problem(problem: CoverProblem) -> Reduced:
    """Reduce a problem without changing its optimum."""
    counts = {"rows": problem.matrix.shape[0], "columns": problem.matrix.shape[1]}
    uncoverable = uncoverable_targets(problem)
    taken = np.flatnonzero(problem.mandatory)
    if len(uncoverable):
        return Reduced([], taken, uncoverable, counts)
    instance = _first_instance(problem)
    instance, forced, feasible = shrink(instance, problem.mandatory[instance.choice])
    counts |= {"rows_reduced": instance.shape[0], "columns_reduced": instance.shape[1]}
    parts = [part.rescaled() for part in split_components(instance)] if feasible else []
    counts |= {"rows_taken": len(forced), "parts": len(parts)}
    return Reduced(parts, np.sort(forced), uncoverable, counts, feasible)


def uncoverable_targets(problem: CoverProblem) -> Ints:
    """Targets that too few choices can cover, a group counting once; sorted."""
    number = alone_to_none(problem.groups)
    alone = number < 0
    number[alone] = number.max(initial=-1) + 1 + np.arange(alone.sum())
    often = times_coverable(problem.matrix, number, problem.forbidden)
    return np.flatnonzero(often < problem.at_least).astype(np.int64)


def times_coverable(matrix: sparse.csr_matrix, group: Ints, forbidden: Bools) -> Ints:
    """How often allowed choices can cover each target (n,), those of a group counting once."""
    entries = matrix.tocoo()
    free = ~forbidden[entries.row]
    shape = (matrix.shape[1], int(group.max(initial=0)) + 1)
    ones = np.ones(int(free.sum()))
    seen = sparse.csr_matrix((ones, (entries.col[free], group[entries.row[free]])), shape=shape)
    return np.diff(seen.indptr).astype(np.int64)


def _first_instance(problem: CoverProblem) -> Instance:
    """Choices that may be taken and targets that ask for something."""
    targets = np.flatnonzero(problem.at_least > 0)
    choices = np.flatnonzero(~problem.forbidden)
    matrix = problem.matrix[choices][:, targets].tocsr()
    matrix.sort_indices()
    step = objective_step(problem.costs)
    unit = step or power_of_two(float(problem.costs.max(initial=1.0)))
    cost = problem.costs[choices] / unit
    return Instance(
        matrix,
        np.round(cost) if step else cost,
        problem.at_least[targets].astype(np.int32),
        alone_to_none(problem.groups[choices]),
        choices.astype(np.int64),
        step > 0,
        unit,
    )


def shrink(instance: Instance, mandatory: Bools) -> tuple[Instance, Ints, bool]:
    """Repeat all reductions until nothing changes; instance, choices taken, feasible."""
    taken: list[int] = []
    while True:
        before = instance.shape
        none = np.zeros((0, before[0]), bool)
        alive, fixed = np.ones(before[0], bool), mandatory.copy()
        feasible, left, _ = propagate(
            *arrays(instance), instance.need, instance.group, alive, fixed, none
        )
        taken += instance.choice[fixed].tolist()
        if not feasible:
            return instance, np.array(taken, np.int64), False
        instance = replace(instance, need=left).select(alive & ~fixed, left > 0)
        instance = _drop_dominated(instance)
        mandatory = np.zeros(instance.shape[0], bool)
        if instance.shape == before:
            return instance, np.array(taken, np.int64), True


def _drop_dominated(instance: Instance) -> Instance:
    """Without implied targets, then without replaceable choices."""
    choices, targets = instance.shape
    if choices * targets > MAX_BITS or 0 in instance.shape:
        useful = np.diff(instance.by_choice.indptr) > 0
        return instance.select(useful, np.ones(targets, bool))
    start, index, target_start, target_index = arrays(instance)
    bits = pack_bits(target_start, target_index, choices)
    keep = drop_implied_targets(target_start, target_index, start, index, bits, instance.need)
    instance = instance.select(np.ones(choices, bool), keep)
    alive, fixed = np.ones(choices, bool), np.zeros(choices, bool)
    start, index, *_ = arrays(instance)
    left, free = residual_needs(start, index, instance.need, alive, fixed)
    bits = pack_bits(start, index, instance.shape[1])
    drop_dominated_choices(
        *arrays(instance),
        bits,
        instance.cost,
        instance.group,
        left,
        free,
        alive,
        fixed,
        np.zeros((0, choices), bool),
    )
    return instance.select(alive, np.ones(instance.shape[1], bool))


def split_components(instance: Instance) -> list[Instance]:
    """Instances that share no target and no group, in the order of their first choice."""
    choices, targets = instance.shape
    if not targets:
        return []
    entries = instance.by_choice.tocoo()
    grouped = np.flatnonzero(instance.group >= 0)
    first = choices + targets
    # A graph of choices, targets and groups, numbered in this order.
    one = np.concatenate([entries.row, grouped])
    other = np.concatenate([entries.col + choices, instance.group[grouped] + first])
    size = first + int(instance.group.max(initial=-1)) + 1
    links = sparse.coo_matrix((np.ones(len(one)), (one, other)), shape=(size, size))
    _, label = connected_components(links, directed=False)
    numbers = np.unique(label[choices:first])
    order = np.argsort([np.argmax(label[:choices] == number) for number in numbers])
    return [
        instance.select(label[:choices] == number, label[choices:first] == number)
        for number in numbers[order]
    ]


def arrays(instance: Instance) -> tuple[Ints32, Ints32, Ints32, Ints32]:
    """Starts and indices by choice, then by target, as the kernels take them."""
    choices, targets = instance.by_choice, instance.by_target
    return choices.indptr, choices.indices, targets.indptr, targets.indices
