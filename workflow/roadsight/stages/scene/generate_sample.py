"""Generate the embedded sample: a scanned synthetic site, its truth and digitised edges."""

from __future__ import annotations

import argparse
import logging
import sys
from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import NDArray

from roadsight.base.arrays import Floats
from roadsight.io.cloud.clouds import write_laz
from roadsight.io.vector.sample import write_native_lines
from roadsight.io.vector.vectors import write_layers
from roadsight.scene.classes import VEGETATION
from roadsight.stages.command import run_stage
from roadsight.synthetic.highway.highway import EPSG, build_highway
from roadsight.synthetic.highway.mobile_scanner import PointChunk, scan
from roadsight.synthetic.highway.truth import digitised_edges, truth_layers

_FIRST_SECOND_OF_WEEK = 200_000.0
"""When the scan begins, s of the GPS week: some moment on a Tuesday."""
TRUTH_DIMENSION = "truth_class"
"""Extra dimension of the cloud with each point's `TruthClass`: for scoring, never an input."""


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="generate_sample", description=__doc__)
    parser.add_argument("--scene", choices=["highway"], default="highway")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--points", type=int, default=3_500_000, help="about so many points")
    parser.add_argument("--length-m", type=float, default=250.0, help="length of road, 40 to 600")
    parser.add_argument("--radius-m", type=float, default=600.0, help="of the curve to the left")
    parser.add_argument("--grade", type=float, default=0.018, help="rise over run")
    parser.add_argument("--tunnel", choices=["yes", "no"], default="yes", help="at its end")
    parser.add_argument("--overhead", choices=["yes", "no"], default="no", help="wires, roofs")
    parser.add_argument("--cloud", required=True, help="LAZ to write")
    parser.add_argument(
        "--class-scheme",
        choices=["usual", "plants"],
        default="usual",
        help="usual: every point is 0, never classified; plants: vegetation is told",
    )
    parser.add_argument("--truth", required=True, help="GeoPackage to write")
    parser.add_argument("--edges", required=True, help="GeoJSON to write")
    return parser


def generate_sample(arguments: argparse.Namespace) -> None:
    """Build the site, scan it and write the three files."""
    highway = build_highway(
        arguments.seed,
        arguments.length_m,
        arguments.radius_m,
        arguments.grade,
        arguments.tunnel == "yes",
        arguments.overhead == "yes",
    )
    frame = highway.frame()
    scan_rng, click_rng = np.random.default_rng(arguments.seed).spawn(2)
    xyz_m, dims = _cloud(scan(highway, arguments.points, scan_rng))
    if arguments.class_scheme == "plants":
        truth = dims[TRUTH_DIMENSION]
        dims["classification"] = np.where(np.isin(truth, VEGETATION), truth, 0).astype(np.uint8)
    write_laz(arguments.cloud, xyz_m, frame, dims)
    write_layers(arguments.truth, truth_layers(highway), frame)
    write_native_lines(arguments.edges, digitised_edges(highway, click_rng), frame, EPSG)
    logging.info("%d points on %g m of %s", len(xyz_m), arguments.length_m, arguments.scene)


def _cloud(chunks: Iterable[PointChunk]) -> tuple[Floats, dict[str, NDArray]]:
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


def main(argv: Sequence[str] | None = None) -> int:
    """Run the stage."""
    return run_stage(_parser(), generate_sample, argv)


if __name__ == "__main__":
    sys.exit(main())
