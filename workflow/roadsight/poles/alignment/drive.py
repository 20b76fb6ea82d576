"""The images of a drive with their place on the road, ready to be aligned."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

from roadsight.base.arrays import Bools, Floats
from roadsight.base.errors import InputError
from roadsight.base.sections.poles import Reach
from roadsight.geometry.cameras import wrap_deg
from roadsight.poles.alignment.landmarks import Columns, LandmarkNoise, Landmarks, PoleAxes
from roadsight.poles.alignment.pose import Start
from roadsight.poles.alignment.roadside import NearEdges, RoadEdges, edges_ahead
from roadsight.poles.alignment.solve import MEDIAN_OF_NORMAL, ImageEdges, Noise, Task
from roadsight.poles.alignment.track import extended_track, track_headings_deg
from roadsight.poles.images.views import VIEWS
from roadsight.poles.sightings.lidar_poles import PoleColumns

# Function of a camera place (3,) and points (n, 3): which of them the terrain does not hide
Visible = Callable[[Floats, Floats], Bools]
# By this much the track reaches beyond the farthest road edge, since points past its ends have no
# side; at the ends of a route it is continued straight on
_BEYOND_M = 60.0
# Columns this much beyond the range of landmarks are loaded: the range is measured from the track,
# and again from the pose, which may be nearer
_SLACK_M = 10.0
# Height of a camera above the road before it is known, for sight lines; what `weak_mount` expects
_EYE_M = 2.2


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
            x_m, y_m, z_m = (float(row[name]) for name in ("x", "y", "z_road"))
            grade = _grade(path, z, k)
            road = roadway_at(edges, np.array([x_m, y_m, z_m]), heading[k], grade)
            width, height = int(row["width_px"]), int(row["height_px"])
            tilt, middle = (road.grade, road.bank), ((width - 1) / 2, (height - 1) / 2)
            start = Start(
                x_m, y_m, z_m, road.heading_deg, *tilt, width, height, *middle, road.bend, road.hump
            )
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

    def numbers(name: str) -> Floats:
        return rows[name].to_numpy(np.float64)

    front = place.start
    view = np.array([VIEWS.index(name) for name in rows["view"]], np.int64)
    shape = np.column_stack([numbers("width_view_px"), numbers("height_view_px")])
    middle = np.where((view == 0)[:, None], [front.cx_px, front.cy_px], 0.5 * (shape - 1.0))
    axes = PoleAxes(
        view,
        np.column_stack([numbers("u"), numbers("v")]) - middle,
        numbers("v_foot") - middle[:, 1],
        numbers("v_top") - middle[:, 1],
        shape[:, 1] / front.height_px,
        np.hypot(noise.axis_px, noise.axis_share * numbers("width_px")),
        rows["foot_visible"].to_numpy(bool),
        rows["top_cut"].to_numpy(bool),
        numbers("slope"),
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


# Direction and tilt of the road under the vehicle, from the LiDAR's road edges around it.
# Vehicles keep to their road within a degree, while the direction between two satellite positions
# 8 m apart may be wrong by several; and a camera tilts with the road.

# How far around a place edges tell the road's direction and tilt. Where a road changes its bend
# within this, a mean direction lags behind by a sixth of the radius squared times the change: 0.4
# degrees on the generated rural road, always towards a straighter road, so that the lens found
# with it is too long. With the change of the bend and of the grade as unknowns, 30 m serve as well
# as 20 in dense clouds and have less noise in sparse ones (24, 8, 2 pulses/m2).
_AROUND_M = 30.0
_TURN_DEG = 25.0  # Edges that run at a greater angle to the road are of side roads and drives
_FEWEST = 12  # With fewer edge points the track alone has to do
# As if height (m), grade, bank, bend of the grade (1/m) and its change (1/m2) were known
# beforehand this well: grades change over some 100 m.
_TILT_SIGMA = np.array([0.5, 0.03, 0.04, 0.002, 1e-4])
_HEIGHT_SIGMA_M = 0.03  # One standard deviation of an edge point's height
# The same of direction (radians), bend (1/m) and its change (1/m2): radii below some 30 m are
# unlikely, and so is a clothoid that reaches one of 30 m within 30 m
_COURSE_SIGMA = np.array([1.0, 0.03, 1e-3])
_LEAST_TURN_DEG = 0.1  # Least standard deviation of an edge point's direction
_INDEPENDENT = 0.1  # Share of edge points that tell something new: neighbours err alike
_ROUNDS = 8  # Rounds of reweighing

# The rest decides where a track is moved (decision 091). On generated drives whose positions
# drift by 3 m (roads of seeds 1 and 5) these places are inside their road then, and drives that
# keep to it stay, with any of the values in brackets.

# How far ahead and behind edges tell where the road lies across a place of the track (3 to 5; from
# 8 on a bend and the heading's error move one more drive of 2 pulses/m2)
_STRIP_M = 5.0
# How far aside they do: a receiver's error of some metres and the road's width (10 to 20)
_ASIDE_M = 15.0
# Points of one line, 0.3 m apart along it, have no such gap between them across (0.3 to 1)
_APART_M = 0.5
# Metres along the road, of the 10 of the strip, in which a line has points: a lone point is none
# (1 to 5)
_FEWEST_M = 3
# Lines nearer to each other have no road between them: the width of a lane (1.5 to 4)
_NARROWEST_M = 2.5
# Most by which the width of a gap differs from the road's, as a share of it. Roads are told to 7
# percent; the mouth of a drive adds 30 (0.1 to 0.4).
_LIKE_WIDTH = 0.25
# A drive none of whose places is as far beside the road as this stays as it is: places of drives
# that keep to their road are up to 0.46 m beside its edges (with 1 m, one of three drifting drives
# stays and leaves 5 of 38 places beside the road)
_BESIDE_M = 0.5
# Share of the road's width by which places of a moved drive are inside its edges (0.1 to 0.35)
_WITHIN = 0.25


@dataclass(frozen=True)
class Roadway:
    """Direction and tilt of the road at one place.

    Heading in degrees from grid north, rise per metre ahead and to the right; turn to the right
    in radians per metre and change of the grade per metre. Where too few edges
    lie around, the track alone has to do, and bank, bend and hump are 0.
    """

    heading_deg: float
    grade: float
    bank: float
    bend: float
    hump: float


def roadway_at(
    edges: RoadEdges, place_xyz_m: ArrayLike, heading_deg: float, grade: float
) -> Roadway:
    """Road under a place.

    Parameters
    ----------
    place_xyz_m : on the road, local metres. heading_deg, grade : of the track there.
    """
    place = np.asarray(place_xyz_m, np.float64)
    index = edges.near(place, _AROUND_M)
    along = edges.along[index]
    turn = wrap_deg(np.degrees(np.arctan2(along[:, 0], along[:, 1])) - heading_deg)
    turn = (turn + 90.0) % 180.0 - 90.0  # Edges run either way.
    offset = edges.xyz_m[index] - place
    (turned_deg, bend), like = _course(_ahead(offset, heading_deg), turn)
    if like.sum() < _FEWEST:
        return Roadway(heading_deg, grade, 0.0, 0.0, 0.0)
    offset, heading = offset[like], heading_deg + turned_deg
    # Surface through the edges: height, grade, bank, bend of the grade and its change.
    ahead, right = _ahead(offset, heading), _aside(offset, heading)
    terms = np.column_stack([np.ones_like(ahead), ahead, right, ahead**2, ahead**3 / 6.0])
    weight = _INDEPENDENT / _HEIGHT_SIGMA_M**2
    known = np.diag(1.0 / _TILT_SIGMA**2)
    expected = np.array([0.0, grade, 0.0, 0.0, 0.0])
    tilt = np.linalg.solve(
        weight * terms.T @ terms + known, weight * terms.T @ offset[:, 2] + known @ expected
    )
    on_right = _aside(offset, heading_deg) >= 0
    bank = tilt[2] if min(on_right.sum(), (~on_right).sum()) >= 3 else 0.0
    return Roadway(heading % 360.0, tilt[1], bank, bend, 2.0 * tilt[3])


def on_road(track_xy_m: ArrayLike, headings_deg: ArrayLike, edges: RoadEdges) -> Floats:
    """Track of one route, moved into its road where it is clearly beside it.

    A receiver without corrections is off by metres that last for some hundred. Where it has the
    vehicle beside the road, both edges of the road lie on one side of the track. The road is as
    wide there as where the track is on it, and its middle changes little from place to place.

    Parameters
    ----------
    track_xy_m : (n, 2) local metres, finite, in the order of travel.
    headings_deg : (n,) of the track, degrees clockwise from grid north.
    edges : of the site, local metres.

    Returns
    -------
    (n, 2) local metres. Places are moved across their headings only. All stay where no place has
    edges on both sides, or none is clearly beside the road.
    """
    track = np.array(track_xy_m, np.float64)
    headings = np.asarray(headings_deg, np.float64)
    gaps = [_gaps(place, heading, edges) for place, heading in zip(track, headings, strict=True)]
    widths = [right - left for gap in gaps for left, right in gap if left < 0.0 < right]
    if not widths:
        return track
    width_m = float(np.median(widths))
    path_m = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(track, axis=0).T))])
    # The gap that each place is in or next to, unless that is not as wide as the road.
    road = np.full((len(gaps), 2), np.nan)
    for gap, own in zip(gaps, road, strict=True):
        if len(gap):
            nearest = gap[np.argmin(np.maximum(gap[:, 0], -gap[:, 1]))]
            if abs(nearest[1] - nearest[0] - width_m) <= _LIKE_WIDTH * width_m:
                own[:] = nearest
    steps_m = _steps(road, width_m, path_m)
    angle = np.radians(headings)
    return track + steps_m[:, None] * np.column_stack([np.cos(angle), -np.sin(angle)])


def _gaps(xy_m: Floats, heading_deg: float, edges: RoadEdges) -> Floats:
    """What lies between the lines of edges across a place: (m, 2) metres to the right of it."""
    index = edges.near(xy_m, np.hypot(_ASIDE_M, _STRIP_M))
    offset = edges.xyz_m[index, :2] - xy_m
    along = edges.along[index]
    turn = wrap_deg(np.degrees(np.arctan2(along[:, 0], along[:, 1])) - heading_deg)
    like = np.abs((turn + 90.0) % 180.0 - 90.0) < _TURN_DEG
    like &= np.abs(_ahead(offset, heading_deg)) <= _STRIP_M
    aside, ahead = _aside(offset[like], heading_deg), _ahead(offset[like], heading_deg)
    order = np.argsort(aside)
    lines = np.split(order, np.flatnonzero(np.diff(aside[order]) >= _APART_M) + 1)
    lines = [line for line in lines if len(np.unique(np.floor(ahead[line]))) >= _FEWEST_M]
    at = np.array([np.median(aside[line]) for line in lines])
    gaps = np.column_stack([at[:-1], at[1:]])
    return gaps[np.diff(at) >= _NARROWEST_M]


def _steps(road: Floats, width_m: float, path_m: Floats) -> Floats:
    """Metres (n,) to the right that bring the places of drifting stretches inside the road.

    A stretch ends where the middle of the road seems to jump: what follows is another road, or
    none. It drifts if it has places on the road and clearly beside it. All its places go inside
    the edges by the same share, so that the line has no steps; those that tell no road follow
    their neighbours.

    Parameters
    ----------
    road : (n, 2) metres to the right of the places, nan where unknown. path_m : (n,) of the track.
    """
    steps = np.zeros(len(road))
    known = np.flatnonzero(np.isfinite(road[:, 0]))
    if not len(known):
        return steps
    jump = np.abs(np.diff(road[known].mean(axis=1))) > 0.5 * width_m
    for stretch in np.split(known, np.flatnonzero(jump) + 1):
        beside = np.maximum(road[stretch, 0], -road[stretch, 1])
        if beside.min() < 0.0 and beside.max() >= _BESIDE_M:
            inside = road[stretch] + _WITHIN * width_m * np.array([1.0, -1.0])
            steps[stretch] = np.clip(0.0, inside[:, 0], inside[:, 1])
    return np.interp(path_m, path_m[known], steps[known])


def _aside(offset: Floats, heading_deg: float) -> Floats:
    heading = np.radians(heading_deg)
    return offset[:, 0] * np.cos(heading) - offset[:, 1] * np.sin(heading)


def _ahead(offset: Floats, heading_deg: float) -> Floats:
    heading = np.radians(heading_deg)
    return offset[:, 0] * np.sin(heading) + offset[:, 1] * np.cos(heading)


def _course(ahead_m: Floats, turn_deg: Floats) -> tuple[tuple[float, float], Bools]:
    """Turn of the road at the place (degrees) and its bend (radians per metre).

    Robust parabola through the directions of edges (Huber); also which of them run like the road.
    """
    terms = np.column_stack([np.ones_like(ahead_m), ahead_m, 0.5 * ahead_m**2])
    known, course = np.diag(_COURSE_SIGMA**-2.0), np.zeros(3)
    like = np.abs(turn_deg) < _TURN_DEG
    for _ in range(_ROUNDS if like.any() else 0):
        off = np.abs(np.radians(turn_deg) - terms @ course)
        like = off < np.radians(_TURN_DEG)
        if not like.any():
            break
        sigma = np.median(off[like]) / MEDIAN_OF_NORMAL
        sigma = max(float(sigma), np.radians(_LEAST_TURN_DEG))
        weight = _INDEPENDENT * like / (sigma * np.maximum(off, sigma))
        normal = terms.T @ (weight[:, None] * terms) + known
        course = np.linalg.solve(normal, terms.T @ (weight * np.radians(turn_deg)))
    return (float(np.degrees(course[0])), float(course[1])), like
