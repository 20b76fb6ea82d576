"""What lies beside the road, from its edge outwards: shoulder, foreslope, ditch, backslope.

Names follow the AASHTO Roadside Design Guide, 4th edition (2011), chapter 3: a foreslope falls
from the shoulder, a backslope rises beyond the ditch; slopes are written 1V:nH.

A profile is cut in two steps. Dynamic programming finds the number and the places of the cuts:
each piece is fitted by itself, and Schwarz's criterion (BIC) weighs misfit against the number of
pieces. Then all pieces are fitted together as a line that bends at its hinges, which move to where
the data want them (V. M. R. Muggeo, Estimating regression models with unknown break-points,
Statistics in Medicine 22, 2003); where two pieces do not meet there is a step: kerb, wall, drop.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial import cKDTree

from roadsight.base.arrays import Floats, Ints
from roadsight.base.errors import InputError

# Heights are taken to be no better than this: straight pieces stand for ground that is not quite
# straight (generated ditches with natural ground beyond; smaller values cut the natural ground).
LEAST_SIGMA_M = 0.005
# Lower steps are texture. FHWA's Safety Edge guidance starts to treat drop-offs at 2 inches.
STEP_M = 0.05
_MOST = 10  # pieces at most
_FEWEST_HEIGHTS = 3  # bins of a piece: two make a slope, three show that it is straight
_FEW_HEIGHTS = 4  # of so many in a bin none is told to be an outlier
# Heights further from the median than so many sigmas are of grass or stones. Means of the others
# know a third more than the median does: slopes of generated ditch bottoms are within 0.033 instead
# of 0.040 (95 %), those beside them within 0.013 instead of 0.016.
_OUTLIER = 3.0
_ROUNDS = 12  # rounds in which hinges move; on exact sections they rest after 4 to 6
_NARROWEST_M = 0.3  # hinges keep this distance: narrower pieces are steps
_STEEP_OVER_M = 1.5  # mean slopes are over so much


@dataclass(frozen=True)
class Profile:
    """Heights across the road.

    Parameters
    ----------
    run_m : (n,) from the road's edge outwards, ascending. height_m : (n,) above the edge.
    sigma_m : (n,) one standard deviation of each height.
    """

    run_m: Floats
    height_m: Floats
    sigma_m: Floats

    def __len__(self) -> int:
        return len(self.run_m)


@dataclass(frozen=True)
class Pieces:
    """A profile as straight pieces; k pieces have k + 1 ends.

    Parameters
    ----------
    ends_m : (k + 1,) runs of the ends. sigma_ends_m : (k + 1,) of the hinges, 0 at both ends.
    slope : (k,) rise over run, negative falls away from the road. sigma_slope : (k,).
    jump_m : (k - 1,) rise of the step at each inner end, 0 where the pieces meet.
    start_height_m : height at the first end.
    """

    ends_m: Floats
    sigma_ends_m: Floats
    slope: Floats
    sigma_slope: Floats
    jump_m: Floats
    start_height_m: float

    def __len__(self) -> int:
        return len(self.slope)

    def height_m(self, run_m: ArrayLike) -> Floats:
        """Heights (n,) at runs; beyond the ends the last pieces go on. On a step, its far side."""
        run = np.asarray(run_m, np.float64)
        inner = self.ends_m[1:-1]
        height = self.start_height_m + self.slope[0] * (run - self.ends_m[0])
        for place, bend, jump in zip(inner, np.diff(self.slope), self.jump_m, strict=True):
            height = height + bend * np.maximum(run - place, 0.0) + jump * (run >= place)
        return height


def binned_profile(
    run_m: ArrayLike, height_m: ArrayLike, bin_m: float = 0.1, sigma_m: float | None = None
) -> Profile:
    """Profile of scattered heights: the mean of each bin without outliers, of few the median.

    Parameters
    ----------
    run_m, height_m : (n,), in any order; rows that are not finite are left out.
    sigma_m : of one height; None: measured from how neighbouring bins differ.
    """
    run, height = np.asarray(run_m, np.float64), np.asarray(height_m, np.float64)
    known = np.isfinite(run) & np.isfinite(height)
    run, height = run[known], height[known]
    order = np.argsort(run, kind="stable")
    run, height = run[order], height[order]
    number = np.floor(run / bin_m + 1e-6).astype(np.int64)
    _, first, count = np.unique(number, return_index=True, return_counts=True)
    bins = []  # mean run and height, and their sigma for heights of sigma 1
    for start, n in zip(first, count, strict=True):
        x, z = run[start : start + n], height[start : start + n]
        if n <= _FEW_HEIGHTS:
            # The median of n normal heights has sigma 1.25 / sqrt(n), of one or two 1 / sqrt(n).
            wide = 1.2533 if n > 2 else 1.0
            bins.append((float(x.mean()), float(np.median(z)), wide / float(np.sqrt(n))))
            continue
        off = np.abs(z - np.median(z))
        kept = off <= _OUTLIER * 1.4826 * np.median(off) + 1e-9
        sigma = 1.0 / float(np.sqrt(kept.sum()))
        bins.append((float(x[kept].mean()), float(z[kept].mean()), sigma))
    middle, level, share = np.array(bins).reshape(-1, 3).T
    own = noise_of(middle, level, share) if sigma_m is None else sigma_m
    return Profile(middle, level, np.hypot(own * share, LEAST_SIGMA_M))


def noise_of(run_m: Floats, height_m: Floats, share: Floats | None = None) -> float:
    """Noise of heights from how much each differs from the line through its neighbours, m.

    Hinges and steps touch few of them, and the median does not hear these. 0 with fewer than five.
    """
    if len(run_m) < 5:
        return 0.0
    before, after = np.diff(run_m)[:-1], np.diff(run_m)[1:]
    weight = after / (before + after)
    bend = height_m[1:-1] - weight * height_m[:-2] - (1 - weight) * height_m[2:]
    size = np.ones(len(run_m)) if share is None else share
    spread = np.sqrt(size[1:-1] ** 2 + (weight * size[:-2]) ** 2 + ((1 - weight) * size[2:]) ** 2)
    return float(1.4826 * np.median(np.abs(bend / spread)))


def fit_pieces(profile: Profile) -> Pieces:
    """Straight pieces of a profile, as many as Schwarz's criterion asks for.

    Raises
    ------
    InputError : fewer than three heights.
    """
    if len(profile) < _FEWEST_HEIGHTS:
        raise InputError(
            "a profile has too few heights",
            where="cross-section",
            found=len(profile),
            allowed=f"{_FEWEST_HEIGHTS} or more",
        )
    cuts = _cuts(profile)
    middles = (profile.run_m[cuts - 1] + profile.run_m[cuts]) / 2
    return _bent_line(profile, middles, _steps(profile, cuts))


def _cuts(profile: Profile) -> Ints:
    """First rows of the pieces after the first, by dynamic programming over all cuts."""
    x, z, w = profile.run_m, profile.height_m, profile.sigma_m**-2
    sums = np.array([w, w * x, w * z, w * x * x, w * x * z, w * z * z])
    total = np.concatenate([np.zeros((6, 1)), np.cumsum(sums, axis=1)], axis=1)
    n = len(x)
    # Misfit of the piece of rows i to j - 1, (n + 1, n + 1).
    s, sx, sz, sxx, sxz, szz = total[:, None, :] - total[:, :, None]
    with np.errstate(divide="ignore", invalid="ignore"):
        vxx, vxz, vzz = sxx - sx * sx / s, sxz - sx * sz / s, szz - sz * sz / s
        misfit = vzz - vxz * vxz / vxx
    rows = np.arange(n + 1)
    long = rows[None, :] - rows[:, None] >= _FEWEST_HEIGHTS
    misfit = np.where(long & np.isfinite(misfit), np.maximum(misfit, 0.0), np.inf)
    best, origin = misfit[0].copy(), np.zeros((_MOST, n + 1), np.int64)
    # A piece more: its slope and the place of its hinge. Steps cost one more; they are rare.
    scores = [best[n]]
    for number in range(1, _MOST):
        paths = best[:, None] + misfit
        origin[number] = np.argmin(paths, axis=0)
        best = paths[origin[number], rows]
        scores.append(best[n] + 3 * number * np.log(n))
    cuts, end = [], n
    for level in range(int(np.argmin(scores)), 0, -1):
        end = int(origin[level][end])
        cuts.append(end)
    return np.array(cuts[::-1], np.int64)


def _steps(profile: Profile, cuts: Ints) -> Floats:
    """Whether the lines either side of each cut fail to meet near it, (k,) bool."""
    bounds = np.concatenate([[0], cuts, [len(profile)]]).astype(int)
    lines = [np.polyfit(profile.run_m[a:b], profile.height_m[a:b], 1) for a, b in pairwise(bounds)]
    found = np.zeros(len(cuts), bool)
    for number, row in enumerate(cuts):
        (slope, level), (later, beyond) = lines[number], lines[number + 1]
        place = (profile.run_m[row - 1] + profile.run_m[row]) / 2
        gap = beyond + later * place - level - slope * place
        apart = abs(gap / (slope - later)) if slope != later else np.inf
        noise = np.hypot(profile.sigma_m[row - 1], profile.sigma_m[row])
        found[number] = abs(gap) > max(STEP_M * 0.8, 3 * noise) and apart > _NARROWEST_M
    return found


def _bent_line(profile: Profile, hinges: Floats, steps: Floats) -> Pieces:
    """All pieces fitted together; hinges that are no steps move (Muggeo 2003)."""
    x, z, w = profile.run_m, profile.height_m, 1 / profile.sigma_m
    hinges, free = hinges.astype(np.float64).copy(), ~steps.astype(bool)
    low, high = x[0], x[-1]
    k, moving, jumping = len(hinges), np.flatnonzero(free), np.flatnonzero(~free)
    best: tuple[float, Floats] | None = None
    for _ in range(_ROUNDS):
        design = _design(x, low, hinges, moving, jumping)
        fitted, *_ = np.linalg.lstsq(design * w[:, None], z * w, rcond=None)
        # Misfit without the columns that only say how hinges should move.
        still = np.delete(design, 2 + k + np.arange(len(moving)), axis=1)
        plain, *_ = np.linalg.lstsq(still * w[:, None], z * w, rcond=None)
        misfit = float((((z - still @ plain) * w) ** 2).sum())
        if best is None or misfit < best[0] - 1e-9:
            best = (misfit, hinges.copy())
        bends, pulls = fitted[2 : 2 + k][moving], fitted[2 + k : 2 + k + len(moving)]
        shift = np.where(np.abs(bends) > 1e-4, pulls / np.where(bends == 0, 1, bends), 0.0)
        moved = hinges.copy()
        moved[moving] += np.clip(shift, -0.3, 0.3)
        if np.any(np.diff(np.r_[low, moved, high]) < _NARROWEST_M / 2):
            break
        if len(moving) == 0 or np.abs(moved - hinges).max() < 1e-4:
            break
        hinges = moved
    hinges = best[1] if best is not None else hinges
    return _measured(profile, hinges, moving, jumping)


def _design(x: Floats, low: float, hinges: Floats, moving: Ints, jumping: Ints) -> Floats:
    """Columns: level, slope, bends, pulls of the moving hinges, jumps."""
    past = (x[:, None] > hinges).astype(np.float64)
    bends = np.maximum(x[:, None] - hinges, 0.0)
    ramp = np.column_stack([np.ones(len(x)), x - low])
    return np.column_stack([ramp, bends, -past[:, moving], past[:, jumping]])


def _measured(profile: Profile, hinges: Floats, moving: Ints, jumping: Ints) -> Pieces:
    """Pieces with given hinges, and sigmas that know that hinges were fitted too."""
    x, z, w = profile.run_m, profile.height_m, 1 / profile.sigma_m
    k, low = len(hinges), float(x[0])
    full = _design(x, low, hinges, moving, jumping)
    still = np.delete(full, 2 + k + np.arange(len(moving)), axis=1)
    plain, *_ = np.linalg.lstsq(still * w[:, None], z * w, rcond=None)
    left = max(len(x) - full.shape[1], 1)
    # Sigmas grow with the misfit where straight pieces do not suffice.
    excess = max(1.0, float((((z - still @ plain) * w) ** 2).sum()) / left)
    covariance = excess * np.linalg.pinv((full * w[:, None]).T @ (full * w[:, None]))
    to_slopes = np.zeros((k + 1, full.shape[1]))
    to_slopes[:, 1] = 1.0
    to_slopes[:, 2 : 2 + k] = np.tril(np.ones((k + 1, k)), -1)
    slope = np.cumsum(plain[1 : 2 + k])
    sigma_slope = np.sqrt(np.maximum(np.diag(to_slopes @ covariance @ to_slopes.T), 0.0))
    sigma_ends = np.zeros(k + 2)
    bends = plain[2 : 2 + k]
    variance = np.maximum(np.diag(covariance), 0.0)
    for number, hinge in enumerate(moving):
        bend = max(abs(bends[hinge]), 1e-3)
        sigma_ends[1 + hinge] = np.sqrt(variance[2 + k + number]) / bend
    spacing = np.diff(x)
    jump = np.zeros(k)
    for number, hinge in enumerate(jumping):
        jump[hinge] = plain[2 + k + number]
        row = min(int(np.searchsorted(x, hinges[hinge])), len(spacing))
        sigma_ends[1 + hinge] = spacing[max(row - 1, 0)] / np.sqrt(12)
    ends = np.r_[low, hinges, x[-1]]
    sigma_slope = np.maximum(sigma_slope, 1e-6)
    return Pieces(ends, sigma_ends, slope, sigma_slope, jump, float(plain[0]))


def steepest(pieces: Pieces, sign: int = -1) -> tuple[float, float, float]:
    """Steepest mean slope over 1.5 m, its sigma, and the run at which that window starts.

    Parameters
    ----------
    sign : -1 looks for the steepest fall, +1 for the steepest rise.

    Returns
    -------
    slope (0 where nothing falls or rises so), sigma, start (m). On a profile shorter than the
    window the whole profile is the window.
    """
    low, high = float(pieces.ends_m[0]), float(pieces.ends_m[-1])
    window = min(_STEEP_OVER_M, high - low)
    if window <= 0:
        return 0.0, float("nan"), low
    # The mean slope of a bent line is greatest where the window starts or ends at a hinge.
    starts = np.r_[pieces.ends_m, pieces.ends_m - window, pieces.ends_m - 1e-9]
    starts = np.unique(np.clip(starts, low, high - window))
    slopes = (pieces.height_m(starts + window) - pieces.height_m(starts)) / window
    row = int(np.argmax(sign * slopes))
    slope = float(slopes[row]) if sign * slopes[row] > 0 else 0.0
    ends = np.minimum(pieces.ends_m[1:], starts[row] + window)
    inside = np.clip(ends - np.maximum(pieces.ends_m[:-1], starts[row]), 0.0, None)
    return slope, float(inside @ pieces.sigma_slope / window), float(starts[row])


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
