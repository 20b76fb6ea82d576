"""Simulated drives past poles whose rays are known: straight and bent, dense and sparse."""

from dataclasses import dataclass

import numpy as np

from roadsight.poles.triangulate.rays import make_rays


@dataclass(frozen=True)
class Drive:
    """Errors of sightings and where poles stand; lengths in metres, angles in degrees."""

    poles: int = 40
    gap_m: float = 20.0
    step_m: float = 8.0
    bend_m: float = np.inf
    reach_m: float = 24.0
    place_m: float = 0.5
    drift_m: float = 0.0
    turn_deg: float = 1.0
    depth: float = 0.2
    hidden: float = 0.0
    shown: float = 0.85
    strays: float = 0.0


def simulate(drive, seed):
    """Poles (p, 2), and rows of x, y, bearing, depth, image and pole (-1: a stray)."""
    rng = np.random.default_rng(seed)
    along = np.cumsum(rng.uniform(0.5, 1.5, drive.poles) * drive.gap_m)
    aside = rng.choice([-1.0, 1.0], drive.poles) * rng.uniform(3.5, 9.0, drive.poles)
    poles = on_road(drive, along, aside)
    stations = np.arange(0.0, along[-1] + 10.0, drive.step_m)
    farther = 1.0 + rng.exponential(drive.hidden, len(poles)) * (drive.hidden > 0)
    wander = np.zeros(2)
    rows = []
    for image, true in enumerate(on_road(drive, stations, np.zeros(len(stations)))):
        keep = np.exp(-drive.step_m / 70.0) if image else 0.0
        wander = keep * wander + np.sqrt(1 - keep**2) * rng.normal(0, 1, 2) * drive.drift_m
        camera = true + wander + rng.normal(0, drive.place_m, 2)
        gap = poles - true
        away, bearing = np.hypot(*gap.T), np.degrees(np.arctan2(*gap.T))
        for pole in np.flatnonzero((away < drive.reach_m) & (away > 2.5)):
            if rng.random() < drive.shown:
                turned = bearing[pole] + rng.normal(0, drive.turn_deg)
                depth = away[pole] * farther[pole] * np.exp(rng.normal(0, drive.depth))
                rows.append((*camera, turned, depth, image, pole))
        for _ in range(rng.poisson(drive.strays)):
            rows.append((*camera, rng.uniform(0, 360), rng.uniform(4, drive.reach_m), image, -1))
    return poles, np.array(rows)


def on_road(drive, along, aside):
    """Places (n, 2) beside a road that turns left with a radius and goes on."""
    if not np.isfinite(drive.bend_m):
        return np.column_stack([along, aside])
    turn = along / drive.bend_m
    radius = drive.bend_m + aside
    return np.column_stack([radius * np.sin(turn), drive.bend_m - radius * np.cos(turn)])


def rays_and_poles(rows):
    """Rays, and the pole that each shows."""
    rays = make_rays(rows[:, :2], rows[:, 2], rows[:, 3], image=rows[:, 4].astype(int))
    return rays, rows[rays.row, 5].astype(int)
