"""Radius, grade, cross-slope and paved width of a road by station, with their uncertainty."""

from __future__ import annotations

import numpy as np
import pandas as pd

from roadsight.base.arrays import Floats, Ints
from roadsight.poles.risk.cross_sections import Height
from roadsight.poles.risk.roads import Road

STATION_M = 5.0  # spacing of the rows: a radius or grade changes little over it
# Radii are fitted by quartics over so much road either way: the longest that the noise explains. On
# 12 generated roads whose edges err as those of the generated scan (3.4 cm, alike over 6 m), 45 m
# are the best of 35 to 50: 95 % of the stations on arcs of 190 to 380 m are within 4.1 % (35 m:
# 6.4). On an arc of 30 m, 45 m are 18 % off and 18 m 3 %.
CURVE_HALVES_M = (45.0, 35.0, 25.0, 18.0)
# Noise explains a misfit up to so many times that of the centreline: with 1.0 a fifth of the gentle
# bends lose their long fit to chance (95 % within 5.4 %), with 2 arcs of 60 m are 10 % off, not 6.
_EXPLAINED = 1.5
# Grades are fitted by cubics over so much road either way; parabolas lose 0.1 % where the grade
# changes as on the generated roads.
GRADE_HALF_M = 25.0
# Heights of a grade are means over so much of the road: five have less noise than one.
_ABREAST_M = (-1.2, -0.6, 0.0, 0.6, 1.2)
WIDTH_HALF_M = 5.0  # widths are medians over so much road either way
# Greater radii are told from straight by nobody: the offset over 60 m is below 0.1 m.
STRAIGHT_M = 5000.0
# So many neighbours share their error: strips of edge points overlap by half (`roads._between`),
# terrain cells of 0.5 m reach over two heights.
_CORRELATION = 2.0
COLUMNS = (
    "road", "station_m", "x", "y", "z", "heading_deg", "radius_m", "bend", "curvature_per_km",
    "sigma_curvature_per_km", "grade_percent", "sigma_grade_percent", "cross_slope_left_percent",
    "cross_slope_right_percent", "sigma_cross_slope_percent", "paved_width_m",
    "sigma_paved_width_m",
)  # fmt: skip


def road_geometry(road: Road, height: Height | None, every_m: float = STATION_M) -> pd.DataFrame:
    """Geometry of a road.

    Parameters
    ----------
    height : ground height (m) at x and y; None or NaN where unknown.
    every_m : spacing of the rows, which lie at whole multiples of it.

    Returns
    -------
    columns `COLUMNS`. ``radius_m`` is infinite where straight: where the curvature is below two
    sigmas, or below 1 / `STRAIGHT_M`; ``bend`` is left, right or straight in
    the direction of rising measure; grades are positive uphill in that direction; cross-slopes are
    negative where the pavement falls away from the centreline. NaN where unknown, ``bend`` empty: a
    road of less than seven metres has no radius.
    """
    first = np.ceil(road.start_m / every_m) * every_m
    stations = np.arange(first, road.end_m + 1e-6, every_m)
    curvature = np.array([_curvature(road, s) for s in stations]).reshape(-1, 2)
    grade = np.array([_grade(road, s, height) for s in stations]).reshape(-1, 3)
    width = np.array([_width(road, s) for s in stations]).reshape(-1, 2)
    slopes = np.array([_cross_slopes(road, s, height) for s in stations]).reshape(-1, 3)
    place, way = road.place(stations), road.direction(stations)
    size = np.abs(curvature[:, 0])
    straight = np.isfinite(size) & ~(size > np.maximum(2 * curvature[:, 1], 1 / STRAIGHT_M))
    radius = 1.0 / np.where(straight, 1.0, size)
    turns = [straight, curvature[:, 0] > 0, curvature[:, 0] < 0]
    bend = np.select(turns, ["straight", "left", "right"], "")
    columns = [
        np.full(len(stations), road.name, object),
        stations,
        *place.T,
        grade[:, 2],
        np.degrees(np.arctan2(way[:, 0], way[:, 1])) % 360,
        np.where(straight, np.inf, radius),
        bend.astype(object),
        *(1000 * curvature).T,
        *(100 * grade[:, :2]).T,
        *(100 * slopes).T,
        *width.T,
    ]
    return pd.DataFrame(dict(zip(COLUMNS, columns, strict=True)))


def _curvature(road: Road, station: float) -> tuple[float, float]:
    """Curvature (1/m, positive to the left) and its sigma, from a quartic across the chord.

    The sigma holds the noise, and how much a shorter fit differs: what the bend itself does within
    the fit. Errors on generated roads are 1.0 (the generated scan) to 1.7 of it.
    """
    found = []
    for half in CURVE_HALVES_M:
        rows = _near(road, station, half)
        if len(rows) < 8:
            break
        origin, way = road.place(np.array([station]))[0], road.direction(np.array([station]))[0]
        gap = road.xy_m[rows] - origin
        along, across = gap @ way, gap @ np.array([-way[1], way[0]])
        fitted, covariance, misfit = _fit(along / half, across, 4, road.noise_m)
        first, second = fitted[1] / half, 2 * fitted[2] / half**2
        # Errors of edges are alike over 6 m, and smoothing carries them further: without the
        # factor, errors on generated roads are 2 to 3 sigma (root mean square).
        sigma = 2 * np.sqrt(4 * covariance[2, 2]) / half**2
        found.append((float(second / (1 + first**2) ** 1.5), float(sigma), misfit))
        if len(found) > 1 and not found[-2][2] > _EXPLAINED * road.noise_m:
            curvature, sigma = found[-2][:2]
            return curvature, float(np.hypot(sigma, found[-1][0] - curvature))
    return found[-1][:2] if found else (float("nan"), float("nan"))


def _grade(road: Road, station: float, height: Height | None) -> tuple[float, float, float]:
    """Grade, its sigma and the height at a station, from a quadratic along the centreline."""
    nan = (float("nan"),) * 3
    rows = _near(road, station, GRADE_HALF_M)
    if height is None or len(rows) < 8:
        return nan
    abreast = [road.place(road.station_m[rows], offset) for offset in _ABREAST_M]
    heights = np.mean([np.asarray(height(p[:, 0], p[:, 1]), np.float64) for p in abreast], axis=0)
    known = np.isfinite(heights)
    if known.sum() < 8:
        return nan
    along = (road.station_m[rows] - station)[known] / GRADE_HALF_M
    fitted, covariance, _ = _fit(along, heights[known], 3)
    at = road.place(np.array([station]))
    # Distances in plan, whatever the measure counts.
    plan = np.hypot(*np.diff(road.xy_m[rows], axis=0).T).sum()
    scale = float(plan / (road.station_m[rows[-1]] - road.station_m[rows[0]]))
    return (
        float(fitted[1] / GRADE_HALF_M / scale),
        float(np.sqrt(covariance[1, 1]) / GRADE_HALF_M / scale),
        float(np.asarray(height(at[:, 0], at[:, 1]))[0]),
    )


def _cross_slopes(road: Road, station: float, height: Height | None) -> tuple[float, float, float]:
    """Slope of the pavement left and right of the centreline, and the greater sigma of the two."""
    nan = float("nan")
    if height is None:
        return nan, nan, nan
    found, sigmas = [], []
    at = station + np.arange(-2.0, 2.1, 1.0)
    at = at[(at >= road.start_m) & (at <= road.end_m)]
    for side in (-1, 1):
        edge = float(road.edge_m(np.array([station]), np.array([side]))[0])
        if not np.isfinite(edge) or edge < 1.2 or not len(at):
            found.append(nan)
            continue
        # The edge itself is where heights of ground and pavement mix.
        away = np.arange(0.3, edge - 0.3, 0.25)
        rows = [road.place(np.full(len(away), s), side * away) for s in at]
        heights = np.array([height(p[:, 0], p[:, 1]) for p in rows], np.float64)
        level = np.nanmean(heights, axis=0) if np.isfinite(heights).any() else heights[0]
        known = np.isfinite(level)
        if known.sum() < 4:
            found.append(nan)
            continue
        fitted, covariance, _ = _fit(away[known], level[known], 1)
        found.append(float(fitted[1]))
        sigmas.append(float(np.sqrt(covariance[1, 1])))
    return found[0], found[1], max(sigmas, default=nan)


def _width(road: Road, station: float) -> tuple[float, float]:
    """Paved width and its sigma: the median of what is known near."""
    rows = _near(road, station, WIDTH_HALF_M)
    widths = (road.left_m + road.right_m)[rows]
    widths = widths[np.isfinite(widths)]
    if len(widths) < 3:
        return float("nan"), float("nan")
    middle = float(np.median(widths))
    spread = 1.4826 * float(np.median(np.abs(widths - middle)))
    return middle, 1.2533 * spread / np.sqrt(len(widths) / 2)


def _near(road: Road, station: float, half_m: float) -> Ints:
    """Rows of the centreline near a station; at the ends the window shifts inwards."""
    inner = min(half_m, (road.end_m - road.start_m) / 2)
    middle = np.clip(station, road.start_m + inner, road.end_m - inner)
    return np.flatnonzero(np.abs(road.station_m - middle) <= half_m)


def _fit(
    x: Floats, y: Floats, degree: int, sigma: float = float("nan")
) -> tuple[Floats, Floats, float]:
    """Polynomial by least squares: coefficients from the constant up, their covariance, misfit.

    One y has the given sigma, or that of the misfit if it is NaN or less.
    """
    design = np.vander(x, degree + 1, increasing=True)
    fitted, *_ = np.linalg.lstsq(design, y, rcond=None)
    left = y - design @ fitted
    variance = float(left @ left) / max(len(x) - degree - 1, 1)
    misfit = float(np.sqrt(variance))
    if np.isfinite(sigma):
        variance = max(variance, sigma**2)
    covariance = _CORRELATION * variance * np.linalg.pinv(design.T @ design)
    return np.asarray(fitted, np.float64), np.asarray(covariance, np.float64), misfit
