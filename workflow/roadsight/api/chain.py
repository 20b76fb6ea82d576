"""The workflow's own stages, one after the other, for verbs that need several of them."""

from __future__ import annotations

import importlib
import sys
from pathlib import Path
from typing import Any

from roadsight.io.records.atomic import read_json
from roadsight.io.records.sources import stage_module
from roadsight.scene.pavement.choice import choose_method

MANIFESTS = Path(__file__).resolve().parents[3] / "resources" / "manifests"
_ROAD_CLASS = "11"
"""Class "road surface" of LAS 1.4, as a profile names it."""
_LEAST_ROAD = 1e-4
"""Share of points with that class from which a cloud counts as classified; below it stand stray
points, and the pavement is sought by shape."""


class Chain:
    """The workflow's own stages, one after the other in one folder."""

    def __init__(self, folder: Path, *, street: bool = False) -> None:
        self._folder, self._street = folder, street

    def path(self, name: str) -> str:
        """Path of one of its files."""
        return str(self._folder / name)

    def _run(self, stage: str, *options: str, **files: str) -> None:
        """Run a stage; it has told its own message where it ends the verb."""
        named = [
            part
            for name, file in files.items()
            for part in (f"--{name.replace('_', '-')}", self.path(file))
        ]
        code = importlib.import_module(stage_module(stage)).main([*named, *options])
        if code:
            sys.exit(code)

    def scene(self, drive: Any) -> None:
        """Cloud, terrain and, where the cloud has no road class, pavement."""
        options = ("--site", drive.cloud.stem, "--crs", drive.crs)
        units = ("--units", drive.units, "--vertical-units", drive.vertical_units)
        self._run(
            "ingest_cloud",
            *options,
            *units,
            str(drive.cloud),
            cloud="cloud.parquet",
            frame="frame.json",
        )
        files = {"cloud": "cloud.parquet", "frame": "frame.json"}
        self._run("profile_scene", **files, out="profile.json")
        self._run(
            "build_dem",
            *options[:2],
            **files,
            profile="profile.json",
            dem="dem.tif",
            ground="ground.parquet",
        )
        shares = read_json(self.path("profile.json"))["class_shares"]
        self._classified = shares.get(_ROAD_CLASS, 0.0) >= _LEAST_ROAD
        if not self._classified:
            found = {"profile": "profile.json"}
            if (
                choose_method("auto", False, read_json(self.path("profile.json"))).method
                == "published"
            ):
                found["clusters"] = "clusters.parquet"
                self._run(
                    "cluster_fpfh",
                    cloud="cloud.parquet",
                    ground="ground.parquet",
                    profile="profile.json",
                    out="clusters.parquet",
                )
            self._run(
                "extract_pavement",
                *options[:2],
                **files,
                **found,
                ground="ground.parquet",
                pavement="pavement.gpkg",
                points="pavement.parquet",
            )

    def track(self, drive: Any) -> None:
        """Top view, and the frames of the videolog on it."""
        files = {"cloud": "cloud.parquet", "frame": "frame.json", "dem": "dem.tif"}
        found = {} if self._classified else {"pavement": "pavement.gpkg"}
        source = "class" if self._classified else "pavement"
        self._run(
            "rasterise_lidar",
            "--road-source",
            source,
            **files,
            **found,
            voxels="voxels.parquet",
            top="top.tif",
        )
        self._run(
            "read_videolog",
            "--videolog",
            drive.videolog,
            "--images",
            drive.images,
            **files,
            top="top.tif",
            out="frames.parquet",
        )

    def road(self) -> None:
        """Road edges, pole-like columns, terrain."""
        files = {"cloud": "cloud.parquet", "frame": "frame.json"}
        curbs = ["--method", "curbs"] if self._street else []
        self._run(
            "extract_road_edges",
            *curbs,
            **files,
            top="top.tif",
            frames="frames.parquet",
            edges="road_edges.parquet",
            lines="road_edges.gpkg",
        )
        self._run("find_pole_columns", **files, dem="dem.tif", out="columns.parquet")
        ground = {} if self._classified else {"ground": "ground.parquet"}
        self._run("build_terrain", cloud="cloud.parquet", **ground, out="terrain.npz")

    def images(self, drive: Any) -> None:
        """What the images show."""
        source = [str(MANIFESTS / "road_classes.yaml")]
        if drive.masks:
            source = [drive.masks, drive.map]
        images = ("--images", drive.images)
        self._run(
            "segment_images", *images, "--source", *source, frames="frames.parquet", out="masks.zip"
        )
        shown = {"frames": "frames.parquet", "masks": "masks.zip"}
        first = ["--borders", "nearest"] if self._street else []
        self._run("trace_image_edges", *first, **shown, out="image_edges.parquet")
        self._run("trace_pole_axes", **shown, out="pole_axes.parquet")
        self._run("match_images", *images, frames="frames.parquet", out="matches.parquet")

    def cameras(self, drive: Any) -> None:
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
        lens = ["--intrinsics", drive.intrinsics] if drive.intrinsics else []
        dense = {"cloud": "cloud.parquet", "masks": "masks.zip"}
        shared = ["--method", drive.method, "--photographs", drive.images, *lens]
        known = ["--hfov-deg", str(drive.hfov_deg)]
        known += ["--baseline", drive.baseline] if drive.baseline else []
        known += ["--start", "landmarks"] if self._street else []
        self._run(
            "calibrate_drive",
            *known,
            *shared,
            **inputs,
            **dense,
            matches="matches.parquet",
            out="calibration.json",
        )
        limits = ["--max-sigma-heading-deg", str(drive.max_sigma_heading_deg)]
        self._run(
            "align_cameras",
            *shared,
            *limits,
            **inputs,
            **dense,
            calibration="calibration.json",
            out="cameras.parquet",
        )
