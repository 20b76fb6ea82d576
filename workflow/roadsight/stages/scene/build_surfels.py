"""The scene as oriented surfels, for ray casting."""

from __future__ import annotations

import logging
import sys
from pathlib import Path
from typing import Annotated

from roadsight.base.sections.sensing import SurfelMaking
from roadsight.io.cloud.tiles import StandingCloud
from roadsight.io.records.scene_tables import write_surfels
from roadsight.scene.classes import VEGETATION
from roadsight.scene.surfels import build_surfels, in_company
from roadsight.scene.voxel_planes import add_moments, sum_moments
from roadsight.stages.command import Command, logged

log = logging.getLogger("build_surfels")

_MOST_ALONE = 0.01
"""Share of points left out above which these are no strays: 0.5 m takes 0.03 % of a dense mobile
cloud, 1.9 % of a street that was scanned once, and 18 % of an airborne cloud spaced like that."""


def write_scene_surfels(
    cloud_path: Path,
    settings: SurfelMaking,
    traffic: Annotated[Path | None, "mask of points to leave out"] = None,
    *,
    out: Path,
) -> None:
    """Sum up the cloud in voxels, tile by tile, and turn them into surfels."""
    without = VEGETATION if settings.vegetation == "leave_out" else ()
    cloud = StandingCloud(cloud_path, traffic, without)
    tiles = logged(range(len(cloud.tiles)), len(cloud.tiles), log, "tiles")
    parts, points = [], 0
    for tile in tiles:
        xyz, radius_m = cloud.xyz(tile), settings.outlier_radius_m
        if radius_m > 0:  # without those that stand alone
            others, engine = settings.outlier_neighbours, settings.outlier_engine
            xyz = xyz[in_company(xyz, cloud.around(tile, radius_m), radius_m, others, engine)]
        parts.append(sum_moments(xyz, settings.surfel_size_m))
        points += len(xyz)
    alone = cloud.points - points
    if alone:
        log.info("%d of %d points stand alone and are left out", alone, cloud.points)
    if alone > _MOST_ALONE * cloud.points:
        log.warning(
            "%.1f %% of the points have too few others within %g m: the radius is too small for"
            " the spacing of this cloud, and surfaces are lost",
            100 * alone / cloud.points,
            settings.outlier_radius_m,
        )
    voxels = add_moments(parts)
    surfels = build_surfels(voxels)
    log.info(
        "%d points, %d voxels of %.3f m, %d surfels",
        points,
        len(voxels.keys),
        settings.surfel_size_m,
        len(surfels),
    )
    write_surfels(out, surfels, {"voxel_m": settings.surfel_size_m, "points": points})


main = Command(write_scene_surfels)


if __name__ == "__main__":
    sys.exit(main())
