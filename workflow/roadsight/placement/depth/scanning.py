"""What a sensor in a pose would record of the scene: the scan of each kind.

A solid-state LiDAR records one frame from phase zero. A camera records no ranges: its scan is the
surface that its pixels show, thinned to what a report can draw. A radar's is what each cell of its
angular resolution meets first.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from roadsight.base.arrays import Floats
from roadsight.placement.sensors.sensors import AimedSensor, Camera, Radar, Rosette

_MOST_PIXELS = 200_000
"""Pixels of a camera's scan: what a report can draw."""


def scan_directions(sensor: AimedSensor) -> Floats:
    """Unit vectors (n, 3) in the sensor frame along which a scan looks."""
    if isinstance(sensor, Rosette):
        return rosette_directions(sensor)
    if isinstance(sensor, Camera):
        return _pixel_directions(sensor)
    if isinstance(sensor, Radar):
        return _cell_directions(sensor)
    raise TypeError(f"no scan of {type(sensor).__name__}")


def rosette_directions(
    sensor: Rosette, phases_rad: tuple[float, float] | NDArray = (0.0, 0.0)
) -> Floats:
    """The points of one frame in their order, lasers in turn.

    Parameters
    ----------
    phases_rad : angles of both prisms as the frame begins.
    """
    number = np.arange(int(sensor.points))
    time_s = number / sensor.points_per_s
    one, two = (
        2 * np.pi * hertz * time_s + phase
        for hertz, phase in zip(sensor.rotors_hz, phases_rad, strict=True)
    )
    arrow = sensor.field_deg / 4
    u = arrow * (np.cos(one) + np.cos(two))
    v = arrow * (np.sin(one) + np.sin(two)) + sensor.laser_offsets_deg[number % sensor.lasers]
    angle = np.radians(np.hypot(u, v))
    share = np.radians(np.sinc(angle / np.pi))  # sine over angle, of degrees
    return np.column_stack([np.cos(angle), share * u, share * v])


def _pixel_directions(camera: Camera) -> Floats:
    """Pixels, every n-th in both directions."""
    pixels = camera.columns_px * camera.rows_px
    step = max(int(np.ceil(np.sqrt(pixels / _MOST_PIXELS))), 1)
    u, v = (
        (np.arange(step // 2, count, step) + 0.5 - count / 2) / camera.focal_px
        for count in (camera.columns_px, camera.rows_px)
    )
    left, up = (part.ravel() for part in np.meshgrid(u, v))
    rays = np.column_stack([np.ones(len(left)), left, up])
    return np.asarray(rays / np.linalg.norm(rays, axis=1, keepdims=True))


def _cell_directions(radar: Radar) -> Floats:
    """Middles of cells: the resolution of the zone that each azimuth lies in, both ways."""
    parts, inner = [], 0.0
    low, high = radar.elevation_min_deg, radar.elevation_max_deg
    for zone in radar.zones:
        count = max(round((zone.half_angle_deg - inner) / zone.resolution_deg), 1)
        side = inner + (np.arange(count) + 0.5) * (zone.half_angle_deg - inner) / count
        rows = max(round((high - low) / zone.resolution_deg), 1)
        up = low + (np.arange(rows) + 0.5) * (high - low) / rows
        parts.append(np.stack(np.meshgrid(np.concatenate([-side[::-1], side]), up), -1))
        inner = zone.half_angle_deg
    azimuth, elevation = np.radians(np.concatenate([part.reshape(-1, 2) for part in parts])).T
    flat = np.cos(elevation)
    return np.column_stack([flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation)])
