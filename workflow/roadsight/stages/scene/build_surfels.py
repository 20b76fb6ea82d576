"""The scene as oriented surfels, for ray casting."""

from __future__ import annotations

import argparse
import logging
import sys

from roadsight.io.cloud.standing import StandingCloud
from roadsight.io.records.atomic import read_json
from roadsight.io.records.surfels import write_surfels
from roadsight.scene.spacing import plan_spacing_m
from roadsight.scene.surfels.surfels import build_surfels
from roadsight.scene.surfels.voxel_moments import add_moments, sum_moments
from roadsight.stages.command import run_stage
from roadsight.stages.progress import logged

log = logging.getLogger("build_surfels")


def write_scene_surfels(arguments: argparse.Namespace) -> None:
    """Sum up the cloud in voxels, tile by tile, and turn them into surfels."""
    cloud = StandingCloud(arguments.cloud, arguments.traffic)
    density_per_m2 = read_json(arguments.profile)["density_per_m2"]["median"]
    edge_m = max(arguments.surfel_size_m, plan_spacing_m(density_per_m2))
    tiles = logged(range(len(cloud.tiles)), len(cloud.tiles), log, "tiles")
    voxels = add_moments([sum_moments(cloud.xyz(tile), edge_m) for tile in tiles])
    surfels = build_surfels(voxels)
    log.info(
        "%d points, %d voxels of %.3f m, %d surfels",
        cloud.points,
        len(voxels.keys),
        edge_m,
        len(surfels),
    )
    write_surfels(arguments.out, surfels, {"voxel_m": edge_m, "points": cloud.points})


def main(argv: list[str] | None = None) -> int:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    for name in ("cloud", "profile", "out"):
        parser.add_argument(f"--{name}", required=True)
    parser.add_argument("--traffic", nargs="?", help="mask of points to leave out")
    parser.add_argument("--surfel-size-m", type=float, default=0.1, help="at least point spacing")
    return run_stage(parser, write_scene_surfels, argv)


if __name__ == "__main__":
    sys.exit(main())
