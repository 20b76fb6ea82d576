"""A winding rural road with its surroundings, described exactly, from one seed."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike
from pyproj import CRS

from roadsight.base.arrays import Floats
from roadsight.base.errors import InputError
from roadsight.base.sections.run import RuralScene
from roadsight.geometry.frames import Frame
from roadsight_worlds.rural.rural_buildings import add_house, add_mailbox, add_vehicle
from roadsight_worlds.rural.rural_furniture import (
    Furnisher,
    RuralPole,
    add_delineators,
    add_fence,
    add_guardrail,
    add_signs,
    add_utility_line,
)
from roadsight_worlds.rural.rural_ground import (
    CAR_PARK,
    GRAVEL_DRIVE,
    LANE_M,
    PAVED_DRIVE,
    SIDE_ROAD,
    Branch,
    Hills,
    RuralGround,
    Section,
    corridor_mesh,
    far_mesh,
    make_branch,
    make_hills,
)
from roadsight_worlds.rural.rural_line import RuralLine, random_line
from roadsight_worlds.rural.rural_materials import Material
from roadsight_worlds.rural.rural_mesh import Mesh, MeshBuilder
from roadsight_worlds.rural.rural_panels import add_panels
from roadsight_worlds.rural.rural_plants import add_plants
from roadsight_worlds.rural.rural_surface import Surface, make_surface

_USUAL = RuralScene()  # What a rural road is, unless asked for another.
EPSG = 6543  # NAD83(2011) / North Carolina, US survey feet.
VERTICAL_EPSG = 6360  # Heights in US survey feet above NAVD88.
US_FOOT_M = 1200.0 / 3937.0  # By its definition.
ORIGIN_FT = (760_000.0, 600_000.0, 2_150.0)  # Easting, northing and height of the local origin.
_LEAD_M = 130.0  # The road goes on so far beyond both ends of the site.
_SHORTEST_M = 60.0  # Shorter roads leave no room for what stands beside them.
# Stretches of a road of several lanes that have hatching, as shares of its length.
_HATCHED = ((0.1, 0.2), (0.5, 0.62), (0.78, 0.86))
# Where car parks open onto the road: share of its length, side.
_CAR_PARKS = ((0.46, 1), (0.92, -1))
# Depth of the ditch beside flush verges: the shelf's own fall, so that there is none.
_FLUSH_M = 0.05
_LONGEST_M = 3000.0  # Longer ones are refused, because the mesh grows with the length.


@dataclass(frozen=True)
class RuralSite:
    """The site in its local frame; the drive runs from station 0 to ``length_m``.

    Parameters
    ----------
    seed : what it was built from.
    ground, surface : shape of the ground and what it is.
    mesh : every triangle; the first ``corridor_triangles`` are the corridor's ground, whose
        vertices have stations and offsets in ``road_m`` (k, 2).
    kinds : kind of each object of the mesh.
    poles, trees : every post and every trunk, see `RuralPole`. guardrails : lines (n, 3) on the
        ground. buildings : corners (4, 3) of their eaves.
    """

    seed: int
    length_m: float
    ground: RuralGround
    surface: Surface
    mesh: Mesh
    corridor_triangles: int
    road_m: Floats
    kinds: tuple[str, ...]
    poles: tuple[RuralPole, ...]
    trees: tuple[RuralPole, ...]
    guardrails: tuple[Floats, ...]
    buildings: tuple[Floats, ...]

    @property
    def line(self) -> RuralLine:
        """Middle of the road."""
        return self.ground.line

    def frame(self) -> Frame:
        """Native coordinates: EPSG:6543 and NAVD88, both in US survey feet."""
        crs = CRS.from_user_input(f"EPSG:{EPSG}+{VERTICAL_EPSG}")
        return Frame(ORIGIN_FT, US_FOOT_M, US_FOOT_M, crs.to_wkt())

    def height(self, xy_m: ArrayLike) -> Floats:
        """Height (n,) of the ground at plan points (n, 2) of the corridor, local metres."""
        return self.ground.height(*self.line.road(xy_m).T)


def build_rural(
    seed: int,
    length_m: float,
    detail: float = 1.0,
    panels_per_km: float = 0.0,
    cars_per_km: float = 0.0,
    scene: RuralScene = _USUAL,
) -> RuralSite:
    """Build the site; the same arguments give the same site.

    Parameters
    ----------
    length_m : length of the drive; the road goes on for 130 m at both ends.
    detail : number of leaves against the usual (their area stays).
    panels_per_km : signs of any form and colour beside the usual ones, for training.
    cars_per_km : cars parked beside the road beside the usual ones, for training.
    scene : relief, lanes, verges, and what is left of the paint.

    Raises
    ------
    InputError : the seed is negative or the length is outside 60 m to 3,000 m.
    """
    if seed < 0:
        raise InputError("a seed is negative", where="seed", found=seed, allowed="0 or more")
    if not _SHORTEST_M <= length_m <= _LONGEST_M:
        allowed = f"{_SHORTEST_M:g} to {_LONGEST_M:g}"
        raise InputError("is out of range", where="length_m", found=length_m, allowed=allowed)
    streams = np.random.SeedSequence([seed, 7]).spawn(6)
    line_rng, hill_rng, thing_rng, plant_rng, panel_rng, car_rng = (
        np.random.default_rng(s) for s in streams
    )
    line = random_line(-_LEAD_M, length_m + _LEAD_M, line_rng)
    hills = make_hills(line, hill_rng)
    line = replace(line, wave_m=scene.relief * line.wave_m)
    hills = replace(hills, height_m=scene.relief * hills.height_m)
    ground = _ground(line, hills, length_m, scene, thing_rng)
    builder = MeshBuilder()
    builder.start("ground")
    vertices, triangles, road = corridor_mesh(ground)
    builder.add(vertices, triangles, Material.GROUND)
    builder.start("far land")
    builder.add(*far_mesh(hills, hill_rng), Material.FAR_FOREST)
    add = Furnisher(ground, builder, thing_rng, [])
    houses = _furnish(add, length_m)
    add.rng = plant_rng
    add_plants(add, houses, detail)
    add.rng = panel_rng
    add_panels(add, panels_per_km)
    add.rng = car_rng
    _park_beside(add, cars_per_km)
    _fill_car_parks(add)
    several = scene.lanes > 1
    passing = [] if several else [[0.42 * length_m, 0.62 * length_m]]
    hatched = [np.multiply(length_m, share) for share in _HATCHED] if several else []
    surface = make_surface(ground, passing, hatched, scene.worn_markings)
    return RuralSite(
        seed,
        length_m,
        ground,
        surface,
        builder.build(),
        len(triangles),
        road,
        tuple(builder.kinds),
        tuple(add.poles),
        tuple(add.trees),
        tuple(add.guardrails),
        tuple(add.buildings),
    )


def _ground(
    line: RuralLine, hills: Hills, length_m: float, scene: RuralScene, rng: np.random.Generator
) -> RuralGround:
    """Ground with one side road, four driveways, car parks if any, and a stream."""
    section = Section(lanes=scene.lanes, lane_m=LANE_M * scene.lanes)
    section = section._replace(
        pavement_m=section.lane_m + rng.uniform(0.25, 0.5),
        shoulder_m=section.beside(section.shoulder_m),
        ditch_m=_FLUSH_M if scene.flush_verges else section.ditch_m,
    )
    side = int(rng.choice([-1, 1]))
    wanted = (
        (SIDE_ROAD, 0.37, side, rng.uniform(-0.25, 0.25)),
        (GRAVEL_DRIVE, 0.13, -side, rng.uniform(-0.2, 0.2)),
        (PAVED_DRIVE, 0.27, side, 0.0),
        (GRAVEL_DRIVE, 0.55, side, rng.uniform(-0.2, 0.2)),
        (PAVED_DRIVE, 0.83, -side, 0.0),
    )
    branches: list[Branch] = [
        make_branch(line, section, hills, kind, share * length_m + rng.uniform(-8.0, 8.0), at, skew)
        for kind, share, at, skew in wanted
    ]
    gully = 0.7 * length_m + rng.uniform(-10.0, 10.0)
    if scene.car_parks:  # last, so that all else is where it is without them
        branches += [
            make_branch(line, section, hills, CAR_PARK, share * length_m, at, 0.0)
            for share, at in _CAR_PARKS
        ]
    return RuralGround(line, section, tuple(branches), hills, gully)


def _furnish(add: Furnisher, length_m: float) -> list[Floats]:
    """Add everything but plants; plan places of the houses."""
    ground, rng = add.ground, add.rng
    side = int(rng.choice([-1, 1]))
    add_utility_line(add, side)
    add_signs(add)
    add_delineators(add)
    drives = [b for b in ground.branches if b.kind not in (SIDE_ROAD, CAR_PARK)]
    houses = [add_house(add, branch) for branch in drives[:3]]
    for branch in drives:
        add_mailbox(add, branch)
    beside = ground.section.beside
    add_fence(add, 0.6 * length_m, 0.6 * length_m + 64.0, beside(-side * 11.5))
    for sign in (-1.0, 1.0):
        add_guardrail(add, ground.gully_m - 20.0, ground.gully_m + 20.0, beside(sign * 4.55))
    # One car on a driveway and two beside the road.
    drive = drives[1]
    ax, ay = drive.ahead
    station, offset = add.ground.line.road(drive.start_m + 16.0 * drive.ahead)[0]
    turn = np.arctan2(ay, ax) - add.heading(station)
    add_vehicle(add, station, offset, float(turn))
    for share in (0.2, 0.93):
        aside = float(add.rng.choice([-1.0, 1.0]))
        place = share * length_m, add.ground.section.beside(aside * 5.0)
        if add.free(*place, 2.0):
            add_vehicle(add, *place, 0.0 if aside < 0 else np.pi)
    return houses


def _park_beside(add: Furnisher, per_km: float) -> None:
    """Park cars on the shoulders, either way, where nothing stands."""
    first, last = float(add.ground.line.station_m[0]), float(add.ground.line.station_m[-1])
    for station in add.rng.uniform(first + 5.0, last - 5.0, round(per_km * (last - first) / 1e3)):
        side = float(add.rng.choice([-1.0, 1.0]))
        place = float(station), add.ground.section.beside(side * add.rng.uniform(4.8, 7.5))
        if add.free(*place, 2.5):
            add_vehicle(add, *place, add.rng.choice([0.0, np.pi]) + add.rng.normal(0.0, 0.1))


def _fill_car_parks(add: Furnisher) -> None:
    """Park cars in two rows on each car park, half of its bays taken."""
    for park in (branch for branch in add.ground.branches if branch.kind == CAR_PARK):
        left = np.array([-park.ahead[1], park.ahead[0]])
        facing = float(np.arctan2(park.ahead[1], park.ahead[0]))
        for along in (13.0, 25.0):
            for across in add.rng.permutation(np.arange(-10.5, 11.0, 3.0))[:4]:
                spot = park.start_m + along * park.ahead + across * left
                station, offset = add.ground.line.road(spot)[0]
                add_vehicle(add, station, offset, facing - add.heading(station))
