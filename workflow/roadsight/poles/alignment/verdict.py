"""Whether an alignment can be trusted, and if not, why."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from roadsight.base.arrays import Bools, Floats
from roadsight.base.sections.poles import AlignmentLimits
from roadsight.poles.alignment.dense import DenseFit, DenseTask
from roadsight.poles.alignment.kernel import NEAR_M, camera
from roadsight.poles.alignment.pose import ALONG, CX, FOCAL, LATERAL, PITCH, UNKNOWNS, YAW
from roadsight.poles.alignment.solve import FINEST, Fit, Noise, Task

# Reasons not to trust a pose
TOO_LITTLE = "too little of the cloud is in view"
UNHELD = "the image does not hold the pose: its uncertainty is not finite"
AT_BOUND = "the pose is at the bound of the search"
NO_LEAD = "the best pose fits hardly better than random ones: image and cloud may be of two places"
AMBIGUOUS = "ambiguous: two poses fit about as well"
VAGUE_HEADING = "the heading is too uncertain"
VAGUE_PLACE = "the place across the road is too uncertain"
_PIXELS_OF_A_SIDE = 10  # Edge pixels that a side of the road needs to count as seen
# Slack in pixels at the end of the cloud's edges, as the kernel leaves at the ends of a piece
_BEYOND_PX = 2.0
# A cloud that ends nearer leaves so little to judge by that a heading passes which its expectation
# has a degree off: 12 of 12 generated images at 15 m. From 25 m on as few pass as by all pixels.
_SHORTEST_M = 20.0


def residual_px(fit: Fit, share: float = 0.5, known: Bools | None = None) -> float:
    """Distance in pixels within which a share of the edge pixels is from their road edges.

    Parameters
    ----------
    known : (m,) pixels that count; all if None.
    """
    off = np.abs(fit.residuals[:, 0] if known is None else fit.residuals[known, 0])
    return float(np.quantile(off, share)) if len(off) else float("nan")


@dataclass(frozen=True)
class Limits:
    """Bounds of what is accepted.

    Parameters
    ----------
    fewest_pixels : edge pixels in the image that the cloud reaches; the rest is about these.
    fewest_points : LiDAR edge points ahead.
    residual_px : median distance of the edge pixels across their road edges, at 1,000 pixels of
        image width, beside what the cloud's own edges leave open.
    inliers : least share of pixels within three standard deviations.
    landmarks, inliers_with_landmarks : so many landmarks that agree let less of the edges do, since
        plants and side roads hide or feign borders.
    sigma_heading_deg, sigma_lateral_m : one standard deviation, of an image that stands alone; a
        site asks for more of a heading that its drive helps to tell.
    from_expected : how many standard deviations the pose may be from the expected one.
    ambiguity : how much more a second, different minimum must cost (log-likelihood).
    """

    fewest_pixels: int = 40
    fewest_points: int = 30
    residual_px: float = AlignmentLimits().max_residual_px
    inliers: float = 0.5
    landmarks: int = 2
    inliers_with_landmarks: float = 0.15
    sigma_heading_deg: float = 0.25
    sigma_lateral_m: float = 0.5
    from_expected: float = 4.0
    ambiguity: float = 2.0


def too_little(task: Task, limits: Limits) -> str:
    """Why there is nothing to align, or "" if there is enough."""
    if len(task.image_edges.uv_px) < limits.fewest_pixels:
        return "too few edges in the image"
    if len(task.map_edges.half_m) < limits.fewest_points:
        return "too few road edges ahead"
    return ""


def doubt(task: Task, fits: Sequence[Fit], limits: Limits) -> str:
    """Why the best minimum cannot be trusted, or "" if it can."""
    return edge_doubt(task, fits[0], limits) or pose_doubt(task, fits, limits)


# Doubts about edges that were compared: those of the image may be of something else
OTHER_THINGS = ("the edges of image and road disagree", "the edges fit badly")


def edge_doubt(task: Task, fit: Fit, limits: Limits) -> str:
    """Why the edges of image and cloud do not belong together, or "" if they do."""
    share = limits.inliers
    if agreeing_landmarks(task, fit) >= limits.landmarks:
        share = limits.inliers_with_landmarks
    known = reached(task, fit)
    with np.errstate(invalid="ignore"):
        inliers = (fit.residuals[known, 1] < FINEST).mean() if known.any() else 0.0
    usual_px = limits.residual_px * task.start.width_px / 1000
    limit_px = np.hypot(usual_px, edge_sigma_px(fit, task, known))
    doubts = (
        (not np.isfinite(fit.residuals[:, 0]).all(), "the road edges are behind the camera"),
        (known.sum() < limits.fewest_pixels, "too few of the image's edges are in the cloud"),
        (inliers < share, OTHER_THINGS[0]),
        (residual_px(fit, share, known) > limit_px, OTHER_THINGS[1]),
    )
    return next((reason for doubtful, reason in doubts if doubtful), "")


def pose_doubt(task: Task, fits: Sequence[Fit], limits: Limits) -> str:
    """Why the pose itself is no good, whatever it rests on, or "" if it is."""
    best = fits[0]
    sigma = np.sqrt(np.diag(best.covariance))
    expected = np.sqrt(np.diag(np.linalg.inv(task.prior_information)))
    apart = np.abs(best.unknowns - task.prior_mean) / expected
    worst = UNKNOWNS[int(np.argmax(apart))]
    doubts = (
        (apart.max() > limits.from_expected, f"{worst} is too far from what was expected"),
        (is_ambiguous(fits, limits), AMBIGUOUS),
        (sigmas(best, task)[0] > limits.sigma_heading_deg, VAGUE_HEADING),
        (sigma[LATERAL] > limits.sigma_lateral_m, VAGUE_PLACE),
    )
    return next((reason for doubtful, reason in doubts if doubtful), "")


def reached(task: Task, fit: Fit) -> Bools:
    """Which edge pixels (m,) lie no higher in the image than the cloud's edges; all near its end.

    Where the cloud ends ahead of the camera, the image shows road that nothing can agree with. The
    end is that of the side that goes on: where the other one stops before, its border is missing.
    """
    start, edges, _ = task.scene
    turn, _, centre, _ = camera(start, fit.unknowns)
    ahead = (edges[0] - centre) @ turn.T
    ahead = ahead[ahead[:, 2] > NEAR_M]
    if ahead[:, 2].max(initial=0.0) < _SHORTEST_M:
        return np.ones(len(task.image_edges.uv_px), bool)
    rows = start[7] + np.exp(fit.unknowns[FOCAL]) * ahead[:, 1] / ahead[:, 2]
    return np.asarray(task.image_edges.uv_px[:, 1] >= rows.min() - _BEYOND_PX, bool)


def edge_sigma_px(fit: Fit, task: Task, known: Bools | None = None) -> float:
    """What the cloud's spacing adds to its road edges in the image, pixels, median of the pixels.

    In a sparse cloud an edge is known to some decimetres, which is many pixels near the camera;
    one standard deviation. A dense cloud adds nothing.

    Parameters
    ----------
    known : (m,) pixels that count; all if None.
    """
    usual = Noise()
    own = np.array([task.noise.pixel_px, task.noise.border_px])
    usual_m = np.array([usual.across_m, usual.border_m])
    added = 1.0 - (usual_m / np.array([task.noise.across_m, task.noise.border_m])) ** 2
    counts = [task.image_edges.groups[2], len(task.image_edges.uv_px) - task.image_edges.groups[2]]
    pixel, share = np.repeat(own, counts), np.repeat(np.maximum(added, 0.0), counts)
    with np.errstate(invalid="ignore", divide="ignore"):
        variance = share * ((fit.residuals[:, 0] / fit.residuals[:, 1]) ** 2 - pixel**2)
    variance = variance if known is None else variance[known]
    variance = variance[np.isfinite(variance)]
    return float(np.sqrt(max(np.median(variance), 0.0))) if len(variance) else 0.0


def agreeing_landmarks(task: Task, fit: Fit) -> int:
    """How many landmarks are where the pose says, within three standard deviations."""
    if fit.matched is None:
        return 0
    _, _, _, residuals = task.with_matched(fit.matched).matched_misfit(fit.unknowns, FINEST, False)
    return int(np.count_nonzero(np.abs(residuals) < FINEST))


def is_ambiguous(fits: Sequence[Fit], limits: Limits) -> bool:
    """Whether another minimum is really elsewhere and costs about the same.

    One that is nearer than what would be accepted as uncertain does no harm.
    """
    best = fits[0]
    allowed = np.array([limits.sigma_heading_deg, limits.sigma_heading_deg, 0.0])
    for other in fits[1:]:
        gap = np.abs(other.unknowns - best.unknowns)[[YAW, PITCH, LATERAL]]
        limit = 3.0 * np.sqrt(np.diag(best.covariance))[[YAW, PITCH, LATERAL]]
        if (gap > np.maximum(limit, allowed)).any() and other.cost - best.cost < limits.ambiguity:
            return True
    return False


def is_one_sided(task: Task) -> bool:
    """Whether only one side of the road has edges in the image."""
    count = np.diff(task.image_edges.groups)
    return bool(min(count[0] + count[2], count[1] + count[3]) < _PIXELS_OF_A_SIDE)


def condition(fit: Fit, task: Task) -> float:
    """Ratio of the greatest to the least variance of the pose, in expected standard deviations.

    Near 1 where image and road tell nothing; large where they tell one direction of the pose far
    better than another, as on a straight road.
    """
    unit = 1.0 / np.sqrt(np.diag(np.linalg.inv(task.prior_information)))[:FOCAL]
    scaled = fit.covariance[:FOCAL, :FOCAL] * np.outer(unit, unit)
    variances = np.linalg.eigvalsh(0.5 * (scaled + scaled.T))
    return float(variances[-1] / max(variances[0], 1e-300))


def moved_by_centre(fit: Fit, task: Task, by_centre: Floats) -> Floats:
    """What one standard deviation of the drive's principal point moves (k,) in a solved image.

    Parameters
    ----------
    by_centre : (k,) what it moves in the expectation, its own shift included.
    """
    rest = np.arange(len(by_centre)) != CX
    expected = task.prior_information[np.ix_(rest, rest)]
    pull = expected @ by_centre[rest] - fit.normal[rest, CX] * by_centre[CX]
    moved = by_centre.copy()
    moved[rest] = np.linalg.solve(expected + fit.normal[np.ix_(rest, rest)], pull)
    return moved


def moved_by_focal(fit: Fit) -> Floats:
    """What goes with one standard deviation of the focal length (k,) in a solved image.

    The focal length is its drive's: images hardly differ in it, so that all are moved alike.
    """
    by_focal = fit.covariance[FOCAL]
    return np.asarray(by_focal / np.sqrt(by_focal[FOCAL]), np.float64)


def heading_turns(task: Task) -> Floats:
    """Degrees of heading for one of each unknown (k,), with what the road turns along it."""
    turns = np.zeros(len(task.prior_mean))
    turns[[YAW, ALONG]] = 1.0, np.degrees(task.start.bend)
    return turns


def sigmas(fit: Fit, task: Task) -> tuple[float, float, float, float]:
    """One standard deviation of heading and pitch (degrees), across and along the road (m).

    Heading and pitch include what the road turns over the uncertain place along it.
    """
    turn = np.zeros((4, len(fit.unknowns)))
    turn[0] = heading_turns(task)
    turn[[1, 2, 3], [PITCH, LATERAL, ALONG]] = 1.0
    turn[1, ALONG] = np.degrees(task.start.hump)
    variance = np.diag(turn @ fit.covariance @ turn.T)
    a, b, c, d = (float(v) for v in np.sqrt(variance))
    return a, b, c, d


def with_shared_edges(fit: Fit, task: Task) -> Fit:
    """The same pose, as sure as it is if the errors of the cloud's edges are in the expectation.

    Neighbours see the same edges, errors included. What an image's own edges tell counts by
    `Noise.own_share`, landmarks count in full
    (`docs/decisions/098-edges-that-neighbours-share.md`).
    """
    told, _ = fit.taught(task.noise.own_share, 1.0)
    covariance = np.asarray(np.linalg.inv(told + task.prior_information), np.float64)
    return replace(fit, covariance=covariance)


# What a fit of all that photograph and cloud share must keep, beside `Limits`.
_SAMPLES = 300  # of the cloud in view
_BOUND = 4.0  # offset in expected standard deviations: a pose beyond was not searched
# By how much more another pose must cost (log-likelihood); below it wrong poses of the five streets
# pass.
_SECOND = 6.0
# Log-likelihood ratio beyond the best of many random poses: at right poses of five streets 8.7 to
# 37, at wrong ones and with images of other streets up to 7.0 (100 fits).
LEAST_LEAD = 8.0


def dense_doubt(task: DenseTask, fit: DenseFit, limits: Limits) -> str:
    """Why a fit cannot be trusted, or "" if it can."""
    with np.errstate(invalid="ignore"):
        sigma = fit.sigma
    doubts = (
        (fit.samples < _SAMPLES, TOO_LITTLE),
        (not (np.isfinite(sigma).all() and np.isfinite(fit.offsets).all()), UNHELD),
        (bool((np.abs(fit.offsets) >= _BOUND * task.sigma).any()), AT_BOUND),
        (fit.lead < LEAST_LEAD, NO_LEAD),
        (fit.second < _SECOND, AMBIGUOUS),
        (sigma[YAW] > limits.sigma_heading_deg, VAGUE_HEADING),
        (sigma[1] > limits.sigma_lateral_m, VAGUE_PLACE),
    )
    return next((reason for doubtful, reason in doubts if doubtful), "")


def lost_views(reasons: Iterable[str]) -> str:
    """What a drive loses, for people: how many of its views have no pose, and why."""
    counted = Counter(reasons)
    used, total = counted.pop("", 0), counted.total()
    why = "; ".join(f"{count} x {reason}" for reason, count in sorted(counted.items()))
    return f"{total} of {total + used} views are not used" + (f": {why}" if why else "")
