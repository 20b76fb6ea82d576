"""What a plan may choose: sensors at places that may carry them, their costs, what they see."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import pandas as pd
from scipy import sparse

from roadsight.geometry.frames import Frame
from roadsight.io.records.detections import read_detections
from roadsight.io.records.poses import FOR_SENSORS
from roadsight.io.records.tables import read_table
from roadsight.placement.plans.choices import choices_of
from roadsight.placement.sight.coverage import detection_matrix
from roadsight.stages.placement.shared.allowed import AllowedFiles, allowed_candidates


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
