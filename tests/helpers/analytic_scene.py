"""A level plane with boxes on it, and targets that are traced one ray at a time."""

import numpy as np

from roadsight.placement.sensors.rays import beam_directions
from roadsight.placement.sensors.sensors import load_sensor
from roadsight.placement.sight.posed import Panorama

RADIUS_M, HEIGHT_M = 0.25, 0.6


def scene_ranges(origin, directions, boxes):
    """Ranges (n,) along unit directions (n, 3) to the plane z = 0 or a box; else infinite."""
    with np.errstate(divide="ignore", invalid="ignore"):
        nearest = np.where(directions[:, 2] < 0, -origin[2] / directions[:, 2], np.inf)
        for low, high in boxes:
            one, two = (low - origin) / directions, (high - origin) / directions
            enter = np.nanmax(np.minimum(one, two), axis=1)
            leave = np.nanmin(np.maximum(one, two), axis=1)
            hit = (enter < leave) & (enter > 0)
            nearest = np.where(hit & (enter < nearest), enter, nearest)
    return nearest


def target_ranges(origin, directions, foot):
    """Ranges (n,) at which rays enter an upright cylinder of the default size; else infinite."""
    foot = np.asarray(foot, float) - origin
    a = (directions[:, :2] ** 2).sum(axis=1)
    b = directions[:, :2] @ foot[:2]
    root_of = b**2 - a * (foot[:2] @ foot[:2] - RADIUS_M**2)
    with np.errstate(divide="ignore", invalid="ignore"):
        root = np.sqrt(np.maximum(root_of, 0))
        caps = np.sort(
            [foot[2] / directions[:, 2], (foot[2] + HEIGHT_M) / directions[:, 2]], axis=0
        )
        enter = np.maximum(np.maximum((b - root) / a, caps[0]), 0)
        leave = np.minimum((b + root) / a, caps[1])
    return np.where((root_of >= 0) & (enter < leave) & (enter > 0), enter, np.inf)


class Trace:
    """Every ray (n, 3) from one place through the scene, one by one."""

    def __init__(self, origin, directions, boxes, max_range_m):
        self.origin, self.directions, self.max_range_m = origin, directions, max_range_m
        self.scene = scene_ranges(origin, directions, boxes)

    def meets(self, foot):
        """Rays that meet the target in range, whatever stands before it."""
        self.target = target_ranges(self.origin, self.directions, foot)
        return self.target < self.max_range_m

    def sees(self, foot):
        """Rays that return from the target."""
        return self.meets(foot) & (self.target < self.scene)


def panorama_of(origin, boxes=(), step_deg=0.2, range_m=200.0, yaw_deg=0.0):
    """The analytic scene as the program sees it."""
    sensor = load_sensor("", f"panorama-{step_deg:g}deg-{range_m:.0f}m")
    directions = beam_directions(sensor, yaw_deg).reshape(-1, 3).astype(np.float64)
    found = scene_ranges(np.asarray(origin, float), directions, boxes)
    found[found >= range_m] = 0.0
    depth = found.astype(np.float32).reshape(sensor.shape)
    return Panorama(depth, sensor, np.asarray(origin, float), yaw_deg)
