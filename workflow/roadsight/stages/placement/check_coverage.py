"""Which targets no candidate of a plan sees."""

from __future__ import annotations

import logging
import sys
from collections import defaultdict
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import pandas as pd

from roadsight.base.errors import InputError
from roadsight.geometry.frames import Frame
from roadsight.io.records.atomic import read_json, write_json
from roadsight.io.records.placement_tables import read_seen_targets
from roadsight.io.records.tables import read_table
from roadsight.stages.command import Command
from roadsight.stages.placement.shared.plan_choices import AllowedFiles, allowed_candidates

log = logging.getLogger("check_coverage")


def check_coverage(
    targets_path: Path,
    candidates_paths: Sequence[Path],
    detections: Sequence[Path],
    plans: Annotated[Sequence[str], "plan=sensor,sensor"],
    rules: AllowedFiles,
    frame_path: Annotated[Path | None, "needed with zones and rules of mounting"] = None,
    *,
    out: Path,
) -> None:
    """Write the uncovered targets of each plan."""
    targets = pd.Index(read_table(targets_path)["target"])
    if targets.empty:
        raise InputError(
            "no target: no pavement cell has enough points",
            where=str(targets_path),
            hint="lower targets.min_points or raise targets.cell_size_m",
        )
    candidates = pd.concat([read_table(path) for path in candidates_paths], ignore_index=True)
    allowed = None
    if frame_path:
        frame = Frame.from_dict(read_json(frame_path))
        free, _, _ = allowed_candidates(rules, candidates, frame_path, frame)
        allowed = None if free.all() else set(candidates["candidate"][free].astype(str))
        log.info("%d of %d candidates may carry a sensor", free.sum(), len(free))
    seen: dict[str, set[str]] = defaultdict(set)
    for path in detections:
        sensor, names = read_seen_targets(path, allowed)
        seen[sensor] |= set(names)
    told = {}
    for entry in plans:
        name, _, sensors = entry.partition("=")
        covered = set().union(*(seen[sensor] for sensor in sensors.split(",")))
        gaps = targets[~targets.isin(covered)]
        told[name] = {"uncovered": list(gaps), "covered_share": 1 - len(gaps) / len(targets)}
        log.info("%s: %d of %d targets uncovered", name, len(gaps), len(targets))
    count = len(candidates) if allowed is None else len(allowed)
    content = {"targets": len(targets), "candidates": count, "plans": told}
    write_json(out, content)


main = Command(check_coverage)


if __name__ == "__main__":
    sys.exit(main())
