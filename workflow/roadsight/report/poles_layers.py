"""What the map of the poles job draws, packed for the page; all in local metres."""

from __future__ import annotations

import base64
import json
import re
from typing import Any

import cv2
import numpy as np
import pandas as pd
from numpy.typing import ArrayLike, NDArray

from roadsight.base.arrays import Floats, Ints
from roadsight.geometry.cameras import azimuth_deg, wrap_deg
from roadsight.geometry.frames import Frame
from roadsight.geometry.north import longitudes_latitudes
from roadsight.io.raster.top_rasters import TopRaster
from roadsight.report.packing import pack, pack_points, thin

ACCEPTED, REJECTED, UNUSED = 0, 1, 2
_MOST_EDGE_POINTS = 60_000  # Points of road edges on the map, packed into the page
_OPEN_RAY_M = 30.0  # Length of the drawn ray of a sighting without a depth
_MOST_APART_DEG = 10.0  # A ray and a pole further apart in direction do not belong together


def cameras_of(frames: pd.DataFrame, cameras: pd.DataFrame) -> pd.DataFrame:
    """One row an image of the route: its pose, or its place where it has none.

    Returns
    -------
    image, route, sequence, x, y, heading_deg, state (0 accepted, 1 rejected, 2 not used), reason,
    residual_px, yaw_deg and lateral_m (correction against the track, right is positive) with
    sigma_yaw_deg and sigma_lateral_m, station_m along its route; NaN where unknown
    """
    own = cameras.drop_duplicates("image").set_index("image")
    pose = own.reindex(frames["image"])
    aligned = frames["image"].isin(own.index).to_numpy()
    accepted = aligned & (pose["accepted"].astype(object) == True).to_numpy()  # noqa: E712
    state = np.where(accepted, ACCEPTED, np.where(aligned, REJECTED, UNUSED))
    reason = np.where(aligned, pose["reason"].fillna("").to_numpy(), frames["status"].to_numpy())
    reason = np.where((state == UNUSED) & (reason == "ok"), "not aligned", reason)
    track = {name: frames[name].to_numpy(np.float64) for name in ("x", "y", "heading_deg")}
    found = {name: pose[name].to_numpy(np.float64) for name in track}
    best = {name: np.where(np.isfinite(found[name]), found[name], track[name]) for name in track}
    right = np.radians(track["heading_deg"])
    shift_x, shift_y = found["x"] - track["x"], found["y"] - track["y"]
    steps = frames["step_m"].fillna(0.0)
    return pd.DataFrame(
        {
            "image": frames["image"].astype(str).to_numpy(),
            "route": frames["route"].astype(str).to_numpy(),
            "sequence": frames["sequence"].to_numpy(),
            **best,
            "state": state,
            "reason": np.where(accepted, "", reason),
            "residual_px": pose["residual_px"].to_numpy(np.float64),
            "yaw_deg": wrap_deg(found["heading_deg"] - track["heading_deg"]),
            "sigma_yaw_deg": pose["sigma_heading_deg"].to_numpy(np.float64),
            "lateral_m": shift_x * np.cos(right) - shift_y * np.sin(right),
            "sigma_lateral_m": pose["sigma_lateral_m"].to_numpy(np.float64),
            "station_m": (steps.groupby(frames["route"]).cumsum() - steps).to_numpy(np.float64),
        }
    )


def camera_layer(cameras: pd.DataFrame, shown: list[str]) -> dict[str, Any]:
    """Cameras of the map.

    Parameters
    ----------
    cameras : of `cameras_of`. shown : images that the page embeds, in its order.
    """
    reasons = sorted(set(cameras["reason"]))
    return {
        "images": cameras["image"].tolist(),
        "xy": pack(cameras[["x", "y"]].to_numpy(), "f4"),
        "heading_deg": pack(cameras["heading_deg"].fillna(0.0).to_numpy(), "f4"),
        "state": pack(cameras["state"].to_numpy(), "u1"),
        "residual_px": pack(cameras["residual_px"].fillna(-1.0).to_numpy(), "f4"),
        "reasons": reasons,
        "reason": pack([reasons.index(reason) for reason in cameras["reason"]], "u2"),
        "shown": [shown.index(name) if name in shown else -1 for name in cameras["image"]],
    }


def edge_points(edges_xyz_m: NDArray) -> dict[str, Any]:
    """LiDAR road edge as points, thinned evenly where there are very many."""
    return pack_points(edges_xyz_m[thin(edges_xyz_m, _MOST_EDGE_POINTS)])


def names_in(value: Any) -> list[str]:
    """Names in a cell that holds a list, JSON, or text parted by semicolons or bars."""
    if value is None or (isinstance(value, float) and np.isnan(value)):
        return []
    if not isinstance(value, str):
        return [str(name) for name in value]
    if value.startswith("["):
        return [str(name) for name in json.loads(value)]
    return [name.strip() for name in re.split(r"[;|]", value) if name.strip()]


def match_sightings(sightings: pd.DataFrame, poles: pd.DataFrame) -> Ints:
    """Row of the pole that each sighting (n,) belongs to, -1 if none.

    A pole names the images that support it. In each of them it owns at most one kept sighting of
    its kind, and a sighting has one owner; those that point at a pole best, and by no more than
    10 degrees past it, are given first.
    """
    owner = np.full(len(sightings), -1)
    images = sightings["image"].to_numpy()
    served: set[tuple[int, str]] = set()
    for _, number, row in sorted(_pointings(sightings, poles)):
        if owner[row] < 0 and (number, images[row]) not in served:
            owner[row] = number
            served.add((number, images[row]))
    return owner


def _pointings(sightings: pd.DataFrame, poles: pd.DataFrame) -> list[tuple[float, int, int]]:
    """Angle between sighting and pole, row of the pole and row of the sighting."""
    kept, kinds = sightings["kept"].to_numpy(bool), sightings["kind"].to_numpy()
    groups = sightings.groupby("image", sort=False).indices
    place, bearing = sightings[["x", "y"]].to_numpy(float), sightings["bearing_grid_deg"].to_numpy()
    columns = zip(poles[["x", "y"]].to_numpy(float), poles["kind"], poles["images"], strict=True)
    found = []
    for number, (xy, kind, images) in enumerate(columns):
        for image in names_in(images):
            rows = groups.get(image, np.empty(0, np.int64))
            rows = rows[kept[rows] & (kinds[rows] == kind)]
            apart = np.abs(wrap_deg(azimuth_deg(place[rows], xy) - bearing[rows]))
            near = apart <= _MOST_APART_DEG
            pairs = zip(apart[near].tolist(), rows[near].tolist(), strict=True)
            found += [(angle, number, row) for angle, row in pairs]
    return found


def sighting_layer(sightings: pd.DataFrame, owner: Ints, images: list[str]) -> dict[str, Any]:
    """Rays from cameras to what they saw; 30 m long where the distance is not known.

    Parameters
    ----------
    owner : (n,) of `match_sightings`. images : names of all cameras of the map.
    """
    numbers = {name: number for number, name in enumerate(images)}
    place, bearing = sightings[["x", "y"]].to_numpy(float), sightings["bearing_grid_deg"].to_numpy()
    drawn = np.isfinite(place).all(axis=1) & np.isfinite(bearing)
    drawn &= sightings["image"].isin(images).to_numpy()
    depth = sightings["depth_m"].to_numpy(float)
    depth = np.where(np.isfinite(depth), depth, _OPEN_RAY_M)
    angle = np.radians(bearing)
    ends = place + np.column_stack([np.sin(angle), np.cos(angle)]) * depth[:, None]
    chosen = sightings[drawn]
    return {
        "rays": pack(np.column_stack([place, ends])[drawn], "f4"),
        "camera": pack([numbers[name] for name in chosen["image"]], "u4"),
        "pole": pack(owner[drawn] + 1, "u4"),
        "kept": pack(chosen["kept"].to_numpy(bool), "u1"),
    }


def pole_records(poles: pd.DataFrame, images: list[str], frame: Frame) -> list[dict[str, Any]]:
    """Poles with everything that map and tables say of them."""
    numbers = {name: number for number, name in enumerate(images)}
    xy = poles[["x", "y"]].to_numpy(np.float64)
    native = frame.to_native(xy)
    degrees = longitudes_latitudes(frame, xy)
    kept = ("x", "y", "z", "score", "sigma_major_m", "sigma_minor_m", "sigma_azimuth_deg")
    return [
        {
            "id": str(row["id"]),
            "kind": str(row["kind"]),
            **{key: finite(row[key]) for key in kept},
            "native": native[number].tolist(),
            "lon_lat_deg": None if degrees is None else degrees[number].tolist(),
            "cameras": [numbers[name] for name in names_in(row["images"]) if name in numbers],
            "images": len(names_in(row["images"])),
            "decided": row.get("decided", ""),
            "probability": finite(row.get("probability")),
            "height_m": finite(row.get("height_m")),
            "cloud_shows": row.get("cloud_shows", ""),
        }
        for number, row in enumerate(poles.to_dict("records"))
    ]


def finite(value: Any) -> Any:
    """Plain number, text or flag; None where there is none or where it is not finite."""
    plain = value.item() if isinstance(value, np.generic) else value
    if plain is None or plain is pd.NA:
        return None
    if isinstance(plain, float) and not np.isfinite(plain):
        return None
    return plain


# The LiDAR's classes seen from above, as a small picture for the map.

LEVELS = 40  # Grey levels between two kinds, so that no rounding in a browser mixes them up
# Kinds by class of LAS: 2 ground, 3 vegetation of any height, 4 building, 5 road, 6 bridge; further
# 0 nothing and 1 other. Of several in one pixel of the picture the last one wins.
_KIND_OF_CLASS = {2: 2, 3: 3, 4: 3, 5: 3, 6: 4, 11: 5, 17: 6}
# Cells along the longer side of the picture; cells are merged until it is no larger
_MOST_CELLS = 2200
# The picture ends so far from the route: what is further off tells nothing of its poles
_REACH_M = 80.0


def class_layer(top: TopRaster, cameras_xy_m: ArrayLike) -> dict[str, Any] | None:
    """Kinds near the cameras as PNG of grey levels (kind times `LEVELS`), in base64.

    Parameters
    ----------
    top : overhead view of the cloud.
    cameras_xy_m : (n, 2) local metres; cells further than 80 m from all of them are left out.

    Returns
    -------
    place and size of the picture and its PNG; None if nothing of it lies near a camera
    """
    xy = np.asarray(cameras_xy_m, np.float64).reshape(-1, 2)
    xy = xy[np.isfinite(xy).all(axis=1)]
    window = _window(top, xy)
    if window is None:
        return None
    low_row, high_row, low_column, high_column = window
    kind_of_class = np.ones(256, np.uint8)
    kind_of_class[[0, *_KIND_OF_CLASS]] = [0, *_KIND_OF_CLASS.values()]
    kinds = kind_of_class[top.cls[low_row:high_row, low_column:high_column]]
    factor = max(1, -(-max(kinds.shape) // _MOST_CELLS))
    rows, columns = kinds.shape
    padded = np.pad(kinds, ((0, -rows % factor), (0, -columns % factor)))
    blocks = padded.reshape(padded.shape[0] // factor, factor, -1, factor)
    coarse = np.ascontiguousarray(blocks.max(axis=(1, 3)))
    cell_m = top.cell_size_m * factor
    west_m = top.west_m + low_column * top.cell_size_m
    north_m = top.north_m - low_row * top.cell_size_m
    column = np.floor((xy[:, 0] - west_m) / cell_m).astype(np.int64)
    row = np.floor((north_m - xy[:, 1]) / cell_m).astype(np.int64)
    # Cells far from every camera are left out; cameras beyond the rim count as on it.
    reach = _REACH_M / cell_m
    rim_row, rim_column = row.clip(0, coarse.shape[0] - 1), column.clip(0, coarse.shape[1] - 1)
    near = np.hypot(row - rim_row, column - rim_column) <= reach
    free = np.ones(coarse.shape, np.uint8)
    free[rim_row[near], rim_column[near]] = 0
    coarse[cv2.distanceTransform(free, cv2.DIST_L2, 5) > reach] = 0
    _, png = cv2.imencode(".png", coarse * LEVELS, [cv2.IMWRITE_PNG_COMPRESSION, 9])
    return {
        "west_m": west_m,
        "north_m": north_m,
        "cell_size_m": cell_m,
        "rows": coarse.shape[0],
        "columns": coarse.shape[1],
        "png": base64.b64encode(png.tobytes()).decode("ascii"),
    }


def _window(top: TopRaster, xy_m: Floats) -> tuple[int, int, int, int] | None:
    """Rows and columns of the raster within reach of the cameras' box."""
    if not len(xy_m):
        return None
    rows, columns = top.cls.shape
    (west, south), (east, north) = xy_m.min(axis=0) - _REACH_M, xy_m.max(axis=0) + _REACH_M
    cell = top.cell_size_m
    low_column = int(np.clip(np.floor((west - top.west_m) / cell), 0, columns))
    high_column = int(np.clip(np.ceil((east - top.west_m) / cell), 0, columns))
    low_row = int(np.clip(np.floor((top.north_m - north) / cell), 0, rows))
    high_row = int(np.clip(np.ceil((top.north_m - south) / cell), 0, rows))
    if low_row >= high_row or low_column >= high_column:
        return None
    return low_row, high_row, low_column, high_column
