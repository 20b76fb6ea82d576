"""Lens and mount of a drive from what its images measured and what they share, in one solution.

Road edges and a few columns tell the focal length of a drive to a hundredth at best. Where the
road bends, neighbouring images share a hundred points that turn with it: their turns, in pixels,
add up to the bend, which the track knows in degrees.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from roadsight.base.arrays import Floats
from roadsight.base.doubts import Doubt
from roadsight.poles.alignment.drift import MARK_OVERLAP, OVERLAP, DriftModel
from roadsight.poles.alignment.drive import Place
from roadsight.poles.alignment.epipolar import POSED
from roadsight.poles.alignment.landmarks import LandmarkNoise, landmark_misfit
from roadsight.poles.alignment.locate import locate
from roadsight.poles.alignment.pose import CX, FOCAL, INSETS, SIZE, Spread
from roadsight.poles.alignment.solve import FINEST, Fit
from roadsight.poles.alignment.ties import (
    HELD,
    LENS,
    SCALES,
    Member,
    Normal,
    drifting,
    eliminated,
    first_place,
    pose_misfit,
    shared_points,
    solve_bordered,
    swaying,
    told_by_others,
)
from roadsight.poles.calibration.calibration import (
    Loader,
    Mount,
    no_surer,
    usable,
    with_centre_open,
)
from roadsight.poles.calibration.calibration_table import DriveCalibration

# Squared distance of an image from what all say, in standard deviations, at which it counts a
# quarter: four times what is usual for so many unknowns
_SOFT = 4.0 * SIZE
_FLAT = 1e-9  # Directions of an image's misfit this much flatter than the steepest tell nothing
_LENS = np.array([FOCAL, CX])  # Unknowns of the lens, which all images have in common


@dataclass(frozen=True)
class Tied:
    """One image of a drive, the points that it shares with the next one, and its own fit if any."""

    member: Member
    fit: Fit | None


def mount_together(
    images: Sequence[Tied],
    prior: Mount,
    spread: Spread,
    model: DriftModel,
    scales: Sequence[float] = SCALES,
) -> Mount:
    """Mean unknowns of a drive under all that its images measured and share.

    Gauss-Newton over the poses of all images and the drive's mean: the images' linearised misfits,
    how a vehicle sways about the mean, how the error of the track changes, and shared points.
    Images that the others contradict count less.

    Parameters
    ----------
    images : in the order of travel. prior : what is known of the mean beforehand.
    scales : of the rounds, in standard deviations of a shared point.
    """
    data = [None if one.fit is None else measured(one.fit, spread) for one in images]
    members = [one.member for one in images]
    now = np.array([member.unknowns for member in members])
    mean = prior.mean.copy()
    known = np.asarray(np.linalg.inv(prior.covariance), np.float64)
    weights = np.ones(len(images))
    held = Normal(np.zeros((POSED + SIZE, POSED + SIZE)), np.zeros(POSED + SIZE))
    held.matrix[:POSED, :POSED] = HELD.matrix
    covariance = prior.covariance
    for scale in scales:
        now[:, _LENS] = mean[_LENS]
        own = [_own(*pair, mean) for pair in zip(now, data, strict=True)]
        counted = [
            _beside_mean(swaying(x, mean, spread)) + o.times(w)
            for x, o, w in zip(now, own, weights, strict=True)
        ]
        counted[0] = counted[0] + _beside_mean(first_place(members[0], now[0], mean, model))
        links = [
            _beside_mean(drifting(*pair, at, mean, model))
            + _with_lens(shared_points(pair, at, scale))
            for pair, at in zip(pairwise(members), pairwise(now), strict=True)
        ]
        if scale > scales[-1]:
            counted = [one + held for one in counted]
        border = Normal(known, known @ (prior.mean - mean))
        steps, step, covariance = solve_bordered(counted, links, border)
        now[:, :POSED] += steps
        mean = mean + step
        # Squared distance of the steps from what an image measured, in its standard deviations.
        off = []
        for one, s in zip(own, steps, strict=True):
            gap = one.right - one.matrix @ np.r_[s, step]
            inverse = np.linalg.pinv(one.matrix, rcond=_FLAT, hermitian=True)
            off.append(float(gap @ inverse @ gap))
        weights = (1.0 / (1.0 + np.array(off) / _SOFT)) ** 2
    return Mount(mean, covariance, sum(one is not None for one in data))


def measured(fit: Fit, spread: Spread) -> Normal:
    """What an image measured of its pose and of the drive's other mean unknowns, (14, 14).

    Its own other unknowns, which lie about these, are taken out.
    """
    normal, gradient = fit.taught(OVERLAP, MARK_OVERLAP)
    rest = SIZE - POSED
    pull = np.diag(spread.vector()[POSED:] ** -2.0)
    order = np.r_[POSED:SIZE, :POSED]
    matrix, right = np.zeros((SIZE + rest, SIZE + rest)), np.zeros(SIZE + rest)
    matrix[:SIZE, :SIZE] = normal[np.ix_(order, order)]
    right[:SIZE] = (normal @ fit.unknowns - gradient)[order]
    matrix[:rest, :rest] += pull
    matrix[:rest, SIZE:] = matrix[SIZE:, :rest] = -pull
    matrix[SIZE:, SIZE:] = pull
    return eliminated(Normal(matrix, right), rest)[0]


def _own(at: Floats, data: Normal | None, mean: Floats) -> Normal:
    """What an image measured, of steps of its pose and of the mean."""
    whole = Normal(np.zeros((POSED + SIZE, POSED + SIZE)), np.zeros(POSED + SIZE))
    if data is None:
        return whole
    place = np.r_[:POSED, POSED + POSED : POSED + SIZE]
    right = data.right - data.matrix @ np.r_[at[:POSED], mean[POSED:]]
    whole.matrix[np.ix_(place, place)] = data.matrix
    whole.right[place] = right
    return whole


def _beside_mean(one: Normal) -> Normal:
    """Misfit of poses about the mean's pose, of steps of both."""
    size = len(one.right)
    apart = np.zeros((size, size + SIZE))
    apart[:, :size] = np.eye(size)
    apart[:, size : size + POSED] = -np.tile(np.eye(POSED), (size // POSED, 1))
    return Normal(apart.T @ one.matrix @ apart, apart.T @ one.right)


def _with_lens(points: Normal) -> Normal:
    """Misfit of shared points, of steps of both poses and of the mean, whose lens both have."""
    size = 2 * POSED + SIZE
    place = np.r_[: 2 * POSED, 2 * POSED + _LENS]
    matrix, right = np.zeros((size, size)), np.zeros(size)
    matrix[np.ix_(place, place)] = points.matrix
    right[place] = points.right
    return Normal(matrix, right)


# Principal point of a drive's camera, as far as the whole drive tells it.
# A principal point that is off and a camera that is turned show nearly the same: only near the
# image's sides do they differ, by the square of the distance from the middle. Errors of the map,
# of masks and of pairs do that as well, and images that show one thing share its error. How sure
# the point is follows from parts of the drive: left out in turn, they move it by what they are
# worth.

# Parts of a drive that are left out in turn. They differ in their columns, since all images that
# show one share its error: on a street whose map is smeared by 0.2 m the point's sigma by parts is
# 6 px, where the misfit alone says 1.3 and the point is 7 px off.
_PARTS = 6
# What is left of a lens's bending at the image's sides, one standard deviation: images taken for
# rectified are so to some tenths of a pixel. A principal point moves what is there by its shift
# times (half the width / focal length)^2, so that a narrow lens hardly tells it: with a lens of 22
# degrees, where that is 0.04, a point 15 px off was found in the middle with 5.8 px as its sigma.
_BENT_PX = 0.3
# Turn of the camera from which an open principal point is told: the limit of a right heading
_MATTERS_DEG = 0.1
# Standard deviations by which the point must be off the middle to be taken from the drive
_TOLD = 2.0
# Mount of a drive from its images and what is known of it beforehand
Solver = Callable[[Sequence[Tied], Mount], Mount]


def told_centre(
    images: Sequence[Tied], held: Mount, prior: Mount, centre_px: float, solve: Solver
) -> tuple[Mount, bool]:
    """Mount with the principal point that a drive tells, and whether it tells any.

    One that is not clearly off the middle stays there, known as well as the drive can tell.

    Parameters
    ----------
    held, prior : mount and what is known of it, with the point in the middle.
    centre_px : one standard deviation of the point beforehand.
    """
    free = with_centre_open(prior, centre_px)
    mount = solve(images, free)
    sigma_px, sigma_focal = lens_sigmas(images, mount, free, solve)
    off_px = abs(float(mount.mean[CX]))
    if off_px < _TOLD * sigma_px:
        held = with_centre_open(held, min(float(np.hypot(off_px, sigma_px)), centre_px))
        return no_surer(held, FOCAL, sigma_focal), False
    return no_surer(with_centre_open(mount, sigma_px), FOCAL, sigma_focal), True


def centre_doubts(route: str, mount: Mount) -> list[Doubt]:
    """What a drive leaves open of its principal point, as far as it matters to headings."""
    sigma_px = float(np.sqrt(mount.covariance[CX, CX]))
    turns_deg = float(np.degrees(sigma_px / np.exp(mount.mean[FOCAL])))
    # A point that is told lies off the middle; one that is not stays there but for rounding.
    if abs(mount.mean[CX]) > sigma_px or turns_deg < _MATTERS_DEG:
        return []
    text = (
        f"route {route}: it does not tell the principal point, which is taken in the middle of the"
        f" images: headings may be off by {turns_deg:.1f} degrees (1 sigma), bearings near the"
        " middle are not (give poles.intrinsics where the lens is known): 1 sigma, px"
    )
    return [Doubt("principal_point_open", "note", text, round(sigma_px, 1))]


def with_lens_sigmas(images: Sequence[Tied], mount: Mount, prior: Mount, solve: Solver) -> Mount:
    """Mount of a free principal point, its lens known as well as parts of the drive agree on it."""
    sigma_px, sigma_focal = lens_sigmas(images, mount, prior, solve)
    return no_surer(with_centre_open(mount, sigma_px), FOCAL, sigma_focal)


def lens_sigmas(
    images: Sequence[Tied], mount: Mount, prior: Mount, solve: Solver
) -> tuple[float, float]:
    """One standard deviation of the point (px) and of the logarithm of the focal length.

    Of their misfit, or by what parts of the drive move them, if that is more (grouped jackknife):
    columns are left out in turn, and with them all that is said about them; for the focal length,
    so are stretches with all that their images say. What a lens may still bend is added to the
    point's. Fewer columns than parts tell nothing of it beyond what is known.
    """
    own_px, own_focal = np.sqrt(np.diag(mount.covariance)[[CX, FOCAL]])
    stretches = np.array_split(np.arange(len(images)), _PARTS)
    silent = [
        replace(one, member=replace(one.member, shared=one.member.shared[:0]), fit=None)
        for one in images
    ]
    drives = [
        [silent[k] if k in part else images[k] for k in range(len(images))] for part in stretches
    ]
    by_stretch = _jackknife(drives, prior, solve)
    columns = sorted({place for one in images for place in _columns(one)})
    if len(columns) < _PARTS:
        focal = max(own_focal, by_stretch[FOCAL])
        return float(np.sqrt(prior.covariance[CX, CX])), float(focal)
    parts = [set(columns[k::_PARTS]) for k in range(_PARTS)]
    by_column = _jackknife(
        [[_without(one, part) for one in images] for part in parts], prior, solve
    )
    width_px = images[0].member.place.start.width_px
    bent_px = _BENT_PX / (0.5 * width_px / float(np.exp(mount.mean[FOCAL]))) ** 2
    focal = max(own_focal, by_stretch[FOCAL], by_column[FOCAL])
    return float(np.hypot(max(by_column[CX], own_px), bent_px)), float(focal)


def _jackknife(drives: Sequence[Sequence[Tied]], prior: Mount, solve: Solver) -> Floats:
    """Standard deviations (k,) of the mean unknowns, from drives of which a part is left out."""
    found = [solve(images, prior).mean for images in drives]
    return np.asarray(np.sqrt((len(found) - 1) * np.var(found, axis=0)), np.float64)


_Column = tuple[float, float]


def _columns(one: Tied) -> list[_Column]:
    """Where the columns stand that an image shows, local metres."""
    if one.fit is None or one.fit.matched is None:
        return []
    start = one.member.place.start
    xy_m = one.fit.matched.mapped[:, :2] + [start.x_m, start.y_m]
    return [(float(x), float(y)) for x, y in np.round(xy_m, 2)]


def _without(one: Tied, left_out: set[_Column]) -> Tied:
    """The same image without some of the columns."""
    kept, fit = np.array([place not in left_out for place in _columns(one)], bool), one.fit
    if fit is None or kept.all():
        return one
    assert fit.matched is not None
    assert fit.matched_normal is not None
    assert fit.matched_gradient is not None
    matched = fit.matched.part(kept)
    start = one.member.place.start
    vector = start.vector(np.array([start.x_m, start.y_m, start.z_road_m]))
    _, normal, gradient, _ = landmark_misfit(
        fit.unknowns, vector, matched.observed, matched.mapped, matched.sigma_rad, FINEST, True
    )
    fit = replace(
        fit,
        matched=matched,
        normal=fit.normal - fit.matched_normal + normal,
        gradient=fit.gradient - fit.matched_gradient + gradient,
        matched_normal=normal,
        matched_gradient=gradient,
    )
    return replace(one, fit=fit)


# Pixels (n, 4) that two images share, by the names of both
Shared = Mapping[tuple[str, str], Floats]
# Places in the order of travel, each with the pixels (n, 4) that it shares with the next one
Chain = list[tuple[Place, Floats]]


def in_order(places: Sequence[Place], shared: Shared) -> Chain:
    """Places of a drive in the order of travel with what each shares with the next one."""
    ordered = sorted(places, key=lambda place: place.station_m)
    pairs = [(one.image, other.image) for one, other in pairwise(ordered)]
    empty = np.empty((0, 4))
    return list(zip(ordered, [*(shared.get(p, empty) for p in pairs), empty], strict=True))


def is_tied(chain: Chain) -> bool:
    """Whether any two images of a drive share points."""
    return any(len(points) for _, points in chain)


def with_ties(
    calibration: DriveCalibration,
    places: Sequence[Place],
    loaders: Sequence[Loader],
    noise: LandmarkNoise,
    starts: Mapping[str, Floats],
    shared: Shared,
) -> DriveCalibration:
    """Calibration in which each image expects the pose that the other images tell it.

    Parameters
    ----------
    starts : unknowns of the images, as far as they were found. shared : of images that follow each
        other; the same calibration if there is none of this drive.
    """
    chain = in_order(places, shared)
    if not is_tied(chain):
        return calibration
    load = {place.image: loader for place, loader in zip(places, loaders, strict=True)}
    members = [
        _member(calibration, place, load[place.image], noise, starts.get(place.image), points)
        for place, points in chain
    ]
    mount, model = calibration.mount, calibration.drift.model
    told = told_by_others(members, (mount.mean, mount.covariance), calibration.spread, model)
    return replace(calibration, told=told)


def _member(
    calibration: DriveCalibration,
    place: Place,
    load: Loader,
    noise: LandmarkNoise,
    start: Floats | None,
    shared: Floats,
) -> Member:
    """One image with what it measures by itself."""
    mean, information = calibration.expected(place)
    task = load(mean, information)
    fits = locate(task, noise, start)
    if not usable(task, fits):
        return Member(place, mean, None, shared)
    normal, gradient = fits[0].taught(OVERLAP, MARK_OVERLAP)
    mount = calibration.mount
    rest = (np.diag(mount.covariance) + calibration.spread.vector() ** 2)[POSED:]
    # The drive has one lens: its error is no image's own.
    rest[:LENS] = calibration.spread.vector()[POSED:INSETS] ** 2
    measured, by_lens = pose_misfit(normal, gradient, fits[0].unknowns, mount.mean, rest)
    return Member(place, fits[0].unknowns, measured, shared, by_lens)
