"""Generate the embedded rural site: airborne cloud, truth, and the table of its videolog."""

from __future__ import annotations

import argparse
import logging
import sys
from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import NDArray

from roadsight.base.arrays import Floats
from roadsight.io.cloud.clouds import write_laz
from roadsight.io.images.videolog_shards import write_csv
from roadsight.io.vector.vectors import write_layers
from roadsight.stages.command import run_stage
from roadsight.synthetic.rendering.images import RuralRenderer
from roadsight.synthetic.rural.airborne_scanner import (
    CLASS_SCHEMES,
    AirborneScanner,
    Returns,
    scan_rural,
)
from roadsight.synthetic.rural.rural_road import build_rural
from roadsight.synthetic.rural.rural_truth import rural_layers
from roadsight.synthetic.rural.videolog import GpsNoise, drifting, random_drives, shots
from roadsight.synthetic.rural.videolog_tables import (
    CAMERA_DECIMALS,
    POLE_DECIMALS,
    VIDEOLOG_DECIMALS,
    camera_table,
    pole_table,
    videolog_table,
)

OBJECT_DIMENSION = "truth_object"
"""Extra dimension of the cloud with the object each point is on: for scoring, never an input."""


def generate_rural(arguments: argparse.Namespace) -> None:
    """Build the site, scan it, drive along it, and write cloud, truth and tables."""
    site = build_rural(arguments.seed, arguments.length_m, relief=arguments.relief)
    scanner = AirborneScanner(
        pulses_per_m2=arguments.pulses_per_m2,
        hits_poles=arguments.pole_returns == "yes",
        class_scheme=arguments.class_scheme,
    )
    rng = np.random.default_rng([arguments.seed, 31])
    xyz_m, dims = _cloud(scan_rural(RuralRenderer(site), rng, scanner))
    write_laz(arguments.cloud, xyz_m, site.frame(), dims)
    write_layers(arguments.truth, rural_layers(site), site.frame())
    write_csv(arguments.poles, pole_table(site), POLE_DECIMALS)
    sides = arguments.side_views == "yes"
    drives = random_drives(
        arguments.seed,
        hfov_deg=arguments.hfov_deg,
        side_views=sides,
        principal_point_px=arguments.principal_point_px,
        gps=drifting(arguments.gps_drift_m) if arguments.gps_drift_m else GpsNoise(),
    )
    places = [place for drive in drives for place in shots(site, drive, arguments.seed)]
    write_csv(arguments.videolog, videolog_table(site, places), VIDEOLOG_DECIMALS)
    write_csv(arguments.cameras, camera_table(site, places), CAMERA_DECIMALS)
    logging.info("%d points, %d places, %d posts", len(xyz_m), len(places), len(site.poles))


def _cloud(parts: Iterable[Returns]) -> tuple[Floats, dict[str, NDArray]]:
    """Points (n, 3) in local metres and their LAS dimensions."""
    columns: dict[str, list[NDArray]] = {name: [] for name in Returns.__dataclass_fields__}
    for part in parts:
        for name, values in columns.items():
            values.append(getattr(part, name))
    joined = {name: np.concatenate(values) for name, values in columns.items()}
    xyz_m = joined.pop("xyz_m")
    joined["point_source_id"] = joined.pop("line")
    joined["scan_angle_rank"] = joined.pop("scan_angle_deg")
    joined[OBJECT_DIMENSION] = joined.pop("object_id").astype(np.uint16)
    return xyz_m, joined


def main(argv: Sequence[str] | None = None) -> int:
    """Run the stage."""
    parser = argparse.ArgumentParser(prog="generate_rural", description=__doc__)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--length-m", type=float, default=1000.0, help="of the drive, 60 to 3000")
    parser.add_argument("--pulses-per-m2", type=float, default=24.0, help="of the laser")
    parser.add_argument("--relief", type=float, default=1.0, help="heights; 0 is level")
    parser.add_argument("--hfov-deg", type=float, default=0.0, help="first camera; 0: about 20")
    parser.add_argument("--side-views", choices=("yes", "no"), default="yes")
    parser.add_argument("--principal-point-px", type=float, default=0.0, help="from the middle")
    parser.add_argument("--gps-drift-m", type=float, default=0.0, help="0: about 1.4")
    parser.add_argument("--pole-returns", choices=("yes", "no"), default="yes")
    parser.add_argument("--class-scheme", choices=CLASS_SCHEMES, default="usual")
    parser.add_argument("--cloud", required=True, help="LAZ to write, classified")
    parser.add_argument("--truth", required=True, help="GeoPackage to write")
    parser.add_argument("--poles", required=True, help="CSV of every post to write")
    parser.add_argument("--videolog", required=True, help="CSV of the images to write")
    parser.add_argument("--cameras", required=True, help="CSV of the true cameras to write")
    return run_stage(parser, generate_rural, argv)


if __name__ == "__main__":
    sys.exit(main())
