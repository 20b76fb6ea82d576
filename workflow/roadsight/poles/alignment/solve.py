"""The pose of one image: coarse search, then damped least squares from the best places."""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from roadsight.base.arrays import Floats, Ints
from roadsight.base.sections.poles import Reach
from roadsight.poles.alignment.kernel import costs, misfit
from roadsight.poles.alignment.landmarks import Landmarks, MatchedLandmarks, landmark_misfit
from roadsight.poles.alignment.pose import FOCAL, INSETS, LATERAL, PITCH, TURNS, YAW, Start
from roadsight.poles.alignment.roadside import NearEdges


@dataclass(frozen=True)
class ImageEdges:
    """Edge pixels of one image, grouped: lane left, lane right, border left, border right.

    Attributes
    ----------
    uv_px : (m, 2). groups : (5,) where each group begins and ends.
    """

    uv_px: Floats
    groups: Ints

    @classmethod
    def from_pixels(
        cls, uv_px: ArrayLike, side: ArrayLike, lane: ArrayLike, points: int = Reach().pixels
    ) -> ImageEdges:
        """Group the pixels and thin them evenly, whatever their order.

        Parameters
        ----------
        uv_px : (m, 2). side : (m,) -1 left, +1 right; others are left out.
        lane : (m,) whether a pixel is of a painted line rather than of the road's border.
        points : how many to keep at most.
        """
        uv = np.asarray(uv_px, np.float64).reshape(-1, 2)
        sign, painted = np.asarray(side, int).ravel(), np.asarray(lane, bool).ravel()
        used = (np.abs(sign) == 1) & np.isfinite(uv).all(axis=1)
        group = np.where(painted, 0, 2) + (sign > 0)
        step = max(used.sum() / max(points, 1), 1.0)
        kept = []
        for value in range(4):
            own = np.flatnonzero(used & (group == value))
            own = own[np.lexsort((uv[own, 0], uv[own, 1]))]
            kept.append(own[np.floor(np.arange(0.5 * step, len(own), step)).astype(int)])
        ends = np.concatenate([[0], np.cumsum([len(part) for part in kept])])
        return cls(np.ascontiguousarray(uv[np.concatenate(kept)]), ends.astype(np.int64))

    def thinned(self, points: int) -> ImageEdges:
        """Fewer of the same pixels."""
        group = np.repeat(np.arange(4), np.diff(self.groups))
        return self.from_pixels(self.uv_px, np.where(group % 2, 1, -1), group < 2, points)


# Error of a road edge across, one standard deviation, as a share of the points' spacing: an edge
# lies anywhere between a point of the road and one beside it, and is smoothed along. Measured on
# the generated rural road: 0.07 m at 8 pulses/m2 and 0.16 m at 2, against the edges of 24.
_OF_SPACING = 0.2


@dataclass(frozen=True)
class Noise:
    """One standard deviation of a pixel of an image edge and of a point of a road edge.

    Painted lines are sharp; where a road's border lies, between pavement, gravel and grass, an
    image knows less well.

    Parameters
    ----------
    independent : share of edge pixels that tell something new: errors of neighbours are alike,
        both in the image and on the road. weight : by how much more lanes and borders count, as
        far as they fit better or worse.
    """

    pixel_px: float = 0.8
    border_px: float = 4.0
    across_m: float = 0.03
    border_m: float = 0.1
    height_m: float = 0.03
    independent: float = 0.03
    weight: tuple[float, float] = (1.0, 1.0)

    @classmethod
    def of_spacing(cls, spacing_m: float) -> Noise:
        """Noise where the cloud's points on the road are so far apart; 0: not known."""
        across_m = _OF_SPACING * spacing_m
        return cls(across_m=max(cls.across_m, across_m), border_m=max(cls.border_m, across_m))

    @property
    def own_share(self) -> float:
        """Share of what an image's edges tell that is no error of the cloud's, 1 where it is dense.

        The variance of a dense cloud's painted lines to this one's: 0.23 at 8 pulses/m2, 0.05 at 2.
        """
        return min(type(self)().across_m / self.across_m, 1.0) ** 2

    def table(self) -> Floats:
        """What the kernel takes, (2, 4) of lanes and borders."""
        lanes, borders = (self.independent * weight for weight in self.weight)
        return np.array(
            [
                [self.pixel_px, self.across_m, self.height_m, lanes],
                [self.border_px, self.border_m, self.height_m, borders],
            ]
        )


@dataclass(frozen=True)
class Task:
    """One image: edges in it and on the map, where the vehicle is about and how sure that is.

    Attributes
    ----------
    image_edges, map_edges : of the road. prior_mean, prior_information : (k,), (k, k) the unknowns
        expected, and the inverse of their covariance.
    landmarks : axes and columns, if there are any. matched : axes that were given a column.
    scene : what the kernel takes of start and edges. coarse, coarse_scene : few of the pixels, and
        the scene with few of the edge points, for scans.
    """

    start: Start
    image_edges: ImageEdges
    map_edges: NearEdges
    noise: Noise
    prior_mean: Floats
    prior_information: Floats
    landmarks: Landmarks | None = None
    matched: MatchedLandmarks | None = None
    scene: tuple[Floats, Any, Ints] = field(init=False, repr=False, compare=False)
    coarse: ImageEdges = field(init=False, repr=False, compare=False)
    coarse_scene: tuple[Floats, Any, Ints] = field(init=False, repr=False, compare=False)

    @property
    def origin_m(self) -> Floats:
        """Where the kernel's coordinates begin (3,)."""
        return np.array([self.start.x_m, self.start.y_m, self.start.z_road_m])

    def with_matched(self, matched: MatchedLandmarks | None) -> Task:
        """The same image with these landmarks."""
        task = copy(self)
        object.__setattr__(task, "matched", matched)
        return task

    def coarser(self, pixels: int = 120, step: int = 3) -> Task:
        """The same image with fewer pixels and points, which together tell as much."""
        image_edges = self.image_edges.thinned(pixels)
        share = len(self.image_edges.uv_px) / max(len(image_edges.uv_px), 1)
        noise = replace(self.noise, independent=share * self.noise.independent)
        map_edges = self.map_edges.thinned(step)
        return replace(self, image_edges=image_edges, map_edges=map_edges, noise=noise)

    def without_edges(self) -> Task:
        """The same image with its landmarks alone."""
        return replace(self, image_edges=ImageEdges(np.empty((0, 2)), np.zeros(5, np.int64)))

    def __post_init__(self) -> None:
        few = self.map_edges.thinned(max(len(self.map_edges.half_m) // _SCANNED, 1))
        # A frozen class has no other way to keep what is computed once.
        object.__setattr__(self, "scene", self._scene(self.map_edges))
        object.__setattr__(self, "coarse", self.image_edges.thinned(80))
        object.__setattr__(self, "coarse_scene", self._scene(few))

    def _scene(self, map_edges: NearEdges) -> tuple[Floats, Any, Ints]:
        edges = (
            np.ascontiguousarray(map_edges.xyz_m - self.origin_m),
            np.ascontiguousarray(map_edges.along),
            np.ascontiguousarray(map_edges.inward),
            np.ascontiguousarray(map_edges.half_m),
        )
        sides = np.array([0, map_edges.left, len(map_edges.half_m)], np.int64)
        return self.start.vector(self.origin_m), edges, sides

    def evaluate(
        self, unknowns: Floats, scale: float, slopes: bool = True
    ) -> tuple[float, Floats, Floats, Floats]:
        """Cost with the expectation's part, normal matrix and gradient of the data, residuals.

        Landmarks count in all but the residuals, which are those of the edge pixels.
        """
        pixels = self.image_edges.uv_px, self.image_edges.groups
        cost, normal, gradient, residuals = misfit(
            unknowns, *self.scene, *pixels, self.noise.table(), scale, slopes
        )
        apart = unknowns - self.prior_mean
        expected = 0.5 * apart @ self.prior_information @ apart
        total = cost + float(expected)
        if self.matched is not None:
            own = self.matched_misfit(unknowns, scale, slopes)
            total, normal, gradient = total + own[0], normal + own[1], gradient + own[2]
        return float(total), normal, gradient, residuals

    def matched_misfit(
        self, unknowns: Floats, scale: float, slopes: bool = True
    ) -> tuple[float, Floats, Floats, Floats]:
        """Cost, normal matrix, gradient and residuals of the landmarks alone."""
        matched = self.matched
        if matched is None:
            size = len(unknowns)
            return 0.0, np.zeros((size, size)), np.zeros(size), np.empty(0)
        given = matched.observed, matched.mapped, matched.sigma_rad
        return landmark_misfit(unknowns, self.scene[0], *given, scale, slopes)

    def scan(self, trials: Floats, scale: float) -> Floats:
        """Cost of many sets of unknowns (t, k), on few of the pixels and of the edge points."""
        few = self.coarse
        share = len(self.image_edges.uv_px) / max(len(few.uv_px), 1)
        pixels = few.uv_px, few.groups
        data = costs(trials, *self.coarse_scene, *pixels, self.noise.table(), scale)
        apart = trials - self.prior_mean
        return share * data + 0.5 * np.einsum("ti,ij,tj->t", apart, self.prior_information, apart)


@dataclass(frozen=True)
class Fit:
    """A minimum.

    Attributes
    ----------
    unknowns : (k,). covariance : (k, k). cost : at the finest scale.
    residuals : (m, 2) of each pixel: across its edge in pixels, and in standard deviations.
    normal, gradient : of the data alone, at the minimum. matched : the landmarks that count in it.
    matched_normal, matched_gradient : their part of normal and gradient, None without any.
    """

    unknowns: Floats
    covariance: Floats
    cost: float
    residuals: Floats
    normal: Floats
    gradient: Floats
    matched: MatchedLandmarks | None = None
    matched_normal: Floats | None = None
    matched_gradient: Floats | None = None

    def taught(self, edges: float, landmarks: float) -> tuple[Floats, Floats]:
        """Normal matrix and gradient with a share of what edges and landmarks say."""
        normal, gradient = edges * self.normal, edges * self.gradient
        if self.matched_normal is not None and self.matched_gradient is not None:
            normal = normal + (landmarks - edges) * self.matched_normal
            gradient = gradient + (landmarks - edges) * self.matched_gradient
        return normal, gradient


# Median of the absolute value of a standard normal variable
MEDIAN_OF_NORMAL = 0.6745
_SCANNED = 100  # Edge points in a scan, about: it only has to tell which valley is the lowest
_State = tuple[float, Floats, Floats, Floats]
# Scale of the last descent, in standard deviations. What is further off hardly counts and does not
# agree.
FINEST = 3.0
# Steps at a coarse scale at most, whose minimum is only a start; three times as many at the finest
_STEPS = 5
_INSETS = np.arange(INSETS, TURNS)  # Numbers of the insets among the unknowns
_HELD = 1e9  # Stiffness of an unknown that is held; where the expectation alone speaks, it is 1


# Range at which an error across the road is counted as a turn; a shorter one calls for the grid
# search more often
_NEAR_M = 20.0
_PULL = 16.0  # Scale, in standard deviations of a pixel, from which a descent still finds its edges


def search(task: Task, starts: int = 3) -> list[Fit]:
    """Minima, the best first, from a grid over yaw, pitch and lateral place.

    Where the expectation leaves less open than edges pull from, there is one minimum: the one that
    is downhill from there.
    """
    sigma = np.sqrt(np.diag(np.linalg.inv(task.prior_information)))
    focal_px = np.exp(task.prior_mean[FOCAL])
    # How far two standard deviations of the expected pose move road edges in the image.
    turn = max(np.radians(sigma[YAW]), np.radians(sigma[PITCH]), sigma[LATERAL] / _NEAR_M)
    pull = float(2.0 * turn * focal_px) / task.noise.pixel_px
    if pull <= _PULL:
        return [descend(task, task.prior_mean, max(pull, FINEST))]
    # Scale at which the expected pose pulls from as far as it may be wrong.
    scale = float(max(8.0, focal_px * np.radians(sigma[YAW]) / task.noise.pixel_px))
    grid = np.stack(np.meshgrid(*[np.arange(-2, 3)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    trials = np.repeat(task.prior_mean[None], len(grid), axis=0)
    trials[:, [YAW, PITCH, LATERAL]] += grid * sigma[[YAW, PITCH, LATERAL]]
    values = task.scan(trials, 0.5 * scale)
    chosen: list[int] = []
    for number in np.argsort(values, kind="stable"):
        apart = [np.abs(grid[number] - grid[other]).max() for other in chosen]
        if not apart or min(apart) > 1:
            chosen.append(int(number))
        if len(chosen) == starts:
            break
    fits = [descend(task, trials[number], 0.5 * scale) for number in chosen]
    return sorted(fits, key=lambda fit: fit.cost)


def descend(task: Task, unknowns: Floats, scale: float) -> Fit:
    """Levenberg-Marquardt from a coarse scale, halved down to the finest.

    Unknowns are measured in their expected standard deviations. Where lines lie in the road moves
    only at the finest scale: a middle line that shows alone would else become the line at the edge.
    """
    unit = 1.0 / np.sqrt(np.diag(task.prior_information))
    while True:
        finest = scale <= FINEST
        steps = 3 * _STEPS if finest else _STEPS
        unknowns, state = _settle(task, unknowns, unit, max(scale, FINEST), steps, finest)
        if finest:
            break
        scale *= 0.5
    cost, normal, gradient, residuals = state
    covariance = np.linalg.inv(normal + task.prior_information)
    covariance = 0.5 * (covariance + covariance.T)
    fit = Fit(unknowns, covariance, cost, residuals, normal, gradient)
    if task.matched is None:
        return fit
    _, own, slope, _ = task.matched_misfit(unknowns, FINEST)
    return replace(fit, matched=task.matched, matched_normal=own, matched_gradient=slope)


def _settle(
    task: Task, unknowns: Floats, unit: Floats, scale: float, steps: int, all_free: bool
) -> tuple[Floats, _State]:
    """Damped steps at one scale, until they no longer pay."""
    held = np.zeros((len(unknowns), len(unknowns)))
    if not all_free:
        held[_INSETS, _INSETS] = _HELD
    state = task.evaluate(unknowns, scale)
    damping = 1e-3
    for _ in range(steps):
        cost, normal, gradient, _ = state
        full = (normal + task.prior_information) * np.outer(unit, unit) + held
        slope = (gradient + task.prior_information @ (unknowns - task.prior_mean)) * unit
        damped = full + damping * np.diag(np.diag(full))
        step = -np.linalg.solve(damped, slope) * unit
        trial = task.evaluate(unknowns + step, scale)
        if trial[0] < cost:
            unknowns, state = unknowns + step, trial
            damping = max(damping * 0.2, 1e-9)
            # The cost is a log-likelihood: so little more decides nothing.
            if cost - trial[0] < 1e-4 * (1.0 + 1e-2 * cost):
                break
        else:
            damping *= 10.0
            if damping > 1e4:
                break
    return unknowns, state
