"""``robust: tolerance`` through the workflow, recomputed from beams and surfels one by one."""

import json

import numpy as np
import pandas as pd

from roadsight.io.records.scene_tables import read_surfels
from roadsight.placement.sensors.sensors import load_sensors

PLAIN = "  plans: [os-32, os-64]\n"
ROBUST = """\
  plans: [os-32]
  own_plans:
    robust: {title: OS1-32 with tolerance, sensors: [OS1-32], robust: tolerance}
"""
EXACT = "settings:\n  effects: {partial_hits: skip, overhead_cover: auto}\n"
"""Whole beams, so that they can be counted."""
RADIUS_M, HEIGHT_M, MIN_BEAMS = 0.25, 0.6, 8


class Scene:
    """Surfels as rectangles, each on its plane z = a x + b y or its like."""

    def __init__(self, path) -> None:
        surfels = read_surfels(str(path))
        self.centre_m = np.asarray(surfels.centre_m, np.float64)
        self.normal = np.asarray(surfels.normal, np.float64)
        self.axis = np.abs(self.normal).argmax(axis=1)
        # Half edges along x, y, z: those of the two axes that follow the plane's own.
        self.half_m = np.zeros((len(surfels), 3))
        for step in (1, 2):
            own = np.arange(len(surfels)), (self.axis + step) % 3
            self.half_m[own] = surfels.half_m[:, step - 1]

    def between(self, start, end) -> np.ndarray:
        """Surfels near the way from a sensor to a target."""
        way = (end - start)[:2]
        length = np.hypot(*way)
        offset = self.centre_m[:, :2] - start[:2]
        along = offset @ way / length
        beside = np.abs(offset @ np.array([-way[1], way[0]])) / length
        reach = RADIUS_M + 2 * self.half_m.max(axis=1)
        return np.flatnonzero((along > -reach) & (along < length + 1.0) & (beside < reach))

    def first_m(self, origin, ways, rows) -> np.ndarray:
        """Ranges (n,) at which rays from one origin meet the first of some surfels."""
        normal, axis = self.normal[rows], self.axis[rows]
        facing = ways @ normal.T
        offset = self.centre_m[rows] - origin
        with np.errstate(divide="ignore", invalid="ignore"):
            at_m = (offset * normal).sum(axis=1) / facing
        hit = at_m[..., None] * ways[:, None, :] - offset
        inside = np.ones(at_m.shape, bool)
        for k in range(3):
            inside &= (np.abs(hit[..., k]) <= self.half_m[rows, k]) | (axis == k)
        return np.where(inside & (at_m > 0), at_m, np.inf).min(axis=1, initial=np.inf)


def rotation(yaw, pitch, roll) -> np.ndarray:
    """Columns are the axes of a sensor that is turned by yaw, then pitch, then roll, degrees."""
    (cy, cp, cr), (sy, sp, sr) = (f(np.radians([yaw, pitch, roll])) for f in (np.cos, np.sin))
    about_z = np.array([[cy, -sy, 0], [sy, cy, 0], [0, 0, 1]])
    about_y = np.array([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]])
    return about_z @ about_y @ np.array([[1, 0, 0], [0, cr, -sr], [0, sr, cr]])


def beams_of(sensor, axes) -> np.ndarray:
    azimuth, elevation = np.meshgrid(
        np.radians(sensor.azimuth_deg), np.radians(sensor.elevation_deg)
    )
    flat = np.cos(elevation)
    ways = np.stack([flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation)], axis=-1)
    return ways.reshape(-1, 3) @ axes.T


def on_cylinder_m(origin, ways, foot) -> np.ndarray:
    """Ranges (n,) at which rays meet the side or the top of an upright cylinder."""
    x, y = (origin - foot)[:2]
    a = (ways[:, :2] ** 2).sum(axis=1)
    b = ways[:, :2] @ np.array([x, y])
    root = b * b - a * (x * x + y * y - RADIUS_M**2)
    side = (-b - np.sqrt(np.where(root > 0, root, np.nan))) / a
    z = origin[2] + side * ways[:, 2] - foot[2]
    side = np.where((z >= 0) & (z <= HEIGHT_M), side, np.inf)
    with np.errstate(divide="ignore"):
        top = (foot[2] + HEIGHT_M - origin[2]) / ways[:, 2]
    over = np.hypot(*(np.array([x, y])[:, None] + top * ways[:, :2].T)) <= RADIUS_M
    return np.minimum(side, np.where(over & (top > 0), top, np.inf))


def counted(scene, sensor, origin, axes, feet) -> np.ndarray:
    """Beams (n,) that return from each target."""
    ways, found = beams_of(sensor, axes), []
    for foot in feet:
        middle = foot + np.array([0, 0, HEIGHT_M / 2]) - origin
        away_m = np.linalg.norm(middle)
        aimed = ways @ (middle / away_m) > np.cos(min(HEIGHT_M / away_m, 1.5))
        target_m = on_cylinder_m(origin, ways[aimed], foot)
        rays = ways[aimed][np.isfinite(target_m)]
        first_m = scene.first_m(origin, rays, scene.between(origin, foot))
        target_m = target_m[np.isfinite(target_m)]
        found.append(((target_m < first_m) & (target_m <= sensor.range_m)).sum())
    return np.array(found)


def changed_poses(entry):
    """The sensor as planned, and moved and turned by what a crew may be off."""
    origin = np.array([entry[axis] for axis in "xyz"])
    yaw = entry["yaw_deg"]
    level = rotation(yaw, 0, 0)
    yield origin, level
    for k in range(3):
        for sign in (-1, 1):
            yield origin + sign * 0.2 * level[:, k], level
            turn = np.zeros(3)
            turn[k] = sign
            yield origin, rotation(yaw + turn[0], *turn[1:])


def lost_when_off(scene, sensor, plan, feet) -> int:
    """Targets that a move or a turn of one sensor loses, over all of these.

    Of the targets that one sensor alone sees, the 25 with the fewest beams are counted.
    """
    planned = [
        counted(scene, sensor, *next(changed_poses(entry)), feet) for entry in plan["sensors"]
    ]
    seen = np.array(planned) > MIN_BEAMS
    assert seen.any(axis=0).all()
    lost = 0
    for number, entry in enumerate(plan["sensors"]):
        alone = np.flatnonzero(seen[number] & (seen.sum(axis=0) == 1))
        weakest = alone[np.argsort(planned[number][alone], kind="stable")][:25]
        for origin, axes in changed_poses(entry):
            beams = counted(scene, sensor, origin, axes, feet[weakest])
            lost += int((beams <= MIN_BEAMS).sum())
    return lost


def test_a_robust_plan_loses_nothing_by_another_count(copy_of_finished):
    checkout = copy_of_finished
    checkout.edit("config/sites/tiny.yaml", PLAIN, ROBUST)
    checkout.edit("config/sites/tiny.yaml", "settings:\n", EXACT)
    folder = checkout.folder / "results/tiny/placement"
    files = [f"results/tiny/placement/{plan}/tolerance.json" for plan in ("robust", "os-32")]
    result = checkout.snakemake(*files, "--cores", "1")
    assert result.returncode == 0, result.stdout[-3000:] + result.stderr[-5000:]
    told = json.loads((folder / "robust/tolerance.json").read_text())
    assert all(row["lost"] == 0 for row in told["rows"] if row["kind"] != "one sensor out")
    scene = Scene(checkout.folder / "results/tiny/scene/surfels.parquet")
    sensor = load_sensors(checkout.folder / "config/sensors.yaml")["OS1-32"]
    targets, lost = pd.read_parquet(folder / "targets.parquet"), {}
    for name in ("robust", "os-32"):
        plan = json.loads((folder / name / "solution.json").read_text())
        assert plan["status"] == "optimal"
        wanted = targets[~targets["target"].isin(plan["excluded"])]
        feet = wanted[["x", "y", "z"]].to_numpy(np.float64)
        lost[name] = lost_when_off(scene, sensor, plan, feet)
    assert lost["robust"] == 0 < lost["os-32"]
