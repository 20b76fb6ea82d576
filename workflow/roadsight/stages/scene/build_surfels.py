"""The scene as oriented surfels, for ray casting."""

from __future__ import annotations

import logging
import sys
from pathlib import Path
from typing import Annotated

from roadsight.base.arrays import Floats32
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
        xyz = _points(cloud, tile, settings)
        parts.append(sum_moments(xyz, settings.surfel_size_m))
        points += len(xyz)
    _tell_alone(cloud.points - points, cloud.points, settings.outlier_radius_m)
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


def _points(cloud: StandingCloud, tile: int, settings: SurfelMaking) -> Floats32:
    """Points of a tile, without those that stand alone where these are to go."""
    xyz, radius_m = cloud.xyz(tile), settings.outlier_radius_m
    if radius_m == 0:
        return xyz
    others, engine = settings.outlier_neighbours, settings.outlier_engine
    return xyz[in_company(xyz, cloud.around(tile, radius_m), radius_m, others, engine)]


def _tell_alone(alone: int, points: int, radius_m: float) -> None:
    """Say how many points were left out, and where that is more than strays can be."""
    if alone:
        log.info("%d of %d points stand alone and are left out", alone, points)
    if alone > _MOST_ALONE * points:
        log.warning(
            "%.1f %% of the points have too few others within %g m: the radius is too small for"
            " the spacing of this cloud, and surfaces are lost",
            100 * alone / points,
            radius_m,
        )


main = Command(write_scene_surfels)


if __name__ == "__main__":
    sys.exit(main())
