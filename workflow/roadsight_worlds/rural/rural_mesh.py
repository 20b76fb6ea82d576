"""Triangles of the rural site, collected part by part."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from roadsight.base.arrays import Bytes, Floats, Floats32, Ints32

# Triangles of a box, by row of `_CORNERS`.
_BOX = np.array(
    [
        [0, 2, 1],
        [1, 2, 3],
        [4, 5, 6],
        [5, 7, 6],
        [0, 1, 4],
        [1, 5, 4],
        [2, 6, 3],
        [3, 6, 7],
        [0, 4, 2],
        [2, 4, 6],
        [1, 3, 5],
        [3, 7, 5],
    ]
)
# Of a box with half edges of 1.
_CORNERS = np.array([[x, y, z] for z in (-1, 1) for y in (-1, 1) for x in (-1, 1)], float)


class Mesh(NamedTuple):
    """Triangles with what they are; the ground's come first.

    Parameters
    ----------
    vertices_m : (n, 3) local metres, float64.
    triangles : (m, 3) int32.
    material : (m,) uint8 `Material`. object_id : (m,) int32. tint : (m,) float32, 0 to 1.
    normal : (m, 3) float32, how the triangle is lit (crowns as a whole are, not leaf by leaf).
    """

    vertices_m: Floats
    triangles: Ints32
    material: Bytes
    object_id: Ints32
    tint: Floats32
    normal: Floats32


def face_normals(corners_m: Floats) -> Floats:
    """Unit normals (m, 3) of triangles (m, 3, 3); a triangle without area has a vertical one."""
    normal = np.cross(corners_m[:, 1] - corners_m[:, 0], corners_m[:, 2] - corners_m[:, 0])
    length = np.linalg.norm(normal, axis=1, keepdims=True)
    return np.where(length > 0.0, normal / np.maximum(length, 1e-300), [0.0, 0.0, 1.0])


@dataclass
class MeshBuilder:
    """Collects parts; objects are numbered from 0 in the order of `start`."""

    kinds: list[str] = field(default_factory=list)
    _parts: list[Mesh] = field(default_factory=list)

    def start(self, kind: str) -> int:
        """Start an object and return its number."""
        self.kinds.append(kind)
        return len(self.kinds) - 1

    def add(
        self,
        vertices_m: ArrayLike,
        triangles: ArrayLike,
        material: int,
        tint: ArrayLike = 0.5,
        normal: ArrayLike | None = None,
    ) -> None:
        """Add triangles (m, 3) over vertices (n, 3) to the object started last."""
        vertices, faces = np.asarray(vertices_m, float), np.asarray(triangles, np.int32)
        lit = face_normals(vertices[faces]) if normal is None else np.asarray(normal)
        count = len(faces)
        self._parts.append(
            Mesh(
                vertices,
                faces,
                np.full(count, material, np.uint8),
                np.full(count, len(self.kinds) - 1, np.int32),
                np.broadcast_to(np.asarray(tint, np.float32), count),
                lit.astype(np.float32),
            )
        )

    def box(
        self,
        centre_m: ArrayLike,
        half_m: ArrayLike,
        heading_rad: float,
        material: int,
        tint: float = 0.5,
    ) -> None:
        """Add an upright box whose x axis points along ``heading_rad``."""
        self.add(
            turned(_CORNERS * np.asarray(half_m, float), heading_rad, centre_m),
            _BOX,
            material,
            tint,
        )

    def quad(self, corners_m: ArrayLike, material: int, tint: float = 0.5) -> None:
        """Add a flat convex polygon (k, 3) as a fan."""
        corners = np.asarray(corners_m, float)
        fan = [[0, i, i + 1] for i in range(1, len(corners) - 1)]
        self.add(corners, fan, material, tint)

    def post(
        self,
        foot_m: ArrayLike,
        height_m: float,
        radius_m: tuple[float, float],
        sides: int,
        material: int,
        tint: float = 0.5,
    ) -> None:
        """Add an upright prism with its foot 0.4 m in the ground; radii at foot and top."""
        foot = np.asarray(foot_m, float)
        ends = np.stack([raised(foot, -0.4), raised(foot, height_m)])
        self.tube(ends, radius_m, sides, material, tint)

    def tube(
        self,
        line_m: ArrayLike,
        radius_m: tuple[float, float],
        sides: int,
        material: int,
        tint: float = 0.5,
    ) -> None:
        """Add a prism along a line (k, 3), closed at its end, of the same volume as round."""
        line = np.asarray(line_m, float)
        rings = _rings(line, np.linspace(*radius_m, len(line)), sides)
        a = np.arange(sides)
        b = (a + 1) % sides
        wall = np.concatenate(
            [np.column_stack([a, b, b + sides]), np.column_stack([a, b + sides, a + sides])]
        )
        faces = [wall + sides * k for k in range(len(line) - 1)]
        last = sides * (len(line) - 1)
        faces.append(np.array([[last, last + i, last + i + 1] for i in range(1, sides - 1)]))
        self.add(rings.reshape(-1, 3), np.concatenate(faces), material, tint)

    def build(self) -> Mesh:
        """All parts as one mesh."""
        first = np.cumsum([0] + [len(p.vertices_m) for p in self._parts[:-1]])
        faces = [p.triangles + np.int32(k) for p, k in zip(self._parts, first, strict=True)]
        columns = list(zip(*self._parts, strict=True))
        joined = [np.concatenate(c) for c in columns]
        joined[1] = np.concatenate(faces)
        return Mesh(*joined)


def turned(points_m: ArrayLike, heading_rad: float, place_m: ArrayLike) -> Floats:
    """Points (n, 3) of a body's frame whose x axis points along ``heading_rad``, at a place."""
    cos, sin = np.cos(heading_rad), np.sin(heading_rad)
    about_z = np.array([[cos, sin, 0.0], [-sin, cos, 0.0], [0.0, 0.0, 1.0]])
    return np.asarray(points_m, float) @ about_z + np.asarray(place_m, float)


def raised(place_m: ArrayLike, by_m: float) -> Floats:
    """Place (3,) moved up."""
    return np.add(place_m, [0.0, 0.0, by_m])


def _rings(line: Floats, radius: Floats, sides: int) -> Floats:
    """Corners (k, sides, 3) around a line; the polygon has the area of the circle."""
    ahead = np.gradient(line, axis=0)
    ahead /= np.linalg.norm(ahead, axis=1, keepdims=True)
    steep = np.abs(ahead[:, 2:]) > 0.9
    across = np.cross(ahead, np.where(steep, [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]))
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    up = np.cross(across, ahead)
    angle = 2.0 * np.pi * (np.arange(sides) + 0.5) / sides
    same_area = np.sqrt(2.0 * np.pi / (sides * np.sin(2.0 * np.pi / sides)))
    reach = (same_area * radius)[:, None, None]
    ring = np.cos(angle)[:, None] * across[:, None] + np.sin(angle)[:, None] * up[:, None]
    return line[:, None] + reach * ring
