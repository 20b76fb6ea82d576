"""What a plan loses where its sensors do not stand exactly as planned."""

from __future__ import annotations

import argparse
import logging
import sys

import geopandas as gpd
import numpy as np

from roadsight.base.options import add_settings
from roadsight.config.sections.sensing import Lidar
from roadsight.geometry.frames import Frame
from roadsight.io.records.atomic import read_json, write_json
from roadsight.io.vector.vectors import write_layers
from roadsight.placement.plans.tolerance import lost_shares, tolerance_of
from roadsight.placement.sight.detection import MIN_BEAMS
from roadsight.stages.command import run_stage
from roadsight.stages.placement.shared.changed_sight import ChangedSight, add_change_arguments
from roadsight.stages.placement.shared.detection_inputs import add_sight_arguments

log = logging.getLogger("measure_tolerance")


def measure_tolerance(arguments: argparse.Namespace) -> None:
    """Write a table of losses, and the targets with how often each is lost."""
    solution = read_json(arguments.solution)
    frame = Frame.from_dict(read_json(arguments.frame))
    sight = ChangedSight(arguments)
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
        "move_m": arguments.move_m,
        "turn_deg": arguments.turn_deg,
        "other_height_m": arguments.other_height_m,
        "targets": int(seen.any(axis=0).sum()),
        "rows": rows,
        "not_measured": skipped,
    }
    write_json(arguments.out, content)
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
    write_layers(arguments.layers, {"targets": layer}, frame, {"targets": "Point Z"})
    for row in rows:
        log.info(
            "%s: at most %d targets lost (%.1f %%)", row["kind"], row["lost"], 100 * row["share"]
        )


def main(argv: list[str] | None = None) -> int:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    for name in ("solution", "targets", "surfels", "frame", "sensors-file", "out", "layers"):
        parser.add_argument(f"--{name}", required=True)
    parser.add_argument("--min-beams", type=int, default=MIN_BEAMS)
    add_settings(parser, Lidar, "azimuth_stride")
    add_sight_arguments(parser)
    add_change_arguments(parser)
    return run_stage(parser, measure_tolerance, argv)


if __name__ == "__main__":
    sys.exit(main())
