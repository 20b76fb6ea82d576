"""How many sensors a plan saves if an object is taken away: a tree felled, a sign moved."""

from __future__ import annotations

import logging
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import pandas as pd
from scipy import sparse
from scipy.spatial import cKDTree

from roadsight.base.arrays import Bools
from roadsight.base.section import needed
from roadsight.base.sections.placement import Cover, Coverage
from roadsight.geometry.frames import Frame
from roadsight.io.records.atomic import read_json, write_json
from roadsight.io.records.scene_tables import read_surfels
from roadsight.io.records.tables import read_table
from roadsight.io.vector.vectors import read_layer
from roadsight.placement.depth.surfel_lidar import SurfelLidar
from roadsight.scene.surfels import Surfels
from roadsight.setcover import CoverProblem, solve_cover_problem
from roadsight.setcover.common.deadline import WorkLimit
from roadsight.stages.command import Command
from roadsight.stages.placement.shared.changed_sight import ChangedFiles, ChangedSight
from roadsight.stages.placement.shared.plan_choices import ChoiceFiles, read_choices

log = logging.getLogger("try_removals")

REMOVABLE = ("tree", "bush", "sign", "pole", "barrier")
"""Kinds that an agency can take away or move; buildings and the ground stay."""
_TOLD = {"name": str, "kind": str, "targets": int, "sensors": int, "sight_lines": int}
"""What is told of objects in the way."""
_MOST_TOLD = 12
"""So many of them are told; the layer has all."""
_LONGEST_M = 20.0
"""Longer objects, such as barriers along the road, are not taken away for a sensor."""
_OTHERWISE = ("options", "robust", "availability")
"""Plans with these are not solved again: they ask for more than a cover."""
_NEAR_M = 40.0
"""Candidates so near an object are rendered without it: its shadow is widest from there."""
_LIMIT_SHARE = 0.2
"""Share of the plan's limit that each object has: an object more costs a fifth of a plan more. The
cover at hand still stands without the object, so that a search cut short tells no saving, and its
status says so."""
_MOST_CANDIDATES = 300
"""Candidates rendered for an object, the nearest: 20 to 30 CPU s with 128 channels."""


@dataclass(frozen=True, kw_only=True)
class RemovalFiles(ChangedFiles, ChoiceFiles):
    """A plan, and the objects that stand in its way."""

    solution: Path
    objects: Path
    obstacles: Path
    costs: Sequence[str]
    felled: Annotated[int, Coverage]
    time_limit_s: Annotated[float, Cover]


def try_removals(given: RemovalFiles, *, out: Path) -> None:
    """Write a row for each of the objects that hide most targets from the plan's sensors."""
    solution = read_json(given.solution)
    frame = Frame.from_dict(read_json(given.frame))
    objects = read_layer(given.obstacles, "objects", frame)
    greatest = objects[[*_TOLD]].iloc[:_MOST_TOLD].astype(_TOLD).to_dict("records")
    objects = objects[objects["kind"].isin(REMOVABLE)]
    rows: list[dict[str, Any]] = []
    if given.felled and len(objects) and not any(key in solution for key in _OTHERWISE):
        members = read_table(given.objects)
        members["object"] = members["object"].astype(str)
        span = members.groupby("object")[["x", "y"]].agg(np.ptp)  # in plan, across its corners
        length_m = pd.Series(np.hypot(span["x"], span["y"]), span.index, dtype=np.float64)
        is_short = length_m.reindex(objects["name"]).to_numpy() <= _LONGEST_M
        short = objects[is_short].iloc[: given.felled]
        rows = _rows(given, solution, short, members, frame) if len(short) else []
    content = {"plan": solution["plan"], "objects": greatest, "rows": rows}
    write_json(out, content)
    for row in rows:
        log.info(
            "without %s: cost %g instead of %g", row["object"], row["cost"], row["cost_before"]
        )


def _rows(
    given: RemovalFiles,
    solution: dict[str, Any],
    objects: pd.DataFrame,
    members: pd.DataFrame,
    frame: Frame,
) -> list[dict[str, Any]]:
    sight = ChangedSight(given)
    plan = read_choices(given, given.costs, frame)
    candidates, choices = plan.candidates, plan.choices
    matrix = plan.matrix(sight.targets["target"])
    surfels = read_surfels(needed(given.surfels, "--surfels"))
    wanted = ~sight.targets["target"].isin(solution["excluded"]).to_numpy()
    rows = []
    for name, kind, hidden in zip(
        objects["name"], objects["kind"], objects["targets"], strict=True
    ):
        own = members[members["object"] == name][["x", "y", "z"]]
        lidar = SurfelLidar(_without(surfels, own), engine=given.engine)
        away, _ = cKDTree(own[["x", "y"]]).query(candidates[["x", "y"]].to_numpy(np.float64))
        near = np.flatnonzero(away <= _NEAR_M)
        near = near[np.argsort(away[near], kind="stable")][:_MOST_CANDIDATES]
        seen = _seen_without(sight, lidar, choices, candidates, near, matrix)
        problem = CoverProblem(
            seen[:, wanted],
            choices["cost"].to_numpy(),
            choices["position"].to_numpy(),
            solution["at_least"],
        )
        limit = WorkLimit(_LIMIT_SHARE * given.time_limit_s)
        cover = solve_cover_problem(problem, limit, seed=1)
        # Nothing is seen less without the object, so that the plan as it is still covers.
        cheaper = cover.objective < solution["objective"]
        now_seen = int((np.asarray(seen.sum(axis=0)).ravel() > 0)[~wanted].sum())
        rows.append(
            {
                "object": str(name),
                "kind": str(kind),
                "hidden_targets": int(hidden),
                "cost_before": solution["objective"],
                "cost": float(cover.objective) if cheaper else solution["objective"],
                "sensors_before": len(solution["sensors"]),
                "sensors": len(cover.chosen if cheaper else solution["sensors"]),
                "more_targets": now_seen,
                "candidates": len(near),
                "status": cover.status,
            }
        )
    return rows


def _without(surfels: Surfels, own: pd.DataFrame) -> Surfels:
    """The scene without the surfels of an object, which are known by their places."""
    place = np.dtype((np.void, 3 * np.dtype(np.float32).itemsize))
    key = np.ascontiguousarray(surfels.centre_m, np.float32).view(place).ravel()
    gone = np.ascontiguousarray(own.to_numpy(np.float32)).view(place).ravel()
    return surfels.select(~np.isin(key, gone))


def _seen_without(
    sight: ChangedSight,
    lidar: SurfelLidar,
    choices: pd.DataFrame,
    candidates: pd.DataFrame,
    near: np.ndarray,
    matrix: sparse.csr_matrix,
) -> sparse.csr_matrix:
    """What choices near an object see without it, beside what they saw."""
    rows = matrix.tolil(copy=True)
    for row in np.flatnonzero(choices["position"].isin(near) & ~choices["posed"]):
        choice = choices.iloc[row]
        if not sight.can_change(choice["sensor"]):
            continue
        place = candidates.iloc[choice["position"]].to_dict() | {"sensor": choice["sensor"]}
        found: Bools = sight.sees(place, None, lidar)
        found |= np.asarray(matrix[row].todense()).ravel()
        rows.rows[row] = np.flatnonzero(found).tolist()
        rows.data[row] = [True] * int(found.sum())
    return rows.tocsr()


main = Command(try_removals)


if __name__ == "__main__":
    sys.exit(main())
