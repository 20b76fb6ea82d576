"""An airborne laser scanner over the rural road, classified as a state's survey would be.

Each pulse starts at the aircraft, on one of two flight lines along the site, and aims at a place
of a jittered grid. A pulse that meets leaves may go on through a gap, up to four returns.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from roadsight.base.arrays import Bytes, Floats, Ints, Ints32
from roadsight.base.errors import InputError
from roadsight.base.sections.run import Sample
from roadsight_worlds.rendering.images import Cast, RuralRenderer
from roadsight_worlds.rural.rural_materials import (
    CLOUD_OF_GROUND,
    CLOUD_OF_MATERIAL,
    REFLECTANCE_OF_GROUND,
    REFLECTANCE_OF_MATERIAL,
    Material,
)
from roadsight_worlds.rural.rural_surface import ground_kinds

_STRIP_M = 40.0  # Length of the road that is scanned at once; it bounds memory.
# Pulses start so high above the ground that they aim at: above everything that stands on it.
_START_ABOVE_M = 90.0
_GAP_SHARE = 0.55  # Share of the pulses that go on through leaves, bushes and wires after a return.
_GAP_M = 0.6  # A pulse that goes on may meet the next thing 0.3 to 2 times this behind a return.
_MOST_RETURNS = 4  # Returns of a pulse.
_LOW_M = 0.5  # Plants below this are low vegetation (class 3).
_MEDIUM_M = 2.0  # Plants below this are medium vegetation (class 4), those above it high (class 5).
_EDGE_M = 1.0  # Points within this distance of the pavement's edge may have the wrong class.
_USUAL = Sample()  # What a site is, unless asked for another.
# What producers say of points: ASPRS classes with poles in the vegetation; 0; 1; wires 14, poles 15
# and what is left 64.
CLASS_SCHEMES = ("usual", "none", "unclassified", "lines")
_LINE = (Material.POLE_WOOD, Material.FITTING, Material.WIRE, Material.STEEL_POST)
_OPEN = (Material.LEAVES, Material.BUSH, Material.WIRE)  # What lets a part of a pulse through.


@dataclass(frozen=True)
class AirborneScanner:
    """Aircraft and laser.

    Parameters
    ----------
    pulses_per_m2 : aimed at level ground, both lines together. half_width_m : of the corridor.
    flight_height_m : above the road. line_offset_m : of the two flight lines from the site's axis.
    range_sigma_m, plan_sigma_m : noise along and across the pulse.
    edge_error_share : points within a metre of the pavement's edge with the wrong class.
    hits_poles : whether returns on poles and wires are kept. class_scheme : of `CLASS_SCHEMES`.
    """

    pulses_per_m2: float = _USUAL.pulses_per_m2
    half_width_m: float = 60.0
    flight_height_m: float = 1000.0
    line_offset_m: float = 150.0
    range_sigma_m: float = 0.02
    plan_sigma_m: float = 0.02
    edge_error_share: float = 0.01
    hits_poles: bool = True
    class_scheme: str = _USUAL.class_scheme


@dataclass(frozen=True)
class Returns:
    """Measured points, local metres.

    Parameters
    ----------
    xyz_m : (n, 3). classification : (n,) ASPRS class as delivered. intensity : (n,) 16 bit.
    return_number, number_of_returns : (n,). line : (n,) flight line, 1 or 2.
    scan_angle_deg : (n,). object_id : (n,) of the site's mesh, truth.
    """

    xyz_m: Floats
    classification: Bytes
    intensity: NDArray[np.uint16]
    return_number: Bytes
    number_of_returns: Bytes
    line: NDArray[np.uint16]
    scan_angle_deg: Floats
    object_id: Ints32


def scan_rural(
    renderer: RuralRenderer, rng: np.random.Generator, scanner: AirborneScanner | None = None
) -> Iterator[Returns]:
    """Scan the corridor of the drive and 20 m beyond both ends, strip by strip of stations.

    Raises
    ------
    InputError : the density is not positive.
    """
    scanner = scanner or AirborneScanner()
    if not scanner.pulses_per_m2 > 0.0:
        raise InputError("must be positive", where="pulses_per_m2", found=scanner.pulses_per_m2)
    first, last = -20.0, renderer.site.length_m + 20.0
    for start in np.arange(first, last, _STRIP_M):
        yield _strip(renderer, start, min(start + _STRIP_M, last), scanner, rng)


def _strip(
    renderer: RuralRenderer,
    start_m: float,
    end_m: float,
    scanner: AirborneScanner,
    rng: np.random.Generator,
) -> Returns:
    """Every return of the pulses aimed at a stretch of road."""
    # Stations and offsets of a jittered grid with the wanted density.
    cell = 1.0 / np.sqrt(scanner.pulses_per_m2)
    station = np.arange(start_m, end_m, cell)
    offset = np.arange(-scanner.half_width_m, scanner.half_width_m, cell)
    grid = np.stack(np.meshgrid(station, offset, indexing="ij"), axis=-1).reshape(-1, 2)
    road = grid + rng.uniform(0.0, cell, grid.shape)
    line = rng.integers(0, 2, len(road))
    origin, ray, angle = _pulses(renderer, road, line, scanner)
    pulse, number, hits = _echoes(renderer, origin, ray, rng)
    classes, reflectance = _surfaces(renderer, hits)
    # Swap road and ground for some points near the pavement's edge.
    edge = renderer.site.ground.section.pavement_m
    near = np.abs(np.abs(hits.road_m[:, 1]) - edge) < _EDGE_M
    swap = near & np.isin(classes, (2, 11))
    swap &= rng.uniform(size=len(classes)) < scanner.edge_error_share
    classes = np.where(swap, 13 - classes, classes).astype(np.uint8)
    along = ray[pulse]
    classes = _in_scheme(renderer, hits, classes, scanner.class_scheme)
    noise = rng.normal(0.0, scanner.plan_sigma_m, (len(pulse), 3))
    noise += along * rng.normal(0.0, scanner.range_sigma_m, (len(pulse), 1))
    mesh = renderer.site.mesh
    facing = np.abs(np.einsum("ij,ij->i", along, mesh.normal[hits.triangle]))
    strength = reflectance * (0.35 + 0.65 * facing) * 0.75 ** (number - 1.0)
    strength *= np.exp(rng.normal(0.0, 0.08, len(pulse)))
    count = np.bincount(pulse, minlength=len(road))
    found = Returns(
        hits.place_m + noise,
        classes,
        np.clip(65535.0 * strength, 1.0, 65535.0).astype(np.uint16),
        number.astype(np.uint8),
        count[pulse].astype(np.uint8),
        (line[pulse] + 1).astype(np.uint16),
        angle[pulse],
        mesh.object_id[hits.triangle],
    )
    if scanner.hits_poles:
        return found
    kept = ~np.isin(mesh.material[hits.triangle], _LINE)
    columns = found.__dataclass_fields__
    return Returns(**{name: getattr(found, name)[kept] for name in columns})


def _in_scheme(renderer: RuralRenderer, hits: Cast, classes: Bytes, scheme: str) -> Bytes:
    """Classes as another producer delivers them."""
    if scheme == "usual":
        return classes
    if scheme != "lines":
        return np.full_like(classes, 0 if scheme == "none" else 1)
    material = renderer.site.mesh.material[hits.triangle]
    line = [material == Material.WIRE, np.isin(material, _LINE), classes == 1]
    return np.select(line, [np.uint8(14), np.uint8(15), np.uint8(64)], classes)


def _pulses(
    renderer: RuralRenderer, road: Floats, line: Ints, scanner: AirborneScanner
) -> tuple[Floats, Floats, Floats]:
    """Starts 90 m above ground, unit directions, and signed scan angles of pulses."""
    site = renderer.site
    target = np.column_stack([site.line.plan(*road.T), site.line.height(road[:, 0])])
    ends = site.line.plan(np.array([0.0, site.length_m]), 0.0)
    ahead = (ends[1] - ends[0]) / np.linalg.norm(ends[1] - ends[0])
    left = np.array([-ahead[1], ahead[0]])
    aside = (target[:, :2] - ends[0]) @ left
    wanted = np.where(line == 0, scanner.line_offset_m, -scanner.line_offset_m)
    lean = (aside - wanted) / scanner.flight_height_m
    ray = np.column_stack([lean[:, None] * left, -np.ones(len(lean))])
    ray /= np.linalg.norm(ray, axis=1, keepdims=True)
    start = target - ray * (_START_ABOVE_M / -ray[:, 2:])
    return start, ray, np.degrees(np.arctan(lean))


def _echoes(
    renderer: RuralRenderer, origin: Floats, ray: Floats, rng: np.random.Generator
) -> tuple[NDArray[np.intp], Ints, Cast]:
    """Pulse number, return number and surface of every return, by pulse and return."""
    pulse, number, parts = [], [], []
    active, start = np.arange(len(ray)), origin
    for turn in range(1, _MOST_RETURNS + 1):
        cast = renderer.cast(start, ray[active])
        met = np.flatnonzero(cast.triangle >= 0)
        hits = cast.take(met)
        active = active[met]
        pulse.append(active)
        number.append(np.full(len(met), turn))
        parts.append(hits)
        through = np.isin(renderer.site.mesh.material[hits.triangle], _OPEN)
        through &= rng.uniform(size=len(met)) < _GAP_SHARE
        active = active[through]
        gap = _GAP_M * rng.uniform(0.3, 2.0, (len(active), 1))
        start = hits.place_m[through] + gap * ray[active]
    joined = Cast(
        np.concatenate([p.range_m for p in parts]),
        np.concatenate([p.triangle for p in parts]),
        np.concatenate([p.place_m for p in parts]),
        np.concatenate([p.road_m for p in parts]),
    )
    pulses, numbers = np.concatenate(pulse), np.concatenate(number)
    order = np.lexsort((numbers, pulses))
    return pulses[order], numbers[order], joined.take(order)


def _surfaces(renderer: RuralRenderer, hits: Cast) -> tuple[Bytes, Floats]:
    """Class and reflectance of surfaces; vegetation by its height above the ground."""
    site = renderer.site
    material = site.mesh.material[hits.triangle]
    classes, reflectance = CLOUD_OF_MATERIAL[material], REFLECTANCE_OF_MATERIAL[material]
    plants = np.flatnonzero(classes == 5)
    road = site.line.road(hits.place_m[plants, :2])
    above = hits.place_m[plants, 2] - site.ground.height(*road.T)
    classes[plants] = np.select([above < _LOW_M, above < _MEDIUM_M], [3, 4], 5)
    ground = np.flatnonzero(material == Material.GROUND)
    at = hits.place_m[ground, :2], hits.road_m[ground]
    classes[ground] = CLOUD_OF_GROUND[ground_kinds(site.surface, *at, lines=False)]
    reflectance[ground] = REFLECTANCE_OF_GROUND[ground_kinds(site.surface, *at)]
    return classes, reflectance
