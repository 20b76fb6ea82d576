"""What stands beside the sample highway: barriers, rails, tunnel, poles, signs, cars; plants."""

from __future__ import annotations

import numpy as np

from roadsight.base.arrays import Floats
from roadsight_worlds.casting.materials import TruthClass
from roadsight_worlds.highway.highway_ground import WING_M, CrossSection
from roadsight_worlds.highway.roadside import Roadside

_WALL_INNER_M = 12.5  # Offset of the inner face of the tunnel's outer walls.
_WALL_OUTER_M = 13.5  # Offset of their outer face.
_CLEARANCE_M = 6.6  # Height of the tunnel's ceiling above the road.
# Top of the portal wall above the road: it holds back the hill (`HILL_HEIGHT_M`).
_PORTAL_TOP_M = 9.0
_RAIL_OFFSET_M = 12.35  # Offset of guard rails, in front of poles and signs.
_POST_OFFSET_M = 12.95  # Offset of lamps, signs and the gantry's post.
_BUILDING_SHARE = 0.42  # Place of the hut along the open road; plants keep off it.
_BUILDING_OFFSET_M = -36.0  # Its offset; below 0 is right of the road.


def add_furniture(road: Roadside, section: CrossSection, open_m: float, end_m: float) -> None:
    """Furnish the highway: open road up to station ``open_m``, tunnel from there to ``end_m``."""
    add_median_barrier(road, section, open_m)
    add_tunnel(road, open_m, end_m)
    add_guard_rail(road, (0.05 * open_m, 0.60 * open_m), -_RAIL_OFFSET_M)
    add_guard_rail(road, (0.45 * open_m, 0.85 * open_m), _RAIL_OFFSET_M)
    for station in np.arange(12.0, open_m - 5.0, 35.0):
        add_lamp(road, float(station))
    for station in np.arange(20.0, open_m, 45.0):
        add_utility_pole(road, float(station))
    add_gantry(road, 0.55 * open_m)
    for share, side in ((0.20, -1.0), (0.35, 1.0), (0.78, -1.0)):
        add_sign(road, share * open_m, side * _POST_OFFSET_M)
    for share, length in ((0.26, 4.6), (0.34, 4.2)):
        add_car(road, share * open_m, section.lane_edges_m[-1] + 1.3, length)
    add_building(road, _BUILDING_SHARE * open_m)


# Height of the wires above the road: between the lowest and the highest place of a sensor.
_WIRE_M = 8.0
_CANOPY_M = 5.2  # Height of the canopy's underside above the road.
_BEAM_M = 6.2  # Height of the gantry's beam above the road.


def add_overhead(road: Roadside, open_m: float) -> None:
    """What hangs over both edges of the open road: wires, a canopy, a gantry across all lanes."""
    wires = road.new("wires", "steel", TruthClass.STRUCTURE)
    for shift in (-0.4, 0.4):
        station = 0.30 * open_m + shift
        plane = road.plane_m(station) + _WIRE_M
        road.box(wires, station, 0.0, (plane - 0.02, plane + 0.02), (0.02, 16.0))
    canopy = road.new("canopy", "concrete", TruthClass.STRUCTURE)
    station = 0.50 * open_m
    plane = road.plane_m(station) + _CANOPY_M
    for side in (-1.0, 1.0):
        road.box(canopy, station, side * _POST_OFFSET_M, (plane, plane + 0.25), (4.0, 2.6))
        road.post(canopy, station - 3.8, side * (_POST_OFFSET_M + 2.4), _CANOPY_M + 0.5, 0.12)
        road.post(canopy, station + 3.8, side * (_POST_OFFSET_M + 2.4), _CANOPY_M + 0.5, 0.12)
    gantry = road.new("gantry", "steel", TruthClass.STRUCTURE)
    station = 0.75 * open_m
    plane = road.plane_m(station) + _BEAM_M
    road.box(gantry, station, 0.0, (plane, plane + 0.8), (0.4, 15.0))
    for side in (-1.0, 1.0):
        road.post(gantry, station, side * 14.8, _BEAM_M + 0.8, 0.2)


def add_median_barrier(road: Roadside, section: CrossSection, open_m: float) -> None:
    """Concrete barrier on the median, 0.9 m above the strip, from the start to the tunnel."""
    barrier = road.new("median_barrier", "concrete", TruthClass.BARRIER)
    foot = section.median_rise_m
    road.strip(barrier, (0.0, open_m), 0.0, (foot - 0.15, foot + 0.25), 0.30)
    road.strip(barrier, (0.0, open_m), 0.0, (foot - 0.15, foot + 0.90), 0.11)


def add_guard_rail(road: Roadside, stations_m: tuple[float, float], offset_m: float) -> None:
    """Steel beam 0.31 m high on posts every 2 m."""
    rail = road.new("guard_rail", "steel", TruthClass.BARRIER)
    verge = road.point(stations_m[0], offset_m)[2] - road.plane_m(stations_m[0])
    road.strip(rail, stations_m, offset_m, (verge + 0.44, verge + 0.75), 0.04)
    behind = offset_m + np.copysign(0.09, offset_m)
    for station in np.arange(stations_m[0] + 1.0, stations_m[1], 2.0):
        ground = road.point(float(station), float(behind))[2]
        road.box(rail, float(station), float(behind), (ground - 0.3, ground + 0.72), (0.06, 0.05))


def add_tunnel(road: Roadside, start_m: float, end_m: float) -> None:
    """Two-bore box tunnel with a portal wall and wings."""
    tunnel = road.new("tunnel", "concrete", TruthClass.STRUCTURE)
    half = 0.5 * (_WALL_OUTER_M - _WALL_INNER_M)
    for side in (-1.0, 1.0):
        wall = side * (_WALL_INNER_M + half)
        road.strip(tunnel, (start_m, end_m), wall, (-1.0, _CLEARANCE_M + 0.5), half)
        wing = 0.5 * (WING_M - _WALL_INNER_M)
        limits = road.plane_m(start_m) - 6.5, road.plane_m(start_m) + _PORTAL_TOP_M
        road.box(tunnel, start_m, side * (_WALL_INNER_M + wing), limits, (0.5, wing))
    road.strip(tunnel, (start_m, end_m), 0.0, (-0.5, _CLEARANCE_M + 0.5), 0.4)
    road.strip(tunnel, (start_m, end_m), 0.0, (_CLEARANCE_M, _CLEARANCE_M + 1.2), _WALL_OUTER_M)
    limits = road.plane_m(start_m) + _CLEARANCE_M, road.plane_m(start_m) + _PORTAL_TOP_M
    road.box(tunnel, start_m, 0.0, limits, (0.5, _WALL_INNER_M))


def add_lamp(road: Roadside, station_m: float) -> None:
    """Lamp post on the left verge with an arm over the road."""
    lamp = road.new("lamp", "steel", TruthClass.POLE)
    ground = road.pole(lamp, "lamp", station_m, _POST_OFFSET_M, 9.0, 0.09)
    arm = _POST_OFFSET_M - 1.2
    road.box(lamp, station_m, arm, (ground + 8.8, ground + 8.9), (0.04, 1.2))
    road.box(lamp, station_m, arm - 1.4, (ground + 8.7, ground + 8.9), (0.15, 0.4))


def add_utility_pole(road: Roadside, station_m: float) -> None:
    """Wooden pole with a cross-arm at the foot of the fill."""
    pole = road.new("utility_pole", "wood", TruthClass.POLE)
    ground = road.pole(pole, "utility_pole", station_m, -28.0, 11.0, 0.15)
    road.box(pole, station_m, -28.0, (ground + 10.2, ground + 10.35), (0.06, 1.1))


def add_gantry(road: Roadside, station_m: float) -> None:
    """Cantilever gantry with a sign panel over the right carriageway."""
    gantry = road.new("gantry", "steel", TruthClass.POLE)
    road.pole(gantry, "gantry", station_m, -_POST_OFFSET_M, 7.6, 0.2)
    plane = road.plane_m(station_m)
    road.box(gantry, station_m, -9.3, (plane + 6.5, plane + 6.8), (0.12, 3.65))
    panel = road.new("sign_panel", "sign", TruthClass.STRUCTURE)
    road.box(panel, station_m - 0.2, -7.4, (plane + 5.6, plane + 7.8), (0.05, 1.8))


def add_sign(road: Roadside, station_m: float, offset_m: float) -> None:
    """Road sign on a thin post, seen by the traffic of its own side."""
    sign = road.new("sign", "steel", TruthClass.POLE)
    ground = road.pole(sign, "sign", station_m, offset_m, 2.9, 0.045)
    panel = road.new("sign_panel", "sign", TruthClass.STRUCTURE)
    towards_traffic = float(np.copysign(0.07, offset_m))
    road.box(
        panel, station_m + towards_traffic, offset_m, (ground + 2.0, ground + 2.9), (0.015, 0.45)
    )


def add_car(road: Roadside, station_m: float, distance_m: float, length_m: float) -> None:
    """Car parked on the right shoulder: body, cabin, four wheels."""
    car = road.new("car", "paint", TruthClass.VEHICLE)
    ground = road.point(station_m, -distance_m)[2]
    half = 0.5 * length_m
    road.box(car, station_m, -distance_m, (ground + 0.22, ground + 0.85), (half, 0.9))
    road.box(car, station_m - 0.2, -distance_m, (ground + 0.85, ground + 1.45), (0.5 * half, 0.78))
    for along in (-0.62, 0.62):
        for across in (-0.78, 0.78):
            at = station_m + along * half, -distance_m + across
            road.box(car, *at, (ground - 0.05, ground + 0.6), (0.3, 0.1))


def add_building(road: Roadside, station_m: float) -> None:
    """Hut at the foot of the fill, askew to the road."""
    hut = road.new("building", "concrete", TruthClass.STRUCTURE)
    ground = road.point(station_m, _BUILDING_OFFSET_M)[2]
    limits = ground - 1.0, ground + 3.8
    road.box(hut, station_m, _BUILDING_OFFSET_M, limits, (4.0, 3.0), yaw_deg=12.0)


_TREES_PER_M = 0.24  # Tried places by length of road; those too near to something else stay empty.
_BUSHES_PER_M = 0.36  # As of trees.
_KEEP_OFF_M = 6.0  # Between a tree and anything else, about the width of a crown.


def add_vegetation(road: Roadside, open_m: float, rng: np.random.Generator) -> None:
    """Plant both slopes along the open road; every plant keeps off the poles and off the others.

    Crowns are many leaf clumps, so that rays get in between.
    """
    taken = [(pole.station_m, pole.offset_m) for pole in road.poles]
    taken.append((_BUILDING_SHARE * open_m, _BUILDING_OFFSET_M))
    for plant, per_m, gap_m in ((_tree, _TREES_PER_M, _KEEP_OFF_M), (_bush, _BUSHES_PER_M, 2.0)):
        for _ in range(round(per_m * open_m)):
            side = rng.choice([-1.0, 1.0])
            at = rng.uniform(2.0, open_m - 4.0), side * rng.uniform(16.0, 40.0)
            if all(np.hypot(at[0] - s, at[1] - o) > gap_m for s, o in taken):
                taken.append(at)
                plant(road, at, rng)


def _tree(road: Roadside, at: tuple[float, float], rng: np.random.Generator) -> None:
    """Trunk and an egg-shaped crown of leaf clumps."""
    height = rng.uniform(5.5, 10.5)
    trunk = road.new("trunk", "wood", TruthClass.HIGH_VEGETATION)
    ground = road.post(trunk, *at, 0.55 * height, 0.018 * height)
    crown = road.new("tree", "leaves", TruthClass.HIGH_VEGETATION)
    x, y, _ = road.point(*at)
    middle = np.array([x, y, ground + 0.66 * height])
    half = height * np.array([0.24, 0.24, 0.33])
    _leaves(road, crown, middle, half, round(12.0 * height), (0.14, 0.42), rng)


def _bush(road: Roadside, at: tuple[float, float], rng: np.random.Generator) -> None:
    """Low round bush without a trunk."""
    bush = road.new("bush", "leaves", TruthClass.LOW_VEGETATION)
    size = rng.uniform(0.5, 1.1)
    x, y, ground = road.point(*at)
    middle = np.array([x, y, ground + 0.6 * size])
    _leaves(road, bush, middle, size * np.array([1.0, 1.0, 0.7]), 24, (0.08, 0.25), rng)


def _leaves(
    road: Roadside,
    object_id: int,
    middle: Floats,
    half: Floats,
    count: int,
    radii_m: tuple[float, float],
    rng: np.random.Generator,
) -> None:
    """Fill an ellipsoid with clumps, denser towards its shell as light makes real crowns."""
    direction = rng.normal(size=(count, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    depth = rng.uniform(0.15, 1.0, (count, 1)) ** 0.5
    size = rng.uniform(*radii_m, (count, 1)) * rng.uniform(0.6, 1.0, (count, 3))
    road.clumps(object_id, middle + direction * depth * half, size)
