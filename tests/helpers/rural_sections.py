"""Exact cross-sections of generated rural roads, and ground points as a scanner would give them."""

import numpy as np

from roadsight_worlds.rural.rural_ground import SIDE_ROAD, section_profile


def open_stations(site, side, step_m=7.0):
    """Stations where nothing bends the section on a side: no branch, no bridge."""
    stations = np.arange(20.0, site.length_m - 20, step_m)
    away = np.abs(stations - site.ground.gully_m) > 25
    for branch in site.ground.branches:
        reach = 24.0 if branch.kind == SIDE_ROAD else 16.0
        if branch.side == side:
            away &= np.abs(stations - branch.station_m) > reach
    return stations[away]


def true_hinges(site):
    """Hinges from the pavement's edge outwards (m) and the slopes between them."""
    offsets, heights = (np.array(a) for a in section_profile(site.ground.section))
    slopes = np.diff(heights) / np.diff(offsets)
    return offsets[1:] - offsets[1], slopes[1:]


def edge_and_outward(site, station, side):
    """Place of the pavement's edge and the way from it off the road, (2,) each."""
    at = site.line.plan(station, side * site.ground.section.pavement_m)
    beyond = site.line.plan(station, side * (site.ground.section.pavement_m + 1))
    return at, beyond - at


def exact_height(site):
    return lambda x, y: site.height(np.column_stack([x, y]))


def ground_points(site, rng, station_m=(0.0, 100.0), half_m=14.0, per_m2=20.0, sigma_m=0.02):
    """Ground points (n, 3) over a stretch of road, with noise upright."""
    low, high = station_m
    n = int((high - low) * 2 * half_m * per_m2)
    station, offset = rng.uniform(low, high, n), rng.uniform(-half_m, half_m, n)
    height = site.ground.height(station, offset) + rng.normal(0, sigma_m, n)
    return np.column_stack([site.line.plan(station, offset), height])
