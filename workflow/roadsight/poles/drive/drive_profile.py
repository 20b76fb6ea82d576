"""What a drive is like, as far as effects hang on it; measured before anything is simulated."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Any

import numpy as np
import pandas as pd

from roadsight.base.arrays import Bools, Bytes, Floats, Ints
from roadsight.geometry.lens import RadialLens
from roadsight.poles.drive.drive_lenses import Key, lens_content
from roadsight.poles.images.front_view import left_out_share
from roadsight.poles.images.plumb_line import doubt, fit_lens
from roadsight.poles.images.upright_curves import upright_curves
from roadsight.scene.terrain.sight_lines import Height, hidden_road_share

Picture = Callable[[str], Bytes]

EYE_M = 2.2
"""Height of a camera above the road; what is known before any calibration."""
REACH_M = 240.0
"""How far ahead road counts: the reach of the alignment by default."""
FIELDS_DEG = (10.0, 15.0, 20.0, 25.0, 30.0, 40.0, 50.0, 60.0, 75.0, 90.0, 110.0)
"""Horizontal fields of view for which the roadside is measured: a site's own one then changes the
decision, not the profile."""
_CAMERAS = 60
"""Cameras that the hidden road is estimated from, spread over all drives."""
_PICTURES = 120
"""Images of a drive that its lens is measured in."""
_ROADSIDE_M = (3.0, 6.0, 9.0, 12.0)
"""Offsets from the track at which poles may stand."""
_ROADSIDE_STEP_M = 4.0
"""Distance between places along the track."""
_ROAD_M = (3.0,)
"""Offsets of the road's edges from the track, before any edge is known."""
_NEAR_M = 40.0
"""Range within which images measure a pole: the reach of the triangulation by default."""
_VIEWS = 3
"""Images that a pole needs (`docs/decisions/019-two-rays-are-not-enough.md`)."""


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
