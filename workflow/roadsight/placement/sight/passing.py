"""Passing vehicles, as boxes that stand on the pavement and a Poisson process."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from roadsight.placement.sight.kinds import KINDS, Box

CAR = KINDS["car"]
# AASHTO Green Book (2018): design vehicle WB-67, 73.5 ft long, 13.5 ft high.
TRUCK = Box(22.40, 2.59, 4.11)


def vehicles_per_m(
    aadt: float, truck_share: float, speed_kmh: float, peak_share: float, lanes: float
) -> tuple[float, float]:
    """Cars and trucks on a metre of one lane at a moment of the peak hour.

    Flow over speed. The peak hour carries ``peak_share`` of the day's vehicles (the K factor of the
    Highway Capacity Manual), spread evenly over the lanes.
    """
    flow_per_h = aadt * peak_share / lanes
    density = flow_per_h / (speed_kmh * 1000)
    return density * (1 - truck_share), density * truck_share


def expected_in_the_way(
    sensor_m: ArrayLike, target_m: ArrayLike, lane_y_m: float, per_m: float, vehicle: Box
) -> float:
    """Mean number of vehicles of one lane that a line of sight meets.

    The lane runs straight along x, the pavement is level at z = 0. Within the lane's vehicles'
    width, y to y + dy, the line lies below their height over a length s along the lane; a vehicle
    of length L meets it when its middle lies within s + L, so per_m (s + L) of them do.

    Parameters
    ----------
    sensor_m, target_m : x, y, z of the line's ends, at different y. lane_y_m : lane's middle.
    per_m : vehicles per metre of lane.
    """
    start, end = np.asarray(sensor_m, np.float64), np.asarray(target_m, np.float64)
    half = vehicle.width_m / 2
    across = end[1] - start[1]
    crossing = np.sort((np.array([lane_y_m - half, lane_y_m + half]) - start[1]) / across)
    low, high = np.clip(crossing, 0.0, 1.0)
    # Of the line within the lane, what lies below the vehicles' height counts.
    fall = end[2] - start[2]
    if fall != 0:
        level = (vehicle.height_m - start[2]) / fall
        low, high = (max(low, level), high) if fall < 0 else (low, min(high, level))
    elif start[2] > vehicle.height_m:
        return 0.0
    if low >= high:
        return 0.0
    return float(per_m * (abs((high - low) * (end[0] - start[0])) + vehicle.length_m))
