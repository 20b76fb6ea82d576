"""Whether an installed sensor stands and sees as planned: its scan against the planned one.

The pose is found by point-to-plane registration (Chen and Medioni 1992) of the measured scan to the
planned one, from the planned pose, or from headings all around it where that is nearer. Planes come
from neighbouring beams, not from neighbouring points: rings on the ground are far apart.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from roadsight.base.arrays import Bools, Floats

_BEAMS = 25  # neighbouring beams of a plane: a window of 5 by 5
_THICK_M = 0.05  # thickness of a plane, at most: the noise of cloud and LiDAR, and grass
_FLAT = 0.2  # the same by its width: what is thicker is a crown, an edge or a rod
_POINTS = 6_000  # points that are registered, evenly drawn: more move the pose by less than 1 mm
_HEADINGS = 36  # headings that are tried first, all around
_KEPT_HEADINGS = 3  # so many of them, those that agree best, are registered
# How near a plane a point must lie to count, from coarse to fine: a sensor that stands where it was
# planned starts within the first.
_NEAR_M = (3.0, 1.0, 0.5, 0.25)
_STEPS = 12  # steps of registration at each
# A beam agrees if it ends this near the planned beams around it: three times the noise of a LiDAR
# and a cloud together, and the height of a kerb.
AGREE_M = 0.15
_ASIDE = 2.0  # steps between beams that a measured one may lie from a planned one that returned
# Weight of points in no plane: each is drawn to the point of its own beam, not where it belongs, so
# that they only hold what no plane does.
_LOOSE = 0.01
_AROUND = 4  # planned beams around a measured one
_LEVEL = 0.7  # planes whose normals rise more than this are ground or the like
# Share of the beams that must agree for a scan to be of the place: on the generated highway those
# of other places reached 0.43, of the next sensors in one tunnel 0.85, of the place itself 0.99.
SAME_PLACE = 0.5
# The same of beams that end on anything but level ground, which is alike anywhere: 0.2 on another
# street as level as this, nearly 1 at the place itself.
SAME_STRUCTURE = 0.3
# Beams of the measured scan that must reach a target, or as few as the plan asks for: rows lie a
# little beside where they were planned, so that fewer meet a target than the plan counts.
_FEWEST_BEAMS = 2
_FEWEST = 100  # planes and points from which a pose can be found


class Target(NamedTuple):
    """Size of all targets, metres, and the beams of which the plan asked for more."""

    radius_m: float
    height_m: float
    min_beams: int


@dataclass(frozen=True)
class Planned:
    """A planned scan from one position.

    Parameters
    ----------
    position_m : (3,). xyz_m : (n, 3). normal : (n, 3) of the plane through the beams around; zero
    where they lie in none. beams : (n, 2) azimuth and elevation in usual steps; step_deg : of both.
    """

    position_m: Floats
    xyz_m: Floats
    normal: Floats
    beams: Floats
    step_deg: Floats

    @property
    def structure(self) -> Bools:
        """Which are no level ground (n,): walls, barriers, trunks, crowns."""
        return np.abs(self.normal[:, 2]) < _LEVEL


@dataclass(frozen=True)
class Registered:
    """A measured scan in the place where it fits.

    Parameters
    ----------
    rotation, shift_m : of the scan as it was placed: ``x @ rotation.T + shift_m``.
    agree : (n,) of the measured points, whether each ends where planned beams around it do.
    structure : (n,) whether the planned beam next to it ends on anything but level ground.
    """

    rotation: Floats
    shift_m: Floats
    agree: Bools
    structure: Bools

    @property
    def share(self) -> float:
        """Share of the measured points that agree."""
        return float(self.agree.mean()) if len(self.agree) else 0.0

    @property
    def same_place(self) -> bool:
        """Whether it is a scan of the planned place at all."""
        enough = self.structure.sum() < _FEWEST or self.structure_share >= SAME_STRUCTURE
        return self.share >= SAME_PLACE and bool(enough)

    @property
    def structure_share(self) -> float:
        """The same of those on anything but level ground."""
        return float(self.agree[self.structure].mean()) if self.structure.any() else 0.0


def planned_scan(xyz_m: Floats, position_m: Floats, step_deg: Floats | None = None) -> Planned:
    """A scan (n, 3) from one position, with planes through neighbouring beams.

    Parameters
    ----------
    step_deg : (2,) usual distance of columns and of rows; None: as wide as high, by their number.
    """
    azimuth, elevation, _ = _angles(xyz_m, position_m)
    if step_deg is None:
        span = np.ptp(azimuth) * np.ptp(elevation) if len(azimuth) else 1.0
        step_deg = np.full(2, max(np.sqrt(span / max(len(azimuth), 1)), 1e-3))
    step = step_deg
    beams = np.column_stack([azimuth, elevation]) / step
    normal = np.zeros(xyz_m.shape)
    if len(xyz_m) < _BEAMS:
        return Planned(position_m, xyz_m, normal, beams, step)
    near = cKDTree(beams).query(beams, k=_BEAMS)[1]
    group = xyz_m[near] - xyz_m[near].mean(axis=1)[:, None]
    value, vector = np.linalg.eigh(np.einsum("nki,nkj->nij", group, group) / _BEAMS)
    flat = (value[:, 0] <= _FLAT**2 * value[:, 1]) & (value[:, 0] <= _THICK_M**2)
    normal[flat] = vector[flat, :, 0]
    return Planned(position_m, xyz_m, normal, beams, step)


def _angles(xyz_m: Floats, position_m: Floats) -> tuple[Floats, Floats, Floats]:
    """Azimuth and elevation in degrees, and range, of points from a position."""
    offset = xyz_m - position_m
    level = np.hypot(offset[:, 0], offset[:, 1])
    azimuth = np.degrees(np.arctan2(offset[:, 1], offset[:, 0]))
    return azimuth, np.degrees(np.arctan2(offset[:, 2], level)), np.hypot(level, offset[:, 2])


def register(scan_xyz_m: Floats, planned: Planned) -> Registered:
    """Move a scan (n, 3), placed as planned, to where it fits the planned one best.

    Returns
    -------
    what was found; where there is too little to go by, the scan as it was placed.
    """
    start = np.eye(3), np.zeros(3)
    position_m = planned.position_m
    if len(planned.xyz_m) < _FEWEST or len(scan_xyz_m) < _FEWEST:
        return _compared(scan_xyz_m, planned, *start)
    count = len(scan_xyz_m)
    points = scan_xyz_m[np.unique(np.linspace(0, count - 1, min(count, _POINTS)).astype(np.int64))]
    tree = cKDTree(planned.xyz_m)
    turns = [Rotation.from_euler("z", 360 * k / _HEADINGS, degrees=True) for k in range(_HEADINGS)]
    starts = [(turn.as_matrix(), position_m - turn.apply(position_m)) for turn in turns]
    few = points[:: max(len(points) // 1_000, 1)]
    away = [tree.query(few @ turn.T + shift, distance_upper_bound=1.0)[0] for turn, shift in starts]
    shares = [float(np.isfinite(one).mean()) for one in away]
    best = np.argsort(-np.array(shares), kind="stable")[:_KEPT_HEADINGS]
    found = []
    for k in dict.fromkeys([0, *best.tolist()]):  # the heading as planned in any case
        pose = starts[k]
        for near_m in _NEAR_M:
            for _ in range(_STEPS):
                pose, moved = _stepped(points, tree, planned, pose, near_m)
                if not moved:
                    break
        found.append(_compared(points, planned, *pose))
    fit = max(found, key=lambda one: one.share)
    return _compared(scan_xyz_m, planned, fit.rotation, fit.shift_m)


def _stepped(
    points: Floats, tree: cKDTree, planned: Planned, pose: tuple[Floats, Floats], near_m: float
) -> tuple[tuple[Floats, Floats], bool]:
    """Pose after one step, and whether it moved."""
    placed = points @ pose[0].T + pose[1]
    away_m, nearest = tree.query(placed, distance_upper_bound=2 * near_m)
    used = np.isfinite(away_m)
    normal, offset = planned.normal[nearest[used]], placed[used] - planned.xyz_m[nearest[used]]
    arm = placed[used] - placed.mean(axis=0)
    flat = normal.any(axis=1)
    loose = ~flat & (away_m[used] < near_m)
    # Where beams end in no plane, points are drawn to points, along each axis.
    axes = np.repeat(np.eye(3), loose.sum(), axis=0)
    normal = np.concatenate([normal[flat], axes])
    arm = np.concatenate([arm[flat], np.tile(arm[loose], (3, 1))])
    offset = np.concatenate([offset[flat], np.tile(offset[loose], (3, 1))])
    residual = np.einsum("ij,ij->i", offset, normal)
    share = np.concatenate([np.ones(flat.sum()), np.full(3 * loose.sum(), _LOOSE)])
    near = np.abs(residual) < near_m
    if near.sum() < _FEWEST // 2:
        return pose, False
    normal, residual = normal[near], residual[near]
    slope = np.column_stack([np.cross(arm[near], normal), normal])
    weight = share[near] / (1 + (residual / (0.3 * near_m)) ** 2)
    # Directions that nothing holds are left as they are.
    left, right = slope.T @ (weight[:, None] * slope), -slope.T @ (weight * residual)
    change = np.linalg.lstsq(left, right, rcond=1e-6)[0]
    turn, middle = Rotation.from_rotvec(change[:3]), placed.mean(axis=0)
    shift = turn.apply(pose[1] - middle) + middle + change[3:]
    moved = np.abs(change[:3]).max() > 1e-6 or np.abs(change[3:]).max() > 1e-5
    return (turn.as_matrix() @ pose[0], shift), bool(moved)


def _compared(points: Floats, planned: Planned, rotation: Floats, shift_m: Floats) -> Registered:
    none = np.zeros(len(points), bool)
    if len(planned.xyz_m) < _AROUND or not len(points):
        return Registered(rotation, shift_m, none, none)
    azimuth, elevation, range_m = _angles(points @ rotation.T + shift_m, planned.position_m)
    beams = np.column_stack([azimuth, elevation]) / planned.step_deg
    away, near = cKDTree(planned.beams).query(beams, k=_AROUND)
    around = np.linalg.norm(planned.xyz_m - planned.position_m, axis=1)[near]
    agree = (range_m >= around.min(axis=1) - AGREE_M) & (range_m <= around.max(axis=1) + AGREE_M)
    return Registered(
        rotation, shift_m, agree & (away[:, 0] <= _ASIDE), planned.structure[near[:, 0]]
    )


def lost_targets(
    planned: Planned, measured_m: Floats, position_m: Floats, feet_m: Floats, target: Target
) -> tuple[Bools, Bools]:
    """Targets that the planned scan sees, and those of them that the measured one does not.

    A target is in sight where most beams into its outline go on to it or past it, as far as beams
    return at all.

    Parameters
    ----------
    measured_m : (n, 3) measured points where they belong. position_m : (3,) of the sensor found.
    feet_m : (t, 3) of the targets. All in local metres.

    Returns
    -------
    (t,) seen as planned, (t,) of these lost
    """
    asked = target.min_beams + 1
    before = _in_sight(planned.xyz_m, planned.position_m, feet_m, target, asked)
    after = _in_sight(measured_m, position_m, feet_m, target, min(asked, _FEWEST_BEAMS))
    return before, before & ~after


def _in_sight(
    xyz_m: Floats, position_m: Floats, feet_m: Floats, target: Target, fewest: int
) -> Bools:
    if not len(xyz_m) or not len(feet_m):
        return np.zeros(len(feet_m), bool)
    half_m = np.array([0.0, 0.0, target.height_m / 2])
    offset, away = xyz_m - position_m, feet_m + half_m - position_m
    range_m = np.maximum(np.linalg.norm(offset, axis=1), 1e-9)
    distance_m = np.maximum(np.linalg.norm(away, axis=1), target.radius_m)
    rays, ahead = offset / range_m[:, None], away / distance_m[:, None]
    level = np.maximum(np.hypot(ahead[:, 0], ahead[:, 1]), 1e-9)
    aside = np.column_stack([-ahead[:, 1], ahead[:, 0], np.zeros(len(ahead))]) / level[:, None]
    upward = np.cross(ahead, aside)
    # A cylinder from above shows less of its side and more of its top.
    high_m = target.height_m / 2 * level + target.radius_m * np.abs(ahead[:, 2])
    around = np.hypot(target.radius_m, high_m) / distance_m
    beams = cKDTree(rays).query_ball_point(ahead, around)
    reach_m = distance_m - target.radius_m
    seen = np.zeros(len(feet_m), bool)
    for k, near in enumerate(beams):
        own = rays[near]
        on = np.abs(own @ aside[k]) * distance_m[k] <= target.radius_m
        on &= np.abs(own @ upward[k]) * distance_m[k] <= high_m[k]
        past = int((range_m[near][on] >= reach_m[k]).sum())
        seen[k] = past >= fewest and 2 * past >= on.sum()
    return seen
