"""What a crew takes along: one row for each sensor of each plan."""

from __future__ import annotations

import logging
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import pandas as pd

from roadsight.geometry.frames import Frame
from roadsight.io.records.atomic import atomic_path, read_json
from roadsight.io.vector.vectors import read_layer
from roadsight.report.handover.stakeout import stakeout
from roadsight.stages.command import Command

log = logging.getLogger("write_stakeout")


def write_stakeout(
    frame_path: Path,
    edges_path: Path,
    solutions_paths: Annotated[Sequence[Path], "solution.json of each plan"],
    *,
    out: Path,
) -> None:
    """Write the table."""
    frame = Frame.from_dict(read_json(frame_path))
    edges = read_layer(edges_path, "edges", frame)
    solutions = [read_json(path) for path in solutions_paths]
    table = pd.concat(
        [stakeout(found["plan"], found["sensors"], edges, frame) for found in solutions],
        ignore_index=True,
    )
    with atomic_path(out) as temporary:
        table.to_csv(temporary, index=False)
    log.info("%d sensors of %d plans", len(table), len(solutions))


main = Command(write_stakeout)


if __name__ == "__main__":
    sys.exit(main())
