"""Generate the embedded rural site: airborne cloud, truth, and the table of its videolog."""

from __future__ import annotations

import logging
import sys
from collections.abc import Iterable
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray

from roadsight.base.arrays import Floats
from roadsight.base.sections.run import Run, RuralScene, RuralSurvey, Sample
from roadsight.io.cloud.clouds import write_laz
from roadsight.io.records.atomic import write_json
from roadsight.io.records.text_tables import write_csv
from roadsight.io.vector.vectors import write_layers
from roadsight.stages.command import Command
from roadsight_worlds.rendering.images import RuralRenderer
from roadsight_worlds.rural.airborne_scanner import AirborneScanner, Returns, scan_rural
from roadsight_worlds.rural.rural_road import build_rural
from roadsight_worlds.rural.rural_truth import rural_layers
from roadsight_worlds.rural.videolog import GpsNoise, drifting, random_drives, shots
from roadsight_worlds.rural.videolog_tables import (
    CAMERA_DECIMALS,
    POLE_DECIMALS,
    VIDEOLOG_DECIMALS,
    camera_table,
    pole_table,
    registered_cameras,
    videolog_table,
)

OBJECT_DIMENSION = "truth_object"
"""Extra dimension of the cloud with the object each point is on: for scoring, never an input."""


def generate_rural(
    scene: RuralScene,
    survey: RuralSurvey,
    length_m: Annotated[float, Sample],
    class_scheme: Annotated[str, Sample],
    seed: Annotated[int, Run],
    *,
    cloud: Annotated[Path, "LAZ to write, classified"],
    truth: Annotated[Path, "GeoPackage to write"],
    poles: Annotated[Path, "CSV of every post to write"],
    videolog: Annotated[Path, "CSV of the images to write"],
    cameras: Annotated[Path, "CSV of the true cameras to write"],
    baseline: Annotated[Path, "JSON of a camera of each image size to write, rounded"],
) -> None:
    """Build the site, scan it, drive along it, and write cloud, truth and tables."""
    site = build_rural(seed, length_m, scene=scene)
    scanner = AirborneScanner(
        pulses_per_m2=survey.pulses_per_m2,
        hits_poles=survey.pole_returns,
        class_scheme=class_scheme,
    )
    rng = np.random.default_rng([seed, 31])
    xyz_m, dims = _cloud(scan_rural(RuralRenderer(site), rng, scanner))
    write_laz(cloud, xyz_m, site.frame(), dims)
    write_layers(truth, rural_layers(site), site.frame())
    write_csv(poles, pole_table(site), POLE_DECIMALS)
    drives = random_drives(
        seed,
        hfov_deg=scene.hfov_deg,
        side_views=scene.side_views,
        principal_point_px=scene.principal_point_px,
        gps=drifting(survey.gps_drift_m) if survey.gps_drift_m else GpsNoise(),
    )
    driven = [shots(site, drive, seed) for drive in drives]
    places = [place for drive in driven for place in drive]
    write_csv(videolog, videolog_table(site, places), VIDEOLOG_DECIMALS)
    write_csv(cameras, camera_table(site, places), CAMERA_DECIMALS)
    write_json(baseline, registered_cameras(site, driven))
    logging.info("%d points, %d places, %d posts", len(xyz_m), len(places), len(site.poles))


def _cloud(parts: Iterable[Returns]) -> tuple[Floats, dict[str, NDArray[Any]]]:
    """Points (n, 3) in local metres and their LAS dimensions."""
    columns: dict[str, list[NDArray[Any]]] = {name: [] for name in Returns.__dataclass_fields__}
    for part in parts:
        for name, values in columns.items():
            values.append(getattr(part, name))
    joined = {name: np.concatenate(values) for name, values in columns.items()}
    xyz_m = joined.pop("xyz_m")
    joined["point_source_id"] = joined.pop("line")
    joined["scan_angle_rank"] = joined.pop("scan_angle_deg")
    joined[OBJECT_DIMENSION] = joined.pop("object_id").astype(np.uint16)
    return xyz_m, joined


main = Command(generate_rural)


if __name__ == "__main__":
    sys.exit(main())
