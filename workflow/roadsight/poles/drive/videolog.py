"""Frames of a videolog: which images are used, where they were taken and where they look.

Whatever is wrong with one image costs that image only: its ``status`` says why it is not used. What
is wrong with the whole table (swapped coordinates, another place) is one error.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike, NDArray

from roadsight.base.arrays import Bools, Floats, Ints
from roadsight.base.errors import InputError
from roadsight.base.sections.poles import Videolog
from roadsight.geometry.cameras import azimuth_deg, compass_deg

OK = "ok"
_FEW = 2  # Places in a row that may be strays; more of them are a drive of their own
# Share of places at which a track in random order turns back: about half; a drive at almost none
_MOST = 0.4
# A size with fewer images than this, and less than a fifth of the usual size's, is not calibrated
_RARE_SIZE = 20
_JUMP_M, _JUMP_FACTOR = 50.0, 5.0  # A step above both this and so many median steps is a jump


@dataclass(frozen=True)
class Site:
    """What the cloud says about places.

    Parameters
    ----------
    to_local : function of latitude and longitude (n,), degrees, that gives x, y (n, 2), metres.
    covers : function of x, y (n, 2): whether the cloud is there. road_height : function of x, y
        (n, 2): height of the road, NaN where unknown. extent : the cloud's place, in words.
    is_local : whether the table has y and x of the cloud's local system instead of degrees.
    """

    to_local: Callable[[ArrayLike, ArrayLike], Floats]
    covers: Callable[[Floats], Bools]
    road_height: Callable[[Floats], Floats]
    extent: str = ""
    is_local: bool = False


def build_frames(table: pd.DataFrame, site: Site, settings: Videolog) -> pd.DataFrame:
    """Frames of all routes, sorted by route and sequence.

    Parameters
    ----------
    table : columns image, route, sequence, latitude, longitude, path, left_path, right_path,
        width_px, height_px and status (of the image file); one row for each image.

    Returns
    -------
    the columns above and x, y, z_road, heading_deg, heading_raw_deg, step_m; the sequence as whole
    numbers, status "ok" or the first reason why the image is not used

    Raises
    ------
    InputError : latitude and longitude are swapped, no image is near the cloud, or none is usable.
    """
    frames = unique_images(table)
    frames["status"] = merged(frames["status"], size_status(frames))
    xy, located = locate(frames, site)
    frames[["x", "y"]] = xy
    frames["status"] = merged(located, frames["status"])
    frames["_located"] = np.asarray(located) == OK
    frames = in_order(frames)
    routes = [_along(route, settings) for _, route in frames.groupby("route", sort=True)]
    frames = pd.concat(routes, ignore_index=True)
    frames["z_road"] = np.nan
    known = frames["_located"].to_numpy()
    frames.loc[known, "z_road"] = site.road_height(frames.loc[known, ["x", "y"]].to_numpy())
    bare = np.where(frames["z_road"].isna(), "no ground of the cloud near", OK)
    frames["status"] = merged(frames["status"], bare)
    if not (frames["status"] == OK).any():
        counts = frames["status"].value_counts()
        raise InputError(
            "no image can be used",
            where="videolog",
            found="; ".join(f"{count} x {reason}" for reason, count in counts.items()),
        )
    return frames.drop(columns="_located")


def merged(first: ArrayLike, second: ArrayLike) -> NDArray[np.object_]:
    """The first status unless it is ok, else the second one."""
    first, second = np.asarray(first, object), np.asarray(second, object)
    return np.where(first != OK, first, second)


def unique_images(table: pd.DataFrame) -> pd.DataFrame:
    """One row for each image; an image that is listed at two places is not used."""
    table = table[table["image"] != ""]
    moved = table.groupby("image")[["latitude", "longitude"]].nunique(dropna=False).max(axis=1) > 1
    frames = table.drop_duplicates("image").reset_index(drop=True)
    twice = frames["image"].map(moved).to_numpy(bool)
    status = np.where(twice, "listed at two places", OK)
    return frames.assign(status=merged(status, frames["status"]))


def size_status(frames: pd.DataFrame) -> NDArray[np.object_]:
    """Status of images by their size: a few of another size than their route's are not used.

    A camera is calibrated by size and route, for which a handful of images is not enough.
    """
    status = np.full(len(frames), OK, object)
    good = frames["status"] == OK
    for _, rows in frames[good].groupby("route"):
        counts = rows.value_counts(["width_px", "height_px"])
        most = counts.index[0]
        for size, count in zip(counts.index, counts, strict=True):
            if count < _RARE_SIZE and count * 5 < counts.iloc[0]:
                own = rows.index[(rows[["width_px", "height_px"]].to_numpy() == size).all(axis=1)]
                status[own] = f"{size[0]} x {size[1]} px, others of its route {most[0]} x {most[1]}"
    return status


def locate(frames: pd.DataFrame, site: Site) -> tuple[Floats, NDArray[np.object_]]:
    """Places x, y (n, 2) of frames, NaN where unknown, and status of each.

    Raises
    ------
    InputError : as `build_frames`.
    """
    latitude, longitude = (frames[c].to_numpy(float) for c in ("latitude", "longitude"))
    given = np.isfinite(latitude) & np.isfinite(longitude)
    # In degrees, 0, 0 is what a receiver without a fix writes; a local system begins there.
    if not site.is_local:
        given &= (latitude != 0) | (longitude != 0)
    xy, inside = _places(site, latitude, longitude, given)
    _, inside_swapped = _places(site, longitude, latitude, given & (not site.is_local))
    inside_swapped &= ~inside
    if given.any() and not inside.any():
        _nowhere(frames[given], site, bool(inside_swapped.mean() > 0.5 * given.mean()))
    status = np.where(inside, OK, "outside the cloud").astype(object)
    status[inside_swapped] = "latitude and longitude look swapped"
    status[~given] = "no position"
    return np.where(inside[:, None], xy, np.nan), status


def _places(site: Site, latitude: Floats, longitude: Floats, given: Bools) -> tuple[Floats, Bools]:
    """Places x, y (n, 2), NaN where the coordinates cannot be any, and which the cloud covers."""
    possible = given.copy()
    if not site.is_local:
        possible &= (np.abs(latitude) <= 90) & (np.abs(longitude) <= 360)
    xy = np.full((len(latitude), 2), np.nan)
    xy[possible] = site.to_local(latitude[possible], longitude[possible])
    covered = np.asarray(np.isfinite(xy).all(axis=1))
    xy[~covered] = np.nan
    covered[covered] = site.covers(xy[covered])
    return xy, covered


def _nowhere(frames: pd.DataFrame, site: Site, swapped: bool) -> None:
    found = (
        f"latitude {frames['latitude'].median():.5f}, longitude {frames['longitude'].median():.5f}"
    )
    if swapped:
        raise InputError(
            "latitude and longitude are swapped",
            where="videolog",
            found=found,
            allowed=site.extent or None,
            hint="exchange the names of the two columns",
        )
    system = "those of the cloud" if site.is_local else "WGS 84 degrees"
    raise InputError(
        "no image was taken near the cloud",
        where="videolog",
        found=found.replace("latitude", "y").replace("longitude", "x") if site.is_local else found,
        allowed=site.extent or None,
        hint=f"check the cloud's CRS and the coordinates, which must be {system}",
    )


def in_order(frames: pd.DataFrame) -> pd.DataFrame:
    """Frames by route and sequence, ties as they came; a frame without a number gets -1.

    Sequences that are no whole numbers (mile posts) become ranks.
    """
    frames = frames.copy()
    known = np.isfinite(frames["sequence"])
    lost = np.where(known, OK, "no sequence number")
    frames["status"] = merged(frames["status"], lost)
    again = frames[known].duplicated(["route", "sequence"]).reindex(frames.index, fill_value=False)
    frames["status"] = merged(frames["status"], np.where(again, "sequence number used before", OK))
    frames["_located"] &= (known & ~again).to_numpy()
    for _, rows in frames.groupby("route"):
        number = rows["sequence"]
        if (number.dropna() % 1 != 0).any():
            frames.loc[rows.index, "sequence"] = number.rank(method="dense") - 1
    frames["sequence"] = frames["sequence"].where(known, -1).astype(np.int64)
    return frames.sort_values(["route", "sequence"], kind="stable", ignore_index=True)


def _along(route: pd.DataFrame, settings: Videolog) -> pd.DataFrame:
    """Headings, steps and status of the frames of one route, in order."""
    route = route.copy()
    route[["heading_deg", "heading_raw_deg", "step_m"]] = np.nan
    located = np.flatnonzero(route["_located"])
    xy = route[["x", "y"]].to_numpy()
    drives, stray_m = split_drives(xy[located])
    _check_direction(xy[located], route["route"].iloc[0])
    status = np.full(len(route), OK, object)
    for row, gap_m in zip(located, stray_m, strict=True):
        if gap_m > 0:
            status[row] = f"GPS jump of {gap_m:.0f} m"
    for drive in drives:
        rows = located[drive]
        smooth, raw = headings_deg(xy[rows], settings.heading_images)
        lost = wandering(xy[rows], settings.heading_images)
        smooth, raw = np.where(lost, np.nan, smooth), np.where(lost, np.nan, raw)
        columns = ["heading_deg", "heading_raw_deg", "step_m"]
        route.loc[route.index[rows], columns] = np.column_stack([smooth, raw, steps_m(xy[rows])])
        still = np.append(False, (np.diff(xy[rows], axis=0) == 0).all(axis=1))
        status[rows[still]] = "same position as the image before"
        status[rows[lost & (status[rows] == OK)]] = "the camera stood or wandered"
        if (unknown := np.isnan(smooth) & ~lost).any():
            only = "the only image of its route" if len(rows) == 1 else "the vehicle never moved"
            status[rows[unknown]] = only
    return route.assign(status=merged(route["status"], status))


def _check_direction(xy: Floats, route: str) -> None:
    """Refuse an order in which the track turns back at most images.

    Raises
    ------
    InputError : it does.
    """
    back, count = turning_back(xy)
    if count > 1 and back > _MOST * count:
        raise InputError(
            "the track turns back at most images, so their order is not that of the drive",
            where=f"videolog, route {route}",
            found=f"{back} of {count} places",
            hint="give a column time or sequence, or images with EXIF DateTimeOriginal",
        )


def split_drives(xy_m: Floats) -> tuple[list[Ints], Floats]:
    """Runs of places of one route without jumps, and strays.

    One or two places that lie a jump away from those before and after are strays. Where the track
    goes on elsewhere after a jump, it is another drive.

    Parameters
    ----------
    xy_m : (n, 2) local metres in order.

    Returns
    -------
    drives : numbers of the places of each. stray_m : (n,) length of the jump of a stray, else 0.
    """
    stray_m = np.zeros(len(xy_m))
    if len(xy_m) == 0:
        return [], stray_m
    step = steps_m(xy_m)
    # Longest step that is no jump, by the median step between images that moved.
    moved = steps_m(xy_m[moving(xy_m)])[:-1]
    limit = max(_JUMP_FACTOR * (float(np.median(moved)) if len(moved) else 0.0), _JUMP_M)
    runs = np.split(np.arange(len(xy_m)), np.flatnonzero(step[:-1] > limit) + 1)
    if max(map(len, runs)) > _FEW:
        for run in (run for run in runs if len(run) <= _FEW):
            stray_m[run] = step[run[0] - 1] if run[0] else step[run[-1]]
    kept = np.flatnonzero(stray_m == 0)
    breaks = np.flatnonzero(steps_m(xy_m[kept])[:-1] > limit * (np.diff(kept))) + 1
    return np.split(kept, breaks), stray_m


# Order of the images of a route: time of capture, a number, a measure along the road, or rows.

# Share of steps between rows of a table in which a measure falls where the drive is against it
_CLEAR = 0.9
_EXIF_DATE = re.compile(r"(\d{4}):(\d\d):(\d\d)")


def seconds_of(texts: pd.Series) -> Floats:
    """Times (n,) of a column as numbers that order them; NaN where one cannot be read.

    Reads numbers (GPS or Unix time, any unit), ISO 8601 and what is near it, EXIF dates, and times
    of day.
    """
    plain = texts.astype(str).str.strip()
    numbers = pd.to_numeric(plain, errors="coerce")
    if numbers.notna().any():
        return numbers.to_numpy(float)
    dates = plain.str.replace(_EXIF_DATE, r"\1-\2-\3", n=1, regex=True)
    day_only = dates.str.fullmatch(r"\d{1,2}:\d\d:\d\d(\.\d+)?")
    dates = dates.where(~day_only, "1970-01-01 " + dates)
    moments = pd.to_datetime(dates, errors="coerce", utc=True, format="mixed")
    found = moments.to_numpy("datetime64[us]").astype(np.int64) / 1e6
    return np.asarray(np.where(moments.isna(), np.nan, found))


def drive_order(
    route: pd.Series, sequence: Floats, time: Floats, is_measure: bool
) -> tuple[Floats, dict[str, str]]:
    """Number (n,) by which the images of each route are ordered, and what decided it by route.

    Times decide where every image of a route has one; images of the same time keep their order by
    number, then by row. A measure along the road that falls from row to row is a drive against it.

    Parameters
    ----------
    route : name (n,). sequence : number of each image, NaN where missing. time : seconds, NaN where
        missing. is_measure : whether the number is a measure such as a mile post.
    """
    found, reasons = sequence.copy(), {}
    for name, rows in route.groupby(route).groups.items():
        own = route.index.get_indexer(rows)
        if len(own) > 1 and np.isfinite(time[own]).all() and np.ptp(time[own]) > 0:
            number = sequence[own]
            order = np.lexsort([np.arange(len(own)), number, time[own]])
            told = number[order]
            reasons[str(name)] = "time of capture"
            if not (np.isfinite(told).all() and (np.diff(told) > 0).all()):
                found[own[order]] = np.arange(len(own), dtype=float)
        elif is_measure:
            steps = np.diff(sequence[own][np.isfinite(sequence[own])])
            steps = steps[steps != 0]
            falls = len(steps) > 0 and np.mean(steps < 0) >= _CLEAR
            reasons[str(name)] = "falling measure" if falls else "rising measure"
            if falls:
                ranks = pd.Series(-sequence[own]).rank(method="dense") - 1
                found[own] = ranks.to_numpy(float)
    return found, reasons


# Headings along a videolog's track of noisy positions.

STANDING_M = 0.5  # Steps below this are standing still: their direction is noise
# Side of the square within which a standing camera's positions wander: GPS noise of 2 to 3 m
WANDERING_M = 10.0
_ROUNDS = 5  # Fits of each parabola, each with weights from the one before


def steps_m(xy_m: ArrayLike) -> Floats:
    """Distance (n,) from each place (n, 2) to the next, 0 for the last."""
    xy = np.asarray(xy_m, np.float64)
    return np.append(np.hypot(*np.diff(xy, axis=0).T), 0.0)[: len(xy)]


def moving(xy_m: ArrayLike) -> Ints:
    """Numbers of the places that are `STANDING_M` or more from the last such place."""
    xy = np.asarray(xy_m, np.float64)
    kept = [0] if len(xy) else []
    for number in range(1, len(xy)):
        if np.hypot(*(xy[number] - xy[kept[-1]])) >= STANDING_M:
            kept.append(number)
    return np.array(kept, np.int64)


def headings_deg(xy_m: ArrayLike, half_window: int = 3) -> tuple[Floats, Floats]:
    """Headings at places of one drive, clockwise from grid north.

    The raw heading is the direction to the next place (the last one takes the one before). The
    smoothed heading is the tangent of a parabola fitted to the places around: GPS noise of 1 m
    over steps of 8 m would else turn the camera by 7 degrees, and the direction to the next place
    is off by half of the bend between the two. A place where the vehicle stands takes the heading
    at which it came, or at which it left if it had not moved before.

    Parameters
    ----------
    xy_m : (n, 2) local metres in the order of travel.
    half_window : places to either side that are fitted; 0 gives the raw heading twice.

    Returns
    -------
    smoothed, raw : (n,) degrees in [0, 360), NaN throughout if the vehicle never moved.
    """
    xy = np.asarray(xy_m, np.float64).reshape(-1, 2)
    nodes = moving(xy)
    if len(nodes) < 2:
        return np.full(len(xy), np.nan), np.full(len(xy), np.nan)
    chord = azimuth_deg(xy[nodes[:-1]], xy[nodes[1:]])
    raw = np.append(chord, chord[-1])
    smooth = raw
    if half_window > 0:
        place = xy[nodes]
        station = np.append(0.0, np.cumsum(np.hypot(*np.diff(place, axis=0).T)))
        tangent = np.empty_like(place)
        for k in range(len(place)):
            part = slice(max(0, k - half_window), k + half_window + 1)
            tangent[k] = _slope(station[part] - station[k], place[part] - place[k])
        smooth = compass_deg(np.degrees(np.arctan2(tangent[:, 0], tangent[:, 1])))
    node_of = np.searchsorted(nodes, np.arange(len(xy)), side="right") - 1
    # A place of a stop that is not its first one came with the node's arrival.
    arrived = np.where(node_of > 0, node_of - (np.arange(len(xy)) != nodes[node_of]), 0)
    return smooth[node_of], raw[arrived]


def wandering(xy_m: ArrayLike, half_window: int = 3) -> Bools:
    """Places (n,) around which a camera stood or wandered, so that its track has no direction.

    Within a few metres, the way from first to last of the places around is less than half of the
    way along them: steps are the noise of positions.
    """
    xy = np.asarray(xy_m, np.float64).reshape(-1, 2)
    reach = max(half_window, 2)
    if _wanders(xy):
        return np.ones(len(xy), bool)
    parts = [xy[max(0, k - reach) : k + reach + 1] for k in range(len(xy))]
    return np.array([_wanders(part) for part in parts], bool)


def _wanders(xy: Floats) -> bool:
    """Whether places (n, 2), four or more, lie within a few metres and lead nowhere."""
    if len(xy) < 4 or np.ptp(xy, axis=0).max() >= WANDERING_M:
        return False
    way = np.hypot(*np.diff(xy, axis=0).T).sum()
    return bool(np.hypot(*(xy[-1] - xy[0])) < 0.5 * way)


def turning_back(xy_m: ArrayLike) -> tuple[int, int]:
    """How many of the places that moved turn back by more than 120 degrees, and how many there are.

    Only tracks longer than where a camera may wander are looked at.
    """
    xy = np.asarray(xy_m, np.float64).reshape(-1, 2)
    nodes = xy[moving(xy)]
    if len(nodes) < 4 or np.ptp(nodes, axis=0).max() < 2 * WANDERING_M:
        return 0, max(len(nodes) - 2, 0)
    step = np.diff(nodes, axis=0)
    step /= np.linalg.norm(step, axis=1, keepdims=True)
    back = (step[:-1] * step[1:]).sum(axis=1) < -0.5
    return int(back.sum()), len(back)


def _slope(station: Floats, xy: Floats) -> Floats:
    """Derivative (2,) at station 0 of a weighted parabola; two places give their chord."""
    scale = np.abs(station).max()
    share = station / scale
    # Somewhat wider than the places, so that the outermost still count.
    window = (1 - (np.abs(share) / 1.15) ** 3) ** 3
    terms = np.stack([np.ones_like(share), share, share**2], axis=1)
    weight = window
    # As if bends were known to be some decimetres over the window, so that an end of the route,
    # where the parabola is free, does not follow the noise.
    bend = np.diag([0.0, 0.0, 1e-2 if len(share) > 3 else 1.0])
    for _ in range(_ROUNDS):
        square = terms.T @ (weight[:, None] * terms) + bend
        fitted = np.linalg.solve(square, terms.T @ (weight[:, None] * xy))
        off = np.linalg.norm(xy - terms @ fitted, axis=1)
        # Places that fit to a few centimetres are no outliers of each other.
        reach = 3.0 * max(float(np.median(off)), 0.05)
        weight = window * np.clip(1 - (off / reach) ** 2, 1e-3, None) ** 2
    return fitted[1]
