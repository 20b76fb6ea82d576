"""What a plan loses where its sensors do not stand exactly as planned."""

from __future__ import annotations

import logging
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from roadsight.base.arrays import Bools
from roadsight.geometry.frames import Frame
from roadsight.io.records.atomic import read_json, write_json
from roadsight.io.records.placement_tables import read_detections
from roadsight.io.vector.vectors import points, write_layers
from roadsight.placement.plans.tolerance import Change, lost_shares, tolerance_of
from roadsight.stages.command import Command
from roadsight.stages.placement.shared.changed_sight import ChangedFiles, ChangedSight

log = logging.getLogger("measure_tolerance")

_PLACE = ["sensor", "candidate"]
"""What tells chosen sensors apart."""


def measure_tolerance(
    given: ChangedFiles,
    solution_path: Path,
    frame_path: Path,
    *,
    detections: Sequence[Path] = (),
    out: Path,
    layers: Path,
) -> None:
    """Write a table of losses, and the targets with how often each is lost.

    Sensors in poses are judged from panoramas: what they see is that of ``detections``, and of the
    ways in which they differ from their plan only a failure is looked at.
    """
    solution = read_json(solution_path)
    frame = Frame.from_dict(read_json(frame_path))
    sight = ChangedSight(given)
    table, places = sight.targets, solution["sensors"]
    seen = np.zeros((len(places), len(table)), bool)
    changed: dict[int, list[tuple[Change, Bools]]] = {}
    posed = []
    for number, place in enumerate(places):
        if "@" in place["candidate"] or not sight.can_change(place["sensor"]):
            posed.append(number)
            continue
        seen[number] = sight.sees(place, None)
        changed[number] = [(change, sight.sees(place, change)) for change in sight.changes]
        log.info("%s: %d ways", place["candidate"], len(sight.changes))
    if posed:
        # Detections know of traffic, which what is rendered does not.
        detected = _detected(places, detections, table["target"])
        seen[posed] = detected[posed]
        for number, ways in changed.items():
            seen[number] &= detected[number]
            changed[number] = [(change, sees & detected[number]) for change, sees in ways]
    found = tolerance_of(seen, changed)
    rows = [row | {"sensor": places[row["sensor"]]["candidate"]} for row in found.rows]
    content = {
        "plan": solution["plan"],
        **given.tolerance.model_dump(),
        "targets": int(seen.any(axis=0).sum()),
        "rows": rows,
        "not_measured": len(posed),
    }
    write_json(out, content)
    known = found.cases > 0
    shares = lost_shares(found.times_lost, found.lost_alone, found.cases)
    layer = table[["x", "y", "z"]].assign(
        target=table["target"].astype(str),
        times_lost=found.times_lost if known else np.nan,
        lost_alone=found.lost_alone.astype(np.int32),
        lost_share=shares if known else np.nan,
    )
    write_layers(layers, {"targets": points(layer)}, frame, {"targets": "Point Z"})
    for row in rows:
        log.info(
            "%s: at most %d targets lost (%.1f %%)", row["kind"], row["lost"], 100 * row["share"]
        )


def _detected(
    places: Sequence[dict[str, Any]], detections: Sequence[Path], targets: pd.Series
) -> Bools:
    """What sensors see (sensors, targets), as their detections say."""
    table = read_detections(detections)
    table = table[table["candidate"].isin([place["candidate"] for place in places])]
    of_sensor = {key: part["target"] for key, part in table.groupby(_PLACE, observed=True)}
    none = table["target"].iloc[:0]
    keys = [tuple(place[name] for name in _PLACE) for place in places]
    return np.array([targets.isin(of_sensor.get(key, none)) for key in keys])


main = Command(measure_tolerance)


if __name__ == "__main__":
    sys.exit(main())
