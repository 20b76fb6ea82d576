"""The images of a drive with their place on the road, ready to be aligned."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pandas as pd

from roadsight.base.arrays import Bools, Floats
from roadsight.base.errors import InputError
from roadsight.base.sections.poles import Reach
from roadsight.poles.alignment.landmarks import VIEWS, Columns, LandmarkNoise, Landmarks, PoleAxes
from roadsight.poles.alignment.pose import Start
from roadsight.poles.alignment.roadside import NearEdges, RoadEdges, edges_ahead
from roadsight.poles.alignment.roadway import on_road, roadway_at
from roadsight.poles.alignment.solve import ImageEdges, Noise, Task
from roadsight.poles.alignment.track import extended_track, track_headings_deg
from roadsight.poles.sightings.lidar_poles import PoleColumns

Visible = Callable[[Floats, Floats], Bools]
"""Function of a camera place (3,) and points (n, 3): which of them the terrain does not hide."""

_BEYOND_M = 60.0
"""By this much the track reaches beyond the farthest road edge, since points past its ends have no
side; at the ends of a route it is continued straight on."""
_SLACK_M = 10.0
"""Columns this much beyond the range of landmarks are loaded: the range is measured from the track,
and again from the pose, which may be nearer."""
_AXIS_NUMBERS = (
    "u",
    "v",
    "slope",
    "v_foot",
    "v_top",
    "width_px",
    "width_view_px",
    "height_view_px",
)
"""Columns of the table of pole axes that hold numbers."""
_EYE_M = 2.2
"""Height of a camera above the road before it is known, for sight lines; what `weak_mount`
expects."""


@dataclass(frozen=True)
class Place:
    """One image on its route.

    Attributes
    ----------
    station_m : path along the route.
    start : at the position that was recorded.
    track_m : (n, 2) the track around it, moved into its road (`on_road`) and continued at its ends.
    """

    image: str
    route: str
    station_m: float
    start: Start
    track_m: Floats


def places_of(frames: pd.DataFrame, edges: RoadEdges, reach: Reach | None = None) -> list[Place]:
    """Places of the images in the order of the table.

    Parameters
    ----------
    frames : image, route, sequence, x, y, z_road (local metres), heading_deg, width_px,
        height_px; one row per image.

    Raises
    ------
    InputError : a position is not finite.
    """
    reach = reach or Reach()
    lost = frames.loc[~np.isfinite(frames[["x", "y"]].to_numpy(np.float64)).all(axis=1), "image"]
    if len(lost):
        raise InputError("a position is not finite", where=f"image {lost.iloc[0]}")
    found: dict[int, Place] = {}
    for route, table in frames.reset_index(drop=True).groupby("route", sort=True):
        rows = table.sort_values("sequence", kind="stable")
        track = rows[["x", "y"]].to_numpy(np.float64)
        z = rows["z_road"].to_numpy(np.float64)
        heading = track_headings_deg(track, rows["heading_deg"].to_numpy(np.float64))
        path = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(track, axis=0).T))])
        driven = on_road(track, heading, edges)
        for k, (number, row) in enumerate(zip(rows.index, rows.to_dict("records"), strict=True)):
            around = np.abs(path - path[k]) <= reach.farthest_m + _BEYOND_M
            line = extended_track(driven[around], _BEYOND_M)
            start = _start(row, edges, heading[k], _grade(path, z, k))
            found[int(number)] = Place(str(row["image"]), str(route), float(path[k]), start, line)
    return [found[number] for number in range(len(frames))]


def _grade(path_m: Floats, z_m: Floats, k: int) -> float:
    """Rise per metre of the road along the track, over 12 m and one image to either side.

    0 where the route has no metre of road there; never above a quarter.
    """
    near = np.abs(path_m - path_m[k]) <= 12.0
    near[max(k - 1, 0) : k + 2] = True
    near &= np.isfinite(z_m)
    step = path_m[near] - path_m[k]
    if len(step) < 2 or np.ptp(step) < 1.0:
        return 0.0
    step = step - step.mean()
    return float(np.clip(step @ z_m[near] / (step @ step), -0.25, 0.25))


def _start(row: dict, edges: RoadEdges, heading_deg: float, grade: float) -> Start:
    x, y, z = float(row["x"]), float(row["y"]), float(row["z_road"])
    road = roadway_at(edges, np.array([x, y, z]), heading_deg, grade)
    width, height = int(row["width_px"]), int(row["height_px"])
    middle = (width - 1) / 2, (height - 1) / 2
    tilt = road.grade, road.bank
    return Start(x, y, z, road.heading_deg, *tilt, width, height, *middle, road.bend, road.hump)


def near_edges(
    place: Place, edges: RoadEdges, reach: Reach, visible: Visible | None = None
) -> NearEdges:
    """Road edges that the image of a place may show."""
    start = place.start
    position = np.array([start.x_m, start.y_m, start.z_road_m])
    seen = None
    if visible is not None:
        index = edges.near(position, reach.farthest_m)
        seen = np.zeros(len(edges.xyz_m), bool)
        eye = position + np.array([0.0, 0.0, _EYE_M])
        seen[index] = visible(eye, edges.xyz_m[index])
    return edges_ahead(
        edges,
        position,
        start.heading_deg,
        place.track_m,
        nearest_m=reach.nearest_m,
        farthest_m=reach.farthest_m,
        points=reach.edge_points,
        visible=seen,
    )


def image_edges_of(rows: pd.DataFrame, reach: Reach) -> ImageEdges:
    """Edge pixels of one image from its rows u, v, side, kind."""
    return ImageEdges.from_pixels(
        rows[["u", "v"]].to_numpy(np.float64),
        rows["side"].to_numpy(),
        (rows["kind"] == "lane").to_numpy(),
        reach.pixels,
    )


def sight_of(
    place: Place, rows: pd.DataFrame, columns: PoleColumns, noise: LandmarkNoise
) -> Landmarks | None:
    """Landmarks of one place; None where it has no axis or no column.

    Parameters
    ----------
    rows : axes of the place: view, u, v, slope, v_foot, v_top, width_px, width_view_px,
        height_view_px, foot_visible, top_cut.
    """
    away_m = np.hypot(*(columns.xy_m - [place.start.x_m, place.start.y_m]).T)
    near = np.flatnonzero(away_m <= noise.farthest_m + _SLACK_M)
    if rows.empty or not len(near):
        return None
    foot = np.column_stack([columns.xy_m[near], columns.z_ground_m[near]])
    open_top = columns.open_top[near] > 0 if len(columns.open_top) else np.zeros(len(near), bool)
    there = Columns(foot, columns.top_m[near], columns.sigma_m[near], open_top)
    get = {name: rows[name].to_numpy(np.float64) for name in _AXIS_NUMBERS}
    front = place.start
    view = np.array([VIEWS.index(name) for name in rows["view"]], np.int64)
    shape = np.column_stack([get["width_view_px"], get["height_view_px"]])
    middle = np.where((view == 0)[:, None], [front.cx_px, front.cy_px], 0.5 * (shape - 1.0))
    axes = PoleAxes(
        view,
        np.column_stack([get["u"], get["v"]]) - middle,
        get["v_foot"] - middle[:, 1],
        get["v_top"] - middle[:, 1],
        shape[:, 1] / front.height_px,
        np.hypot(noise.axis_px, noise.axis_share * get["width_px"]),
        rows["foot_visible"].to_numpy(bool),
        rows["top_cut"].to_numpy(bool),
        get["slope"],
    )
    return Landmarks(axes, there)


def loader(
    place: Place,
    image_edges: ImageEdges,
    map_edges: NearEdges,
    noise: Noise,
    landmarks: Landmarks | None = None,
) -> Callable[[Floats, Floats], Task]:
    """Maker of the image's task from expected unknowns and their inverse covariance."""

    def load(prior_mean: Floats, prior_information: Floats) -> Task:
        return Task(
            place.start, image_edges, map_edges, noise, prior_mean, prior_information, landmarks
        )

    return load
