"""The scene as oriented surfels, for ray casting."""

from __future__ import annotations

import argparse
import logging
import sys

from roadsight.base.arrays import Floats32
from roadsight.base.engines import ENGINES
from roadsight.io.cloud.standing import StandingCloud
from roadsight.io.records.surfels import write_surfels
from roadsight.scene.surfels.local import build_local_surfels
from roadsight.scene.surfels.outliers import in_company
from roadsight.scene.surfels.voxel_moments import add_moments, sum_moments
from roadsight.stages.command import run_stage
from roadsight.stages.progress import logged

log = logging.getLogger("build_surfels")


def write_scene_surfels(arguments: argparse.Namespace) -> None:
    """Sum up the cloud in voxels, tile by tile, and turn them into surfels."""
    cloud = StandingCloud(arguments.cloud, arguments.traffic)
    edge_m = arguments.surfel_size_m
    tiles = logged(range(len(cloud.tiles)), len(cloud.tiles), log, "tiles")
    voxels = add_moments([sum_moments(_points(cloud, tile, arguments), edge_m) for tile in tiles])
    surfels = build_local_surfels(voxels)
    log.info(
        "%d points, %d voxels of %.3f m, %d surfels",
        cloud.points,
        len(voxels.keys),
        edge_m,
        len(surfels),
    )
    write_surfels(arguments.out, surfels, {"voxel_m": edge_m, "points": cloud.points})


def _points(cloud: StandingCloud, tile: int, arguments: argparse.Namespace) -> Floats32:
    """Points of a tile, without those that stand alone where these are to go."""
    xyz = cloud.xyz(tile)
    radius_m, others = arguments.outlier_radius_m, arguments.outlier_neighbours
    if radius_m == 0:
        return xyz
    around = cloud.around(tile, radius_m)
    kept = in_company(xyz, around, radius_m, others, arguments.outlier_engine)
    log.info("tile %d: %d of %d points stand alone", tile, (~kept).sum(), len(kept))
    return xyz[kept]


def main(argv: list[str] | None = None) -> int:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    for name in ("cloud", "out"):
        parser.add_argument(f"--{name}", required=True)
    parser.add_argument("--traffic", nargs="?", help="mask of points to leave out")
    parser.add_argument(
        "--surfel-size-m", type=float, default=0.1, help="edge of the finest voxels"
    )
    parser.add_argument(
        "--outlier-radius-m", type=float, default=0.0, help="0: points that stand alone stay"
    )
    parser.add_argument("--outlier-neighbours", type=int, default=2)
    parser.add_argument("--outlier-engine", choices=ENGINES, default="own")
    return run_stage(parser, write_scene_surfels, argv)


if __name__ == "__main__":
    sys.exit(main())
