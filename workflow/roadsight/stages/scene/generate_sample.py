"""Generate the embedded sample: a scanned synthetic site, its truth and digitised edges."""

from __future__ import annotations

import logging
import sys
from collections.abc import Iterable
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray

from roadsight.base.arrays import Floats
from roadsight.base.sections.run import Run
from roadsight.base.sections.sample import HighwayScene, Sample
from roadsight.io.cloud.clouds import write_laz
from roadsight.io.vector.sample import write_native_lines
from roadsight.io.vector.vectors import write_layers
from roadsight.scene.classes import VEGETATION
from roadsight.stages.command import Command
from roadsight.synthetic.highway.airborne_survey import survey
from roadsight.synthetic.highway.highway import EPSG, build_highway
from roadsight.synthetic.highway.mobile_scanner import PointChunk, scan
from roadsight.synthetic.highway.truth import digitised_edges, truth_layers

_FIRST_SECOND_OF_WEEK = 200_000.0
"""When the scan begins, s of the GPS week: some moment on a Tuesday."""
TRUTH_DIMENSION = "truth_class"
"""Extra dimension of the cloud with each point's `TruthClass`: for scoring, never an input."""


def generate_sample(
    scene: HighwayScene,
    length_m: Annotated[float, Sample],
    class_scheme: Annotated[str, Sample],
    seed: Annotated[int, Run],
    *,
    cloud: Annotated[Path, "LAZ to write"],
    truth: Annotated[Path, "GeoPackage to write"],
    edges: Annotated[Path, "GeoJSON to write"],
) -> None:
    """Build the site, scan it and write the three files."""
    highway = build_highway(
        seed,
        length_m,
        scene.radius_m,
        scene.grade,
        scene.tunnel,
        scene.overhead,
    )
    frame = highway.frame()
    scan_rng, click_rng = np.random.default_rng(seed).spawn(2)
    scanned = survey if scene.scanned_from == "air" else scan
    xyz_m, dims = _cloud(scanned(highway, scene.points, scan_rng))
    if class_scheme == "plants":
        classes = dims[TRUTH_DIMENSION]
        dims["classification"] = np.where(np.isin(classes, VEGETATION), classes, 0).astype(np.uint8)
    write_laz(cloud, xyz_m, frame, dims)
    write_layers(truth, truth_layers(highway), frame)
    write_native_lines(edges, digitised_edges(highway, click_rng), frame, EPSG)
    logging.info("%d points on %g m of road", len(xyz_m), length_m)


def _cloud(chunks: Iterable[PointChunk]) -> tuple[Floats, dict[str, NDArray[Any]]]:
    """Points (n, 3) in local metres and their LAS dimensions; the class stays 0."""
    parts = list(chunks)
    xyz_m = np.concatenate([part.xyz_m for part in parts])
    once = np.ones(len(xyz_m), np.uint8)
    return xyz_m, {
        "intensity": np.concatenate([part.intensity for part in parts]),
        "gps_time": _FIRST_SECOND_OF_WEEK + np.concatenate([part.time_s for part in parts]),
        "point_source_id": np.concatenate([part.sweep for part in parts]),
        "return_number": once,
        "number_of_returns": once,
        TRUTH_DIMENSION: np.concatenate([part.truth_class for part in parts]),
    }


main = Command(generate_sample)


if __name__ == "__main__":
    sys.exit(main())
