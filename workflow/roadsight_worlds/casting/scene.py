"""Scenes of exact surfaces that rays can be cast at."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from roadsight.base.arrays import Floats, Ints32
from roadsight.base.errors import InputError
from roadsight_worlds.casting.alignment import Alignment
from roadsight_worlds.casting.cellgrid import CellGrid, build_grid
from roadsight_worlds.casting.materials import TruthClass
from roadsight_worlds.casting.primitives import Bodies
from roadsight_worlds.casting.terrain import Terrain
from roadsight_worlds.casting.traversal import cast_rays

# Directions whose length is further from 1 are refused, because ranges would not be metres.
_UNIT_TOLERANCE = 1e-6
NO_TERRAIN = Terrain(
    Alignment(0.0, 0.0, 1.0, 0.0, 0.0),
    0.0,
    0.0,
    np.array([0.0, 1.0]),
    np.zeros(2),
    np.zeros((1, 1)),
    0.0,
    0.0,
    1.0,
    1.0,
    np.inf,
    -np.inf,
    np.inf,
    -np.inf,
    -1,
)


@dataclass(frozen=True)
class SceneObject:
    """What a hit's ``object_id`` points to.

    Parameters
    ----------
    kind : what it is, for example "tree" or "ground".
    material : name in `roadsight_worlds.casting.materials.MATERIALS`.
    truth_class : class of the points on it.
    """

    kind: str
    material: str
    truth_class: TruthClass


@dataclass(frozen=True)
class Scene:
    """Exact surfaces in one local frame, metres.

    Parameters
    ----------
    objects : by ``object_id``.
    bodies, terrain : the surfaces.
    grid : acceleration structure over both.
    """

    objects: tuple[SceneObject, ...]
    bodies: Bodies
    terrain: Terrain
    grid: CellGrid

    def cast(
        self, origins_m: ArrayLike, directions: ArrayLike, max_range_m: float
    ) -> tuple[Floats, Ints32, Floats]:
        """First surface along each ray, exactly.

        Parameters
        ----------
        origins_m : (n, 3) local metres. directions : (n, 3) unit vectors.
        max_range_m : farther surfaces do not count.

        Returns
        -------
        range_m : (n,) distance, infinity where nothing is met.
        object_id : (n,) int32, -1 where nothing is met.
        normal : (n, 3) unit normal on the ray's side, NaN where nothing is met.

        Raises
        ------
        InputError : wrong shapes, values that are not finite, or directions not of unit length.
        """
        origins = np.ascontiguousarray(origins_m, dtype=np.float64)
        unit = np.ascontiguousarray(directions, dtype=np.float64)
        _check_rays(origins, unit, max_range_m)
        return cast_rays(self.bodies, self.terrain, self.grid, origins, unit, float(max_range_m))


def _check_rays(origins: Floats, directions: Floats, max_range_m: float) -> None:
    if origins.ndim != 2 or origins.shape[1] != 3 or directions.shape != origins.shape:
        raise InputError(
            "origins and directions differ in shape or are not (n, 3)",
            where="Scene.cast",
            found=f"{origins.shape} and {directions.shape}",
        )
    lengths = np.sqrt(np.einsum("ij,ij->i", directions, directions))
    if not (np.isfinite(origins).all() and (np.abs(lengths - 1.0) <= _UNIT_TOLERANCE).all()):
        raise InputError(
            "a ray is not finite or its direction is not of unit length", where="Scene.cast"
        )
    if not max_range_m > 0.0:
        raise InputError(
            "the maximum range must be positive", where="Scene.cast", found=max_range_m
        )


@dataclass
class SceneBuilder:
    """Collects objects and the bodies that they are made of."""

    objects: list[SceneObject] = field(default_factory=list)
    terrain: Terrain = NO_TERRAIN
    _rows: list[tuple[int, Floats, Floats, Floats, int]] = field(default_factory=list)

    def add_object(self, kind: str, material: str, truth_class: TruthClass) -> int:
        """Start an object and return its id."""
        self.objects.append(SceneObject(kind, material, truth_class))
        return len(self.objects) - 1

    def add_body(
        self,
        object_id: int,
        kind: int,
        centre_m: ArrayLike,
        half_m: ArrayLike,
        scene_from_body: ArrayLike | None = None,
    ) -> None:
        """Add a body (see `Bodies`) to an object; upright where no rotation is given."""
        rotation = np.eye(3) if scene_from_body is None else np.asarray(scene_from_body, float)
        centre, half = np.asarray(centre_m, float), np.asarray(half_m, float)
        self._rows.append((kind, centre, rotation, half, object_id))

    def add_ground(self, terrain: Terrain, material: str) -> int:
        """Set the ground and return its object id."""
        object_id = self.add_object("ground", material, TruthClass.GROUND)
        self.terrain = terrain._replace(object_id=object_id)
        return object_id

    def build(self, cell_m: float = 1.0) -> Scene:
        """Scene with a grid of cells ``cell_m`` wide."""
        columns = list(zip(*self._rows, strict=True)) or [()] * 5
        kinds, centres, rotations, halves, ids = columns
        bodies = Bodies(
            np.array(kinds, dtype=np.int8),
            np.array(centres, dtype=np.float64).reshape(-1, 3),
            np.array(rotations, dtype=np.float64).reshape(-1, 3, 3),
            np.array(halves, dtype=np.float64).reshape(-1, 3),
            np.array(ids, dtype=np.int32),
        )
        return Scene(
            tuple(self.objects), bodies, self.terrain, build_grid(bodies, self.terrain, cell_m)
        )


def rotation_zyx(yaw_rad: float, pitch_rad: float = 0.0, roll_rad: float = 0.0) -> Floats:
    """Rotation scene_from_body (3, 3): roll about x, pitch (nose up) about y, yaw about z."""
    cy, sy = np.cos(yaw_rad), np.sin(yaw_rad)
    cp, sp = np.cos(pitch_rad), np.sin(pitch_rad)
    cr, sr = np.cos(roll_rad), np.sin(roll_rad)
    yaw = np.array([[cy, -sy, 0.0], [sy, cy, 0.0], [0.0, 0.0, 1.0]])
    pitch = np.array([[cp, 0.0, -sp], [0.0, 1.0, 0.0], [sp, 0.0, cp]])
    roll = np.array([[1.0, 0.0, 0.0], [0.0, cr, -sr], [0.0, sr, cr]])
    return yaw @ pitch @ roll
