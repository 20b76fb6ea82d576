"""Scores of the pavement against surveyed or generated truth."""

from __future__ import annotations

import logging
import math
import sys
from pathlib import Path
from typing import Annotated

import numpy as np
import shapely

from roadsight.evidence.scores import pavement_scores
from roadsight.geometry.frames import Frame
from roadsight.io.cloud.tiles import CloudTiles, stack_xyz
from roadsight.io.records.atomic import read_json, write_json
from roadsight.io.records.tables import read_table
from roadsight.io.vector.site_bounds import tell_near
from roadsight.io.vector.vectors import read_layer, read_polygons
from roadsight.stages.command import Command

log = logging.getLogger(__name__)


def score_pavement(
    cloud: Path,
    frame_path: Path,
    ground_path: Path,
    pavement: Path,
    truth: str,
    truth_crs: Annotated[str | None, "CRS of the truth if its file names none"] = None,
    truth_layer: Annotated[str | None, "layer of a generated truth file"] = None,
    reach_m: Annotated[float, "extent of the truth"] = math.inf,
    *,
    out: Path,
) -> None:
    """Write accuracy, recall, F1 and outline distances over all ground points."""
    frame = Frame.from_dict(read_json(frame_path))
    found = shapely.union_all(read_layer(pavement, "pavement", frame).geometry.to_numpy())
    polygons = (
        read_layer(truth, truth_layer, frame)
        if truth_layer
        else read_polygons(truth, frame, truth_crs)
    )
    about = read_json(frame_path)
    tell_near(log, "known polygons", polygons.geometry.to_numpy(), about, truth)
    true = shapely.union_all(polygons.geometry.to_numpy())
    xyz = stack_xyz(CloudTiles(cloud).read(("x", "y", "z")))
    ground = xyz[read_table(ground_path)["ground"].to_numpy()].astype(np.float64)
    write_json(out, pavement_scores(ground[:, :2], found, true, reach_m))


main = Command(score_pavement)


if __name__ == "__main__":
    sys.exit(main())
