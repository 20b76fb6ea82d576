"""What a drive is like, as far as effects hang on it; measured before anything is simulated."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from itertools import pairwise
from typing import Any

import cv2
import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

from roadsight.base.arrays import Bools, Bytes, Floats, Floats32, Ints
from roadsight.geometry.cameras import wrap_deg
from roadsight.geometry.lens import RadialLens
from roadsight.poles.drive.drive_lenses import Key, lens_content
from roadsight.poles.images.plumb_line import doubt, fit_lens
from roadsight.scene.terrain.tin import Height, hidden_road_share

Picture = Callable[[str], Bytes]
EYE_M = 2.2  # Height of a camera above the road; what is known before any calibration
REACH_M = 240.0  # How far ahead road counts: the reach of the alignment by default
# Horizontal fields of view for which the roadside is measured: a site's own one then changes the
# decision, not the profile
FIELDS_DEG = (10.0, 15.0, 20.0, 25.0, 30.0, 40.0, 50.0, 60.0, 75.0, 90.0, 110.0)
_CAMERAS = 60  # Cameras that the hidden road is estimated from, spread over all drives
_PICTURES = 120  # Images of a drive that its lens is measured in
_ROADSIDE_M = (3.0, 6.0, 9.0, 12.0)  # Offsets from the track at which poles may stand
_ROADSIDE_STEP_M = 4.0  # Distance between places along the track
_ROAD_M = (3.0,)  # Offsets of the road's edges from the track, before any edge is known
# Range within which images measure a pole: the reach of the triangulation by default
_NEAR_M = 40.0
_VIEWS = 3  # Images that a pole needs (`docs/decisions/019-two-rays-are-not-enough.md`)


def evenly(count: int, most: int) -> Ints:
    """Numbers of at most so many items, spread evenly over all of them."""
    return np.unique(np.linspace(0, count - 1, min(count, most)).round()).astype(np.int64)


def hidden_share(frames: pd.DataFrame, height: Height) -> float | None:
    """Share of the road within 240 m ahead that the ground hides from up to 60 cameras.

    Parameters
    ----------
    frames : usable ones: route, sequence, x, y, z_road, heading_deg. The road is 3 m to either
        side of their tracks.
    """
    routes = [rows for _, rows in frames.groupby("route", sort=True)]
    sides = [beside_track(rows, _ROAD_M) for rows in routes]
    road = np.concatenate([np.empty((0, 2)), *sides])
    edges_m = np.column_stack([road, height(*road.T)])
    edges_m = edges_m[np.isfinite(edges_m[:, 2])]
    if not len(edges_m):
        return None
    few = frames.iloc[evenly(len(frames), _CAMERAS)]
    eyes = few[["x", "y", "z_road"]].to_numpy(np.float64) + np.array([0.0, 0.0, EYE_M])
    heading = few["heading_deg"].to_numpy(np.float64)
    share = hidden_road_share(height, eyes, heading, edges_m, REACH_M)
    return share if np.isfinite(share) else None


def beside_track(frames: pd.DataFrame, offsets_m: Sequence[float]) -> Floats:
    """Places (n, 2) every 4 m along both sides of a track, at offsets from it."""
    drive = frames.sort_values("sequence", kind="stable")
    xy = drive[["x", "y"]].to_numpy(np.float64)
    if len(xy) < 2:
        return np.empty((0, 2))
    path = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(xy, axis=0).T))])
    moved = np.concatenate([[True], np.diff(path) > 0])
    if path[-1] <= 0.0:
        return np.empty((0, 2))
    station = np.arange(0.0, path[-1], _ROADSIDE_STEP_M)
    on_track = np.column_stack([np.interp(station, path[moved], xy[moved, k]) for k in (0, 1)])
    heading = np.unwrap(np.radians(drive["heading_deg"].to_numpy(np.float64)[moved]))
    turn = np.interp(station, path[moved], heading)
    right = np.column_stack([np.cos(turn), -np.sin(turn)])
    offsets = [side * offset for offset in offsets_m for side in (-1.0, 1.0)]
    return np.concatenate([on_track + offset * right for offset in offsets])


def front_view_gap(frames: pd.DataFrame, hfov_deg: float) -> float | None:
    """Share of the roadside of drives with side images that the front view cannot measure.

    Poles may stand 3 m to 12 m from the track, and need three images within 40 m.

    Parameters
    ----------
    hfov_deg : field of view of the front view.

    Returns
    -------
    None where it cannot be told
    """
    shares, lengths = [], []
    for _, route in frames[has_sides(frames)].groupby("route", sort=True):
        drive = route.sort_values("sequence", kind="stable")
        places = beside_track(drive, _ROADSIDE_M)
        camera = drive[["x", "y"]].to_numpy(np.float64)
        heading = drive["heading_deg"].to_numpy(np.float64)
        share = left_out_share(places, camera, heading, hfov_deg, _NEAR_M, _VIEWS)
        if np.isfinite(share):
            shares.append(share)
            lengths.append(len(places))
    return float(np.average(shares, weights=lengths)) if shares else None


def has_sides(frames: pd.DataFrame) -> Bools:
    """Whether each frame has a left or a right image."""
    named = [frames[name].fillna("").astype(str) != "" for name in ("left_path", "right_path")]
    return np.asarray(named[0] | named[1], bool)


def keys_of(frames: pd.DataFrame) -> list[Key]:
    """Drives of the frames, sorted."""
    names = ["route", "width_px", "height_px"]
    rows = frames[names].drop_duplicates().itertuples(index=False)
    return sorted((str(route), int(width), int(height)) for route, width, height in rows)


def frames_of(frames: pd.DataFrame, key: Key) -> pd.DataFrame:
    """Frames of one drive in the order in which they were taken."""
    own = (frames["route"].astype(str) == key[0]) & (frames["width_px"] == key[1])
    own &= frames["height_px"] == key[2]
    return frames[own].sort_values("sequence", kind="stable")


def measured_lens(key: Key, paths: Iterable[str], picture: Picture) -> dict[str, Any]:
    """The lens of a drive from upright outlines in its images.

    Too few outlines give a pinhole of source "unknown". A lens that is not certain is withheld: its
    displacement and the reason are told, but its coefficients are those of a pinhole.
    """
    curves: list[Floats] = []
    owner: list[int] = []
    names = list(paths)
    for number in evenly(len(names), _PICTURES) if names else ():
        found = upright_curves(picture(names[number]))
        curves += found
        owner += [int(number)] * len(found)
    fitted = fit_lens(curves, *key[1:], owner)
    pinhole = RadialLens.centred(0.0, 0.0, *key[1:])
    if fitted is None:
        return lens_content(key, pinhole, 0.0, None, "unknown")
    withheld = doubt(fitted)
    lens = pinhole if withheld else fitted.lens
    content = lens_content(key, lens, fitted.corner_px, fitted.sigma_px, "plumb lines")
    return content | {"curves": fitted.curves, "bow_px": fitted.bow_px, "withheld": withheld}


# Which roadside the front view of a drive leaves out.


def views_of_places(
    places_m: ArrayLike,
    cameras_m: ArrayLike,
    heading_deg: ArrayLike,
    half_angle_deg: float,
    reach_m: float,
) -> Ints:
    """How many cameras have each place (n, 2) within reach and within an angle of their heading.

    Parameters
    ----------
    cameras_m : (k, 2), heading_deg : (k,) clockwise from grid north.
    """
    places = np.asarray(places_m, np.float64).reshape(-1, 2)
    count = np.zeros(len(places), np.int64)
    headings = np.asarray(heading_deg, np.float64)
    for camera, heading in zip(np.asarray(cameras_m, np.float64), headings, strict=True):
        east, north = (places - camera).T
        turn = wrap_deg(np.degrees(np.arctan2(east, north)) - heading)
        away_m = np.hypot(east, north)
        count += (away_m <= reach_m) & (away_m > 0) & (np.abs(turn) <= half_angle_deg)
    return count


def left_out_share(
    places_m: ArrayLike,
    cameras_m: ArrayLike,
    heading_deg: ArrayLike,
    hfov_deg: float,
    reach_m: float,
    views: int,
) -> float:
    """Share of the places beside a drive that its front view shows in too few images.

    A place ``o`` metres aside enters the frame at ``o / tan(hfov / 2)``: nearer images show it no
    more, farther ones than ``reach_m`` are too far to measure it.

    Parameters
    ----------
    places_m : (n, 2) where poles may stand; those that no direction of view could show in
        ``views`` images within ``reach_m`` do not count. views : images that a pole needs.

    Returns
    -------
    share between 0 and 1; NaN where no place counts
    """
    anyhow = views_of_places(places_m, cameras_m, heading_deg, 90.0, reach_m) >= views
    if not anyhow.any():
        return float("nan")
    seen = views_of_places(places_m, cameras_m, heading_deg, 0.5 * hfov_deg, reach_m)
    return float((seen[anyhow] < views).mean())


# Upright outlines in an image: edges of poles, posts, trunks and walls, to part of a pixel.

# Standard deviation of the blur: less follows the noise, more joins the sides of thin posts
_BLUR_PX = 1.0
# Least step of grey across an outline, as Sobel's window sums it: 5 grey levels a pixel
_LEAST_STEP = 40.0
# An outline's step across must be this many times that along: within 18 degrees of upright
_UPRIGHT = 3.0
# Rows of its own that an outline needs, as a share of its pixels: forks and steps have fewer
_SHARE_OF_ROWS = 0.95
_LEAST_HEIGHT = 0.3  # Lower ones are left out, as a share of the image's height


def upright_curves(image: Bytes) -> list[Floats]:
    """Edges that run from row to row within about 18 degrees of upright.

    Parameters
    ----------
    image : (rows, columns, 3) or (rows, columns).

    Returns
    -------
    curves (n, 2) of pixels u, v, one for each row, from the top; the leftmost top first
    """
    grey = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY) if image.ndim == 3 else image
    smooth = cv2.GaussianBlur(grey.astype(np.float32), (0, 0), _BLUR_PX)
    gu, gv = (cv2.Sobel(smooth, cv2.CV_32F, *order) for order in ((1, 0), (0, 1)))
    curves = []
    for sign in (1.0, -1.0):
        step = np.maximum(sign * gu, 0.0)
        # Where the step is greatest among its neighbours in the row.
        ridge, middle = np.zeros(step.shape, bool), step[:, 1:-1]
        ridge[:, 1:-1] = (middle > step[:, :-2]) & (middle >= step[:, 2:])
        ridge &= (step > _LEAST_STEP) & (step > _UPRIGHT * np.abs(gv))
        curves += _traced(ridge, step, _LEAST_HEIGHT * image.shape[0])
    return sorted(curves, key=lambda curve: (curve[0, 0], curve[0, 1], len(curve)))


def _traced(ridge: Bools, step: Floats32, least_px: float) -> list[Floats]:
    """Connected ridges with one pixel in nearly every row, each at the parabola's vertex."""
    count, labels = cv2.connectedComponents(ridge.astype(np.uint8), connectivity=8)
    v, u = np.nonzero(labels)
    number = labels[v, u]
    order = np.lexsort((u, v, number))
    v, u, number = v[order], u[order], number[order]
    starts = np.searchsorted(number, np.arange(1, count + 1))
    curves = []
    for start, end in pairwise(starts):
        rows, columns = v[start:end], u[start:end]
        if end - start < least_px or len(np.unique(rows)) < _SHARE_OF_ROWS * (end - start):
            continue
        left, here, right = (step[rows, columns + k].astype(np.float64) for k in (-1, 0, 1))
        bend = left - 2.0 * here + right
        shift = np.where(bend < 0, 0.5 * (left - right) / np.where(bend < 0, bend, 1.0), 0.0)
        vertex = columns + np.clip(shift, -0.5, 0.5)
        curves.append(np.column_stack([vertex, rows.astype(np.float64)]))
    return curves
