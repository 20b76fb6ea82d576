"""Weather, mounts, reflectivity, lanes and lenses: what effects are made of."""

from __future__ import annotations

import numpy as np
import pandas as pd
from scipy.special import lambertw
from shapely import LineString, MultiPolygon, Polygon

from roadsight.base.arrays import Numbers
from roadsight.geometry.lens import RadialLens
from roadsight.placement.sensors.light import (
    fog_extinction_per_m,
    rain_extinction_per_m,
    range_in_air_m,
)
from roadsight.placement.sensors.poses import road_normals, tilt_rotation
from roadsight.placement.sight.lanes import trace_lanes
from roadsight.poles.drive.drive_profile import beside_track
from roadsight.scene.pavement.reflectivity import ASPHALT, reflectivity_of
from roadsight_hardcases.case import Errors, hard_case


@hard_case("model_fog", bound=1e-6, unit="m")
def range_in_dense_fog(rng: np.random.Generator) -> Errors:
    """Repeating r = R exp(-a r) never settles in dense fog: it jumps between nothing and all."""
    extinction = np.array([fog_extinction_per_m(v, 905.0) for v in (30.0, 50.0, 100.0, 200.0)])
    clear_m = 120.0
    naive = np.full(len(extinction), clear_m)
    for _ in range(200):
        naive = clear_m * np.exp(-extinction * naive)
    ours = np.array([float(range_in_air_m(clear_m, a)) for a in extinction])

    def off_m(range_m: Numbers) -> float:
        """Distance to the root, by Newton's step at the found range."""
        excess = np.log(range_m) + extinction * range_m - np.log(clear_m)
        return float(np.abs(excess / (1 / range_m + extinction)).max())

    return off_m(np.maximum(naive, 1e-12)), off_m(ours)


@hard_case("model_rain", bound=1e-6, unit="m")
def range_without_rain(rng: np.random.Generator) -> Errors:
    """Lambert's W of nothing over nothing: the range in clear air is no number."""
    naive = ours = 0.0
    for rain_mm_h in (0.0, 1e-300):
        extinction = rain_extinction_per_m(rain_mm_h)
        found = np.divide(lambertw(extinction * 120.0).real, np.float64(extinction))
        naive = max(naive, float(np.nan_to_num(abs(found - 120.0), nan=120.0)))
        ours = max(ours, abs(float(range_in_air_m(120.0, extinction)) - 120.0))
    return naive, ours


@hard_case("tilt_mounts", bound=1e-9, unit="error of a turned unit vector")
def level_ground_has_no_axis(rng: np.random.Generator) -> Errors:
    """A mount on level ground turns about an axis of no length: zero over zero."""
    normal = np.array([0.0, 0.0, 1.0])
    axis = np.cross([0.0, 0.0, 1.0], normal)
    angle, unit = np.arccos(normal[2]), axis / np.linalg.norm(axis)
    cross = np.array([[0, -unit[2], unit[1]], [unit[2], 0, -unit[0]], [-unit[1], unit[0], 0]])
    naive = np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross
    off = [np.linalg.norm(turn[:, 2] - normal) for turn in (naive, tilt_rotation(normal))]
    return np.nan_to_num(off[0], nan=1.0), off[1]


@hard_case("tilt_mounts", bound=5.0, unit="deg")
def mounts_at_the_end_of_the_terrain(rng: np.random.Generator) -> Errors:
    """Beside the end of the terrain a slope from unknown heights is NaN; ours takes it as level."""
    # The road is looked at four metres before the mount, to the west.
    places = np.column_stack([np.full(10, 5.0), np.linspace(5, 45, 10)])
    before = places - np.array([4.0, 0.0])

    def height(x: Numbers, y: Numbers) -> Numbers:
        return np.where(np.asarray(x) < 0, np.nan, 0.05 * np.asarray(x))

    east, west = (height(before[:, 0] + step, before[:, 1]) for step in (3.0, -3.0))
    true = np.array([-0.05, 0.0, 1.0]) / np.hypot(0.05, 1.0)
    slope = (east - west) / 6.0
    naive = np.column_stack([-slope, np.zeros(10), np.ones(10)]) / np.hypot(slope, 1.0)[:, None]
    found = road_normals(places, np.full(10, 180.0), height)
    return tuple(np.degrees(np.arccos(normals @ true)).max() for normals in (naive, found))


@hard_case("measure_reflectivity", bound=0.5, unit="surfaces without a reflectivity")
def cloud_without_intensity(rng: np.random.Generator) -> Errors:
    """Intensities relative to the pavement's are zero over zero without any: asphalt is assumed."""
    nothing = np.zeros(200)
    naive = nothing / np.median(nothing[:50]) * ASPHALT
    return np.isnan(naive).sum(), np.isnan(reflectivity_of(nothing, nothing[:50])).sum()


@hard_case("profile_drive", bound=0.1, unit="m")
def roadside_of_a_road_to_the_north(rng: np.random.Generator) -> Errors:
    """Between headings of 359 and 1 degrees, interpolation passes through south."""
    y = 8.0 * np.arange(30.0)
    heading = np.where(np.arange(30) % 2, 359.0, 1.0)
    drive = pd.DataFrame({"x": 0.0, "y": y, "heading_deg": heading, "sequence": range(30)})
    station = np.arange(0.0, y[-1], 4.0)
    turn = np.radians(np.interp(station, y, heading))
    naive = np.concatenate([side * 6.0 * np.cos(turn) for side in (-1.0, 1.0)])
    right = np.repeat([-6.0, 6.0], len(station))
    ours = beside_track(drive, (6.0,))[:, 0]
    return np.abs(naive - right).max(), np.abs(ours - right).max()


@hard_case("trace_lanes", bound=0.02, unit="share of stations with another number of lanes")
def rough_outline_of_the_road(rng: np.random.Generator) -> Errors:
    """Where a road is about two lanes wide, every dent of its outline takes a lane away."""
    y = np.arange(0.0, 200.5, 0.5)
    left, right = -4.25 + rng.normal(0, 0.15, len(y)), 4.25 + rng.normal(0, 0.15, len(y))
    ring = np.concatenate([np.column_stack([left, y]), np.column_stack([right, y])[::-1]])
    road, edge = MultiPolygon([Polygon(ring).buffer(0)]), LineString([(-4.6, 0), (-4.6, 200)])
    at = np.arange(0, len(y), 4)
    naive = np.floor((right - left - 1.0)[at] / 3.6) != 2
    lanes = trace_lanes([edge], road, 3.6).groupby("station_m")["lane"].nunique()
    return naive.mean(), np.mean(lanes.to_numpy() != 2)


@hard_case("undistort_views", bound=0.01, unit="px")
def inverse_of_a_wide_lens(rng: np.random.Generator) -> Errors:
    """The inverse of distortion by the same formula with the signs changed fails in the corners."""
    lens = RadialLens.centred(-0.28, 0.07, 1920, 1200, 1100.0)
    uv = rng.uniform([0, 0], [1919, 1199], (2000, 2))
    centre = np.array([lens.cx_px, lens.cy_px])
    shown = (lens.distort(uv) - centre) / lens.scale_px
    r2 = (shown**2).sum(axis=1)
    naive = shown * (1 + 0.28 * r2 - 0.07 * r2**2)[:, None] * lens.scale_px + centre
    ours = lens.undistort(lens.distort(uv))
    return np.hypot(*(naive - uv).T).max(), np.hypot(*(ours - uv).T).max()
