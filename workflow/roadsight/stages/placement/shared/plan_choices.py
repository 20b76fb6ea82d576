"""What a plan may choose: sensors at places that may carry them, their costs, what they see."""

from __future__ import annotations

import json
import logging
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
import pandas as pd
from scipy import sparse

from roadsight.base.arrays import Bools, Floats
from roadsight.base.errors import InputError
from roadsight.geometry.frames import Frame
from roadsight.io.records.atomic import read_json
from roadsight.io.records.placement_tables import FOR_SENSORS, read_detections
from roadsight.io.records.tables import read_table
from roadsight.io.vector.known import read_points
from roadsight.io.vector.site_bounds import tell_near
from roadsight.io.vector.vectors import read_polygons
from roadsight.placement.candidates.mounting import (
    Mounting,
    building_cost,
    cable_lengths_m,
    may_be_built,
    outside_zones,
)
from roadsight.placement.plans.plan_problem import choices_of
from roadsight.placement.sight.detection import detection_matrix


@dataclass(frozen=True)
class PlanChoices:
    """Choices of a plan.

    Parameters
    ----------
    candidates : those of all rounds that may carry a sensor, with cable_m if cabinets are known.
    detections : what all candidates see. choices : as `choices_of`, the costs of masts,
        foundations and cables included.
    """

    candidates: pd.DataFrame
    detections: pd.DataFrame
    choices: pd.DataFrame

    def matrix(self, targets: pd.Series) -> sparse.csr_matrix:
        """Which choice sees which target (choices, targets)."""
        pairs = pd.MultiIndex.from_frame(self.choices[["sensor", "candidate"]])
        return detection_matrix(self.detections, pairs, pd.Index(targets))


# Which candidates may carry a sensor, and at what cost beside it: zones, rules of mounting.


@dataclass(frozen=True, kw_only=True)
class AllowedFiles:
    """What says which candidates may carry a sensor."""

    zones: Annotated[str | None, "polygons in which no sensor may stand"] = None
    cabinets: Annotated[str | None, "points of power and fibre"] = None
    mounting: Annotated[str, "rules of mounting as JSON"] = "{}"


@dataclass(frozen=True, kw_only=True)
class ChoiceFiles(AllowedFiles):
    """What tells where a plan's sensors may stand and what they see there."""

    frame: Path
    candidates: Sequence[Path]
    detections: Sequence[Path]


def read_choices(given: ChoiceFiles, cost_entries: Sequence[str], frame: Frame) -> PlanChoices:
    """Choices from candidates and detections; ``cost_entries``: sensor=cost of the plan's sensors.

    Raises
    ------
    InputError : as `allowed_candidates`.
    """
    costs = {name: float(cost) for name, _, cost in (s.partition("=") for s in cost_entries)}
    candidates = pd.concat([read_table(path) for path in given.candidates], ignore_index=True)
    allowed, building_cost, cable_m = allowed_candidates(given, candidates, given.frame, frame)
    if cable_m is not None:
        candidates["cable_m"] = cable_m
    candidates = candidates[allowed].reset_index(drop=True)
    candidates = candidates.drop(columns=FOR_SENSORS, errors="ignore")
    detections = read_detections(given.detections)
    choices = choices_of(costs, candidates, detections)
    choices["cost"] = choices["cost"] + building_cost[allowed][choices["position"]]
    return PlanChoices(candidates, detections, choices)


log = logging.getLogger(__name__)


def allowed_candidates(
    given: AllowedFiles, candidates: pd.DataFrame, frame_path: Path, frame: Frame
) -> tuple[Bools, Floats, Floats | None]:
    """Whether each candidate (m,) may carry a sensor, its cost beside it, and its cable's length.

    Raises
    ------
    InputError : a file is not usable, a cabinet lies off the site, or no candidate is left.
    """
    rules = Mounting(**json.loads(given.mounting or "{}"))
    about = read_json(frame_path)
    cabinets = read_points(given.cabinets, frame) if given.cabinets else None
    if given.cabinets and cabinets is not None:
        places = cabinets[["x", "y"]].to_numpy(np.float64)
        tell_near(log, "cabinets", places, about, given.cabinets)
    where = str(given.cabinets or "mounting")
    cable_m = cable_lengths_m(candidates, cabinets, rules, where)
    free = np.ones(len(candidates), bool)
    if given.zones:
        zones = list(read_polygons(given.zones, frame).geometry)
        tell_near(log, "zones", np.array(zones, object), about, given.zones)
        free = outside_zones(candidates[["x", "y"]].to_numpy(np.float64), zones)
    if "mount" not in candidates:
        return free, np.zeros(len(candidates)), cable_m
    allowed = free & may_be_built(candidates, rules, cable_m)
    if len(candidates) and not allowed.any():
        raise InputError(
            "no candidate may carry a sensor",
            where=str(given.zones or "mounting"),
            found=f"{int((~free).sum())} of {len(candidates)} in zones without sensors, the others"
            " against the rules of mounting",
            hint="make the zones smaller (placement.zones) or the rules milder (mounting)",
        )
    return allowed, building_cost(candidates, rules, cable_m), cable_m
