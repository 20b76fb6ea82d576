"""A mobile laser scanner that drives both carriageways of the sample site."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from roadsight.base.arrays import Bytes, Floats, Ints
from roadsight.base.errors import InputError
from roadsight_worlds.casting.alignment import heading_at, to_plan
from roadsight_worlds.casting.scene import rotation_zyx
from roadsight_worlds.highway.highway import Highway
from roadsight_worlds.highway.returns import LaserModel, measure

# Pulses of a trial that tells which share returns, so that the cloud gets about as many points as
# asked for.
_PILOT_PULSES = 20_000
# Pulses fired at once; they bound memory, and other numbers give other noise.
_CHUNK_PULSES = 400_000
_EVEN_SPACING_AT_M = 5.0  # Lines are as far apart here as the points on them.
_TURNAROUND_S = 120.0  # Between the drives on the two carriageways; GPS times jump by it.


@dataclass(frozen=True)
class MobileScanner:
    """Vehicle with two rotating profilers.

    Parameters
    ----------
    speed_m_s : of the vehicle.
    head_height_m : above the pavement.
    head_yaw_deg : each head's scan plane, turned about the vertical from square to the road.
    head_tilt_deg : how far the scan planes lean back.
    wobble_sigma_m : slow error of the trajectory along each axis.
    laser : the heads' lasers.
    """

    speed_m_s: float = 12.0
    head_height_m: float = 2.4
    head_yaw_deg: tuple[float, ...] = (45.0, -45.0)
    head_tilt_deg: float = 20.0
    wobble_sigma_m: float = 0.006
    laser: LaserModel = field(default_factory=LaserModel)


class Sweep(NamedTuple):
    """One head on one drive.

    Parameters
    ----------
    number : 1, 2, ... in the order of the file.
    offset_m : where the vehicle drives.
    forward : whether it drives towards rising stations.
    yaw_deg : of the head.
    start_s : time at which the drive starts.
    """

    number: int
    offset_m: float
    forward: bool
    yaw_deg: float
    start_s: float


@dataclass(frozen=True)
class PointChunk:
    """Measured points in the site's local frame.

    Parameters
    ----------
    xyz_m : (n, 3). intensity : (n,) 16 bit. time_s : (n,) since the start of the first drive.
    truth_class : (n,) `TruthClass`. sweep : (n,) number of the sweep.
    """

    xyz_m: Floats
    intensity: NDArray[np.uint16]
    time_s: Floats
    truth_class: Bytes
    sweep: NDArray[np.uint16]


def sweeps_of(highway: Highway, scanner: MobileScanner) -> list[Sweep]:
    """Every head in the outer lane of each carriageway, in the direction of its traffic."""
    lane = 0.5 * sum(highway.section.lane_edges_m[-2:])
    drive_s = highway.length_m / scanner.speed_m_s
    drives = ((-lane, True, 0.0), (lane, False, drive_s + _TURNAROUND_S))
    heads = [(*drive[:2], yaw, drive[2]) for drive in drives for yaw in scanner.head_yaw_deg]
    return [Sweep(number, *head) for number, head in enumerate(heads, start=1)]


def pulses(
    highway: Highway, scanner: MobileScanner, sweep: Sweep, elapsed_s: Floats, angle_rad: Floats
) -> tuple[Floats, Floats]:
    """Origins and unit directions (n, 3) of a head's pulses in the local frame.

    Parameters
    ----------
    elapsed_s : (n,) time since the start of the drive. angle_rad : (n,) turn of the mirror.
    """
    driven = scanner.speed_m_s * elapsed_s
    station = driven if sweep.forward else highway.length_m - driven
    plan = to_plan(
        highway.alignment, np.column_stack([station, np.full_like(station, sweep.offset_m)])
    )
    profile = np.interp(sweep.offset_m, *highway.section.profile())
    height = highway.terrain.height_m + highway.terrain.grade * station + profile
    heading = heading_at(highway.alignment, station) + (0.0 if sweep.forward else math.pi)
    mount = rotation_zyx(math.radians(sweep.yaw_deg), math.radians(scanner.head_tilt_deg))
    body = np.cos(angle_rad)[:, None] * mount[:, 1] + np.sin(angle_rad)[:, None] * mount[:, 2]
    cos, sin = np.cos(heading), np.sin(heading)
    ahead, left, up = body.T
    directions = np.column_stack([cos * ahead - sin * left, sin * ahead + cos * left, up])
    return np.column_stack([plan, height + scanner.head_height_m]), directions


def scan(
    highway: Highway, points: int, rng: np.random.Generator, scanner: MobileScanner | None = None
) -> Iterator[PointChunk]:
    """Scan the site with about ``points`` returns, in chunks of bounded size, by sweep and time.

    Raises
    ------
    InputError : fewer than 1,000 points are asked for.
    """
    if points < 1000:
        raise InputError(
            "too few points for a scan", where="points", found=points, allowed="1000 or more"
        )
    scanner = scanner or MobileScanner()
    sweeps = sweeps_of(highway, scanner)
    pulse_rate_hz = _pulse_rate_hz(highway, scanner, sweeps, points, rng)
    drives = dict.fromkeys(sweep.start_s for sweep in sweeps)  # both heads share a trajectory
    wobble = {start: _Wobble(scanner.wobble_sigma_m, rng) for start in drives}
    for sweep in sweeps:
        total = round(pulse_rate_hz * highway.length_m / scanner.speed_m_s)
        for first in range(0, total, _CHUNK_PULSES):
            number = np.arange(first, min(first + _CHUNK_PULSES, total))
            yield _chunk(highway, scanner, sweep, number, pulse_rate_hz, wobble[sweep.start_s], rng)


class _Wobble:
    """Slow error (n, 3) of the trajectory: a few waves of 3 s to 30 s along each axis."""

    def __init__(self, sigma_m: float, rng: np.random.Generator) -> None:
        waves = 5
        self.rate_rad_s = 2.0 * np.pi / rng.uniform(3.0, 30.0, (waves, 3))
        self.phase_rad = rng.uniform(0.0, 2.0 * np.pi, (waves, 3))
        self.amplitude_m = sigma_m * math.sqrt(2.0 / waves)

    def at(self, elapsed_s: Floats) -> Floats:
        waves = zip(self.rate_rad_s, self.phase_rad, strict=True)
        angles = (elapsed_s[:, None] * rate + phase for rate, phase in waves)
        return self.amplitude_m * sum((np.sin(a) for a in angles), np.zeros((len(elapsed_s), 3)))


def _pulse_rate_hz(
    highway: Highway,
    scanner: MobileScanner,
    sweeps: list[Sweep],
    points: int,
    rng: np.random.Generator,
) -> float:
    """Pulses per second and head for the wanted number of points, from a pilot scan."""
    quiet = replace(scanner.laser, mixed_edge_share=0.0, multipath_share=0.0, clutter_share=0.0)
    drive_s = highway.length_m / scanner.speed_m_s
    returned = 0
    for sweep in sweeps:
        elapsed = drive_s * (np.arange(_PILOT_PULSES) + 0.5) / _PILOT_PULSES
        angle = rng.uniform(0.0, 2.0 * np.pi, _PILOT_PULSES)
        rays = pulses(highway, scanner, sweep, elapsed, angle)
        returned += len(measure(highway, *rays, quiet, rng).pulse)
    return points / returned * _PILOT_PULSES / drive_s


def _chunk(
    highway: Highway,
    scanner: MobileScanner,
    sweep: Sweep,
    number: Ints,
    pulse_rate_hz: float,
    wobble: _Wobble,
    rng: np.random.Generator,
) -> PointChunk:
    """Fire the pulses with the given numbers.

    The mirror turns so fast that, 5 m away, lines are as far apart as the points on them.
    """
    line_rate_hz = math.sqrt(scanner.speed_m_s * pulse_rate_hz / (2 * np.pi * _EVEN_SPACING_AT_M))
    elapsed = number / pulse_rate_hz
    angle = 2.0 * np.pi * np.remainder(elapsed * line_rate_hz, 1.0)
    origins, directions = pulses(highway, scanner, sweep, elapsed, angle)
    echoes = measure(highway, origins, directions, scanner.laser, rng)
    hit = echoes.pulse
    xyz = origins[hit] + echoes.range_m[:, None] * directions[hit] + wobble.at(elapsed[hit])
    numbers = np.full(len(hit), sweep.number, np.uint16)
    times = sweep.start_s + elapsed[hit]
    return PointChunk(xyz, echoes.intensity, times, echoes.truth_class, numbers)
