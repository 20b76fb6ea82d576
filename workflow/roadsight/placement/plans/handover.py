"""What a plan's sensors share, and how much data they make."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import numpy as np
from shapely import LineString, get_coordinates, line_interpolate_point, line_locate_point
from shapely import points as shapely_points

from roadsight.base.arrays import Bools, Floats, Ints
from roadsight.placement.sensors.light import reflectivity_range_m
from roadsight.placement.sensors.sensors import AnySensor, Camera, Rosette, Sensor

# The road goes on before and beyond its longest edge as the edge does over this length: longer than
# the rounding of a corner, at which automatic edges end.
_END_M = 20.0
_TANGENT_M = 1.0  # the direction of a line at a place is taken over so much before and after it


def stations_m(edges: Sequence[LineString], xy_m: Floats) -> Floats:
    """Place (n,) of each point along the road: its longest edge, gone on straight at both ends.

    0 is where that edge begins, so that what lies before it is negative. A ring has no ends.
    """
    longest = max(edges, key=lambda edge: edge.length)
    if longest.is_ring:
        return np.asarray(line_locate_point(longest, shapely_points(xy_m)))
    length_m, inner_m = longest.length, min(_END_M, longest.length)
    station_m = np.array(line_locate_point(longest, shapely_points(xy_m)), np.float64)
    for end_m, sign in ((0.0, -1.0), (length_m, 1.0)):
        end, inside = (
            np.asarray(line_interpolate_point(longest, at_m).coords[0][:2])
            for at_m in (end_m, end_m - sign * inner_m)
        )
        onwards = (end - inside) / max(float(np.hypot(*(end - inside))), 1e-9)
        here = station_m == end_m
        beyond_m = (np.asarray(xy_m, np.float64)[here] - end) @ onwards
        station_m[here] += sign * np.maximum(beyond_m, 0.0)
    return station_m


def offsets_m(line: LineString, station_m: Floats, xy_m: Floats) -> Floats:
    """Offset (n,) to the right of a line of points, in the line's direction.

    Parameters
    ----------
    station_m : places along the line, (n,); before its start and beyond its end it goes on
        straight, as in `stations_m`. xy_m : (n, 2).
    """
    inside_m = np.clip(station_m, 0.0, line.length)
    reach_m = np.where(inside_m == station_m, _TANGENT_M, _END_M)
    foot, start, end = (
        get_coordinates(line_interpolate_point(line, np.clip(inside_m + step, 0.0, line.length)))
        for step in (0.0, -reach_m, reach_m)
    )
    way = (end - start) / np.maximum(np.hypot(*(end - start).T), 1e-9)[:, None]
    away = np.asarray(xy_m, np.float64) - foot - way * (station_m - inside_m)[:, None]
    side = np.sign(away[:, 0] * way[:, 1] - away[:, 1] * way[:, 0])
    return np.asarray(side * np.hypot(*away.T), np.float64)


def handover(times_seen: Ints) -> dict[str, Any]:
    """How many sensors see each target (n,): share of two and more, mean, and targets by number."""
    count = max(len(times_seen), 1)
    return {
        "share_seen_by_two": float((times_seen >= 2).sum() / count),
        "mean_sensors": float(times_seen.sum() / count),
        "targets_by_sensors": np.bincount(times_seen, minlength=2).tolist(),
    }


def overlaps(
    seen: Bools, target_station_m: Floats, sensor_station_m: Floats, cell_m: float
) -> list[dict[str, Any]]:
    """Length of road on which each sensor and the next one along it see the same targets.

    Parameters
    ----------
    seen : (sensors, targets). target_station_m, sensor_station_m : places along the road.
    cell_m : the road is counted in stretches of so much.

    Returns
    -------
    sensor and next (numbers from 0), targets (that both see) and length_m, along the road
    """
    order = np.argsort(sensor_station_m, kind="stable")
    stretch = np.floor(target_station_m / cell_m).astype(np.int64)
    found = []
    for one, two in pairwise(order):
        both = seen[one] & seen[two]
        length = float(len(np.unique(stretch[both])) * cell_m)
        found.append(
            {"sensor": int(one), "next": int(two), "targets": int(both.sum()), "length_m": length}
        )
    return found


def data_rates(sensor: AnySensor, frames_hz: float) -> dict[str, float]:
    """Points (LiDAR) or pixels (camera) that a sensor measures in a second; nothing for radars.

    Parameters
    ----------
    frames_hz : turns of spinning LiDARs that state none, and frames of cameras, in a second.
    """
    if isinstance(sensor, Sensor):
        turns_hz = frames_per_s(sensor, frames_hz)
        return {"points_per_s": sensor.rows * sensor.columns * turns_hz}
    if isinstance(sensor, Rosette):
        return {"points_per_s": sensor.points_per_s}
    if isinstance(sensor, Camera):
        return {"pixels_per_s": sensor.columns_px * sensor.rows_px * frames_hz}
    return {}


def frames_per_s(sensor: AnySensor, frames_hz: float) -> float:
    """How many simulated scans a sensor makes in a second; 0 where they are no points."""
    if isinstance(sensor, Rosette):
        return 1 / sensor.frame_s
    if isinstance(sensor, Sensor):
        return frames_hz if sensor.rotation_hz is None else sensor.rotation_hz
    return 0.0


DARK = 0.1  # reflectivity of dark targets: the second one at which data sheets state a range
# Of the range, what is left of it: ranges on data sheets hold for half of the pulses or more, in
# good air, of a new sensor behind a clean window.
SHORTER = 2 / 3


def dark_range_m(sensor: AnySensor, range_m: float) -> float:
    """Range to dark targets; radars and cameras, which no reflectivity limits, keep theirs.

    Parameters
    ----------
    range_m : to the targets of the plan.
    """
    if not isinstance(sensor, Sensor | Rosette):
        return range_m
    return min(range_m, float(reflectivity_range_m(sensor, DARK)))


def distances_m(sensors_xyz_m: Floats, feet_m: Floats, height_m: float) -> Floats:
    """Distance of each sensor (s, 3) from the middle of each target (t, 3 or 4), (s, t)."""
    middle = feet_m[:, :3] + np.array([0.0, 0.0, height_m / 2])
    return np.asarray(np.linalg.norm(sensors_xyz_m[:, None] - middle[None], axis=2))


def margins(
    seen: Bools, distance_m: Floats, range_m: Floats, dark_m: Floats
) -> tuple[dict[str, Any], Bools, Bools]:
    """Targets that a plan sees and would not: if they were dark, or with a third less range.

    A sensor keeps the targets that it sees within the shorter range: beams beyond it are lost and
    no others. One at the very limit may lose some of its beams first; that is not looked at.

    Parameters
    ----------
    seen : (sensors, targets). distance_m : the same shape. range_m, dark_m : (sensors,).

    Returns
    -------
    ``dark`` and ``shorter``, each with the number and share of the seen targets that are lost; and
    (targets,) whether each is still seen then.
    """
    before = seen.any(axis=0)
    kept = [
        np.asarray((seen & (distance_m <= reach[:, None])).any(axis=0))
        for reach in (dark_m, SHORTER * range_m)
    ]
    count = max(int(before.sum()), 1)
    lost = [int((before & ~after).sum()) for after in kept]
    return (
        {
            "dark": {"reflectivity": DARK, "lost": lost[0], "share": lost[0] / count},
            "shorter": {"range_share": SHORTER, "lost": lost[1], "share": lost[1] / count},
        },
        kept[0],
        kept[1],
    )


def ranges_m(sensors: Sequence[AnySensor], reach_m: Sequence[float]) -> tuple[Floats, Floats]:
    """Ranges to the targets of the plan and to dark ones, (sensors,) each."""
    pairs = zip(sensors, reach_m, strict=True)
    dark = [dark_range_m(sensor, reach) for sensor, reach in pairs]
    return np.array(reach_m, np.float64), np.array(dark, np.float64)
