"""What a plan loses where its sensors do not stand exactly as planned."""

from __future__ import annotations

import logging
import sys
from pathlib import Path

import geopandas as gpd
import numpy as np

from roadsight.geometry.frames import Frame
from roadsight.io.records.atomic import read_json, write_json
from roadsight.io.vector.vectors import write_layers
from roadsight.placement.plans.tolerance import lost_shares, tolerance_of
from roadsight.stages.command import Command
from roadsight.stages.placement.shared.changed_sight import ChangedFiles, ChangedSight

log = logging.getLogger("measure_tolerance")


def measure_tolerance(
    given: ChangedFiles, solution_path: Path, frame_path: Path, *, out: Path, layers: Path
) -> None:
    """Write a table of losses, and the targets with how often each is lost."""
    solution = read_json(solution_path)
    frame = Frame.from_dict(read_json(frame_path))
    sight = ChangedSight(given)
    places = [
        p
        for p in solution["sensors"]
        if sight.can_change(p["sensor"]) and "@" not in p["candidate"]
    ]
    seen = np.zeros((len(places), len(sight.targets)), bool)
    changed = {}
    for number, place in enumerate(places):
        seen[number] = sight.sees(place, None)
        changed[number] = [(change, sight.sees(place, change)) for change in sight.changes]
        log.info("%s: %d ways", place["candidate"], len(sight.changes))
    found = tolerance_of(seen, changed)
    names = [place["candidate"] for place in places]
    rows = [row | {"sensor": names[row["sensor"]]} for row in found.rows]
    skipped = len(solution["sensors"]) - len(places)
    content = {
        "plan": solution["plan"],
        **given.tolerance.model_dump(),
        "targets": int(seen.any(axis=0).sum()),
        "rows": rows,
        "not_measured": skipped,
    }
    write_json(out, content)
    shares = lost_shares(found.times_lost, found.lost_alone, found.cases)
    table = sight.targets
    layer = gpd.GeoDataFrame(
        {
            "target": table["target"].astype(str),
            "times_lost": found.times_lost,
            "lost_alone": found.lost_alone.astype(np.int32),
            "lost_share": shares,
        },
        geometry=gpd.points_from_xy(table["x"], table["y"], table["z"]),
    )
    write_layers(layers, {"targets": layer}, frame, {"targets": "Point Z"})
    for row in rows:
        log.info(
            "%s: at most %d targets lost (%.1f %%)", row["kind"], row["lost"], 100 * row["share"]
        )


main = Command(measure_tolerance)


if __name__ == "__main__":
    sys.exit(main())
