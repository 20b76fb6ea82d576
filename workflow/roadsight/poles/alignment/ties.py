"""What the images of a drive tell each other, because they show the same things.

Neighbouring images share a hundred points of trees, houses and fields. These say how the camera
turned, and which way it went in between, to a hundredth of a degree. An image without poles, or
whose road is hidden, thus has the heading that its neighbours have. Each image gets an expectation
from all others, never from itself, so that its own edges and poles still are a check.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np

from roadsight.base.arrays import Floats
from roadsight.poles.alignment.drift import DriftModel, axes
from roadsight.poles.alignment.drive import Place
from roadsight.poles.alignment.epipolar import POSED, shared_misfit, shared_residuals
from roadsight.poles.alignment.pose import ALONG, INSETS, LATERAL, Spread
from roadsight.poles.alignment.solve import MEDIAN_OF_NORMAL

# Scale of each round, in standard deviations of a shared point: wide as long as headings are off,
# narrow against wrong matches. The last one is that of the result.
SCALES = (12.0, 12.0, 12.0, 6.0, 6.0, *[3.0] * 10)
# Scales of the rounds before these where images tell each other their poses. Images that are
# paired with a wrong pole are 20 to 35 sigmas from their neighbours, which from 12 on tears them
# off instead of pulling them back (`docs/decisions/097-links-hold-before-they-tear.md`).
_HOLDING = (48.0, 48.0, 24.0, 24.0)
# One standard deviation of a step: along, lateral, height (m), yaw, pitch, roll (degrees). Shared
# points tell little about the way along the road until the headings are right.
_STEP = np.array([0.5, 0.2, 0.05, 0.2, 0.2, 0.2])
_FEWEST = 12  # Shared points that must agree: the relative pose of two images has five numbers
# One standard deviation of a shared point. With 0.7 px, and every second point counted, a stretch
# of ten images leant on one wrong link (`docs/decisions/047-neighbouring-images-tie-cameras.md`).
_PIXEL_PX = 0.4
# Share of shared points that tell something new: they lie on few things, seen by one lens
_INDEPENDENT = 0.15


# A chain of Gaussian unknowns: what all but one of its members say about that one.
# Every member has a prior, what it measured itself, and links with the next member. Messages run
# along the chain once either way (Kalman filter and smoother in information form), so that a
# drive of any length costs time and memory in proportion to its images.


@dataclass(frozen=True)
class Normal:
    """Quadratic misfit x' A x / 2 - b' x; A may be singular.

    Attributes
    ----------
    matrix : A (k, k). right : b (k,).
    """

    matrix: Floats
    right: Floats

    def __add__(self, other: Normal) -> Normal:
        return Normal(self.matrix + other.matrix, self.right + other.right)

    def times(self, weight: float) -> Normal:
        """The same, counted so many times."""
        return Normal(weight * self.matrix, weight * self.right)

    def least(self) -> tuple[Floats, Floats]:
        """Its minimum (k,) and the inverse (k, k) of its matrix."""
        covariance = np.linalg.inv(self.matrix)
        return covariance @ self.right, 0.5 * (covariance + covariance.T)


# Keeps a step short: what images share is far from linear along the road
HELD = Normal(np.diag(_STEP**-2.0), np.zeros(POSED))
# Surprise, in squared standard deviations, at which a measurement counts a quarter: four times
# what is usual for the six numbers of a pose
_SOFT = 4.0 * POSED
LENS = INSETS - POSED  # How many numbers of the lens images share: focal length and principal point
_PLACE = np.array([ALONG, LATERAL])  # Numbers of the place on the road, whose error is the track's


@dataclass(frozen=True)
class Member:
    """One image of a drive.

    Attributes
    ----------
    unknowns : (k,) as known so far. measured : what it measured of the six numbers of its pose,
        as a misfit of these; None where it measured nothing.
    shared : (n, 4) pixels shared with the next image: u, v here and there.
    by_lens : (6, 2) how the right side of what it measured moves with the drive's log focal length
        and principal point.
    """

    place: Place
    unknowns: Floats
    measured: Normal | None
    shared: Floats
    by_lens: Floats = field(default_factory=lambda: np.zeros((POSED, LENS)))


def told_by_others(
    members: Sequence[Member], mean: tuple[Floats, Floats], spread: Spread, model: DriftModel
) -> dict[str, tuple[Floats, Floats]]:
    """Pose (6,) of each image as all other images of the drive tell it, and its covariance (6, k).

    The covariance is with itself and with the other unknowns. Gauss-Newton over the whole drive:
    what each image measured, how much a vehicle sways, how the error of satellite positions
    changes, and what neighbours share. Measurements that the others
    contradict count less. What the drive's own mean leaves open, its images have in common; it is
    added in the end, as far as the poses rest on the mean: a lens that is a hundredth too long
    turns the last image of a bend by a hundredth of the bend.

    Parameters
    ----------
    members : in the order of travel. mean : of the drive, (k,), and its covariance (k, k).
    spread : of the drive's images about its mean.
    """
    if not members:
        return {}
    now = [member.unknowns.copy() for member in members]
    weights = np.ones(len(members))
    for scale in (*_HOLDING, *SCALES[:-1]):
        priors, own, links = _misfits(members, now, mean[0], spread, model, scale)
        priors = [one + HELD for one in priors]
        counted = [one.times(w) for one, w in zip(own, weights, strict=True)]
        others = others_say(priors, counted, links)
        off = np.array([surprise(one, rest) for one, rest in zip(own, others, strict=True)])
        weights = (1.0 / (1.0 + off / _SOFT)) ** 2
        steps = [(r + o.times(w)).least()[0] for r, o, w in zip(others, own, weights, strict=True)]
        now = [np.r_[x[:POSED] + step, x[POSED:]] for x, step in zip(now, steps, strict=True)]
    priors, own, links = _misfits(members, now, mean[0], spread, model, SCALES[-1])
    counted = [one.times(w) for one, w in zip(own, weights, strict=True)]
    found = [rest.least() for rest in others_say(priors, counted, links)]
    linked = [
        -shared_points(pair, at, SCALES[-1]).matrix[:-LENS, -LENS:]
        for pair, at in zip(pairwise(members), pairwise(now), strict=True)
    ]
    by_lens = [w * m.by_lens for m, w in zip(members, weights, strict=True)]
    rests = _rests_on_mean(members, now, (priors, counted, links), spread, model, (by_lens, linked))
    told = {}
    for m, x, (step, alone), rest in zip(members, now, found, rests, strict=True):
        covariance = rest @ mean[1][:INSETS]
        covariance[:, :POSED] = alone + covariance[:, :INSETS] @ rest.T
        told[m.place.image] = x[:POSED] + step, covariance
    return told


_Misfits = tuple[list[Normal], list[Normal], list[Normal]]


def _misfits(
    members: Sequence[Member],
    now: Sequence[Floats],
    mean: Floats,
    spread: Spread,
    model: DriftModel,
    scale: float,
) -> _Misfits:
    """Priors, own measurements and links, of the steps from where the images are now."""
    nothing = Normal(np.zeros((POSED, POSED)), np.zeros(POSED))
    priors = [swaying(x, mean, spread) for x in now]
    priors[0] = priors[0] + first_place(members[0], now[0], mean, model)
    measured = [member.measured or nothing for member in members]
    own = [
        Normal(one.matrix, one.right - one.matrix @ x[:POSED])
        for one, x in zip(measured, now, strict=True)
    ]
    links = []
    for pair, at in zip(pairwise(members), pairwise(now), strict=True):
        points = shared_points(pair, at, scale)
        alike = Normal(points.matrix[:-LENS, :-LENS], points.right[:-LENS])
        links.append(drifting(*pair, at, mean, model) + alike)
    return priors, own, links


def _rests_on_mean(
    members: Sequence[Member],
    now: Sequence[Floats],
    misfits: _Misfits,
    spread: Spread,
    model: DriftModel,
    by_lens: tuple[Sequence[Floats], Sequence[Floats]],
) -> Floats:
    """How far each pose (n, 6, 8) moves with each number of the drive's mean, the lens included.

    Parameters
    ----------
    by_lens : how the right sides of measurements (6, 2) and links (12, 2) move with the lens.
    """
    priors, own, links = misfits
    still = [Normal(one.matrix, np.zeros(POSED)) for one in own]
    found = np.empty((len(members), POSED, INSETS))
    level = [Normal(one.matrix, np.zeros(POSED)) for one in priors]
    for number in range(LENS):
        pulled = [Normal(m.matrix, by[:, number]) for m, by in zip(own, by_lens[0], strict=True)]
        linked = [Normal(m.matrix, by[:, number]) for m, by in zip(links, by_lens[1], strict=True)]
        for k, rest in enumerate(others_say(level, pulled, linked)):
            found[k, :, POSED + number] = rest.least()[0]
    for number in range(POSED):
        shift = np.zeros(len(now[0]))
        shift[number] = 1.0
        zero = np.zeros(len(shift))
        moved = [Normal(one.matrix, swaying(zero, shift, spread).right) for one in priors]
        moved[0] = moved[0] + Normal(
            0.0 * moved[0].matrix, first_place(members[0], zero, shift, model).right
        )
        pulled = [
            Normal(
                link.matrix, drifting(members[k], members[k + 1], (zero, zero), shift, model).right
            )
            for k, link in enumerate(links)
        ]
        for k, rest in enumerate(others_say(moved, still, pulled)):
            found[k, :, number] = rest.least()[0]
    return found


def swaying(at: Floats, mean: Floats, spread: Spread) -> Normal:
    """The vehicle about the drive's mean; where it is on the road is the track's matter."""
    weight = spread.vector()[:POSED] ** -2.0
    weight[_PLACE] = 0.0
    return Normal(np.diag(weight), weight * (mean - at)[:POSED])


def first_place(member: Member, at: Floats, mean: Floats, model: DriftModel) -> Normal:
    """Error of the track at the drive's first image."""
    turn = np.zeros((2, POSED))
    turn[:, _PLACE] = axes(member.place.start.heading_deg).T
    weight = 1.0 / (model.sigma_m**2 + model.own_m**2)
    gap = turn @ (mean - at)[:POSED]
    return Normal(weight * turn.T @ turn, weight * turn.T @ gap)


def drifting(
    one: Member, other: Member, at: tuple[Floats, Floats], mean: Floats, model: DriftModel
) -> Normal:
    """How the error of the track changes between two images (first-order Gauss-Markov)."""
    keep = float(np.exp(-abs(other.place.station_m - one.place.station_m) / model.length_m))
    turn = np.zeros((2, 2 * POSED))
    turn[:, _PLACE] = -keep * axes(one.place.start.heading_deg).T
    turn[:, POSED + _PLACE] = axes(other.place.start.heading_deg).T
    variance = (1.0 - keep**2) * model.sigma_m**2 + (1.0 + keep**2) * model.own_m**2
    apart = np.r_[(mean - at[0])[:POSED], (mean - at[1])[:POSED]]
    return Normal(turn.T @ turn / variance, turn.T @ (turn @ apart) / variance)


def shared_points(pair: tuple[Member, Member], at: tuple[Floats, Floats], scale: float) -> Normal:
    """What points that two images share tell of steps of both poses and their lens.

    (14, 14); nothing where too few agree.
    """
    one, other = pair
    nothing = Normal(np.zeros((2 * POSED + LENS, 2 * POSED + LENS)), np.zeros(2 * POSED + LENS))
    if len(one.shared) < _FEWEST:
        return nothing
    start = one.place.start
    origin = np.array([start.x_m, start.y_m, start.z_road_m])
    starts = start.vector(origin), other.place.start.vector(origin)
    residuals = shared_residuals(at, starts, one.shared, _PIXEL_PX)
    # How much coarser the points are than expected, from those that agree; never finer.
    near = np.abs(residuals[np.abs(residuals) < scale])
    usual = float(np.median(near)) / MEDIAN_OF_NORMAL if len(near) >= _FEWEST else 1.0
    sigma_px = _PIXEL_PX * max(usual, 1.0)
    normal, gradient, residuals = shared_misfit(at, starts, one.shared, sigma_px, scale)
    if np.count_nonzero(np.abs(residuals) < scale) < _FEWEST:
        return nothing
    return Normal(_INDEPENDENT * normal, -_INDEPENDENT * gradient)


def pose_misfit(
    normal: Floats, gradient: Floats, unknowns: Floats, mean: Floats, rest: Floats
) -> tuple[Normal, Floats]:
    """What an image measured of its pose, its other unknowns taken out.

    Parameters
    ----------
    normal, gradient : (k, k), (k,) of its data at ``unknowns`` (k,).
    mean : (k,) of the drive. rest : (k - 6,) expected variances of the other unknowns.

    Returns
    -------
    its misfit, and how its right side moves (6, 2) with the mean of the first of the others, the
    lens
    """
    right = normal @ unknowns - gradient
    inner = normal[POSED:, POSED:] + np.diag(1.0 / rest)
    tail = right[POSED:] + mean[POSED:] / rest
    gain = np.linalg.solve(inner, normal[POSED:, :POSED])
    matrix = normal[:POSED, :POSED] - normal[:POSED, POSED:] @ gain
    return Normal(0.5 * (matrix + matrix.T), right[:POSED] - gain.T @ tail), -(
        gain[:LENS] / rest[:LENS, None]
    ).T


def others_say(
    priors: Sequence[Normal], own: Sequence[Normal], links: Sequence[Normal]
) -> list[Normal]:
    """For each member its prior and what the other members say: all but its own measurement.

    Parameters
    ----------
    priors, own : (n) of each member, (k, k). links : (n - 1) of each member with the next one,
        (2 k, 2 k).
    """
    ahead = _swept(priors, own, links)
    turned = []
    for link in links[::-1]:
        half = len(link.right) // 2
        order = np.r_[half : 2 * half, :half]
        turned.append(Normal(link.matrix[np.ix_(order, order)], link.right[order]))
    back = _swept(priors[::-1], own[::-1], turned)[::-1]
    return [a + p + b for a, p, b in zip(ahead, priors, back, strict=True)]


def _swept(
    priors: Sequence[Normal], own: Sequence[Normal], links: Sequence[Normal]
) -> list[Normal]:
    """What those before each member say about it."""
    size = len(priors[0].right) if priors else 0
    said = [Normal(np.zeros((size, size)), np.zeros(size))] if priors else []
    for number, link in enumerate(links):
        here = said[-1] + priors[number] + own[number]
        matrix, right = link.matrix.copy(), link.right.copy()
        matrix[:size, :size] += here.matrix
        right[:size] += here.right
        said.append(eliminated(Normal(matrix, right), size)[0])
    return said


def solve_bordered(
    members: Sequence[Normal], links: Sequence[Normal], border: Normal
) -> tuple[Floats, Floats, Floats]:
    """Least misfit of a chain whose members share some numbers, such as those of one camera.

    Members are eliminated one by one, then found from the last to the first.

    Parameters
    ----------
    members : (n) of each member's own k numbers, then the s shared ones, (k + s, k + s).
    links : (n - 1) of each member's, the next one's, and the shared ones, (2 k + s, 2 k + s).
    border : what is known of the shared numbers beforehand, (s, s).

    Returns
    -------
    members' numbers (n, k), shared ones (s,) and their covariance (s, s)
    """
    shared = len(border.right)
    size = len(members[0].right) - shared
    own = np.r_[:size, 2 * size : 2 * size + shared]
    rest = Normal(np.zeros_like(members[0].matrix), np.zeros_like(members[0].right))
    gains = []
    for member, link in zip(members, links, strict=False):
        matrix, right = link.matrix.copy(), link.right.copy()
        here = rest + member
        matrix[np.ix_(own, own)] += here.matrix
        right[own] += here.right
        rest, gain = eliminated(Normal(matrix, right), size)
        gains.append(gain)
    rest, gain = eliminated(rest + members[-1], size)
    common, covariance = (rest + border).least()
    found = [gain.right - gain.matrix @ common]
    for gain in gains[::-1]:
        found.append(gain.right - gain.matrix @ np.r_[found[-1], common])
    return np.array(found[::-1]), common, covariance


def eliminated(one: Normal, size: int) -> tuple[Normal, Normal]:
    """Misfit of what follows the first numbers, and these: ``right - matrix @`` what follows."""
    head, cross = one.matrix[:size, :size], one.matrix[:size, size:]
    both = np.column_stack([cross, one.right[:size]])
    solved = np.asarray(np.linalg.solve(head, both), np.float64)
    gain = Normal(solved[:, :-1], solved[:, -1])
    matrix = one.matrix[size:, size:] - cross.T @ gain.matrix
    right = one.right[size:] - cross.T @ gain.right
    return Normal(0.5 * (matrix + matrix.T), right), gain


def surprise(own: Normal, others: Normal) -> float:
    """Squared distance of what a member measured from what the others say, in sigmas."""
    mean, covariance = others.least()
    gap = own.right - own.matrix @ mean
    spread = own.matrix + own.matrix @ covariance @ own.matrix
    return float(gap @ np.linalg.pinv(spread, hermitian=True) @ gap)
