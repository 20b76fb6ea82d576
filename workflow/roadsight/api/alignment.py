"""Cameras of a videolog, by the workflow's own stages one after the other in one folder."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path
from typing import Unpack

import pandas as pd

from roadsight.api.clouds import Cloud
from roadsight.api.drive import MANIFESTS, Drive, DriveFiles, DriveOptions
from roadsight.base.sections.poles import (
    AlignmentLimits,
    Calibration,
    Columns,
    EdgeTracing,
    Networks,
    PoleMasks,
    Reach,
    RoadClasses,
    RoadEdges,
    SideViews,
    TerrainMesh,
    Videolog,
    Voxels,
)
from roadsight.base.sections.run import Run
from roadsight.base.sections.scene import (
    Ground,
    GroundClasses,
    PavementMethod,
    PavementOutline,
    Scene,
)
from roadsight.geometry.crs import counted_in
from roadsight.geometry.frames import Frame
from roadsight.geometry.reference import UnitChoice
from roadsight.io.records.atomic import read_json
from roadsight.io.records.tables import read_table
from roadsight.scene.pavement.choice import choose_method
from roadsight.stages.command import told_clearly
from roadsight.stages.poles.align_cameras import align_cameras
from roadsight.stages.poles.calibrate_drive import calibrate_drives
from roadsight.stages.poles.find_pole_columns import find_columns
from roadsight.stages.poles.match_images import match_images
from roadsight.stages.poles.read_videolog import read_videolog
from roadsight.stages.poles.segment_images import segment_images
from roadsight.stages.poles.shared.alignment_inputs import SceneFiles
from roadsight.stages.poles.shared.dense_inputs import DenseFiles
from roadsight.stages.poles.trace_image_edges import trace_image_edges
from roadsight.stages.poles.trace_pole_axes import trace_pole_axes
from roadsight.stages.scene.build_dem import build_dem
from roadsight.stages.scene.build_terrain import build_terrain
from roadsight.stages.scene.cluster_fpfh import cluster_fpfh
from roadsight.stages.scene.extract_pavement import Way, extract_pavement
from roadsight.stages.scene.extract_road_edges import extract_road_edges
from roadsight.stages.scene.ingest_cloud import ingest_cloud
from roadsight.stages.scene.profile_scene import profile_scene
from roadsight.stages.scene.rasterise_lidar import RoadSource, rasterise_lidar

# Columns that are named otherwise than in the workflow.
_COLUMNS = {"heading_deg": "heading_grid_deg", "focal_px": "fx_px"}
# Columns of the table of cameras, before what its places are counted in.
_RETURNED = (
    *("image", "x", "y", "z", "heading_grid_deg", "pitch_deg", "roll_deg"),
    *("fx_px", "cx_px", "cy_px", "sigma_heading_deg", "sigma_lateral_m", "residual_px"),
    *("accepted", "reason"),
)


def align(
    videolog: pd.DataFrame | str | os.PathLike[str],
    cloud: Cloud | str | os.PathLike[str],
    images: str | os.PathLike[str],
    **options: Unpack[DriveOptions],
) -> pd.DataFrame:
    """Where each camera of a videolog stood and looked (paper 2, sections 3.1 and 3.2).

    Parameters
    ----------
    videolog : columns image, latitude, longitude (WGS 84, degrees; x, y with ``crs="local"``), or
        the path of such a CSV.
    cloud : LAS or LAZ file, or what `read_cloud` made of one; its file is read again.
    images : folder or ZIP.
    options : crs, units, vertical_units, overlap : of the cloud, as `read_cloud` takes them.
        masks : folder of label images; None: a small network labels them. map : what labels mean.
        hfov_deg : field of view, 0: unknown. intrinsics : CSV of a known lens. baseline : JSON of
        registered cameras. street : a street mapped from a vehicle, whose edges are curbs.
        method : auto, road, dense, published or none. max_sigma_heading_deg : cameras whose heading
        is less certain are not accepted. engine : own or open3d, for the pavement.

    Returns
    -------
    one row for each usable image: x, y, z in the cloud's CRS and units, heading_grid_deg clockwise
    from grid north, pitch_deg, roll_deg, fx_px, cx_px, cy_px, sigma_heading_deg, sigma_lateral_m,
    residual_px, accepted and the reason where it was not

    Raises
    ------
    InputError : a file or a value that cannot be used.

    Examples
    --------
    A straight road of 8 m to the north, driven 1 m right of its middle; the images show it as
    labels alone, and its edges correct what GPS says.

    >>> import os, cv2, laspy, numpy as np, pandas as pd, roadsight
    >>> rng = np.random.default_rng(1)
    >>> x, y = rng.uniform([-20, -20], [20, 150], (40_000, 2)).T
    >>> cloud = laspy.create(point_format=6, file_version="1.4")
    >>> cloud.x, cloud.y, cloud.z = x, y, rng.normal(0, 0.01, x.size)
    >>> cloud.classification = np.where(np.abs(x) < 4, 11, 2)
    >>> cloud.write("road.las")
    >>> right_m, ahead_m = np.array([[-5, -5, 3, 3], [3, 300, 300, 3]])
    >>> u, v = 320 + 500 * right_m / ahead_m, 240 + 500 * 2 / ahead_m  # from 2 m above the road
    >>> corners = np.column_stack([u, v]).round().astype(np.int32)
    >>> label = cv2.fillPoly(np.zeros((480, 640), np.uint8), [corners], 1)
    >>> drive = pd.DataFrame({"image": [f"{n}.png" for n in range(5)], "y": 10.0 * np.arange(5)})
    >>> drive["x"] = 1 + rng.normal(0, 0.3, 5)
    >>> os.makedirs("labels", exist_ok=True)
    >>> all(cv2.imwrite(f"labels/{image}", label) for image in drive["image"])
    True
    >>> cameras = roadsight.align(drive, "road.las", "labels", masks="labels", crs="local",
    ...                           hfov_deg=65, max_sigma_heading_deg=0.5)
    >>> bool(cameras["accepted"].all()), bool((np.abs(cameras["x"] - 1) < 0.2).all())
    (True, True)
    >>> bool((np.abs((cameras["heading_grid_deg"] + 180) % 360 - 180) < 0.5).all())
    True
    """
    if isinstance(cloud, Cloud):
        read: DriveOptions = {
            "crs": cloud.choice.crs,
            "units": cloud.choice.units,
            "vertical_units": cloud.choice.vertical_units,
            "overlap": cloud.overlap,
        }
        path, options = cloud.native.header.path, {**read, **options}
    else:
        path = Path(cloud)
    drive = Drive(path, str(images), **options)
    if not isinstance(videolog, pd.DataFrame):
        return cameras_of(str(videolog), drive)
    with tempfile.TemporaryDirectory(prefix="roadsight-") as folder:
        table = Path(folder) / "videolog.csv"
        videolog.to_csv(table, index=False)
        return cameras_of(str(table), drive)


def cameras_of(videolog: str, drive: Drive) -> pd.DataFrame:
    """Table of cameras as `align` returns it.

    Raises
    ------
    InputError : as `align`.
    """
    with told_clearly("align"), tempfile.TemporaryDirectory(prefix="roadsight-") as folder:
        chain = Chain(Path(folder), videolog, drive)
        chain.scene()
        chain.track()
        chain.road()
        chain.images(drive)
        cameras = read_table(chain.cameras(drive)).rename(columns=_COLUMNS)
        frame = Frame.from_dict(read_json(chain.frame))
    cameras[["x", "y", "z"]] = frame.to_native(cameras[["x", "y", "z"]].to_numpy(float))
    return cameras[list(_RETURNED)].assign(**counted_in(frame))


_ROAD_CLASS = "11"  # class "road surface" of LAS 1.4, as a profile names it
# Share of points with that class from which a cloud counts as classified; below it stand stray
# points, and the pavement is sought by shape.
_LEAST_ROAD = 1e-4


class Chain:
    """Stages of a drive, whose files lie in a folder; those of a street where the drive is one."""

    def __init__(self, folder: Path, videolog: str, drive: DriveFiles) -> None:
        self._folder, self._videolog, self._drive = folder, videolog, drive
        self._site = drive.cloud.stem
        self.cloud, self.frame = self.path("cloud.parquet"), self.path("frame.json")
        self.dem, self.frames = self.path("dem.tif"), self.path("frames.parquet")
        self.road_edges = self.path("road_edges.parquet")
        self._profile, self._ground = self.path("profile.json"), self.path("ground.parquet")
        self._pavement, self._top = self.path("pavement.gpkg"), self.path("top.tif")
        self._columns, self._terrain = self.path("columns.parquet"), self.path("terrain.npz")
        self._masks, self._axes = self.path("masks.zip"), self.path("pole_axes.parquet")
        self._image_edges = self.path("image_edges.parquet")
        self._matches = self.path("matches.parquet")

    def path(self, name: str) -> Path:
        """Path of one of its files."""
        return self._folder / name

    def scene(self) -> None:
        """Cloud, terrain and, where the cloud has no road class, pavement."""
        drive, site, cloud, frame = self._drive, self._site, self.cloud, self.frame
        choice = UnitChoice(drive.crs, drive.units, drive.vertical_units)
        ingest_cloud(
            (drive.cloud,), site, choice, Scene(overlap=drive.overlap), cloud=cloud, frame=frame
        )
        profile_scene(cloud, frame, out=self._profile)
        build_dem(
            site, cloud, frame, self._profile, Ground(), dem=self.dem, ground_path=self._ground
        )
        profile = read_json(self._profile)
        self._classified = profile["class_shares"].get(_ROAD_CLASS, 0.0) >= _LEAST_ROAD
        if self._classified:
            return
        clusters, classes = None, GroundClasses(fpfh_engine=drive.engine)
        if choose_method("auto", False, profile).method == "published":
            clusters = self.path("clusters.parquet")
            cluster_fpfh(cloud, self._ground, self._profile, classes, Run().seed, out=clusters)
        way = Way(
            PavementOutline(),
            PavementMethod().method,
            classes.intensity,
            drive.engine,
            profile=self._profile,
            clusters=clusters,
        )
        points = self.path("pavement.parquet")
        extract_pavement(
            site, cloud, frame, self._ground, way, pavement=self._pavement, points_path=points
        )

    def track(self) -> None:
        """Top view, and the frames of the videolog on it."""
        source = RoadSource("class")
        if not self._classified:
            source = RoadSource("pavement", pavement=self._pavement, dem=self.dem)
        voxels = self.path("voxels.parquet")
        rasterise_lidar(
            self.cloud, self.frame, Voxels(), source, voxels_path=voxels, top_path=self._top
        )
        read_videolog(
            self._videolog,
            self._drive.images,
            self.cloud,
            self.frame,
            self.dem,
            Videolog(),
            self._top,
            out=self.frames,
        )

    def road(self) -> None:
        """Road edges, pole-like columns, terrain."""
        settings = RoadEdges(method="curbs") if self._drive.street else RoadEdges()
        extract_road_edges(
            self._top,
            self.frame,
            settings,
            self.cloud,
            self.frames,
            edges_path=self.road_edges,
            lines=self.path("road_edges.gpkg"),
        )
        find_columns(self.cloud, self.frame, self.dem, Columns(), out=self._columns)
        ground = None if self._classified else self._ground
        build_terrain(self.cloud, RoadClasses(), TerrainMesh(), ground, out=self._terrain)

    def images(self, drive: Drive) -> None:
        """What the images show."""
        frames, masks = self.frames, self._masks
        source = [drive.masks, drive.map] if drive.masks else [str(MANIFESTS / "road_classes.yaml")]
        height_px = Networks().image_height_px
        segment_images(frames, drive.images, (source,), height_px, out=masks)
        edges = EdgeTracing(borders="nearest") if drive.street else EdgeTracing()
        trace_image_edges(frames, masks, edges, out=self._image_edges)
        trace_pole_axes(frames, masks, PoleMasks(), out=self._axes)
        match_images(frames, drive.images, out=self._matches)

    def cameras(self, drive: Drive) -> Path:
        """Table of poses by road alignment."""
        sides = SideViews()
        files = SceneFiles(
            self.frames,
            self.road_edges,
            self.frame,
            (self._image_edges,),
            Reach(),
            terrain=self._terrain,
            dem=self.dem,
            pole_axes=(self._axes,),
            columns=self._columns,
        )
        dense = DenseFiles(
            drive.method, drive.intrinsics, self.cloud, Path(drive.images), (self._masks,)
        )
        settings = Calibration(hfov_deg=drive.hfov_deg)
        if drive.street:
            settings = settings.model_copy(update={"start": "landmarks"})
        calibration, out = self.path("calibration.json"), self.path("cameras.parquet")
        calibrate_drives(
            files,
            dense,
            settings,
            sides.left_yaw_deg,
            sides.right_yaw_deg,
            drive.baseline,
            (self._matches,),
            out=calibration,
        )
        limits = AlignmentLimits(max_sigma_heading_deg=drive.max_sigma_heading_deg)
        align_cameras(files, dense, limits, calibration, out=out)
        return out
