"""``roadsight pavement``: label the ground and the road of a cloud."""

from __future__ import annotations

import argparse

import numpy as np
import shapely

from roadsight.api.clouds import labels_of, write_labelled
from roadsight.api.scene import ground, pavement
from roadsight.base.arrays import Floats
from roadsight.base.errors import InputError
from roadsight.commands.cloud_arguments import add_cloud_arguments, check_output, load_cloud
from roadsight.geometry.frames import Frame
from roadsight.io.vector.vectors import read_lines


def add_parser(verbs: argparse._SubParsersAction) -> None:
    """Add the verb."""
    parser = verbs.add_parser("pavement", help="label road (class 11) and other ground (class 2)")
    add_cloud_arguments(parser)
    add_pavement_arguments(parser)
    parser.add_argument("-o", "--out", required=True, help="LAZ or LAS file to write")
    parser.set_defaults(run=run)


def add_pavement_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the pavement search."""
    parser.add_argument(
        "--method",
        choices=["auto", "surface", "published"],
        default="auto",
        help="surface: a surface that runs on until a kerb or grass ends it; published: FPFH and "
        "k-means; auto: surface where the file tells scans of a vehicle apart",
    )
    parser.add_argument(
        "--intensity",
        choices=["auto", "use", "ignore"],
        default="auto",
        help="intensity as a second cue; auto: where points are more than 0.15 m apart",
    )
    parser.add_argument("--seed", type=int, default=1, help="of the random sample of FPFH")
    parser.add_argument(
        "--seeds", default="", help="places on the road, x,y;x,y as in the cloud: surface"
    )
    parser.add_argument("--track", help="line file, where a vehicle drove: surface")


def known_places(
    arguments: argparse.Namespace, frame: Frame
) -> tuple[Floats | None, Floats | None]:
    """Seeds and track, (k, 2) local metres each, or None.

    Raises
    ------
    InputError : a seed is no pair of numbers, or the track cannot be read.
    """
    try:
        places = [place.split(",") for place in arguments.seeds.split(";") if place]
        pairs = [(float(x), float(y)) for x, y in places]
    except ValueError as error:
        raise InputError(
            "are no places", where="--seeds", found=arguments.seeds, allowed="x,y;x,y"
        ) from error
    track = None
    if arguments.track:
        lines = read_lines(arguments.track, frame, None).geometry
        track = shapely.get_coordinates(max(lines, key=lambda line: line.length))
    return frame.to_local(np.array(pairs)) if pairs else None, track


def run(arguments: argparse.Namespace) -> None:
    """Write the cloud with ground and road labels, all other dimensions kept."""
    check_output(arguments, ".laz", ".las")
    cloud = load_cloud(arguments)
    seeds_xy, track_xy = known_places(arguments, cloud.frame)
    labelled = ground(cloud)
    found = pavement(
        cloud,
        method=arguments.method,
        intensity=arguments.intensity,
        ground=labelled,
        seed=arguments.seed,
        seeds_xy=seeds_xy,
        track_xy=track_xy,
    )
    labels = labels_of(cloud, labelled, found.points)
    write_labelled(arguments.out, cloud, labels)
    print(
        f"{found.outline.area:.0f} m2 of pavement in {len(found.outline.geoms)} parts,"
        f" {(labels == 11).sum()} points: {arguments.out}"
    )
