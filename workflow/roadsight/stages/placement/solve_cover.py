"""The proven optimal set of sensors of a plan."""

from __future__ import annotations

import logging
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import geopandas as gpd
import numpy as np
import pandas as pd
from scipy import sparse

from roadsight.base.arrays import Bools, Floats, Ints
from roadsight.base.errors import InputError
from roadsight.base.sections.run import Run
from roadsight.geometry.frames import Frame
from roadsight.geometry.north import bearing_deg, longitudes_latitudes
from roadsight.io.records.atomic import read_json, write_json
from roadsight.io.records.placement_tables import read_traffic
from roadsight.io.records.tables import read_about, read_table
from roadsight.io.vector.vectors import points, read_layer, write_layers
from roadsight.placement.candidates.siting import needs_by_area
from roadsight.placement.plans.availability import (
    CommonTraffic,
    at_level,
    counted_shares,
    past_traffic,
    share_matrix,
)
from roadsight.placement.plans.handover import stations_m
from roadsight.placement.plans.plan_answer import Answer, Better, answer, see_again, stretches
from roadsight.placement.plans.plan_doubts import plan_doubts
from roadsight.placement.plans.plan_problem import Asked, pose, posed_candidates
from roadsight.placement.plans.tolerance import solve_with_tolerance
from roadsight.placement.sight.detection import availability, times_seen
from roadsight.placement.sight.lanes import Traffic
from roadsight.setcover import Cover, CoverProblem, solve_cover_problem
from roadsight.setcover.common.deadline import Effort, WorkLimit
from roadsight.setcover.common.problem import HIGHS, WITHIN_GAP
from roadsight.setcover.common.program import version
from roadsight.setcover.plans.deployment import Deployment
from roadsight.setcover.plans.joint import solve_joint
from roadsight.setcover.plans.whole import solve_whole, verify
from roadsight.stages.command import Command, tell
from roadsight.stages.placement.shared.changed_sight import ChangedFiles, ChangedSight
from roadsight.stages.placement.shared.cover_inputs import PlanFiles, read_asked
from roadsight.stages.placement.shared.plan_choices import ChoiceFiles, read_choices

log = logging.getLogger("solve_cover")


# Covers that must see each target with a probability: traffic read, solved, told.


@dataclass(frozen=True, kw_only=True)
class LevelFiles(PlanFiles):
    """A plan that must see each target with a probability."""

    availability: Annotated[float | None, "how often targets must be in sight"] = None
    lanes: Annotated[Sequence[Path], "lanes and their traffic"] = ()
    target_height_m: float = 0.6


@dataclass(frozen=True, kw_only=True)
class CoverFiles(ChangedFiles, ChoiceFiles, LevelFiles):
    """What a plan is solved of."""

    coverage: Path
    sensors: Annotated[Sequence[str], "name=cost"]
    seed: Annotated[int, Run]
    robust: Annotated[bool, "sensors count with tolerance; needs surfels and sensors file"] = False
    edges: Annotated[Path | None, "the road, for the length seen by two"] = None


def solve_cover(
    given: CoverFiles,
    *,
    solution: Path,
    layers_path: Path,
    timing: Path,
    doubts: Annotated[Path | None, "what the plan rests on"] = None,
) -> None:
    """Write the solution, its layers for GIS, and the solver's timing."""
    frame = Frame.from_dict(read_json(given.frame))
    plan = read_choices(given, given.sensors, frame)
    candidates, detections, choices = plan.candidates, plan.detections, plan.choices
    targets = read_table(given.targets)
    uncovered = read_json(given.coverage)["plans"][given.plan]["uncovered"]
    wanted = targets[~targets["target"].isin(uncovered)].reset_index(drop=True)
    asked = read_asked(given, frame)
    edges = read_layer(given.edges, "edges", frame) if given.edges else None
    traffic = read_traffic(given.lanes[0]).lanes if given.lanes else None
    sight = ChangedSight(given) if given.robust else None
    _check_uncovered(given, targets, uncovered, asked)
    matrix = plan.matrix(wanted["target"])
    answered = levelled = looked_at = None
    robust: dict[str, Any] = {}
    if sight is not None:
        matrix, wanted, beyond, robust, looked_at = _with_tolerance(
            given, sight, asked, matrix, choices, candidates, wanted
        )
        uncovered = [*uncovered, *beyond]
    again = _Again(given, edges, wanted, looked_at)
    if given.availability is not None:
        levelled = cover_at_level(
            given, given.availability, traffic, detections, choices, candidates, wanted
        )
        cover = levelled.cover
    elif asked is None:
        cover = _cheapest(given, matrix, choices, again)
    else:
        posed = pose(asked, matrix, choices, candidates, wanted)
        answered = answer(asked, posed, choices, candidates, *_limits(given), again)
        cover, wanted = answered.cover, posed.targets
        uncovered = [*uncovered, *posed.unseen]
    sensors = _sensor_table(candidates, choices, cover, matrix, frame)
    wanted["sensors"] = times_seen(matrix, cover.chosen)
    content = _content(given, cover, sensors, targets, uncovered)
    content |= robust | again.records | _proven_area(wanted, content["at_least"])
    if levelled is not None:
        wanted["availability"], content["availability"] = levelled.shares, levelled.record
        content["at_least"] = 1  # the level says how often, not how many sensors
    elif "availability" in detections:
        chosen = set(sensors[["sensor", "candidate"]].apply(tuple, axis=1))
        wanted["availability"] = availability(detections, chosen, wanted["target"])
        content["availability"] = described(wanted["availability"].to_numpy())
    layers = {"sensors": points(_located(sensors, frame)), "targets": points(wanted)}
    if answered is not None:
        content |= _option_content(answered, sensors)
        layers |= _option_layers(answered, candidates, choices)
        layers["sensors"] = points(_located(sensors, frame))
    write_layers(layers_path, layers, frame, dict.fromkeys(layers, "Point Z"))
    _tell(given, content, candidates, doubts)
    write_json(timing, {"seconds_cpu": cover.seconds_cpu})
    write_json(solution, content)
    _log_found(given.plan, cover, again.record)


def _log_found(plan: str, cover: Cover, second: dict[str, Any] | None) -> None:
    found = (plan, len(cover.chosen), cover.objective, cover.bound, cover.status)
    log.info("%s: %d sensors, cost %g, bound %g, %s", *found)
    if second:
        shares = 100 * second["once_more"], 100 * second["once_more_before"]
        log.info("%.1f %% of the targets seen once more, before %.1f %%", *shares)


def _tell(
    given: CoverFiles, content: dict[str, Any], candidates: pd.DataFrame, path: Path | None
) -> None:
    """Say what the plan rests on."""
    if path:
        positions = int(candidates["key"].nunique()) if "key" in candidates else len(candidates)
        where = f"site {given.site}, plan {given.plan}"
        tell(plan_doubts(content, positions), path, where, log)


def _with_tolerance(
    given: CoverFiles,
    sight: ChangedSight,
    asked: Asked | None,
    matrix: sparse.csr_matrix,
    choices: pd.DataFrame,
    candidates: pd.DataFrame,
    wanted: pd.DataFrame,
) -> tuple[sparse.csr_matrix, pd.DataFrame, list[str], dict[str, Any], Bools]:
    """What sensors see with tolerance, its targets, those that none sees so; rows looked at."""
    column = pd.Index(sight.targets["target"]).get_indexer(wanted["target"])

    def look(row: int) -> Bools:
        choice = choices.iloc[row]
        place = candidates.iloc[choice["position"]].to_dict()
        return np.asarray(sight.keeps(place | {"sensor": choice["sensor"]})[column])

    def solve(current: sparse.csr_matrix) -> Ints | None:
        seen = np.asarray(current.sum(axis=0)).ravel() > 0
        if not seen.all() and given.uncoverable != "exclude":
            return None
        if asked is not None:
            posed = pose(asked, current, choices, candidates, wanted)
            found = answer(asked, posed, choices, candidates, *_limits(given)).cover.chosen
            return np.asarray(found, np.int64)
        problem = CoverProblem(
            current[:, seen],
            choices["cost"].to_numpy(),
            groups=choices["position"].to_numpy(),
            at_least=given.cover.at_least,
        )
        cover = _solve(given, problem)
        return None if not len(cover.chosen) else np.asarray(cover.chosen, np.int64)

    reduced, known, rounds, exact = solve_with_tolerance(matrix, solve, look)
    seen = np.asarray(reduced.sum(axis=0)).ravel() > 0
    moved = given.tolerance
    if not seen.all() and given.uncoverable != "exclude":
        raise InputError(
            f"{int((~seen).sum())} of {len(seen)} targets are seen by no candidate with tolerance",
            where=f"site {given.site}, plan {given.plan}",
            found=f"moved by {moved.move_m:g} m, turned by {moved.turn_deg:g} degrees,"
            f" masts {moved.other_height_m:g} m lower or higher",
            hint="narrow the tolerance, densify the candidates, leave robust out, or leave these"
            " targets out with coverage.uncoverable: exclude",
        )
    if solve(reduced) is None:
        raise InputError(
            "no set of sensors sees everything with tolerance",
            where=f"site {given.site}, plan {given.plan}",
            hint="narrow the tolerance, lower cover.at_least, or leave robust out",
        )
    beyond = [str(name) for name in wanted["target"][~seen]]
    log.info("tolerance: %d candidates looked at in %d covers", known.sum(), rounds)
    record = {"looked_at": int(known.sum()), "rounds": rounds, "exact": exact}
    record |= {"beyond": len(beyond)}
    kept = wanted[seen].reset_index(drop=True)
    # Rows that were left out because the rounds ran out may have been part of a better cover.
    status = {} if exact else {"status": "time_limit"}
    return reduced[:, seen], kept, beyond, {"robust": record, **status}, known


class _Again:
    """Among plans of one cost, the one that sees most again, and what HiGHS says of its bound.

    ``record`` and ``verified`` are None until there are any.
    """

    def __init__(
        self,
        given: CoverFiles,
        edges: gpd.GeoDataFrame | None,
        wanted: pd.DataFrame,
        looked_at: Bools | None,
    ) -> None:
        self.record: dict[str, Any] | None = None
        self.verified: dict[str, Any] | None = None
        self._verify_s = given.cover.verify_time_limit_s if given.cover.verify == HIGHS else 0.0
        self._limit_s = given.cover.second_time_limit_s if given.cover.second_objective else 0.0
        self._allowed, self._gap = looked_at, given.cover.gap
        self._cell_m = 0.0
        self._stretch: Ints | None = None
        if edges is not None and self._limit_s:
            self._cell_m = float(read_about(given.targets)["cell_size_m"])
            places = wanted[["x", "y"]].to_numpy(np.float64)
            self._stretch = stretches(stations_m(list(edges.geometry), places), self._cell_m)

    @property
    def records(self) -> dict[str, Any]:
        """What solution.json says of both."""
        every = {"second": self.record, "verified": self.verified}
        return {name: record for name, record in every.items() if record}

    def __call__(self, deployment: Deployment, cover: Cover) -> Cover:
        """Cover of the same cost."""
        better, self.record = see_again(
            deployment, cover, self._limit_s, self._stretch, self._cell_m, self._allowed, self._gap
        )
        if self._verify_s:
            self.verified = verify(deployment, better, WorkLimit(self._verify_s)).record()
            log.info("HiGHS: %s", self.verified["result"])
        return better


def _cheapest(
    given: CoverFiles, matrix: sparse.csr_matrix, choices: pd.DataFrame, better: Better
) -> Cover:
    """Cheapest cover, as a plan without options asks for."""
    problem = CoverProblem(
        matrix,
        choices["cost"].to_numpy(),
        groups=choices["position"].to_numpy(),
        at_least=given.cover.at_least,
    )
    cover = _solve(given, problem)
    _check_solved(given, cover)
    return better(Deployment(problem), cover)


def _solve(given: CoverFiles, problem: CoverProblem) -> Cover:
    effort, seed, gap = _limits(given)
    if effort.solver == HIGHS:
        return solve_whole(Deployment(problem), effort.limit(), gap)
    return solve_cover_problem(problem, effort.limit(), seed=seed, gap=gap)


def _limits(given: CoverFiles) -> tuple[Effort, int, float]:
    cover = given.cover
    return Effort(cover.time_limit_s, cover.patience, cover.solver), given.seed, cover.gap


def _option_content(answered: Answer, sensors: pd.DataFrame) -> dict[str, Any]:
    """What solution.json says more, or differently, of a plan with options."""
    for name in answered.sensors:
        sensors[name] = answered.sensors[name].to_numpy()
    goal = answered.record["goal"]
    asked_for = answered.record["asked"]
    changes: dict[str, Any] = {"at_least": asked_for["at_least"]} if "at_least" in asked_for else {}
    return changes | {
        "bound": goal["bound"] if goal["kind"] == "cost" else None,
        "sensors": sensors.to_dict("records"),
        "covered_targets": answered.record["seen_targets"],
        "options": answered.record,
    }


def _option_layers(
    answered: Answer, candidates: pd.DataFrame, choices: pd.DataFrame
) -> dict[str, gpd.GeoDataFrame]:
    """Layers of what could replace each sensor and of a different answer."""
    if "alternatives" not in answered.record:
        return {}

    def table(rows: list[int]) -> pd.DataFrame:
        chosen = choices.iloc[rows]
        places = posed_candidates(chosen, candidates)
        places.insert(1, "sensor", chosen["sensor"].tolist())
        return places

    swaps = table([row for _, row in answered.alternatives])
    replaced = [int(answered.cover.chosen[k]) for k, _ in answered.alternatives]
    swaps["replaces"] = choices["candidate"].iloc[replaced].tolist()
    return {"alternatives": points(swaps), "different": points(table(answered.different.tolist()))}


def _check_uncovered(
    given: CoverFiles, targets: pd.DataFrame, unseen: list[str], asked: Asked | None
) -> None:
    uncovered = len(unseen)
    if asked is not None and asked.soft and uncovered < len(targets):
        return
    missing = uncovered
    if asked is not None and asked.areas is not None:
        beyond = targets[targets["target"].isin(unseen)]
        missing = int((needs_by_area(asked.areas, beyond, asked.at_least)[1] > 0).sum())
    if missing and given.uncoverable == "error":
        raise InputError(
            f"{missing} of {len(targets)} targets are seen by no candidate",
            where=f"site {given.site}, plan {given.plan}",
            hint=f"they are listed in {given.coverage}; densify the candidates"
            " (candidates.spacing_m, coverage.rounds), remove what hides them,"
            " or leave them out with coverage.uncoverable: exclude",
        )
    if uncovered == len(targets):
        raise InputError(
            "no target is seen by any candidate",
            where=f"site {given.site}, plan {given.plan}",
            hint="check the edges' position, the heights and targets.min_beams",
        )
    if uncovered:
        total = len(targets)
        log.warning("%d of %d targets are seen by no candidate: left out", uncovered, total)


def _check_solved(given: LevelFiles, cover: Cover) -> None:
    if cover.status == "infeasible":
        if given.availability is not None:
            raise InputError(
                f"no set of sensors sees every target {given.availability:g} of the time",
                where=f"site {given.site}, plan {given.plan}",
                hint="lower the plan's availability, or densify the candidates",
            )
        found = f"{len(cover.uncoverable)} targets seen by too few candidates"
        if not len(cover.uncoverable):
            found = "enough candidates for each target alone, but one position takes one sensor"
        raise InputError(
            f"no set of sensors covers every target {given.cover.at_least} times",
            where=f"site {given.site}, plan {given.plan}",
            found=found,
            hint="lower cover.at_least or densify the candidates",
        )
    if not len(cover.chosen):
        raise InputError(
            "no set of sensors was found within the time limit",
            where=f"site {given.site}, plan {given.plan}",
            found=f"{given.cover.time_limit_s:g} s",
            hint="raise cover.time_limit_s",
        )
    if cover.status == WITHIN_GAP:
        log.info("proven as far as was asked for, gap %.1f %%", 100 * cover.gap)
    elif cover.status != "optimal":
        log.warning("not proven, gap %.1f %%: out of work or of patience (cover)", 100 * cover.gap)


def _sensor_table(
    candidates: pd.DataFrame,
    choices: pd.DataFrame,
    cover: Cover,
    matrix: sparse.csr_matrix,
    frame: Frame,
) -> pd.DataFrame:
    """The chosen candidates, with what each sees and what only it sees."""
    rows = np.asarray(cover.chosen, np.int64)
    chosen = choices.iloc[rows]
    table = posed_candidates(chosen, candidates)
    table.insert(1, "sensor", chosen["sensor"].tolist())
    table["cost"] = chosen["cost"].to_numpy(np.float64)
    seen = matrix[rows].astype(np.int64)
    once = np.asarray(seen.sum(axis=0)).ravel() == 1
    table["targets"] = np.asarray(seen.sum(axis=1)).ravel()
    table["only"] = np.asarray(seen[:, once].sum(axis=1)).ravel()
    table["native"] = frame.to_native(table[["x", "y", "z"]].to_numpy()).round(4).tolist()
    return table


def _content(
    given: CoverFiles,
    cover: Cover,
    sensors: pd.DataFrame,
    targets: pd.DataFrame,
    uncovered: list[str],
) -> dict[str, Any]:
    return {
        "site": given.site,
        "plan": given.plan,
        "sensor_types": [entry.partition("=")[0] for entry in given.sensors],
        "status": cover.status,
        "objective": cover.objective,
        "bound": cover.bound,
        "gap": cover.gap,
        "solver": cover.solver,
        "solver_version": version(cover.solver),
        "proved_by": cover.proved_by,
        "at_least": given.cover.at_least,
        "sensors": sensors.to_dict("records"),
        "targets": len(targets),
        "covered_targets": len(targets) - len(uncovered),
        "uncoverable_targets": len(uncovered),
        "excluded": uncovered,
        "reductions": cover.reductions,
    }


def _proven_area(targets: pd.DataFrame, at_least: int) -> dict[str, float]:
    """Pavement whose targets are seen as often as asked for; nothing where none says its own."""
    if "area_m2" not in targets:
        return {}
    needed = targets.get("needed", at_least)
    enough = targets["sensors"] >= np.maximum(needed, 1)
    return {"proven_area_m2": float(targets.loc[enough, "area_m2"].sum())}


def _located(sensors: pd.DataFrame, frame: Frame) -> pd.DataFrame:
    """The sensors' layer: number, azimuth clockwise from grid north, and where they are on a globe.

    The number is that of the report, from 1.
    """
    table = sensors.drop(columns="native")
    table.insert(0, "number", np.arange(1, len(table) + 1))
    table["azimuth_deg"] = [bearing_deg(float(yaw)) for yaw in table["yaw_deg"]]
    degrees = longitudes_latitudes(frame, table[["x", "y"]].to_numpy(np.float64))
    unknown = np.full((len(table), 2), np.nan)
    table[["longitude", "latitude"]] = unknown if degrees is None else degrees
    return table


@dataclass(frozen=True)
class Levelled:
    """A cover at a level.

    Parameters
    ----------
    shares : (targets,) how often at least one sensor sees each target. record : what solution.json
        says of it.
    """

    cover: Cover
    shares: Floats
    record: dict[str, Any]


def cover_at_level(
    given: LevelFiles,
    level: float,
    traffic: Traffic | None,
    detections: pd.DataFrame,
    choices: pd.DataFrame,
    candidates: pd.DataFrame,
    targets: pd.DataFrame,
) -> Levelled:
    """Cheapest sensors that together see each target with the plan's probability.

    Parameters
    ----------
    traffic : past which sensors look; None where none is simulated.

    Raises
    ------
    InputError : targets cannot reach the level and may not be left below it.
    """
    pairs = pd.MultiIndex.from_frame(choices[["sensor", "candidate"]].astype(str))
    shares = share_matrix(detections, pairs, pd.Index(targets["target"].astype(str)))
    position = choices["position"].to_numpy(np.int64)
    costs = choices["cost"].to_numpy(np.float64)
    oracle = None
    if traffic is not None:
        feet = targets[["x", "y", "z"]].to_numpy(np.float64)
        middles = feet + np.array([0.0, 0.0, given.target_height_m / 2])
        sensors_m = candidates[["x", "y", "z"]].to_numpy(np.float64)[position]
        shares = past_traffic(shares, traffic, sensors_m, middles)
        posed = at_level(shares, costs, position, level)
        oracle = CommonTraffic(traffic, sensors_m, middles, shares, level, posed.below)
    else:
        log.warning("no traffic is simulated: every sensor sees its targets for certain")
        posed = at_level(shares, costs, position, level)
    _check_below(given, level, posed.below.tolist(), targets)
    cover = solve_joint(posed.problem, given.cover.time_limit_s, given.cover.gap, oracle)
    hidden = shares[cover.chosen].copy()
    hidden.data = np.log1p(-np.minimum(hidden.data, 1 - 1e-12))
    alone = -np.expm1(np.asarray(hidden.sum(axis=0)).ravel())
    seen = alone if oracle is None else oracle.joint_shares(cover.chosen)
    below = sorted({*posed.below.tolist(), *(oracle.given_up if oracle else ())})
    _check_below(given, level, below, targets)
    _check_solved(given, cover)
    record = {
        "level": level,
        "independent": described(alone),
        "below": {str(targets["target"].iloc[t]): float(seen[t]) for t in below},
        **described(seen),
    }
    return Levelled(cover, seen, record)


def described(shares: Floats) -> dict[str, Any]:
    """Mean, least and classes of availability."""
    return {
        "mean": float(shares.mean()),
        "least": float(shares.min()),
        "histogram": counted_shares(shares),
    }


def _check_below(given: LevelFiles, level: float, below: list[int], targets: pd.DataFrame) -> None:
    if not below or given.uncoverable == "exclude":
        return
    first = ", ".join(targets["target"].astype(str).iloc[below[:5]])
    raise InputError(
        f"{len(below)} of {len(targets)} targets are in sight less often than the plan asks,"
        " even if every candidate carries a sensor",
        where=f"site {given.site}, plan {given.plan}",
        found=first,
        allowed=f"{level:g} of the time",
        hint="lower the plan's availability, lower conditions.availability so that sensors count"
        " that see a target less often, or leave these targets below it with"
        " coverage.uncoverable: exclude",
    )


main = Command(solve_cover)


if __name__ == "__main__":
    sys.exit(main())
