"""Denser candidates near targets that no candidate sees (paper 1, section 2.5)."""

from __future__ import annotations

import logging
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import numpy as np
import pandas as pd

from roadsight.base.arrays import Floats
from roadsight.base.sections.placement import Coverage
from roadsight.geometry.frames import Frame
from roadsight.io.records.atomic import read_json
from roadsight.io.records.placement_tables import FOR_SENSORS
from roadsight.io.records.tables import read_table, write_table
from roadsight.placement.candidates.candidates import near_gaps, positions_along
from roadsight.stages.command import Command
from roadsight.stages.placement.place_candidates import (
    COLUMNS,
    CandidateFiles,
    allowed_positions,
    candidates_at,
    read_road,
)

log = logging.getLogger("densify_candidates")


def densify_candidates(
    given: CandidateFiles,
    round_: int,
    coverage: Annotated[Path, "coverage of the round before"],
    targets: Path,
    candidates: Annotated[Sequence[Path], "of all rounds before"],
    plans: Annotated[Sequence[str], "plan=sensor,sensor"],
    radius_m: Annotated[float, Coverage],
    closest_m: Annotated[float, Coverage],
    *,
    out: Path,
) -> None:
    """Write the new candidates of a round: half the spacing of the round before, near gaps only.

    Horizontally and vertically; either spacing "has a lower bound because LiDAR sensors cannot be
    placed too close" (paper 1, section 2.3).
    """
    frame = Frame.from_dict(read_json(given.frame))
    known = pd.concat([read_table(path) for path in candidates], ignore_index=True)
    gaps = _gaps_by_sensor(plans, targets, coverage)
    every = np.concatenate([np.empty((0, 2)), *gaps.values()])
    denser = known.iloc[:0]
    if len(every):
        edges, pavement = read_road(given.edges, given.pavement, frame)
        spacing_m = _halved(given.settings.spacing_m, round_, closest_m)
        positions = positions_along(edges, pavement, spacing_m)
        positions = allowed_positions(positions, pavement, given, frame)
        positions = positions[near_gaps(positions, every, radius_m)]
        if len(positions):
            step_m = _halved(given.settings.height_step_m, round_, closest_m)
            settings = given.settings.model_copy(update={"height_step_m": step_m})
            positions = positions.reset_index(drop=True)
            denser = candidates_at(positions, given, settings, frame, pavement)
            denser = denser[~denser["candidate"].isin(known["candidate"])]
    denser = denser[COLUMNS].astype(known[COLUMNS].dtypes).reset_index(drop=True)
    near = {sensor: near_gaps(denser, gaps_xy, radius_m) for sensor, gaps_xy in gaps.items()}
    denser[FOR_SENSORS] = [
        " ".join(sensor for sensor, found in near.items() if found[row])
        for row in range(len(denser))
    ]
    denser[FOR_SENSORS] = denser[FOR_SENSORS].astype(str)
    counts = ", ".join(f"{sensor}: {found.sum()}" for sensor, found in near.items())
    log.info("%d new candidates (%s)", len(denser), counts or "no gap")
    write_table(out, denser)


def _halved(spacing_m: float, times: int, least_m: float) -> float:
    """A spacing after so many halvings, or before the first that would be less than the least."""
    while times > 0 and spacing_m / 2 >= least_m - 1e-9:
        spacing_m, times = spacing_m / 2, times - 1
    return spacing_m


def _gaps_by_sensor(
    plans: Sequence[str], targets_path: Path, coverage_path: Path
) -> dict[str, Floats]:
    """Places (n, 2) of the targets that no plan's sensors see, for each sensor of such a plan.

    A sensor all of whose plans see everything has no gap, and gets no denser candidates.
    """
    coverage = read_json(coverage_path)["plans"]
    targets = read_table(targets_path)
    open_targets: dict[str, set[str]] = {}
    for entry in plans:
        plan, _, sensors = entry.partition("=")
        for sensor in sensors.split(","):
            open_targets.setdefault(sensor, set()).update(coverage[plan]["uncovered"])
    return {
        sensor: targets.loc[targets["target"].isin(names), ["x", "y"]].to_numpy(np.float64)
        for sensor, names in open_targets.items()
        if names
    }


main = Command(densify_candidates)


if __name__ == "__main__":
    sys.exit(main())
