"""The workflow's own stages, one after the other in one folder, for verbs that need several."""

from __future__ import annotations

from pathlib import Path

from roadsight.api.drive import MANIFESTS, Drive, DriveFiles
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
from roadsight.geometry.reference import UnitChoice
from roadsight.io.records.atomic import read_json
from roadsight.scene.pavement.choice import choose_method
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
