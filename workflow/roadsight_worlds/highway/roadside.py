"""Placing bodies by station and offset."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from roadsight.base.arrays import Floats
from roadsight_worlds.casting.alignment import heading_at, plan_point
from roadsight_worlds.casting.materials import TruthClass
from roadsight_worlds.casting.primitives import BOX, CYLINDER, ELLIPSOID
from roadsight_worlds.casting.scene import SceneBuilder, rotation_zyx
from roadsight_worlds.casting.terrain import Terrain, surface_height

# Posts reach so far into the ground, so that no gap shows below them on a slope.
_FOUNDATION_M = 0.4
_PIECE_M = 4.0  # Longest straight piece of what follows the road.


@dataclass(frozen=True)
class Pole:
    """An upright round post; ``xyz_m`` is the local position of its foot on the ground."""

    kind: str
    station_m: float
    offset_m: float
    xyz_m: tuple[float, float, float]
    height_m: float
    radius_m: float


@dataclass
class Roadside:
    """Scene builder that thinks in road coordinates; heights are local and absolute."""

    terrain: Terrain
    builder: SceneBuilder
    poles: list[Pole] = field(default_factory=list)

    def plane_m(self, station_m: float) -> float:
        """Height of the grade plane."""
        return self.terrain.height_m + self.terrain.grade * station_m

    def point(self, station_m: float, offset_m: float) -> tuple[float, float, float]:
        """Local x, y, z of the ground at a road point."""
        x, y = plan_point(self.terrain.alignment, station_m, offset_m)
        return x, y, surface_height(self.terrain, x, y)

    def new(self, kind: str, material: str, truth_class: TruthClass) -> int:
        """Start an object and return its id."""
        return self.builder.add_object(kind, material, truth_class)

    def box(
        self,
        object_id: int,
        station_m: float,
        offset_m: float,
        bottom_top_m: tuple[float, float],
        half_along_across_m: tuple[float, float],
        yaw_deg: float = 0.0,
        follows_grade: bool = False,
    ) -> None:
        """Add a box square to the road (plus ``yaw_deg``), level or pitched with the grade."""
        x, y = plan_point(self.terrain.alignment, station_m, offset_m)
        bottom, top = bottom_top_m
        heading = float(heading_at(self.terrain.alignment, station_m)) + math.radians(yaw_deg)
        pitch = math.atan(self.terrain.grade) if follows_grade else 0.0
        half = [*half_along_across_m, 0.5 * (top - bottom)]
        centre = [x, y, 0.5 * (bottom + top)]
        self.builder.add_body(object_id, BOX, centre, half, rotation_zyx(heading, pitch))

    def strip(
        self,
        object_id: int,
        stations_m: tuple[float, float],
        offset_m: float,
        above_plane_m: tuple[float, float],
        half_across_m: float,
    ) -> None:
        """Add a long body along the road as boxes of about 4 m that overlap a little."""
        start, end = stations_m
        pieces = max(1, math.ceil((end - start) / _PIECE_M))
        length = (end - start) / pieces
        for i in range(pieces):
            middle = start + (i + 0.5) * length
            plane = self.plane_m(middle)
            limits = plane + above_plane_m[0], plane + above_plane_m[1]
            half = 0.5 * length + 0.05 * (0 < i < pieces - 1), half_across_m
            self.box(object_id, middle, offset_m, limits, half, follows_grade=True)

    def post(
        self, object_id: int, station_m: float, offset_m: float, height_m: float, radius_m: float
    ) -> float:
        """Add an upright cylinder that stands on the ground; return the ground's height there."""
        x, y, z = self.point(station_m, offset_m)
        half = 0.5 * (height_m + _FOUNDATION_M)
        centre = [x, y, z + height_m - half]
        self.builder.add_body(object_id, CYLINDER, centre, [radius_m, radius_m, half])
        return z

    def pole(
        self,
        object_id: int,
        kind: str,
        station_m: float,
        offset_m: float,
        height_m: float,
        radius_m: float,
    ) -> float:
        """Add a post that is listed among the poles; return the ground's height there."""
        ground = self.post(object_id, station_m, offset_m, height_m, radius_m)
        xyz = self.point(station_m, offset_m)
        self.poles.append(Pole(kind, station_m, offset_m, xyz, height_m, radius_m))
        return ground

    def clumps(self, object_id: int, centres_m: Floats, half_m: Floats) -> None:
        """Add upright ellipsoids with centres (n, 3) and half axes (n, 3)."""
        for centre, half in zip(centres_m, half_m, strict=True):
            self.builder.add_body(object_id, ELLIPSOID, centre, half)
