"""``roadsight align``: where each camera of a videolog stood and looked."""

from __future__ import annotations

import argparse
import dataclasses
from pathlib import Path

from roadsight.api.drive import Drive, cameras_of
from roadsight.base.errors import InputError
from roadsight.commands.cloud_arguments import add_drive_arguments
from roadsight.io.records.sighting_tables import write_csv
from roadsight.stages.poles.dense_inputs import METHODS


def add_parser(verbs: argparse._SubParsersAction) -> None:
    """Add the verb."""
    parser = verbs.add_parser("align", help="find the pose of every camera of a videolog")
    parser.add_argument(
        "videolog",
        metavar="VIDEOLOG",
        help="CSV: image, latitude, longitude (x, y with --crs local)",
    )
    add_drive_arguments(parser)
    parser.add_argument("--masks", help="folder of label images; a small network if absent")
    parser.add_argument(
        "--map",
        default=Drive.map,
        help="what the labels show; the project's own classes if absent",
    )
    parser.add_argument("--hfov-deg", type=float, default=0.0, help="field of view, if known")
    parser.add_argument("--baseline", help="registered cameras, JSON")
    parser.add_argument(
        "--intrinsics",
        help="known lens, CSV: fx_px, cx_px, cy_px, one row for all images or one for each image",
    )
    parser.add_argument(
        "--method",
        choices=METHODS,
        default="auto",
        help="dense: all that photograph and cloud share, needs --intrinsics, auto takes it then; "
        "road: road edges and poles; as published; or the track alone",
    )
    parser.add_argument(
        "--max-sigma-heading-deg",
        type=float,
        default=Drive.max_sigma_heading_deg,
        help="cameras with a less certain heading are rejected; more for a rough map",
    )
    parser.add_argument(
        "-o", "--out", required=True, help="CSV to write; places in the cloud's CRS and units"
    )
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> None:
    """Write one row for each usable image.

    Raises
    ------
    InputError : the output's name is not usable.
    """
    if Path(arguments.out).suffix.lower() != ".csv":
        raise InputError("is no name for a table", where=f"--out {arguments.out}", allowed=".csv")
    fields = {field.name: getattr(arguments, field.name) for field in dataclasses.fields(Drive)}
    cameras = cameras_of(Drive(**fields))
    write_csv(arguments.out, cameras)
    print(f"{cameras['accepted'].sum()} of {len(cameras)} cameras: {arguments.out}")
