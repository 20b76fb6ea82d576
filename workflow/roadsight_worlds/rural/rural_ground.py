"""Ground of the rural site: cross-section, branches, hills, and what lies where.

The corridor's mesh follows the road (a column of vertices for every break of the cross-section, a
row every metre), so that the pavement's edge is an edge of the mesh. Each vertex keeps its station
and offset: interpolated over a triangle they tell what the ground is, to about a millimetre.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.ndimage import gaussian_filter, map_coordinates
from scipy.spatial import cKDTree

from roadsight.base.arrays import Floats, Ints32
from roadsight_worlds.rural.rural_line import RuralLine

_ROW_M = 1.0  # Spacing of the corridor's mesh along the road.
_FAR_CELL_M = 14.0  # Cells of the land beyond the corridor.
_FAR_REACH_M = 800.0  # How far that land reaches beyond the road.
_CORRIDOR_M = 110.0  # Half width of the corridor that has an exact surface; trees stand within it.
SIDE_ROAD, GRAVEL_DRIVE, PAVED_DRIVE, CAR_PARK = 0, 1, 2, 3
LANE_M = 3.2  # Width of a lane.


class Section(NamedTuple):
    """Half cross-section, metres from the middle of the road.

    Parameters
    ----------
    lane_m : outer side of the edge line. ditch_m : depth of the ditch beside the shoulder.
    lanes : each way.
    """

    lane_m: float = LANE_M
    pavement_m: float = 3.6
    shoulder_m: float = 4.8
    line_half_m: float = 0.06
    ditch_m: float = 0.65
    lanes: int = 1

    def beside(self, offset_m: float) -> float:
        """Offset that is as far beyond this road's edge as the given one is on a two-lane road."""
        return offset_m + math.copysign(LANE_M * (self.lanes - 1), offset_m)

    @property
    def drive_m(self) -> float:
        """Middle of the outer lane."""
        return self.lane_m - 0.5 * LANE_M


@dataclass(frozen=True)
class Branch:
    """Side road, driveway or car park.

    Parameters
    ----------
    kind : SIDE_ROAD, GRAVEL_DRIVE, PAVED_DRIVE or CAR_PARK.
    station_m, side : where it leaves; 1 is left, -1 right.
    start_m, ahead : (2,) plan place at the pavement's edge, unit direction away from the road.
    half_m, length_m, radius_m : half width, length, radius of the corners.
    rise_m, grade : height at the start, rise over run.
    """

    kind: int
    station_m: float
    side: int
    start_m: Floats
    ahead: Floats
    half_m: float
    length_m: float
    radius_m: float
    rise_m: float
    grade: float

    def along_across(self, xy_m: ArrayLike) -> tuple[Floats, Floats]:
        """Distance along the branch from the pavement's edge, and to the left of its middle."""
        offset = np.asarray(xy_m, float) - self.start_m
        east, north = offset[..., 0], offset[..., 1]
        ax, ay = self.ahead
        return east * ax + north * ay, north * ax - east * ay


@dataclass(frozen=True)
class Hills:
    """Natural height over a square grid in plan, metres."""

    west_m: float
    south_m: float
    height_m: Floats
    distance_m: Floats

    def at(self, xy_m: ArrayLike) -> Floats:
        """Natural height (...) at plan points (..., 2)."""
        xy = np.asarray(xy_m, float)
        cells = (xy.reshape(-1, 2) - [self.west_m, self.south_m]) / _FAR_CELL_M
        height = map_coordinates(self.height_m, cells.T[::-1], order=1, mode="nearest")
        return height.reshape(xy.shape[:-1])


@dataclass(frozen=True)
class RuralGround:
    """Heights and surfaces of the corridor.

    Parameters
    ----------
    gully_m : station of the stream that the road crosses on a short bridge.
    """

    line: RuralLine
    section: Section
    branches: tuple[Branch, ...]
    hills: Hills
    gully_m: float
    bridge_half_m: float = 7.0

    def height(self, station_m: ArrayLike, offset_m: ArrayLike) -> Floats:
        """Height of the ground (n,) at stations and offsets, local metres."""
        station, offset = np.broadcast_arrays(
            np.asarray(station_m, float), np.asarray(offset_m, float)
        )
        xy, away = self.line.plan(station, offset), np.abs(offset)
        near = self.line.height(station) + np.interp(away, *section_profile(self.section))
        toe = section_profile(self.section)[0][-1]
        height = near + (self.hills.at(xy) - near) * _smooth((away - toe) / 26.0)
        for branch in self.branches:
            along, across = branch.along_across(xy)
            bed = branch.rise_m + branch.grade * along
            side = 1.0 - _smooth((np.abs(across) - branch.half_m - 1.5) / 5.0)
            end = 1.0 - _smooth((along - branch.length_m) / 12.0)
            begin = _smooth((away - self.section.pavement_m) / 1.2) * (along > 0.0)
            height = height + (bed - height) * side * end * begin
        depth = 2.6 * (1.0 - _smooth((np.abs(station - self.gully_m) - 1.5) / 5.5))
        reach = 1.0 - _smooth((away - 60.0) / 40.0)
        return height - np.where(away > self.section.shoulder_m + 0.15, depth * reach, 0.0)


def section_profile(section: Section) -> tuple[list[float], list[float]]:
    """Break points of half the cross-section: offsets and heights under the middle, metres."""
    edge, shoulder = section.pavement_m, section.shoulder_m
    fall = -0.02 * edge
    offsets = [0.0, edge, shoulder, shoulder + 1.5, shoulder + 2.2, shoulder + 3.8]
    shelf = fall - 0.05 * (shoulder - edge)
    bed = shelf - section.ditch_m
    return offsets, [0.0, fall, shelf, bed, bed, shelf - 0.05]


def make_hills(line: RuralLine, rng: np.random.Generator) -> Hills:
    """Natural relief that follows the road near it and becomes mountains far away."""
    west, south = line.x_m.min() - _FAR_REACH_M, line.y_m.min() - _FAR_REACH_M
    x = np.arange(west, line.x_m.max() + _FAR_REACH_M, _FAR_CELL_M)
    y = np.arange(south, line.y_m.max() + _FAR_REACH_M, _FAR_CELL_M)
    xy = np.stack(np.meshgrid(x, y), axis=-1)
    tree = cKDTree(np.column_stack([line.x_m, line.y_m]))
    distance, row = tree.query(xy)
    base = gaussian_filter(line.height(line.station_m[row]), 1.5)
    height = base + _waves(xy, (70.0, 240.0), 0.012, rng) * _smooth(distance / 60.0)
    height += 7.0 * _smooth((distance - 40.0) / 200.0)
    mountains = 60.0 + _waves(xy, (350.0, 1200.0), 0.045, rng)
    height += np.maximum(mountains, 10.0) * _smooth((distance - 160.0) / 620.0)
    return Hills(west, south, height, distance)


def _waves(
    xy: Floats, lengths_m: tuple[float, float], steep: float, rng: np.random.Generator
) -> Floats:
    """Sum of plane waves with amplitudes ``steep`` times their lengths."""
    total = np.zeros(xy.shape[:-1])
    for length in np.geomspace(*lengths_m, 9):
        turn, phase = rng.uniform(0.0, 2.0 * np.pi, 2)
        way = xy[..., 0] * math.cos(turn) + xy[..., 1] * math.sin(turn)
        total += steep * length * np.sin(2.0 * np.pi * way / length + phase)
    return total


def make_branch(
    line: RuralLine,
    section: Section,
    hills: Hills,
    kind: int,
    station_m: float,
    side: int,
    skew_rad: float,
) -> Branch:
    """Branch that leaves the road at a station, square to it but for ``skew_rad``."""
    half, length, radius = (
        (2.6, 108.0, 6.0),
        (1.6, 38.0, 2.5),
        (1.8, 36.0, 2.5),
        (13.0, 30.0, 3.0),
    )[kind]
    start = line.plan(station_m, side * section.pavement_m)
    angle = float(line.heading(station_m)) + side * 0.5 * math.pi + skew_rad
    ahead = np.array([math.cos(angle), math.sin(angle)])
    rise = float(line.height(station_m)) - 0.02 * section.pavement_m
    grade = (float(hills.at(start + length * ahead)) - rise) / length
    limit = 0.06 if kind == SIDE_ROAD else 0.1
    grade = min(max(grade, -limit), limit)
    return Branch(kind, station_m, side, start, ahead, half, length, radius, rise, grade)


def _smooth(share: Floats) -> Floats:
    """0 below 0, 1 above 1, a cubic between."""
    t = np.clip(share, 0.0, 1.0)
    return t * t * (3.0 - 2.0 * t)


def column_offsets(section: Section) -> Floats:
    """Offsets of the mesh's columns, denser near the road."""
    breaks = section_profile(section)[0]
    shoulder = section.shoulder_m
    near = [section.pavement_m / 2, shoulder + 0.14, shoulder + 0.16, shoulder + 0.8]
    out = np.concatenate(
        [
            np.arange(breaks[-1] + 1.0, 24.0, 1.3),
            np.arange(24.0, 45.0, 2.2),
            np.arange(45.0, _CORRIDOR_M, 4.0),
            [_CORRIDOR_M],
        ]
    )
    half = np.unique(np.concatenate([breaks, near, out]))
    return np.concatenate([-half[:0:-1], half])


def corridor_mesh(ground: RuralGround) -> tuple[Floats, Ints32, Floats]:
    """Vertices (n, 3), triangles (m, 3), and station and offset (n, 2) of each vertex."""
    stations = np.arange(ground.line.station_m[0], ground.line.station_m[-1], _ROW_M)
    road = np.stack(np.meshgrid(stations, column_offsets(ground.section), indexing="ij"), axis=-1)
    rows, columns = road.shape[:2]
    road = road.reshape(-1, 2)
    height = ground.height(road[:, 0], road[:, 1])
    vertices = np.column_stack([ground.line.plan(road[:, 0], road[:, 1]), height])
    return vertices, grid_triangles(rows, columns), road


def far_mesh(hills: Hills, rng: np.random.Generator) -> tuple[Floats, Ints32]:
    """Wooded land beyond the corridor; it dives below the corridor's mesh."""
    rows, columns = hills.height_m.shape
    x = hills.west_m + _FAR_CELL_M * np.arange(columns)
    y = hills.south_m + _FAR_CELL_M * np.arange(rows)
    canopy = rng.uniform(4.0, 13.0, hills.height_m.shape)
    share = _smooth((hills.distance_m - _CORRIDOR_M) / 50.0)
    sunk = -4.0 * (hills.distance_m < _CORRIDOR_M - 6.0)
    height = hills.height_m + canopy * share + sunk
    vertices = np.column_stack([np.stack(np.meshgrid(x, y), -1).reshape(-1, 2), height.ravel()])
    return vertices, grid_triangles(rows, columns)


def grid_triangles(rows: int, columns: int) -> Ints32:
    """Two triangles for each cell of a grid of vertices, row by row."""
    a = (np.arange(rows - 1)[:, None] * columns + np.arange(columns - 1)).ravel()
    b, c, d = a + 1, a + columns, a + columns + 1
    return np.concatenate([np.column_stack([a, b, c]), np.column_stack([b, d, c])]).astype(np.int32)
