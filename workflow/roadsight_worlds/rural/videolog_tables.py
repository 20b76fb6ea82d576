"""Tables of a generated videolog: what a user gets, and the truth for scoring."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd

from roadsight.geometry.cameras import compass_deg
from roadsight.geometry.north import SiteNorth
from roadsight_worlds.rural.rural_road import RuralSite
from roadsight_worlds.rural.videolog import Shot, attitude_of, mount_of, road_rotation

# Of the true cameras, finer than anything is estimated.
CAMERA_DECIMALS = (
    dict.fromkeys(("x_m", "y_m", "z_m", "height_above_road_m", "station_m"), 4)
    | dict.fromkeys(("easting_usft", "northing_usft", "height_usft"), 4)
    | dict.fromkeys(("heading_grid_deg", "heading_true_deg", "pitch_deg", "roll_deg"), 4)
    | dict.fromkeys(("focal_px", "cx_px", "cy_px"), 4)
    | {"latitude": 9, "longitude": 9}
    | {f"cam_from_world_r{i}{j}": 9 for i in range(3) for j in range(3)}
)
# Of the true poles.
POLE_DECIMALS = dict.fromkeys(("x_m", "y_m", "z_m", "easting_usft", "northing_usft"), 4) | {
    "height_usft": 4,
    "latitude": 9,
    "longitude": 9,
    "height_m": 3,
    "radius_m": 3,
    "station_m": 3,
    "offset_m": 3,
    "edge_distance_m": 3,
}
# Of what a user gets: 1e-7 degrees are a centimetre.
VIDEOLOG_DECIMALS = {"latitude": 7, "longitude": 7}


def videolog_table(site: RuralSite, places: Sequence[Shot]) -> pd.DataFrame:
    """What a videolog gives: images, rounded GPS degrees, route, sequence."""
    north = SiteNorth(site.frame())
    latitude, longitude = north.to_geographic(np.array([shot.gps_xy_m for shot in places]))
    return pd.DataFrame(
        {
            "image": [shot.name() for shot in places],
            **{
                f"{view}_image": [s.name(view) if view in s.cameras else "" for s in places]
                for view in ("left", "right")
            },
            "latitude": latitude,
            "longitude": longitude,
            "route": [shot.route for shot in places],
            "sequence": [shot.sequence for shot in places],
        }
    )


def registered_cameras(site: RuralSite, drives: Sequence[Sequence[Shot]]) -> dict[str, Any]:
    """Baseline of each image size, as a person would set it on one image by eye.

    No person has: it is the true camera of the image in the middle of each drive, against the
    place that GPS gave it and the road there, rounded to 0.1 m and 0.1 degrees.
    """
    found = {}
    for places in drives:
        shot = places[len(places) // 2]
        camera, lens = shot.cameras["front"], shot.cameras["front"].intrinsics
        forward = bool(places[-1].station_m > places[0].station_m)
        road = road_rotation(site, forward, shot.station_m)
        right, _, ahead = road
        way = np.array([*(camera.position_m[:2] - shot.gps_xy_m), 0.0])
        numbers = {
            "hfov_deg": lens.hfov_deg,
            "along_m": way @ ahead,
            "lateral_m": way @ right,
            "height_m": camera.position_m[2] - shot.ground_m,
        } | dict(zip(("yaw_deg", "pitch_deg", "roll_deg"), mount_of(camera, road), strict=True))
        rounded = {name: round(float(value), 1) for name, value in numbers.items()}
        found[f"{lens.width_px}x{lens.height_px}"] = rounded | {"images": 1}
    return found


def camera_table(site: RuralSite, places: Sequence[Shot]) -> pd.DataFrame:
    """True camera of every image of every view."""
    table = pd.DataFrame([_camera_row(shot, view) for shot in places for view in shot.cameras])
    frame = site.frame()
    local = table[["x_m", "y_m", "z_m"]].to_numpy()
    north = SiteNorth(frame)
    table["easting_usft"], table["northing_usft"], table["height_usft"] = frame.to_native(local).T
    table["latitude"], table["longitude"] = north.to_geographic(local[:, :2])
    true = table["heading_grid_deg"] + north.convergence_deg(local[:, :2])
    table["heading_true_deg"] = compass_deg(true.to_numpy())
    return table


def _camera_row(shot: Shot, view: str) -> dict[str, Any]:
    camera = shot.cameras[view]
    heading, pitch, roll = attitude_of(camera)
    x, y, z = camera.position_m.tolist()
    lens = camera.intrinsics
    rotation = {
        f"cam_from_world_r{i}{j}": camera.rotation[i, j] for i in range(3) for j in range(3)
    }
    return {
        "image": shot.name(view),
        "place": shot.name(),
        "view": view,
        "route": shot.route,
        "sequence": shot.sequence,
        "x_m": x,
        "y_m": y,
        "z_m": z,
        "station_m": shot.station_m,
        "height_above_road_m": z - shot.ground_m,
        "heading_grid_deg": heading,
        "pitch_deg": pitch,
        "roll_deg": roll,
        "focal_px": lens.focal_px,
        "cx_px": lens.cx_px,
        "cy_px": lens.cy_px,
        "width_px": lens.width_px,
        "height_px": lens.height_px,
        **rotation,
    }


def pole_table(site: RuralSite) -> pd.DataFrame:
    """Every post: place of its foot, kind, height, distance from the pavement's edge."""
    feet = np.array([pole.xyz_m for pole in site.poles]).reshape(-1, 3)
    native, north = site.frame().to_native(feet), SiteNorth(site.frame())
    latitude, longitude = north.to_geographic(feet[:, :2])
    offset = np.array([pole.offset_m for pole in site.poles])
    return pd.DataFrame(
        {
            "id": np.arange(1, len(feet) + 1),
            "kind": [pole.kind for pole in site.poles],
            **{name: feet[:, i] for i, name in enumerate(("x_m", "y_m", "z_m"))},
            "easting_usft": native[:, 0],
            "northing_usft": native[:, 1],
            "height_usft": native[:, 2],
            "latitude": latitude,
            "longitude": longitude,
            "height_m": [pole.height_m for pole in site.poles],
            "radius_m": [pole.radius_m for pole in site.poles],
            "station_m": [pole.station_m for pole in site.poles],
            "offset_m": offset,
            "edge_distance_m": np.abs(offset) - site.ground.section.pavement_m,
        }
    )
