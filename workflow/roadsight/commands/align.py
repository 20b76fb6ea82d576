"""``roadsight align``: where each camera of a videolog stood and looked."""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path

import pandas as pd

from roadsight.base.errors import InputError
from roadsight.commands.chain import MANIFESTS, Chain, add_cloud_arguments
from roadsight.geometry.frames import Frame
from roadsight.io.records.atomic import read_json
from roadsight.io.records.sighting_tables import write_csv
from roadsight.io.records.tables import read_table
from roadsight.stages.poles.dense_inputs import METHODS

_COLUMNS = {"heading_deg": "heading_grid_deg", "focal_px": "fx_px"}
"""Columns that the verb's table names otherwise than the workflow's."""
_WRITTEN = (
    "image",
    "x",
    "y",
    "z",
    "heading_grid_deg",
    "pitch_deg",
    "roll_deg",
    "fx_px",
    "cx_px",
    "cy_px",
    "sigma_heading_deg",
    "sigma_lateral_m",
    "residual_px",
    "accepted",
    "reason",
)
"""Columns of the verb's table."""


def add_parser(verbs: argparse._SubParsersAction) -> None:
    """Add the verb."""
    parser = verbs.add_parser("align", help="find the pose of every camera of a videolog")
    parser.add_argument(
        "videolog",
        metavar="VIDEOLOG",
        help="CSV: image, latitude, longitude (x, y with --crs local)",
    )
    add_cloud_arguments(parser)
    parser.add_argument("--masks", help="folder of label images; a small network if absent")
    parser.add_argument(
        "--map",
        default=str(MANIFESTS / "labels_project.yaml"),
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
        default=0.12,
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
    with tempfile.TemporaryDirectory(prefix="roadsight-") as folder:
        chain = Chain(Path(folder), street=arguments.street)
        chain.scene(arguments)
        chain.track(arguments)
        chain.road()
        chain.images(arguments)
        chain.cameras(arguments)
        cameras = read_table(chain.path("cameras.parquet")).rename(columns=_COLUMNS)
        frame = Frame.from_dict(read_json(chain.path("frame.json")))
    cameras[["x", "y", "z"]] = frame.to_native(cameras[["x", "y", "z"]].to_numpy(float))
    write_csv(arguments.out, pd.DataFrame(cameras[list(_WRITTEN)]))
    print(f"{cameras['accepted'].sum()} of {len(cameras)} cameras: {arguments.out}")
