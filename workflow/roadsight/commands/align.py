"""``roadsight align``: where each camera of a videolog stood and looked."""

from __future__ import annotations

import argparse
import importlib
import sys
import tempfile
from pathlib import Path

import pandas as pd

from roadsight.errors import InputError
from roadsight.geometry.frames import Frame
from roadsight.io.atomic import read_json
from roadsight.io.sighting_tables import write_csv
from roadsight.io.tables import read_table
from roadsight.stages.ingest_cloud import UNITS

_MANIFESTS = Path(__file__).resolve().parents[3] / "resources" / "manifests"
_ROAD_CLASS, _LEAST_ROAD = "11", 1e-4
_COLUMNS = {"heading_deg": "heading_grid_deg", "focal_px": "fx_px"}
_WRITTEN = (
    "image", "x", "y", "z", "heading_grid_deg", "pitch_deg", "roll_deg", "fx_px", "cx_px", "cy_px",
    "sigma_heading_deg", "sigma_lateral_m", "residual_px", "accepted", "reason",
)  # fmt: skip


def add_parser(verbs: argparse._SubParsersAction) -> None:
    """Add the verb."""
    parser = verbs.add_parser("align", help="find the pose of every camera of a videolog")
    parser.add_argument("videolog", metavar="VIDEOLOG", help="CSV: image, latitude, longitude, ...")
    parser.add_argument("--cloud", type=Path, required=True, help="LAS or LAZ file")
    parser.add_argument("--images", required=True, help="folder or ZIP of the images")
    parser.add_argument("--masks", help="folder of label images; a small network if absent")
    parser.add_argument(
        "--map", default=str(_MANIFESTS / "labels_project.yaml"),
        help="what the labels show; the project's own classes if absent",
    )  # fmt: skip
    parser.add_argument("--hfov-deg", type=float, default=0.0, help="field of view, if known")
    parser.add_argument("--baseline", help="registered cameras, JSON")
    parser.add_argument("--method", choices=("ours", "published", "none"), default="ours")
    parser.add_argument("--crs", default="auto", help="EPSG:nnnn, or auto: the cloud's own")
    parser.add_argument("--units", choices=UNITS, default="auto", help="unit of x and y")
    parser.add_argument("--vertical-units", choices=UNITS, default="auto", help="unit of z")
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
        chain = _Chain(Path(folder))
        chain.scene(arguments)
        chain.road()
        chain.images(arguments)
        chain.cameras(arguments)
        cameras = read_table(chain.path("cameras.parquet")).rename(columns=_COLUMNS)
        frame = Frame.from_dict(read_json(chain.path("frame.json")))
    cameras[["x", "y", "z"]] = frame.to_native(cameras[["x", "y", "z"]].to_numpy(float))
    write_csv(arguments.out, pd.DataFrame(cameras[list(_WRITTEN)]))
    print(f"{cameras['accepted'].sum()} of {len(cameras)} cameras: {arguments.out}")


class _Chain:
    """The workflow's own stages, one after the other in one folder."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder

    def path(self, name: str) -> str:
        return str(self._folder / name)

    def _run(self, stage: str, *options: str, **files: str) -> None:
        """Run a stage; it has told its own message where it ends the verb."""
        named = [
            part
            for name, file in files.items()
            for part in (f"--{name.replace('_', '-')}", self.path(file))
        ]
        code = importlib.import_module(f"roadsight.stages.{stage}").main([*named, *options])
        if code:
            sys.exit(code)

    def scene(self, arguments: argparse.Namespace) -> None:
        """Cloud, terrain and, where the cloud has no road class, pavement."""
        options = ("--site", arguments.cloud.stem, "--crs", arguments.crs)
        units = ("--units", arguments.units, "--vertical-units", arguments.vertical_units)
        self._run("ingest_cloud", *options, *units, str(arguments.cloud),
                  cloud="cloud.parquet", frame="frame.json")  # fmt: skip
        files = {"cloud": "cloud.parquet", "frame": "frame.json"}
        self._run("profile_scene", **files, out="profile.json")
        self._run("build_dem", *options[:2], **files, profile="profile.json",
                  dem="dem.tif", ground="ground.parquet")  # fmt: skip
        shares = read_json(self.path("profile.json"))["class_shares"]
        self._classified = shares.get(_ROAD_CLASS, 0.0) >= _LEAST_ROAD
        if not self._classified:
            self._run("cluster_fpfh", cloud="cloud.parquet", ground="ground.parquet",
                      profile="profile.json", out="clusters.parquet")  # fmt: skip
            self._run("extract_pavement", *options[:2], **files, ground="ground.parquet",
                      clusters="clusters.parquet", pavement="pavement.gpkg",
                      points="pavement.parquet")  # fmt: skip

    def road(self) -> None:
        """Road edges, pole-like columns, terrain."""
        files = {"cloud": "cloud.parquet", "frame": "frame.json"}
        found = {} if self._classified else {"pavement": "pavement.gpkg"}
        source = "class" if self._classified else "pavement"
        self._run("rasterise_lidar", "--road-source", source, **files, **found, dem="dem.tif",
                  voxels="voxels.parquet", top="top.tif")  # fmt: skip
        self._run("extract_road_edges", top="top.tif", frame="frame.json",
                  edges="road_edges.parquet", lines="road_edges.gpkg")  # fmt: skip
        self._run("find_pole_columns", **files, dem="dem.tif", out="columns.parquet")
        ground = {} if self._classified else {"ground": "ground.parquet"}
        self._run("build_terrain", cloud="cloud.parquet", **ground, out="terrain.npz")

    def images(self, arguments: argparse.Namespace) -> None:
        """What the images show."""
        source = [str(_MANIFESTS / "road_classes.yaml")]
        if arguments.masks:
            source = [arguments.masks, arguments.map]
        images = ("--images", arguments.images)
        self._run("read_videolog", "--videolog", arguments.videolog, *images,
                  cloud="cloud.parquet", frame="frame.json", dem="dem.tif", top="top.tif",
                  out="frames.parquet")  # fmt: skip
        self._run("segment_images", *images, "--source", *source, frames="frames.parquet",
                  out="masks.zip")  # fmt: skip
        shown = {"frames": "frames.parquet", "masks": "masks.zip"}
        self._run("trace_image_edges", **shown, out="image_edges.parquet")
        self._run("trace_pole_axes", **shown, out="pole_axes.parquet")

    def cameras(self, arguments: argparse.Namespace) -> None:
        """Poses by road alignment."""
        inputs = {
            "frames": "frames.parquet",
            "image_edges": "image_edges.parquet",
            "road_edges": "road_edges.parquet",
            "frame": "frame.json",
            "dem": "dem.tif",
            "terrain": "terrain.npz",
            "pole_axes": "pole_axes.parquet",
            "columns": "columns.parquet",
        }
        known = ["--hfov-deg", str(arguments.hfov_deg)]
        known += ["--baseline", arguments.baseline] if arguments.baseline else []
        self._run("calibrate_drive", *known, **inputs, out="calibration.json")
        self._run("align_cameras", "--method", arguments.method, **inputs,
                  calibration="calibration.json", out="cameras.parquet")  # fmt: skip
