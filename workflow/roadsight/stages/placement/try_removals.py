"""How many sensors a plan saves if an object is taken away: a tree felled, a sign moved."""

from __future__ import annotations

import argparse
import logging
import sys
from typing import Any

import numpy as np
import pandas as pd
from scipy import sparse
from scipy.spatial import cKDTree

from roadsight.base.arrays import Bools, Floats
from roadsight.base.options import add_settings
from roadsight.config.sections.placement import Cover, Coverage
from roadsight.config.sections.sensing import Lidar
from roadsight.geometry.frames import Frame
from roadsight.io.records.atomic import read_json, write_json
from roadsight.io.records.surfels import read_surfels
from roadsight.io.records.tables import read_table
from roadsight.io.vector.vectors import read_layer
from roadsight.placement.depth.surfel_lidar import SurfelLidar
from roadsight.placement.sight.detection import MIN_BEAMS
from roadsight.scene.surfels.surfels import Surfels
from roadsight.setcover import CoverProblem, solve_cover_problem
from roadsight.setcover.common.deadline import WorkLimit
from roadsight.stages.command import run_stage
from roadsight.stages.placement.shared.allowed import add_allowed_arguments
from roadsight.stages.placement.shared.changed_sight import ChangedSight, add_change_arguments
from roadsight.stages.placement.shared.detection_inputs import add_sight_arguments
from roadsight.stages.placement.shared.plan_choices import read_choices

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
_MOST_CANDIDATES = 300
"""Candidates rendered for an object, the nearest: 20 to 30 CPU s with 128 channels."""


def try_removals(arguments: argparse.Namespace) -> None:
    """Write a row for each of the objects that hide most targets from the plan's sensors."""
    solution = read_json(arguments.solution)
    frame = Frame.from_dict(read_json(arguments.frame))
    members = read_table(arguments.objects)
    members["object"] = members["object"].astype(str)
    objects = read_layer(arguments.obstacles, "objects", frame)
    greatest = objects[[*_TOLD]].iloc[:_MOST_TOLD].astype(_TOLD).to_dict("records")
    possible = objects["kind"].isin(REMOVABLE) & (_lengths_m(objects, members) <= _LONGEST_M)
    objects = objects[possible].iloc[: arguments.felled]
    rows: list[dict[str, Any]] = []
    if len(objects) and not any(key in solution for key in _OTHERWISE):
        rows = _rows(arguments, solution, objects, members, frame)
    content = {"plan": solution["plan"], "objects": greatest, "rows": rows}
    write_json(arguments.out, content)
    for row in rows:
        log.info(
            "without %s: cost %g instead of %g", row["object"], row["cost"], row["cost_before"]
        )


def _lengths_m(objects: pd.DataFrame, members: pd.DataFrame) -> Floats:
    """Length of each object (n,) in plan, across its corners."""
    span = members.groupby("object")[["x", "y"]].agg(np.ptp)
    length_m = pd.Series(np.hypot(span["x"], span["y"]), span.index, dtype=np.float64)
    return np.asarray(length_m.reindex(objects["name"]), np.float64)


def _rows(
    arguments: argparse.Namespace,
    solution: dict[str, Any],
    objects: pd.DataFrame,
    members: pd.DataFrame,
    frame: Frame,
) -> list[dict[str, Any]]:
    sight = ChangedSight(arguments)
    plan = read_choices(arguments, arguments.costs, frame)
    candidates, choices = plan.candidates, plan.choices
    matrix = plan.matrix(sight.targets["target"])
    surfels = read_surfels(arguments.surfels)
    wanted = ~sight.targets["target"].isin(solution["excluded"]).to_numpy()
    rows = []
    for name, kind, hidden in zip(
        objects["name"], objects["kind"], objects["targets"], strict=True
    ):
        own = members[members["object"] == name][["x", "y", "z"]]
        lidar = SurfelLidar(_without(surfels, own), engine=arguments.engine)
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
        cover = solve_cover_problem(problem, WorkLimit(arguments.time_limit_s), seed=1)
        now_seen = int((np.asarray(seen.sum(axis=0)).ravel() > 0)[~wanted].sum())
        rows.append(
            {
                "object": str(name),
                "kind": str(kind),
                "hidden_targets": int(hidden),
                "cost_before": solution["objective"],
                "cost": float(cover.objective),
                "sensors_before": len(solution["sensors"]),
                "sensors": len(cover.chosen),
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
    left = ~np.isin(key, gone)
    return Surfels(surfels.centre_m[left], surfels.normal[left], surfels.half_m[left])


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


def main(argv: list[str] | None = None) -> int:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    names = (
        "solution",
        "targets",
        "surfels",
        "frame",
        "objects",
        "obstacles",
        "sensors-file",
        "out",
    )
    for name in names:
        parser.add_argument(f"--{name}", required=True)
    for name in ("candidates", "detections", "costs"):
        parser.add_argument(f"--{name}", nargs="+", required=True)
    add_settings(parser, Coverage, "felled")
    add_settings(parser, Cover, "time_limit_s")
    parser.add_argument("--min-beams", type=int, default=MIN_BEAMS)
    add_settings(parser, Lidar, "azimuth_stride")
    add_sight_arguments(parser)
    add_change_arguments(parser)
    add_allowed_arguments(parser)
    return run_stage(parser, try_removals, argv)


if __name__ == "__main__":
    sys.exit(main())
