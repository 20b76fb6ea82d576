"""A plan's sensors, and what others in their place would see: from the plan's own detections."""

from __future__ import annotations

import hashlib
import json
import threading
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import geopandas as gpd
import numpy as np
import pandas as pd
from pydantic import Field

from roadsight.base.arrays import Floats, Ints
from roadsight.base.errors import InputError
from roadsight.base.sections.placement import Cover
from roadsight.config.plans import FILES, Plan
from roadsight.io.records.atomic import read_json
from roadsight.io.records.companions import split_layer
from roadsight.io.records.tables import read_table
from roadsight.io.vector.vectors import read_layer
from roadsight.placement.plans.plan_problem import Asked, pose, posed_candidates
from roadsight.placement.sensors.sensors import load_sensors
from roadsight.placement.sight.detection import times_seen
from roadsight.stages.placement.shared.cover_inputs import PlanFiles, read_asked
from roadsight.stages.placement.shared.plan_choices import ChoiceFiles, read_choices
from roadsight.studio.project import FRAME, Project, SiteFolder
from roadsight.studio.requests import Body

_MOST_SENSORS = 5000  # Sensors of a layout that are taken from a page

_SUMMARY = (
    "status", "objective", "bound", "gap", "at_least", "targets", "covered_targets",
    "uncoverable_targets",
)  # fmt: skip


class WhatIf(Body):
    """Sensors that stand: rows of the choices of a plan, as it was when the page read it."""

    version: Annotated[str, Field(max_length=80)]
    rows: Annotated[list[Annotated[int, Field(ge=0)]], Field(max_length=_MOST_SENSORS)]


class Layout:
    """One plan as it is now on disk.

    Parameters
    ----------
    site : where it lies. plan : its name. sensors_file : definitions of sensors.

    Attributes
    ----------
    choices : (n,) as `choices_of`, with their whole cost. places : where they stand and look.
    matrix : which of them sees which target (n, targets). chosen : (k,) those of the solution.
    exclusive : (sets, n), at most one of each set stands.
    needed : (targets,) sensors that each needs. notes : what is not counted, in sentences.

    Raises
    ------
    InputError : no such plan, or a result is not there yet or damaged.
    """

    def __init__(self, site: SiteFolder, plan: str, sensors_file: str) -> None:
        self.files = plan_files(site, plan, sensors_file)
        self.version = state_of(site, plan, self.files)
        self.frame = site.frame()
        self.solution = read_json(self.files["solution"])
        self.targets = read_table(self.files["targets"])
        kinds, asked = load_sensors(sensors_file), site.resolved.plans[plan]
        self.costs = {name: kinds[name].cost for name in asked.sensors}
        self._read_choices(site, plan)
        # Sensors that each target needs: the plan's number, or its areas' own.
        needed = pd.Series(int(self.solution["at_least"]), index=self.targets["target"])
        if self.solution.get("options") and self.files["layers"].exists():
            layer = read_layer(self.files["layers"], "targets", self.frame)
            own = layer.set_index("target")["needed"]
            needed.update(own[own > 0])
        self.needed = np.asarray(needed, np.int64)
        self.notes = _not_counted(asked)

    def _read_choices(self, site: SiteFolder, plan: str) -> None:
        """What could stand instead of the plan's sensors, by the solver's own functions.

        Forbidden are the places of zones, of the rules of mounting and of the plan; of the last,
        the ones where its sensors stand stay.
        """
        given = _given(site, plan, site.resolved.plans[plan], self.files)
        costs = [f"{name}={cost!r}" for name, cost in self.costs.items()]
        found = read_choices(given, costs, self.frame)
        matrix = found.matrix(self.targets["target"])
        where = f"site {site.stem}, plan {plan}"
        asked = read_asked(given, self.frame) or Asked({}, 1, where, exclude=True)
        posed = pose(asked, matrix, found.choices, found.candidates, self.targets).deployment
        chosen = _chosen(found.choices, self.solution, str(self.files["solution"]))
        free = ~posed.problem.forbidden
        free[chosen] = True
        kept = np.flatnonzero(free)
        self.choices = found.choices.assign(cost=posed.problem.costs).iloc[kept]
        self.choices = self.choices.reset_index(drop=True)
        self.places = posed_candidates(self.choices, found.candidates)
        self.matrix, self.exclusive = matrix[kept], posed.exclusive[:, kept]
        self.chosen: Ints = np.searchsorted(kept, chosen)

    def about(self) -> dict[str, Any]:
        """Everything that the page draws."""
        xyz = self.places[["x", "y", "z"]].to_numpy(np.float64)
        kinds = list(self.costs)
        return {
            "version": self.version,
            "frame": {"origin": list(self.frame.origin), "unit_m": self.frame.unit_m},
            "sensors": [{"name": name, "cost": cost} for name, cost in self.costs.items()],
            "choices": {
                "xyz": _flat(xyz),
                "yaw_deg": _flat(self.places["yaw_deg"].to_numpy(np.float64)),
                "height_m": _flat(self.places["height_m"].to_numpy(np.float64)),
                "key": pd.factorize(self.places["key"])[0].tolist(),
                "sensor": [kinds.index(name) for name in self.choices["sensor"]],
                "position": self.choices["position"].tolist(),
                "name": self.choices["candidate"].tolist(),
                "posed": self.choices["posed"].tolist(),
                "cost": self.choices["cost"].tolist(),
                "sees": np.diff(self.matrix.indptr).tolist(),
            },
            "targets": _flat(self.targets[["x", "y", "z"]].to_numpy(np.float64)),
            "chosen": self.chosen.tolist(),
            "solution": {name: self.solution.get(name) for name in _SUMMARY},
            "notes": self.notes,
            "coverage": self._counted(self.chosen),
            **self._obstacles(),
        }

    def coverage(self, rows: Ints) -> dict[str, Any]:
        """What a set of choices sees.

        Parameters
        ----------
        rows : of the choices, each once, no two at one position.

        Returns
        -------
        times : sensors that see each target; needs : those still missing of each, 0 where it is
        covered; covered, lost and gained against the plan; only : targets of each of ``rows`` that
        would be lost without it; cost; next : the choice that would cover most of what is not
        covered (None if none does), and how many.

        Raises
        ------
        InputError : no such choices, or two that exclude each other.
        """
        if len(rows) and rows.max() >= len(self.choices):
            raise InputError("no such candidate", where="studio", found=int(rows.max()))
        position = self.choices["position"].to_numpy()[rows]
        if len(np.unique(position)) < len(position):
            raise InputError("two sensors at one position", where="studio")
        inside = np.bincount(rows, minlength=len(self.choices))
        if (self.exclusive @ inside > 1).any():
            raise InputError(
                "two sensors stand nearer to each other than the plan's spacing_m",
                where="studio",
                hint="move one of them",
            )
        return self._counted(rows)

    def _counted(self, rows: Ints) -> dict[str, Any]:
        times = times_seen(self.matrix, rows)
        covered = times >= self.needed
        before = times_seen(self.matrix, self.chosen) >= self.needed
        critical = covered & (times == self.needed)
        only = np.asarray(self.matrix[rows][:, critical].sum(axis=1)).ravel()
        # Free choice that sees most uncovered targets; the cheaper, then the first, of equals.
        gain = np.asarray(self.matrix[:, ~covered].sum(axis=1)).ravel().astype(np.int64)
        inside = np.zeros(len(self.choices), np.int32)
        inside[rows] = 1
        beside = np.asarray(self.exclusive.T @ (self.exclusive @ inside)).ravel()
        gain[(inside > 0) | (beside > 0)] = 0
        cost = self.choices["cost"].to_numpy(np.float64)
        best = int(np.lexsort((np.arange(len(gain)), cost, -gain))[0]) if len(gain) else 0
        helps = len(gain) > 0 and gain[best] > 0
        return {
            "times": times.tolist(),
            "needs": np.maximum(self.needed - times, 0).tolist(),
            "covered": int(covered.sum()),
            "lost": int((before & ~covered).sum()),
            "gained": int((covered & ~before).sum()),
            "only": only.tolist(),
            "cost": float(self.choices["cost"].to_numpy()[rows].sum()),
            "next": best if helps else None,
            "next_covers": int(gain[best]) if helps else 0,
        }

    def _obstacles(self) -> dict[str, Any]:
        """What stands in the way of the plan's sensors, and why targets are not covered."""
        path = self.files["obstacles"]
        if not path.exists():
            return {"obstacles": [], "uncovered": []}
        obstacles = read_layer(path, "obstacles", self.frame)
        uncovered = read_layer(path, "uncovered", self.frame)
        rows = pd.Index(self.targets["target"]).get_indexer(_column(uncovered, "target"))
        reasons = zip(rows.tolist(), _column(uncovered, "reason"), strict=True)
        return {
            "obstacles": [
                {
                    "x": place.x,
                    "y": place.y,
                    "z": place.z if place.has_z else 0.0,
                    "kind": kind,
                    "targets": int(count),
                    "height_m": float(height),
                }
                for place, kind, count, height in zip(
                    obstacles.geometry,
                    _column(obstacles, "kind"),
                    _column(obstacles, "targets"),
                    _column(obstacles, "height_m"),
                    strict=True,
                )
            ],
            "uncovered": [{"target": row, "reason": reason} for row, reason in reasons if row >= 0],
        }


def _not_counted(plan: Plan) -> list[str]:
    """What a plan asks for and a what-if does not count, in sentences."""
    notes = []
    if plan.availability is not None:
        notes.append(
            f"The plan asks that sensors see each target {100 * plan.availability:g} % of the time,"
            " past traffic. That is not counted here: a target counts that a sensor sees at all."
        )
    if plan.robust is not None:
        notes.append(
            "The plan counts what sensors see with tolerance. That is not counted here: sensors"
            " count as if they stood exactly so."
        )
    return notes


def _column(layer: gpd.GeoDataFrame, name: str) -> list[Any]:
    return layer[name].tolist() if name in layer else []


class Layouts:
    """Plans by site, read again when their files change; the one asked for last is kept."""

    def __init__(self, project: Project) -> None:
        self._project = project
        self._known: tuple[tuple[str, str, str], Layout] | None = None
        self._lock = threading.Lock()

    def of(self, stem: str, plan: str) -> Layout:
        """A plan of a site as it is now.

        Raises
        ------
        InputError : as `Layout`.
        """
        site = self._project.site(stem)
        sensors_file = self._project.config().sensors_file
        key = (stem, plan, state_of(site, plan, plan_files(site, plan, sensors_file)))
        with self._lock:
            if self._known is None or self._known[0] != key:
                self._known = (key, Layout(site, plan, sensors_file))
            return self._known[1]

    def coverage(self, stem: str, plan: str, asked: WhatIf) -> dict[str, Any]:
        """What other sensors would see.

        Raises
        ------
        InputError : as `asked` and `Layout.coverage`.
        """
        return self.asked(stem, plan, asked).coverage(np.array(asked.rows, np.int64))

    def asked(self, stem: str, plan: str, asked: WhatIf) -> Layout:
        """The plan that a page asks about.

        Raises
        ------
        InputError : as `Layout`; or the plan has changed since the page read it.
        """
        layout = self.of(stem, plan)
        if layout.version != asked.version:
            raise InputError(
                "was computed anew meanwhile, or what it may use has changed",
                where=f"plan {plan}",
                hint="reload the page",
            )
        return layout


def _flat(table: Floats) -> list[float]:
    return np.round(table, 3).ravel().tolist()


# Files of a plan, and what of them the solver reads.

# Options of a plan that say where a sensor may stand and what it costs there; the others say what
# is to be seen, and a what-if is free of those
_WHERE_AND_COST = ("forbidden", "poles", "spacing_m")


def plan_files(site: SiteFolder, plan: str, sensors_file: str) -> dict[str, Path]:
    """Files of a plan by a short name; all results but the layers and obstacles are there.

    Raises
    ------
    InputError : no such plan, or a result is not there yet.
    """
    if plan not in site.resolved.plans:
        raise InputError("no such plan", where=f"site {site.stem}", found=plan)
    settings, folder = site.resolved.settings, f"placement/{plan}"
    names = {
        "solution": f"{folder}/solution.json",
        "targets": "placement/targets.parquet",
        "frame": FRAME,
    }
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
    found["sensors"] = Path(sensors_file)
    # Files of the user that decide where sensors of the plan may stand.
    for name in ("zones", "cabinets"):
        path = site.resolved.beside(getattr(site.resolved.site.placement, name))
        if path is not None:
            found[name] = Path(path)
    for name in FILES:
        path = site.resolved.plans[plan].file_of(name)
        if path is not None:
            found[name] = Path(split_layer(path)[0])
    return found


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
