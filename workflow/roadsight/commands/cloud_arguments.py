"""What verbs on a cloud take, and how they read it."""

from __future__ import annotations

import argparse
from pathlib import Path

from roadsight.api.clouds import Cloud, read_cloud
from roadsight.base.errors import InputError
from roadsight.io.cloud.point_filter import OVERLAPS
from roadsight.stages.scene.ingest_cloud import UNITS


def add_cloud_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments that every verb on a cloud takes."""
    parser.add_argument("cloud", metavar="CLOUD", type=Path, help="LAS or LAZ file")
    parser.add_argument(
        "--crs", default="auto", help="EPSG:nnnn, local, or auto: the file's own, else local"
    )
    parser.add_argument("--units", choices=UNITS, default="auto", help="unit of x and y")
    parser.add_argument("--vertical-units", choices=UNITS, default="auto", help="unit of z")
    parser.add_argument(
        "--overlap",
        choices=OVERLAPS,
        default="use",
        help="points of overlapping flight lines; noise, withheld and synthetic ones never count",
    )


def check_output(arguments: argparse.Namespace, *suffixes: str) -> None:
    """Check the output's name before any work is done.

    Raises
    ------
    InputError : it is of another kind, or is the cloud itself.
    """
    out = Path(arguments.out)
    if out.suffix.lower() not in suffixes:
        raise InputError(
            "is no name for what this verb writes",
            where=f"--out {out}",
            allowed=", ".join(suffixes),
        )
    if out.resolve() == arguments.cloud.resolve():
        raise InputError("is the cloud itself", where=f"--out {out}", hint="choose another name")


def load_cloud(arguments: argparse.Namespace) -> Cloud:
    """The verb's cloud."""
    return read_cloud(
        arguments.cloud,
        crs=arguments.crs,
        units=arguments.units,
        vertical_units=arguments.vertical_units,
        overlap=arguments.overlap,
    )


def add_drive_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of a verb that starts from a cloud and a videolog's images."""
    parser.add_argument("--cloud", type=Path, required=True, help="LAS or LAZ file")
    parser.add_argument("--images", required=True, help="folder or ZIP of the images")
    parser.add_argument("--crs", default="auto", help="EPSG:nnnn, or auto: the cloud's own")
    parser.add_argument("--units", choices=UNITS, default="auto", help="unit of x and y")
    parser.add_argument("--vertical-units", choices=UNITS, default="auto", help="unit of z")
    parser.add_argument(
        "--street",
        action="store_true",
        help="a street mapped from a vehicle: edges are curbs, masks count to the first border, "
        "poles say first where the camera looks; needs --hfov-deg",
    )
