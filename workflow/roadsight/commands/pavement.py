"""``roadsight pavement``: label the ground and the road of a cloud."""

from __future__ import annotations

import argparse

from roadsight.commands.memory import (
    add_cloud_arguments,
    check_output,
    labelled_ground,
    labels_of,
    load_cloud,
    pavement_of,
)
from roadsight.io.cloud.clouds import write_laz


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
        "--intensity",
        choices=["auto", "use", "ignore"],
        default="auto",
        help="intensity as a second cue; auto: where points are more than 0.15 m apart",
    )
    parser.add_argument("--seed", type=int, default=1)


def run(arguments: argparse.Namespace) -> None:
    """Write the cloud with ground and road labels, all other dimensions kept."""
    check_output(arguments, ".laz", ".las")
    cloud = load_cloud(arguments)
    ground = labelled_ground(cloud)
    outline, _ = pavement_of(cloud, ground, arguments.intensity, arguments.seed)
    labels = labels_of(cloud, ground, outline)
    write_laz(
        arguments.out, cloud.xyz_m, cloud.frame, {**cloud.native.dims, "classification": labels}
    )
    print(
        f"{outline.area:.0f} m2 of pavement in {len(outline.geoms)} parts,"
        f" {(labels == 11).sum()} points: {arguments.out}"
    )
