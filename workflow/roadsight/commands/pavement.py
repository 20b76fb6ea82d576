"""``roadsight pavement``: label the ground and the road of a cloud."""

from __future__ import annotations

import argparse

from roadsight.api.clouds import labels_of, write_labelled
from roadsight.api.scene import ground, pavement
from roadsight.base.arrays import Floats
from roadsight.base.errors import InputError
from roadsight.commands.cloud_arguments import add_cloud_arguments, check_output, load_cloud
from roadsight.geometry.frames import Frame
from roadsight.io.vector.known_road import read_seeds, read_track


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
    InputError : as `read_seeds` and `read_track`.
    """
    seeds_xy = read_seeds(arguments.seeds, frame, "--seeds")
    return seeds_xy, read_track(arguments.track, frame)


def check_pavement_arguments(arguments: argparse.Namespace) -> None:
    """Refuse places on the road with a method that has no use for them.

    Raises
    ------
    InputError : ``--seeds`` or ``--track`` with ``--method published``.
    """
    given = [f"--{name}" for name in ("seeds", "track") if getattr(arguments, name)]
    if given and arguments.method == "published":
        raise InputError(
            "have no use in this method",
            where=" and ".join(given),
            found="--method published",
            allowed="--method surface or auto",
            hint="leave them out, or let the surface grow from them",
        )


def run(arguments: argparse.Namespace) -> None:
    """Write the cloud with ground and road labels, all other dimensions kept."""
    check_output(arguments, ".laz", ".las")
    check_pavement_arguments(arguments)
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
