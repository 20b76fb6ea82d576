"""What lies beside the road, from its edge outwards: shoulder, foreslope, ditch, backslope.

Names follow the AASHTO Roadside Design Guide, 4th edition (2011), chapter 3: a foreslope falls
from the shoulder, a backslope rises beyond the ditch; slopes are written 1V:nH.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from roadsight.base.arrays import Floats
from roadsight.poles.risk.profiles import (
    STEP_M,
    Pieces,
    Profile,
    binned_profile,
    fit_pieces,
    steepest,
)

Height = Callable[[Floats, Floats], Floats]
# 1V:10H: the guide counts flatter ground as level for placing barriers and as a drivable shoulder
# (RDG 5.6.2.1); shoulders are built with 2 to 8 %.
LEVEL_SLOPE = 0.1
SHOULDER_M = 3.7  # wider level ground beside the pavement is no shoulder: AASHTO's widest is 12 ft
# Level ground between a foreslope and a backslope is a ditch's bottom up to this width.
BOTTOM_M = 3.6
KERB_M = 0.3  # higher steps up are walls: kerbs are 0.1 to 0.2 m high
_FEWEST = 6  # points of a strip, and heights of a profile
_NARROW_M = 0.5  # narrower foreslopes count only where nothing wider falls
_BIN_M = 0.2  # of points of the ground
_STRIP_HALF_M = 3.0  # the strip across the road reaches so far either way along it
_POOLED_M = 9.0  # strips so far beyond the middle one are pooled with it
_MANY = 3  # strips from which on bins are half as wide
_STRIP_M = 3.0  # length of such a strip along the road
_SHIFTS = 3  # steps in which a strip is moved onto the middle one
# A strip whose section lies farther aside is of another: on a bend of 80 m radius the farthest is
# 0.35 m aside.
_MOST_ASIDE_M = 0.5
# Mean square of a strip's misfit in sigmas up to which it has the same section; about 1.3 is due to
# noise of both.
_ALIKE = 2.0
_FAR = 5.0  # single misfits count no more sigmas than this
KINDS = ("shoulder", "foreslope", "ditch bottom", "backslope", "level", "kerb", "drop-off", "wall")


@dataclass(frozen=True)
class Element:
    """Part of a cross-section.

    Parameters
    ----------
    kind : one of `KINDS`. start_m, end_m : from the road's edge; alike for steps.
    sigma_width_m : of end_m - start_m. slope : rise over run; of a step NaN. rise_m : end to end.
    """

    kind: str
    start_m: float
    end_m: float
    sigma_width_m: float
    slope: float
    sigma_slope: float
    rise_m: float

    @property
    def width_m(self) -> float:
        """Width in plan."""
        return self.end_m - self.start_m


@dataclass(frozen=True)
class CrossSection:
    """Half a road's cross-section outside of its edge.

    Parameters
    ----------
    profile, pieces : what was measured, and as straight pieces.
    elements : from the edge outwards.
    fall, rise : steepest mean slope over a window each way: slope, sigma, start (m).
    """

    profile: Profile
    pieces: Pieces
    elements: tuple[Element, ...]
    fall: tuple[float, float, float]
    rise: tuple[float, float, float]

    def foreslope(self, up_to_m: float = np.inf) -> tuple[float, float]:
        """Slope and sigma of the steepest foreslope that starts before ``up_to_m``; else 0, NaN."""
        found = [e for e in self.elements if e.kind == "foreslope" and e.start_m < up_to_m]
        wide = [e for e in found if e.width_m >= _NARROW_M] or found
        if not wide:
            return 0.0, float("nan")
        worst = min(wide, key=lambda e: e.slope)
        return worst.slope, worst.sigma_slope

    def backslope(self, up_to_m: float = np.inf) -> tuple[float, float]:
        """Slope and sigma of the steepest backslope that starts before ``up_to_m``; else 0, NaN."""
        found = [e for e in self.elements if e.kind == "backslope" and e.start_m < up_to_m]
        if not found:
            return 0.0, float("nan")
        worst = max(found, key=lambda e: e.slope)
        return worst.slope, worst.sigma_slope

    def width_m(self, kind: str) -> float:
        """Total width of the elements of a kind."""
        return float(sum(e.width_m for e in self.elements if e.kind == kind))

    def steps(self) -> list[Element]:
        """Kerbs, drop-offs and walls."""
        return [e for e in self.elements if e.kind in ("kerb", "drop-off", "wall")]


def slope_text(slope: float) -> str:
    """A slope as the guide writes it: 1V:2.3H, level, or unknown."""
    if not np.isfinite(slope):
        return "unknown"
    return "level" if abs(slope) < 0.01 else f"1V:{1 / abs(slope):.1f}H"


def cross_section(profile: Profile) -> CrossSection | None:
    """Cross-section of a profile; None where it has fewer than six heights."""
    if len(profile) < 6:
        return None
    pieces = fit_pieces(profile)
    fall, rise = (steepest(pieces, sign) for sign in (-1, +1))
    return CrossSection(profile, pieces, name_elements(pieces), fall, rise)


def name_elements(pieces: Pieces) -> tuple[Element, ...]:
    """Names of the pieces from the edge outwards, and the steps between them."""
    by_slope = [pieces.slope <= -LEVEL_SLOPE, pieces.slope >= LEVEL_SLOPE]
    kinds = np.select(by_slope, ["foreslope", "backslope"], "level").tolist()
    widths = np.diff(pieces.ends_m)
    lead = 0
    while lead < len(kinds) and kinds[lead] == "level":
        lead += 1
    # Level ground beside the pavement is a shoulder if something else follows it in time.
    if 0 < lead < len(kinds) and widths[:lead].sum() <= SHOULDER_M:
        kinds[:lead] = ["shoulder"] * lead
    for number in range(1, len(kinds) - 1):
        between = kinds[number - 1] == "foreslope" and kinds[number + 1] == "backslope"
        if kinds[number] == "level" and between and widths[number] <= BOTTOM_M:
            kinds[number] = "ditch bottom"
    found: list[Element] = []
    for number, kind in enumerate(kinds):
        start, end = pieces.ends_m[number : number + 2]
        sigma = float(np.hypot(*pieces.sigma_ends_m[number : number + 2]))
        slope, sigma_slope = pieces.slope[number], pieces.sigma_slope[number]
        numbers = (start, end, sigma, slope, sigma_slope, slope * (end - start))
        found.append(Element(kind, *map(float, numbers)))
        if number < len(kinds) - 1 and abs(pieces.jump_m[number]) >= STEP_M * 0.8:
            jump = float(pieces.jump_m[number])
            name = "drop-off" if jump < 0 else ("kerb" if jump <= KERB_M else "wall")
            sigma = float(pieces.sigma_ends_m[number + 1])
            nan = float("nan")
            found.append(Element(name, float(end), float(end), sigma, nan, nan, jump))
    return tuple(found)


def profile_from_heights(
    edge_m: Floats, outward: Floats, height: Height, reach_m: float, step_m: float = 0.1
) -> Profile:
    """Profile of a surface from the road's edge outwards.

    Parameters
    ----------
    edge_m : (2,) place of the edge. outward : (2,) unit vector. height : see `Height`, NaN unknown.
    """
    run = np.arange(0.0, reach_m + step_m / 2, step_m)
    places = edge_m + run[:, None] * outward
    heights = np.asarray(height(places[:, 0], places[:, 1]), np.float64)
    return binned_profile(run, heights - _level_at_edge(run, heights), step_m)


def profile_from_points(
    edge_m: Floats, outward: Floats, points_m: Floats, reach_m: float, tree: cKDTree | None = None
) -> Profile:
    """Profile of the ground points of a strip across the road, its slope along the road removed.

    Strips beside it that have the same cross-section, moved by a bend or a grade at most, are
    pooled with it: one alone does not tell the slope of a narrow bottom.

    Parameters
    ----------
    points_m : (n, 3) ground points. tree : of their plan places, if at hand.
    """
    middle = edge_m + outward * reach_m / 2
    tree = cKDTree(points_m[:, :2]) if tree is None else tree
    far_m = _STRIP_HALF_M + _POOLED_M
    around = tree.query_ball_point(middle, np.hypot(reach_m / 2 + _BIN_M, far_m))
    rows = np.array(sorted(around), int)
    gap = points_m[rows, :2] - edge_m
    run = gap @ outward
    along = gap @ np.array([-outward[1], outward[0]])
    inside = (run >= -_BIN_M / 2) & (run <= reach_m) & (np.abs(along) <= far_m)
    strips = []
    for side in (-1, 1):
        for low in np.arange(_STRIP_HALF_M, far_m - 1e-9, _STRIP_M):
            part = inside & (side * along > low) & (side * along <= low + _STRIP_M)
            if part.sum() >= _FEWEST:
                strips.append(_strip(run[part], along[part], points_m[rows[part], 2]))
    near = inside & (np.abs(along) <= _STRIP_HALF_M)
    if near.sum() < _FEWEST:
        none = np.zeros(0)
        return Profile(none, none, none)
    own = _strip(run[near], along[near], points_m[rows[near], 2])
    own = own[0], own[1] - _level_at_edge(*own)
    profile = binned_profile(*own, _BIN_M)
    if len(profile) < _FEWEST:
        return profile
    pieces = fit_pieces(profile)
    alike = [moved for strip in strips if (moved := _moved(*strip, pieces)) is not None]
    if not alike:
        return profile
    pooled_run, pooled_height = np.concatenate([np.stack(one) for one in (own, *alike)], axis=1)
    # So many points fill bins half as wide, which blur hinges less.
    return binned_profile(pooled_run, pooled_height, _BIN_M / 2 if len(alike) >= _MANY else _BIN_M)


def _strip(run: Floats, along: Floats, height: Floats) -> tuple[Floats, Floats]:
    """Runs and heights of points as at the middle of their strip."""
    along = along - along.mean()
    # The slope along the road, from points of the same bin: these differ by it and by noise.
    number = np.floor(run / (2 * _BIN_M)).astype(np.int64)
    _, group = np.unique(number, return_inverse=True)
    count = np.bincount(group)
    flat = along - (np.bincount(group, along) / count)[group]
    rise = height - (np.bincount(group, height) / count)[group]
    spread = float(flat @ flat)
    if spread < 1e-6:
        return run, height
    slope = float(flat @ rise) / spread
    kept = np.abs(rise - slope * flat) <= 3 * 1.4826 * np.median(np.abs(rise - slope * flat)) + 1e-9
    slope = float(flat[kept] @ rise[kept] / max(float(flat[kept] @ flat[kept]), 1e-6))
    return run, height - along * slope


def _moved(run: Floats, height: Floats, pieces: Pieces) -> tuple[Floats, Floats] | None:
    """Points of a strip where the middle one's would be; None if it is another cross-section."""
    strip = binned_profile(run, height, _BIN_M)
    if len(strip) < _FEWEST:
        return None
    aside, up = 0.0, float(np.median(strip.height_m - pieces.height_m(strip.run_m)))
    for _ in range(_SHIFTS):
        at = strip.run_m - aside
        slope = pieces.slope[np.clip(np.searchsorted(pieces.ends_m, at) - 1, 0, len(pieces) - 1)]
        off = strip.height_m - pieces.height_m(at) - up
        design = np.column_stack([-slope, np.ones(len(at))]) / strip.sigma_m[:, None]
        step, *_ = np.linalg.lstsq(design, off / strip.sigma_m, rcond=None)
        aside, up = aside + float(step[0]), up + float(step[1])
        if abs(aside) > _MOST_ASIDE_M:
            return None
    off = (strip.height_m - pieces.height_m(strip.run_m - aside) - up) / strip.sigma_m
    if np.mean(np.minimum(off**2, _FAR**2)) > _ALIKE:
        return None
    return run - aside, height - up


def _level_at_edge(run: Floats, height: Floats) -> float:
    """Height at the edge: the median of what is known within half a metre, else of all."""
    known = np.isfinite(height)
    near = known & (run <= 0.5)
    chosen = near if near.any() else known
    return float(np.median(height[chosen])) if chosen.any() else 0.0
