"""Poles in a shard's images: pixels, bearings and distances from the camera."""

from __future__ import annotations

import logging
import sys
from collections.abc import Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from roadsight.base.arrays import Bools, Bytes, Floats
from roadsight.base.errors import InputError
from roadsight.base.sections.poles import EdgeTracing, Sightings
from roadsight.base.shards import WHOLE, Shard
from roadsight.geometry.cameras import Intrinsics, compass_deg
from roadsight.geometry.frames import Frame
from roadsight.geometry.north import SiteNorth
from roadsight.io.images.image_shards import ImageShard
from roadsight.io.raster.rasters import Raster, read_raster
from roadsight.io.records.atomic import read_json
from roadsight.io.records.tables import read_about, read_table, write_table
from roadsight.poles.alignment.landmarks import Turns
from roadsight.poles.calibration.calibration_table import from_content
from roadsight.poles.drive.drive_lenses import Key
from roadsight.poles.images.kinds import PixelClass
from roadsight.poles.images.lanes import centre_lines
from roadsight.poles.images.views import (
    VIEWS,
    View,
    ViewName,
    ViewOffsets,
    beside,
    merge_views,
    side_intrinsics,
    usable,
    views_of,
)
from roadsight.poles.sightings.distances import HeightAt, fit_front_depth, ground_distance_m
from roadsight.poles.sightings.metric_depth import DepthFit
from roadsight.poles.sightings.sighting_bearing import OWN_COLUMN, TURNED_COLUMNS, ViewCamera
from roadsight.poles.sightings.sightings import Evidence, measure_view
from roadsight.poles.triangulate.cloud_objects import OUT_OF_VIEW, Objects, objects_of, show
from roadsight.poles.triangulate.pole_doubts import UNTURNED
from roadsight.scene.classes import is_road
from roadsight.stages.command import Command, logged
from roadsight.stages.poles.shared.alignment_inputs import read_columns

log = logging.getLogger("measure_poles")

_COLUMNS = (
    "image",
    "route",
    "sequence",
    "view",
    "kind",
    "u_foot",
    "v_foot",
    "u_min",
    "v_min",
    "u_max",
    "v_max",
    "x",
    "y",
    "z",
    "drift_east_m",
    "drift_north_m",
    "aside_east_m",
    "aside_north_m",
    "latitude",
    "longitude",
    "bearing_grid_deg",
    "bearing_deg",
    "depth_m",
    "sigma_bearing_deg",
    OWN_COLUMN,
    *TURNED_COLUMNS,
    "sigma_depth_m",
    "kept",
    "reason",
    "method",
    "depth_from",
    "depth_network_m",
    "sigma_depth_network_m",
    "depth_ground_m",
    "sigma_depth_ground_m",
    "depth_lidar_m",
    "sigma_depth_lidar_m",
    "height_m",
    "lower_edge_rise",
    "upper_edge_rise",
    "width_px",
    "foot_visible",
)

_TEXTS = ("image", "route", "view", "kind", "reason", "method", "depth_from")
"""Columns that hold texts, also where there is no row to tell."""

_SIGMAS = (
    *("sigma_heading_deg", "sigma_pitch_deg", "sigma_lateral_m", "sigma_along_m"),
    *("sigma_cx_px", "heading_by_cx_deg", "sigma_focal_ratio", "heading_by_focal_deg"),
    "pitch_by_cy_deg",
)
"""Columns of the cameras that hold uncertainties, all but the last in the order of `ViewCamera`."""

_SEEN = {"kind": str, "object": np.int64, "image": str, "answer": np.int64}
"""Columns of what views say about objects of the cloud, beside the route."""

_MARKED = {"x": np.float64, "y": np.float64, "image": str}
"""Columns of points on lane markings."""


def measure_poles(
    frames_path: Path,
    cameras_path: Path,
    masks_path: Path,
    depth: Path,
    dem: Path,
    frame_path: Path,
    settings: Sightings,
    min_marking_px: Annotated[float, EdgeTracing],
    turns_path: Annotated[Path | None, "yaw of side views, from what images share"] = None,
    columns: Annotated[Path | None, "pole-like columns of the cloud"] = None,
    calibration: Annotated[Path | None, "has the yaw of side views, if found"] = None,
    voxels: Annotated[Path | None, "only for the bearing `lidar`"] = None,
    objects: Annotated[Path | None, "trees and guardrails of the cloud"] = None,
    views: Sequence[ViewName] = VIEWS,
    shard: Shard = WHOLE,
    grid_convergence: Literal["simulate", "skip"] = "simulate",
    *,
    out: Path,
    seen: Annotated[Path | None, "what images show of the objects"] = None,
    markings: Annotated[Path | None, "lane markings on the ground"] = None,
) -> None:
    """Write the sightings of every image of the shard whose camera was accepted."""
    given = ViewOffsets(settings.left_yaw_deg, settings.right_yaw_deg)
    found = _side_views(calibration, turns_path)
    frames = usable(read_table(frames_path), shard)
    cameras = read_table(cameras_path)
    accepted = cameras[cameras["accepted"]].set_index("image")
    poses = {str(image): pose for image, pose in accepted.iterrows()}
    known = frames[frames["image"].isin(accepted.index)]
    log.info("%d of %d images have an accepted camera", len(known), len(frames))
    frame = Frame.from_dict(read_json(frame_path))
    ground = read_raster(dem, frame)
    evidence = _Evidence(columns, voxels, ground, known, settings)
    masks, depths = ImageShard(masks_path), ImageShard(depth)
    shown = list(views_of(known, tuple(views)))
    lacking = {view.path for view in shown if view.name not in masks or view.name not in depths}
    if lacking:
        log.warning("%d images have no mask or depth: %s", len(lacking), ", ".join(sorted(lacking)))
    shown = [view for view in shown if view.path not in lacking]
    routes = dict(zip(known["image"], known["route"].astype(str), strict=True))
    tables = []
    marked = [pd.DataFrame({name: pd.Series(dtype=kind) for name, kind in _MARKED.items()})]
    asked = objects_of(read_table(objects)) if objects else []
    answers = [pd.DataFrame({name: pd.Series(dtype=kind) for name, kind in _SEEN.items()})]
    for view in logged(shown, len(shown), log, "images"):
        mask, pose = masks.read(view.name), poses[view.image]
        key = routes[view.image], int(pose["width_px"]), int(pose["height_px"])
        turns = found.get(key, Turns())
        camera = _view_camera(view, pose, turns, given, settings, mask.shape)
        depth_map = depths.read(view.name)
        fit, near = evidence.front_fit(view, camera, depth_map), evidence.near(camera, view.image)
        table = measure_view(camera, mask, depth_map, near, settings, fit)
        unturned = key in found and not np.isfinite(turns.sigma_deg[VIEWS.index(view.view)])
        if unturned and settings.side_views == "found":
            table = table.assign(kept=False, reason=UNTURNED)
        else:
            answers += [_answers(camera, mask, one, view, settings) for one in asked]
        if len(table):
            tables.append(table.assign(image=view.image, view=view.view))
        if markings and view.view == "front":
            marked.append(_markings(camera, mask, ground, view, min_marking_px))
    sightings = _together(tables, settings)
    if settings.bearing == "lidar":  # rays begin where the videolog says (section 3.3)
        accepted = accepted.assign(**known.set_index("image")[["x", "y"]])
    table = _finished(sightings, known, accepted, frame, grid_convergence == "simulate")
    for reason, count in table["reason"].value_counts().sort_index().items():
        log.info("%5d %s", count, reason or "kept")
    write_table(out, table, {"settings": settings.model_dump(), "offsets": asdict(given)})
    if markings:
        write_table(markings, pd.concat(marked, ignore_index=True).astype(_MARKED))
    if seen:
        told = pd.concat(answers, ignore_index=True).astype(_SEEN)
        write_table(seen, told.assign(route=told["image"].map(routes).astype(str)))


def _together(tables: list[pd.DataFrame], settings: Sightings) -> pd.DataFrame:
    """Sightings of all views, merged unless the views are stitched, which show nothing twice."""
    sightings = pd.concat(tables, ignore_index=True) if tables else pd.DataFrame()
    if not tables or settings.side_views == "stitched":
        return sightings
    return merge_views(sightings)


def _view_camera(
    view: View,
    pose: pd.Series,
    turns: Turns,
    given: ViewOffsets,
    settings: Sightings,
    shape: tuple[int, ...],
) -> ViewCamera:
    """Camera of a view, turned from the front view's or beside it in its plane."""
    if settings.side_views == "stitched":
        return _camera(view, pose, None, shape)
    known = np.isfinite(turns.sigma_deg)
    left_deg = turns.deg[1] if known[1] else given.left_deg
    right_deg = turns.deg[2] if known[2] else given.right_deg
    camera = _camera(view, pose, ViewOffsets(left_deg, right_deg), shape)
    sigma_deg = turns.sigma_deg[VIEWS.index(view.view)]
    return replace(camera, sigma_yaw_deg=float(sigma_deg)) if np.isfinite(sigma_deg) else camera


def _markings(
    camera: ViewCamera, mask: Bytes, ground: Raster, view: View, min_marking_px: float
) -> pd.DataFrame:
    """Middles of lane markings on the ground."""
    places = markings_on_ground(camera, mask, ground.sample, min_marking_px)
    return pd.DataFrame(places, columns=["x", "y"]).assign(image=view.image)


def _answers(
    camera: ViewCamera, mask: Bytes, asked: Objects, view: View, settings: Sightings
) -> pd.DataFrame:
    """What a view says about the objects that it looks at."""
    answer = show(camera, mask, asked, settings.farthest_m)
    rows = np.flatnonzero(answer != OUT_OF_VIEW)
    told = {"kind": asked.kind, "object": rows, "image": view.image, "answer": answer[rows]}
    return pd.DataFrame(told)


def _side_views(calibrated: Path | None, matched: Path | None) -> dict[Key, Turns]:
    """Yaw of the side views of each drive, where its calibration or shared points found them."""
    drives = read_json(calibrated)["drives"] if calibrated else []
    found = {calibration.key: calibration.turns for calibration in map(from_content, drives)}
    for turn in read_json(matched)["turns"] if matched else []:
        key = turn["route"], turn["width_px"], turn["height_px"]
        deg, sigma = (list(part) for part in (found[key].deg, found[key].sigma_deg))
        number = VIEWS.index(turn["view"])
        deg[number], sigma[number] = turn["turn_deg"], turn["sigma_deg"]
        found[key] = Turns((deg[0], deg[1], deg[2]), (sigma[0], sigma[1], sigma[2]))
    return found


class _Evidence:
    """Terrain and LiDAR around the shard's cameras."""

    def __init__(
        self,
        columns: Path | None,
        voxels: Path | None,
        ground: Raster,
        frames: pd.DataFrame,
        settings: Sightings,
    ) -> None:
        self._ground, self._reach_m = ground, settings.farthest_m
        places = frames[["image", "x", "y"]].itertuples(index=False)
        self._places = {str(image): (x, y) for image, x, y in places}
        self._fits: dict[str, DepthFit] | None = {} if settings.distance == "published" else None
        self._columns = read_columns(columns)
        self._points, self._road = np.empty((0, 3)), np.empty((0, 3))
        if settings.bearing == "lidar" or settings.distance == "published":
            self._points, self._road = _voxels(voxels, frames, self._reach_m + 10.0)
        log.info("%d pole-like columns, %d voxels", len(self._columns), len(self._points))

    def near(self, camera: ViewCamera, image: str) -> Evidence:
        """What lies within reach of a camera."""
        points_m = self._close(self._points, camera)
        return Evidence(self._ground.sample, self._columns, points_m, self._places[image])

    def front_fit(
        self, view: View, camera: ViewCamera, depth: NDArray[np.uint16]
    ) -> DepthFit | None:
        """The study's fit of a place's front view, which holds for its side views; if asked for."""
        if self._fits is None:
            return None
        if view.view == "front":
            road_m = self._close(self._road, camera)
            self._fits[view.image] = fit_front_depth(camera, depth, road_m, self._reach_m)
        return self._fits.get(view.image)

    def _close(self, points_m: Floats, camera: ViewCamera) -> Floats:
        offset = points_m - np.asarray(camera.position_m)
        close: Floats = points_m[np.hypot(offset[:, 0], offset[:, 1]) <= self._reach_m]
        return close


def _voxels(path: Path | None, cameras: pd.DataFrame, reach_m: float) -> tuple[Floats, Floats]:
    """Centres of the voxels around the cameras that are seen from above, and of road among them.

    These are the highest of each column and all of road and bridge, as the study reduces its
    raster (Fig. 4c).
    """
    if not path:
        raise InputError(
            "is needed by sightings.bearing: lidar and sightings.distance: published",
            where="--voxels",
        )
    about = read_about(path)
    cell_m, anchor = float(about["cell_size_m"]), np.array(about["anchor"], np.float64)
    table = read_table(path, ["ix", "iy", "iz", "cls"])
    road = np.asarray(is_road(table["cls"].to_numpy()), bool)
    top = (table["iz"] == table.groupby(["ix", "iy"])["iz"].transform("max")).to_numpy()
    xyz = anchor + (table[["ix", "iy", "iz"]].to_numpy(np.float64) + 0.5) * cell_m
    near = _near(xyz[:, :2], cameras[["x", "y"]].to_numpy(np.float64), reach_m)
    return xyz[near & (top | road)], xyz[near & road]


def _near(xy_m: Floats, places_m: Floats, reach_m: float) -> Bools:
    """Whether points (n, 2) lie in a cell of the size of the reach beside some camera's cell."""
    if not len(places_m):
        return np.zeros(len(xy_m), bool)
    cells = np.floor(places_m / reach_m).astype(np.int64)
    around = {(i + a, j + b) for i, j in cells.tolist() for a in (-1, 0, 1) for b in (-1, 0, 1)}
    low = np.array(sorted(around)).min(axis=0)
    shape = np.array(sorted(around)).max(axis=0) - low + 3
    table = np.zeros(tuple(shape), bool)
    table[tuple((np.array(sorted(around)) - low + 1).T)] = True
    own = np.clip(np.floor(xy_m / reach_m).astype(np.int64) - low + 1, 0, shape - 1)
    return np.asarray(table[own[:, 0], own[:, 1]])


def _camera(
    view: View, pose: pd.Series, offsets: ViewOffsets | None, shape: tuple[int, ...]
) -> ViewCamera:
    """Camera of a view; without offsets, side views lie beside the front view in its plane."""
    front = Intrinsics(
        int(pose["width_px"]),
        int(pose["height_px"]),
        float(pose["focal_px"]),
        float(pose["cx_px"]),
        float(pose["cy_px"]),
    )
    own = front
    if offsets is None:
        own = beside(front, view.view, shape[1], shape[0])
    elif view.view != "front":
        own = side_intrinsics(front, shape[1], shape[0])
    turn_deg = 0.0 if offsets is None else offsets.of(view.view)
    angles = [float(pose[f"{name}_deg"]) for name in ("heading", "pitch", "roll")]
    *sigmas, by_cy_deg = (float(np.nan_to_num(pose[name])) for name in _SIGMAS)
    position = (float(pose["x"]), float(pose["y"]), float(pose["z"]))
    heading, pitch, roll = angles
    camera = ViewCamera(own, position, heading, pitch, roll, turn_deg, *sigmas)
    if own == front:
        # What another row of the principal point tilts, it shifts back: a foot stays where it is
        # seen. A side view with a lens of its own tilts with the front view alone.
        own_deg = np.sqrt(max(camera.sigma_pitch_deg**2 - by_cy_deg**2, 0.0))
        camera = replace(camera, sigma_pitch_deg=float(own_deg))
    if view.view == "front":
        return camera
    # A side view looks past a fixed thing of the front view: its yaw takes up the point's error,
    # and its sigma has what another focal length turns the view's middle by. What that does beside
    # the middle is left out: of 491 bearings in side views over six generated clouds 82 and 97 %
    # lie within one and two sigmas without it.
    apart_deg = np.sqrt(max(camera.sigma_heading_deg**2 - camera.heading_by_cx_deg**2, 0.0))
    return replace(
        camera,
        sigma_heading_deg=float(apart_deg),
        sigma_cx_px=0.0,
        heading_by_cx_deg=0.0,
        sigma_focal_ratio=0.0,
    )


def _finished(
    sightings: pd.DataFrame, frames: pd.DataFrame, cameras: pd.DataFrame, frame: Frame, turned: bool
) -> pd.DataFrame:
    """Columns of the artifact, with the camera's place and bearings from true north.

    Parameters
    ----------
    turned : whether grid north differs from true north by what matters.
    """
    if sightings.empty:
        empty = pd.DataFrame({name: pd.Series(dtype=np.float64) for name in _COLUMNS})
        return empty.astype(
            dict.fromkeys(_TEXTS, str) | {"sequence": np.int64, "kept": bool, "foot_visible": bool}
        )
    table = sightings.join(frames.set_index("image")[["route", "sequence"]], on="image")
    way = np.radians(cameras["heading_deg"])
    along_m, across_m = (cameras[f"sigma_{name}_m"].fillna(0.0) for name in ("along", "lateral"))
    shared = {"drift_east_m": along_m * np.sin(way), "drift_north_m": along_m * np.cos(way)}
    shared |= {"aside_east_m": across_m * np.cos(way), "aside_north_m": -across_m * np.sin(way)}
    table = table.join(cameras[["x", "y", "z"]].assign(**shared), on="image")
    xy = table[["x", "y"]].to_numpy(np.float64)
    nothing = np.full(len(table), np.nan)
    latitude, longitude, turn = nothing, nothing, nothing
    if frame.crs_wkt is not None:
        north = SiteNorth(frame)
        latitude, longitude = north.to_geographic(xy)
        turn = north.convergence_deg(xy) if turned else np.zeros(len(table))
    table["latitude"], table["longitude"] = latitude, longitude
    table["bearing_deg"] = compass_deg(table["bearing_grid_deg"].to_numpy() + turn)
    return table[list(_COLUMNS)].reset_index(drop=True)


# Lane markings of an image on the ground.

FARTHEST_M = 40.0
"""Farther markings are not used: with 0.1 degrees of heading they are 7 cm off. Narrow lenses (20
degrees) see no road nearer than 17 m."""

_THINNED_M = 0.2
"""One point of an image a cell of this width: more tell the same."""


def markings_on_ground(
    camera: ViewCamera, mask: Bytes, height_at: HeightAt, min_marking_px: float
) -> Floats:
    """Middles of the markings that a view shows, (n, 2) local metres, thinned.

    Parameters
    ----------
    mask : project classes (rows, columns). min_marking_px : see `centre_lines`.
    """
    uv = centre_lines(mask == PixelClass.MARKING, min_marking_px)
    if not len(uv):
        return np.empty((0, 2))
    rays = camera.rays(uv)
    position = np.asarray(camera.position_m, np.float64)
    away = ground_distance_m(position, rays, height_at, farthest_m=FARTHEST_M)
    met = np.isfinite(away)
    way = rays[met, :2] / np.hypot(rays[met, 0], rays[met, 1])[:, None]
    places = position[:2] + way * away[met, None]
    _, first = np.unique(np.floor(places / _THINNED_M), axis=0, return_index=True)
    return np.asarray(places[np.sort(first)], np.float64)


main = Command(measure_poles)


if __name__ == "__main__":
    sys.exit(main())
