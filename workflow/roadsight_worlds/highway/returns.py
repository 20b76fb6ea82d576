"""What a pulse brings back: signal, lost returns, range noise and false points."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from roadsight.base.arrays import Bytes, Floats, Ints, Ints32
from roadsight_worlds.casting.materials import MATERIAL_NAMES, MATERIALS, TruthClass
from roadsight_worlds.highway.highway import Highway

# By row of `MATERIAL_NAMES`.
_REFLECTANCE = np.array([MATERIALS[name].reflectance for name in MATERIAL_NAMES])
_ROUGHNESS_M = np.array([MATERIALS[name].roughness_m for name in MATERIAL_NAMES])
_HALF_SIGNAL_M = 30.0  # Range at which intensity has fallen to half.


@dataclass(frozen=True)
class LaserModel:
    """Imperfections of the laser.

    Parameters
    ----------
    min_range_m, max_range_m : no returns nearer or farther.
    range_sigma_m : white noise of the range.
    weakest_signal_per_m2 : reflectance times cosine of incidence over squared range that is
        detected half of the time.
    signal_spread : sigma of the logarithm of the signal.
    mixed_edge_share : share of pulses at a jump between objects whose range falls in between.
    multipath_share : share of ground returns that arrive late, so below the ground.
    clutter_share : share of pulses stopped in the air by dust, insects or birds.
    """

    min_range_m: float = 1.5
    max_range_m: float = 100.0
    range_sigma_m: float = 0.005
    weakest_signal_per_m2: float = 2.5e-6
    signal_spread: float = 0.3
    mixed_edge_share: float = 0.03
    multipath_share: float = 2e-4
    clutter_share: float = 1e-4


@dataclass(frozen=True)
class Echoes:
    """Returns of a run of pulses, one row each.

    Parameters
    ----------
    pulse : (n,) which pulse of the run, ascending.
    range_m : (n,) measured range. intensity : (n,) 16 bit. truth_class : (n,) `TruthClass`.
    """

    pulse: Ints
    range_m: Floats
    intensity: NDArray[np.uint16]
    truth_class: Bytes


def measure(
    highway: Highway,
    origins_m: Floats,
    directions: Floats,
    laser: LaserModel,
    rng: np.random.Generator,
) -> Echoes:
    """Fire consecutive pulses (n, 3) and tell what comes back.

    Parameters
    ----------
    origins_m, directions : (n, 3) local metres and unit vectors, in the order of firing.
    """
    ranges, objects, normals = highway.scene.cast(origins_m, directions, laser.max_range_m)
    pulse = np.flatnonzero(ranges >= laser.min_range_m)
    pulse = pulse[objects[pulse] >= 0]
    surface_m, object_id = ranges[pulse], objects[pulse]
    plan = origins_m[pulse, :2] + surface_m[:, None] * directions[pulse, :2]
    things = highway.scene.objects
    material = np.array([MATERIAL_NAMES.index(o.material) for o in things], np.uint8)[object_id]
    truth = np.array([o.truth_class for o in things], np.uint8)[object_id]
    ground = object_id == highway.terrain.object_id
    material[ground] = highway.ground_materials(plan[ground])
    truth[ground] = highway.ground_classes(plan[ground])
    cosine = np.abs(np.einsum("ij,ij->i", normals[pulse], directions[pulse]))
    strength = _REFLECTANCE[material] * np.exp(rng.normal(0.0, laser.signal_spread, len(pulse)))
    heard = strength * cosine >= laser.weakest_signal_per_m2 * surface_m**2
    # On a 16 bit scale, weaker with range and incidence, 5 % speckle.
    attenuation = np.sqrt(cosine) / (1.0 + (surface_m / _HALF_SIGNAL_M) ** 2)
    speckle = np.exp(rng.normal(0.0, 0.05, len(surface_m)))
    light = 65535.0 * _REFLECTANCE[material] * attenuation * speckle
    intensity = np.clip(light, 1.0, 65535.0).astype(np.uint16)
    noise = rng.normal(0.0, 1.0, len(pulse))
    measured = surface_m + noise * np.hypot(laser.range_sigma_m, _ROUGHNESS_M[material])
    measured, truth = _mixed_edges(pulse, object_id, surface_m, measured, truth, laser, rng)
    # Some returns of road and ground arrive late.
    chance, delay = rng.random(len(truth)), rng.uniform(0.3, 3.0, len(truth))
    late = np.isin(truth, (TruthClass.ROAD, TruthClass.GROUND)) & (chance < laser.multipath_share)
    measured = measured + np.where(late, delay, 0.0)
    truth = np.where(late, TruthClass.LOW_NOISE, truth)
    echoes = Echoes(pulse[heard], measured[heard], intensity[heard], truth[heard])
    return _with_clutter(echoes, ranges, laser, rng)


def _mixed_edges(
    pulse: Ints,
    object_id: Ints32,
    surface_m: Floats,
    measured_m: Floats,
    truth: Bytes,
    laser: LaserModel,
    rng: np.random.Generator,
) -> tuple[Floats, Bytes]:
    """Some pulses that straddle the edge between two objects get a range in between."""
    chance, share = rng.random(len(pulse)), rng.uniform(0.15, 0.85, len(pulse))
    before = np.concatenate([surface_m[:1], surface_m[:-1]])
    edge = np.zeros(len(pulse), dtype=bool)
    edge[1:] = (np.diff(pulse) == 1) & (np.diff(object_id) != 0)
    edge &= (np.abs(surface_m - before) > 0.3) & (chance < laser.mixed_edge_share)
    mixed = surface_m + share * (before - surface_m)
    return np.where(edge, mixed, measured_m), np.where(edge, TruthClass.LOW_NOISE, truth)


def _with_clutter(
    echoes: Echoes, surface_m: Floats, laser: LaserModel, rng: np.random.Generator
) -> Echoes:
    """Some pulses end in the air, at most 30 m away; they replace what lies behind."""
    stopped = np.flatnonzero(rng.random(len(surface_m)) < laser.clutter_share)
    farthest = np.minimum(surface_m[stopped], 30.0)
    stopped = stopped[farthest > laser.min_range_m]
    farthest = farthest[farthest > laser.min_range_m]
    ranges = rng.uniform(laser.min_range_m, farthest)
    keep = ~np.isin(echoes.pulse, stopped)
    pulse = np.concatenate([echoes.pulse[keep], stopped])
    order = np.argsort(pulse, kind="stable")
    faint = rng.integers(200, 3000, len(stopped)).astype(np.uint16)
    high = np.full(len(stopped), TruthClass.HIGH_NOISE, np.uint8)
    return Echoes(
        pulse[order],
        np.concatenate([echoes.range_m[keep], ranges])[order],
        np.concatenate([echoes.intensity[keep], faint])[order],
        np.concatenate([echoes.truth_class[keep], high])[order],
    )
