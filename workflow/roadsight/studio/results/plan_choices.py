"""What a plan may choose, as the solver reads it: places, costs, and what excludes what."""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from scipy import sparse

from roadsight.base.arrays import Bools, Ints
from roadsight.base.errors import InputError
from roadsight.base.sections.placement import Cover
from roadsight.config.plan_options import FILES
from roadsight.config.plans import Plan
from roadsight.io.vector.layer_names import split_layer
from roadsight.placement.plans.plan_problem import Asked, pose
from roadsight.stages.placement.shared.cover_inputs import PlanFiles, read_asked
from roadsight.stages.placement.shared.plan_choices import ChoiceFiles, read_choices
from roadsight.studio.project import FRAME, SiteFolder

_TARGETS = "placement/targets.parquet"
_WHERE_AND_COST = ("forbidden", "poles", "spacing_m")
"""Options of a plan that say where a sensor may stand and what it costs there; the others say what
is to be seen, and a what-if is free of those."""


@dataclass(frozen=True)
class PlanChoices:
    """Choices of a plan.

    Parameters
    ----------
    candidates : those that may carry a sensor. choices : (n,) as `choices_of`, with their whole
        cost. matrix : which of them sees which target (n, targets).
    chosen : (k,) those of the solution. exclusive : (sets, n), at most one of each set stands.
    """

    candidates: pd.DataFrame
    choices: pd.DataFrame
    matrix: sparse.csr_matrix
    chosen: Ints
    exclusive: sparse.csr_matrix

    def excluded(self, rows: Ints) -> Bools:
        """Choices (n,) that cannot stand beside some, these among them."""
        inside = np.zeros(len(self.choices), np.int32)
        inside[rows] = 1
        together = np.asarray(self.exclusive.T @ (self.exclusive @ inside)).ravel() > 0
        return together | (inside > 0)

    def are_crowded(self, rows: Ints) -> bool:
        """Whether two of them cannot stand together."""
        inside = np.bincount(rows, minlength=len(self.choices))
        return bool((self.exclusive @ inside > 1).any())


def plan_files(site: SiteFolder, plan: str, sensors_file: str) -> dict[str, Path]:
    """Files of a plan by a short name; all results but the layers and obstacles are there.

    Raises
    ------
    InputError : no such plan, or a result is not there yet.
    """
    if plan not in site.resolved.plans:
        raise InputError("no such plan", where=f"site {site.stem}", found=plan)
    settings, folder = site.resolved.settings, f"placement/{plan}"
    names = {"solution": f"{folder}/solution.json", "targets": _TARGETS, "frame": FRAME}
    for number in range(settings.coverage.rounds + 1):
        names[f"round {number}"] = f"placement/round-{number}/candidates.parquet"
        shards = settings.coverage.shards if number else settings.shards
        for sensor in site.resolved.plans[plan].sensors:
            for shard in range(shards):
                name = f"placement/round-{number}/detection/{sensor}/{shard}.parquet"
                names[f"shard {number} {sensor} {shard}"] = name
    found = {short: site.file(name) for short, name in names.items()}
    own = {"obstacles": "obstacles.gpkg", "layers": "solution.gpkg"}
    found |= {short: site.results / folder / name for short, name in own.items()}
    return found | {"sensors": Path(sensors_file)} | _maps(site, plan)


def _maps(site: SiteFolder, plan: str) -> dict[str, Path]:
    """Files of the user that decide where sensors of the plan may stand."""
    placement, options = site.resolved.site.placement, site.resolved.plans[plan]
    found = {name: site.resolved.beside(getattr(placement, name)) for name in ("zones", "cabinets")}
    found |= {name: _without_layer(options.file_of(name)) for name in FILES}
    return {name: Path(path) for name, path in found.items() if path is not None}


def _without_layer(path: str | None) -> str | None:
    return None if path is None else split_layer(path)[0]


def state_of(site: SiteFolder, plan: str, files: dict[str, Path]) -> str:
    """A text that changes with the plan's files, its options and the rules of mounting."""
    states = [
        (str(path), path.stat().st_mtime_ns, path.stat().st_size)
        for path in files.values()
        if path.exists()
    ]
    asked = (
        site.resolved.plans[plan].model_dump_json(exclude={"title"}),
        site.resolved.settings.mounting.model_dump_json(),
    )
    return hashlib.sha256(json.dumps([states, asked]).encode()).hexdigest()[:16]


def choices_to_try(
    site: SiteFolder,
    name: str,
    files: dict[str, Path],
    costs: dict[str, float],
    solution: dict[str, Any],
    targets: pd.DataFrame,
) -> PlanChoices:
    """What could stand instead of a plan's sensors: read and priced by the solver's own functions.

    Forbidden are the places of zones, of the rules of mounting and of the plan; of the last, the
    ones where its sensors stand stay.

    Parameters
    ----------
    name : of the plan. files : as `plan_files`. costs : of each of its sensors.

    Raises
    ------
    InputError : as the solver; or a sensor of the solution is no choice any more.
    """
    plan, frame = site.resolved.plans[name], site.frame()
    where = f"site {site.stem}, plan {name}"
    given = _given(site, name, plan, files)
    found = read_choices(given, [f"{name}={cost!r}" for name, cost in costs.items()], frame)
    matrix = found.matrix(targets["target"])
    asked = read_asked(given, frame) or Asked({}, 1, where, exclude=True)
    posed = pose(asked, matrix, found.choices, found.candidates, targets).deployment
    chosen = _chosen(found.choices, solution, str(files["solution"]))
    free = ~posed.problem.forbidden
    free[chosen] = True
    kept = np.flatnonzero(free)
    choices = found.choices.assign(cost=posed.problem.costs).iloc[kept].reset_index(drop=True)
    return PlanChoices(
        found.candidates,
        choices,
        matrix[kept],
        np.searchsorted(kept, chosen),
        posed.exclusive[:, kept],
    )


@dataclass(frozen=True, kw_only=True)
class _Given(ChoiceFiles, PlanFiles):
    """What says where sensors may stand and what a plan asks of them."""


def _given(site: SiteFolder, name: str, plan: Plan, files: dict[str, Path]) -> _Given:
    """What the solver's stage takes, as the rule ``solve_cover`` gives it."""
    placement = site.resolved.site.placement
    zones, cabinets = (
        site.resolved.layered(path) if path else None
        for path in (placement.zones, placement.cabinets)
    )
    asked = {k: v for k, v in json.loads(plan.options() or "{}").items() if k in _WHERE_AND_COST}
    own = {
        part: (file,) if part in asked and (file := plan.file_of(part)) else () for part in FILES
    }
    return _Given(
        site=site.stem,
        plan=name,
        frame=files["frame"],
        candidates=[path for short, path in files.items() if short.startswith("round")],
        detections=[path for short, path in files.items() if short.startswith("shard")],
        mounting=site.resolved.settings.mounting.model_dump_json(),
        options=json.dumps(asked) if asked else "",
        cover=Cover(at_least=1),
        uncoverable="exclude",
        zones=zones,
        cabinets=cabinets,
        forbidden=own["forbidden"],
        poles=own["poles"],
    )


def _chosen(choices: pd.DataFrame, solution: dict[str, Any], where: str) -> Ints:
    pairs = pd.MultiIndex.from_frame(choices[["sensor", "candidate"]])
    named = [(one["sensor"], one["candidate"]) for one in solution["sensors"]]
    rows = pairs.get_indexer(pd.MultiIndex.from_tuples(named)) if named else np.empty(0)
    if (rows < 0).any():
        sensor, candidate = named[int(np.flatnonzero(rows < 0)[0])]
        raise InputError(
            "names sensors that are no candidates any more: candidates, zones or rules of mounting"
            " have changed since",
            where=where,
            found=f"{sensor} at {candidate}",
            hint="run the workflow",
        )
    return np.asarray(rows, np.int64)
