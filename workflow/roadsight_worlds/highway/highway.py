"""The sample site: a divided highway on an arc, with a tunnel at its end, described exactly."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from pyproj import CRS

from roadsight.base import SEED
from roadsight.base.arrays import Bytes
from roadsight.base.errors import InputError
from roadsight.base.sections.run import Sample
from roadsight.geometry.frames import Frame
from roadsight_worlds.casting.alignment import Alignment, to_road
from roadsight_worlds.casting.materials import MATERIAL_NAMES, TruthClass
from roadsight_worlds.casting.scene import Scene, SceneBuilder
from roadsight_worlds.casting.terrain import Terrain
from roadsight_worlds.highway.furniture import add_furniture, add_overhead, add_vegetation
from roadsight_worlds.highway.highway_ground import (
    CrossSection,
    highway_terrain,
    is_marking,
    is_paved,
)
from roadsight_worlds.highway.roadside import Pole, Roadside

# UTM zone 50 north on WGS 84: metres, and places far from 0, where single precision fails.
EPSG = 32650
ORIGIN_M = (668_000.0, 3_547_000.0, 0.0)  # Easting, northing and height of station 0.
_USUAL = Sample()  # What a highway is, unless asked for another.
_HEADING_DEG = 25.0  # Of the road at station 0, from east to north: along neither axis.
_HEIGHT_M = 25.0  # Of the road at station 0.
_TUNNEL_M = 30.0  # Length of the tunnel at the end, at most a quarter of the road.
_FAR_M = 200.0  # A tunnel that begins so far behind the end is none.
_SHORTEST_M = 40.0  # Shorter roads leave no room for what stands beside them.
_LONGEST_M = 600.0  # On longer ones the usual arc would turn by more than a radian.


@dataclass(frozen=True)
class Highway:
    """The sample site in its local frame (metres from `ORIGIN_M` in EPSG:32650).

    Parameters
    ----------
    length_m : the site lies between stations 0 and ``length_m``.
    tunnel_start_m : station of the portal; the tunnel reaches the end of the site.
    section : cross-section; the left side has positive offsets.
    scene : exact surfaces.
    poles : every upright post of more than a rail's size.
    """

    length_m: float
    tunnel_start_m: float
    section: CrossSection
    scene: Scene
    poles: tuple[Pole, ...]

    @property
    def terrain(self) -> Terrain:
        """Exact ground."""
        return self.scene.terrain

    @property
    def alignment(self) -> Alignment:
        """Reference line, the middle of the median."""
        return self.scene.terrain.alignment

    def frame(self) -> Frame:
        """Native coordinates of the site."""
        return Frame(ORIGIN_M, crs_wkt=CRS.from_epsg(EPSG).to_wkt())

    def ground_classes(self, xy_m: ArrayLike) -> Bytes:
        """True class (n,) of the ground at local plan points (n, 2): ROAD or GROUND."""
        offset = to_road(self.alignment, xy_m)[:, 1]
        paved = is_paved(self.section, offset)
        return np.where(paved, TruthClass.ROAD, TruthClass.GROUND).astype(np.uint8)

    def ground_materials(self, xy_m: ArrayLike) -> Bytes:
        """Material (n,) of the ground at local plan points (n, 2), as row of `MATERIAL_NAMES`."""
        station, offset = to_road(self.alignment, xy_m).T
        paved = is_paved(self.section, offset)
        median = np.abs(offset) < self.section.median_half_m
        marking = paved & is_marking(self.section, station, offset)
        codes = [MATERIAL_NAMES.index(name) for name in ("marking", "asphalt", "soil", "grass")]
        return np.select([marking, paved, median], codes[:3], codes[3]).astype(np.uint8)


def build_highway(
    seed: int = SEED,
    length_m: float = _USUAL.length_m,
    radius_m: float = _USUAL.radius_m,
    grade: float = _USUAL.grade,
    tunnel: bool = _USUAL.tunnel,
    overhead: bool = _USUAL.overhead,
) -> Highway:
    """Build the sample site; the same arguments give the same site.

    Parameters
    ----------
    radius_m : of the curve to the left. grade : rise over run.
    tunnel : whether the road ends in a tunnel.
    overhead : whether wires, a canopy and a gantry hang over its edges.

    Raises
    ------
    InputError : the seed is negative or the length is outside 40 m to 600 m.
    """
    if seed < 0:
        raise InputError("a seed is negative", where="seed", found=seed, allowed="0 or more")
    if not _SHORTEST_M <= length_m <= _LONGEST_M:
        raise InputError(
            "the site's length is out of range",
            where="length_m",
            found=length_m,
            allowed=f"{_SHORTEST_M:g} to {_LONGEST_M:g}",
        )
    tunnel_start = length_m - min(_TUNNEL_M, 0.25 * length_m) if tunnel else length_m + _FAR_M
    ground_rng, plant_rng = (
        np.random.default_rng(s) for s in np.random.SeedSequence(seed).spawn(2)
    )
    section = CrossSection()
    heading = math.radians(_HEADING_DEG)
    alignment = Alignment(0.0, 0.0, math.cos(heading), math.sin(heading), 1.0 / radius_m)
    terrain = highway_terrain(
        alignment, section, length_m, tunnel_start, _HEIGHT_M, grade, ground_rng
    )
    builder = SceneBuilder()
    builder.add_ground(terrain, "grass")
    road = Roadside(builder.terrain, builder)
    add_furniture(road, section, tunnel_start, length_m)
    if overhead:
        add_overhead(road, min(tunnel_start, length_m))
    add_vegetation(road, tunnel_start, plant_rng)
    return Highway(length_m, tunnel_start, section, builder.build(), tuple(road.poles))
