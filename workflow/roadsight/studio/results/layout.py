"""A plan's sensors, and what others in their place would see: from the plan's own detections."""

from __future__ import annotations

import threading
from typing import Annotated, Any

import geopandas as gpd
import numpy as np
import pandas as pd
from pydantic import BaseModel, ConfigDict, Field

from roadsight.base.arrays import Bools, Floats, Ints
from roadsight.base.errors import InputError
from roadsight.config.plans import Plan
from roadsight.io.records.atomic import read_json
from roadsight.io.records.tables import read_table
from roadsight.io.vector.vectors import read_layer
from roadsight.placement.plans.choices import posed_candidates
from roadsight.placement.sensors.sensors import load_sensors
from roadsight.placement.sight.coverage import times_seen
from roadsight.studio.project import Project, SiteFolder
from roadsight.studio.results.plan_choices import choices_to_try, plan_files, state_of

_MOST_SENSORS = 5000
"""Sensors of a layout that are taken from a page."""
_SUMMARY = (
    "status",
    "objective",
    "bound",
    "gap",
    "at_least",
    "targets",
    "covered_targets",
    "uncoverable_targets",
)


class WhatIf(BaseModel):
    """Sensors that stand: rows of the choices of a plan, as it was when the page read it."""

    model_config = ConfigDict(extra="forbid")
    version: Annotated[str, Field(max_length=80)]
    rows: Annotated[list[Annotated[int, Field(ge=0)]], Field(max_length=_MOST_SENSORS)]


class Layout:
    """One plan as it is now on disk.

    Parameters
    ----------
    site : where it lies. plan : its name. sensors_file : definitions of sensors.

    Attributes
    ----------
    choices, places, matrix, chosen : as `PlanChoices`, and where the choices stand and look.
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
        found = choices_to_try(site, plan, self.files, self.costs, self.solution, self.targets)
        self.choices, self.matrix, self.chosen = found.choices, found.matrix, found.chosen
        self.places = posed_candidates(self.choices, found.candidates)
        self.needed = self._needed()
        self.notes = _not_counted(asked)
        self._found = found

    def _needed(self) -> Ints:
        """How many sensors each target needs (n,): the plan's, or its areas' own number."""
        needed = pd.Series(int(self.solution["at_least"]), index=self.targets["target"])
        if self.solution.get("options") and self.files["layers"].exists():
            layer = read_layer(self.files["layers"], "targets", self.frame)
            own = layer.set_index("target")["needed"]
            needed.update(own[own > 0])
        return np.asarray(needed, np.int64)

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
        self._check(rows)
        return self._counted(rows)

    def _counted(self, rows: Ints) -> dict[str, Any]:
        times = times_seen(self.matrix, rows)
        covered = times >= self.needed
        before = times_seen(self.matrix, self.chosen) >= self.needed
        critical = covered & (times == self.needed)
        only = np.asarray(self.matrix[rows][:, critical].sum(axis=1)).ravel()
        best, gain = self._next(rows, covered)
        return {
            "times": times.tolist(),
            "needs": np.maximum(self.needed - times, 0).tolist(),
            "covered": int(covered.sum()),
            "lost": int((before & ~covered).sum()),
            "gained": int((covered & ~before).sum()),
            "only": only.tolist(),
            "cost": float(self.choices["cost"].to_numpy()[rows].sum()),
            "next": best,
            "next_covers": gain,
        }

    def _check(self, rows: Ints) -> None:
        if len(rows) and rows.max() >= len(self.choices):
            raise InputError("no such candidate", where="studio", found=int(rows.max()))
        position = self.choices["position"].to_numpy()[rows]
        if len(np.unique(position)) < len(position):
            raise InputError("two sensors at one position", where="studio")
        if self._found.are_crowded(rows):
            raise InputError(
                "two sensors stand nearer to each other than the plan's spacing_m",
                where="studio",
                hint="move one of them",
            )

    def _next(self, rows: Ints, covered: Bools) -> tuple[int | None, int]:
        """Free choice that sees most uncovered targets; the cheaper, then the first, of equals."""
        gain = np.asarray(self.matrix[:, ~covered].sum(axis=1)).ravel().astype(np.int64)
        gain[self._found.excluded(rows)] = 0
        cost = self.choices["cost"].to_numpy(np.float64)
        best = int(np.lexsort((np.arange(len(gain)), cost, -gain))[0]) if len(gain) else 0
        return (best, int(gain[best])) if len(gain) and gain[best] > 0 else (None, 0)

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
