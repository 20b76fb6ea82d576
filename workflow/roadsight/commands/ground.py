"""``roadsight ground``: label the ground of a cloud."""

from __future__ import annotations

import argparse

from roadsight.api.clouds import labels_of, write_labelled
from roadsight.api.scene import ground
from roadsight.commands.cloud_arguments import add_cloud_arguments, check_output, load_cloud
from roadsight.stages.scene.build_dem import add_ground_arguments, ground_settings_of


def add_parser(verbs: argparse._SubParsersAction) -> None:
    """Add the verb."""
    parser = verbs.add_parser("ground", help="label ground points (class 2)")
    add_cloud_arguments(parser)
    add_ground_arguments(parser)
    parser.add_argument("-o", "--out", required=True, help="LAZ or LAS file to write")
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> None:
    """Write the cloud with ground labels, all other dimensions kept."""
    check_output(arguments, ".laz", ".las")
    cloud = load_cloud(arguments)
    labels = labels_of(cloud, ground(cloud, ground_settings_of(arguments)))
    write_labelled(arguments.out, cloud, labels)
    print(f"{(labels == 2).sum()} of {len(labels)} points are ground: {arguments.out}")
