"""What the images of a drive share: lens, mount, mean offsets; found from all of them together.

Two road edges do not determine the pose of one image, let alone its lens. The images of a drive
have one lens and one mount, and each differs from these by its own small, unknown amounts. The
unknowns of one image are taken out of its linearised misfit exactly; what is left adds up over
the images to the drive's mean and its covariance.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from roadsight.base.arrays import Floats
from roadsight.base.errors import InputError
from roadsight.base.sections.poles import CameraPrior
from roadsight.poles.alignment.drift import MARK_OVERLAP, OVERLAP
from roadsight.poles.alignment.pose import (
    CX,
    FOCAL,
    HEIGHT,
    INSETS,
    PITCH,
    SIZE,
    TURNS,
    YAW,
    Spread,
)
from roadsight.poles.alignment.solve import FINEST, Fit, Task, search
from roadsight.poles.alignment.verdict import Limits

_HFOV_DEG = (8.0, 130.0)  # Horizontal fields of view that a camera on a vehicle may have
_HEIGHT_M = (0.5, 5.0)  # Heights above the road that it may have
_ANY_TURN_DEG = 60.0  # One standard deviation of the yaw of a side view of which nothing is known
_SURE_PX = 0.01  # Least standard deviation of a principal point that is known; zero has no inverse
_MIDDLE = 0.75  # Share of half the road beyond which a line is no line at its edge
# Makes the task of one image from the expected unknowns and the inverse of their covariance
Loader = Callable[[Floats, Floats], Task]


@dataclass(frozen=True)
class Mount:
    """Mean unknowns of a drive.

    Attributes
    ----------
    mean : (k,) as `pose.UNKNOWNS`. covariance : (k, k) of the mean.
    images : how many images it rests on.
    """

    mean: Floats
    covariance: Floats
    images: int = 0

    def expected(self, spread: Spread) -> Floats:
        """Inverse covariance (k, k) of one image's unknowns."""
        total = self.covariance + np.diag(spread.vector() ** 2)
        return np.asarray(np.linalg.inv(total), np.float64)


def weak_mount(
    hfov_deg: float | None, width_px: int, centre_px: float = CameraPrior().principal_point_px
) -> Mount:
    """What is known of a camera on a survey vehicle before anything is measured.

    Parameters
    ----------
    hfov_deg : horizontal field of view where it is known to 10 %, else None.
    centre_px : one standard deviation of the principal point's column.
    """
    focal = 0.5 * width_px / np.tan(np.radians(hfov_deg or 60.0) / 2)
    lens = 0.1 if hfov_deg else 0.6
    # On a roof, looking a little down, lines 0.3 m inside the edge.
    mean = np.zeros(SIZE)
    mean[[HEIGHT, PITCH, FOCAL]] = 2.2, -1.0, np.log(focal)
    mean[INSETS : INSETS + 2] = 0.3
    sigma = np.array(
        [
            *(1.2, 0.7, 0.5, 3.0, 4.0, 1.5, lens, max(centre_px, _SURE_PX)),
            *(0.2, 0.2, 0.03, 0.03, _ANY_TURN_DEG, _ANY_TURN_DEG),
        ]
    )
    return Mount(mean, np.diag(sigma**2))


def with_centre_held(mount: Mount) -> Mount:
    """The same mount with a principal point that is where it is expected.

    A yaw that was stated with another point turns by what keeps the middle of the image in place.
    """
    mean = mount.mean.copy()
    mean[YAW] -= np.degrees(np.arctan(mean[CX] * np.exp(-mean[FOCAL])))
    return with_known(replace(mount, mean=mean), CX, 0.0, _SURE_PX)


def with_known(mount: Mount, number: int, value: float, sigma: float) -> Mount:
    """The same mount with one of its unknowns known this well, apart from all others."""
    mean, covariance = mount.mean.copy(), mount.covariance.copy()
    mean[number] = value
    covariance[number], covariance[:, number] = 0.0, 0.0
    covariance[number, number] = sigma**2
    return replace(mount, mean=mean, covariance=covariance)


def with_centre_open(mount: Mount, sigma_px: float) -> Mount:
    """The same mount with a principal point that is known no better than this.

    The yaw was found for the point where it is: another one turns the camera by as much as leaves
    what the image's middle shows where it is.
    """
    if mount.covariance[CX, CX] > _SURE_PX**2:
        return no_surer(mount, CX, sigma_px)
    by_centre = np.zeros(SIZE)
    by_centre[[YAW, CX]] = np.degrees(np.exp(-mount.mean[FOCAL])), 1.0
    more = max(sigma_px**2 - mount.covariance[CX, CX], 0.0)
    return replace(mount, covariance=mount.covariance + more * np.outer(by_centre, by_centre))


def no_surer(mount: Mount, number: int, sigma: float) -> Mount:
    """The same mount with one of its unknowns known no better than this.

    The others follow it as they do in what the drive measured.
    """
    variance = mount.covariance[number, number]
    by_one = mount.covariance[number] / variance
    more = max(sigma**2 - variance, 0.0)
    return replace(mount, covariance=mount.covariance + more * np.outer(by_one, by_one))


def apart_from_centre(covariance: Floats) -> tuple[Floats, Floats]:
    """Covariance (k, k) were the principal point known, and what its sigma moves (k,).

    The covariance is that of the former and the outer product of the latter together.
    """
    by_centre = covariance[CX] / np.sqrt(covariance[CX, CX])
    known = covariance - np.outer(by_centre, by_centre)
    known[CX], known[:, CX] = 0.0, 0.0
    known[CX, CX] = _SURE_PX**2
    return 0.5 * (known + known.T), by_centre


def implausible(mount: Mount, width_px: int) -> str:
    """Why no camera on a vehicle can be like this, or "" if one can.

    Where road edges of image and cloud do not belong together, the best fit is often a lens of a
    few degrees close to the road: everything then lies near everything.
    """
    hfov_deg = float(np.degrees(2 * np.arctan(0.5 * width_px / np.exp(mount.mean[FOCAL]))))
    height_m = float(mount.mean[HEIGHT])
    if not _HFOV_DEG[0] <= hfov_deg <= _HFOV_DEG[1]:
        return f"the drive's calibration is impossible: field of view {hfov_deg:.1f} degrees"
    if not _HEIGHT_M[0] <= height_m <= _HEIGHT_M[1]:
        return f"the drive's calibration is impossible: camera {height_m:.1f} m above the road"
    return ""


def usable(task: Task, fits: Sequence[Fit]) -> bool:
    """Whether the best minimum explains its image well enough to teach about the drive.

    A middle line that was taken for the line at the edge fits as well, with an inset of half the
    road.
    """
    if not fits or len(task.image_edges.uv_px) < Limits.fewest_pixels:
        return False
    near = fits[0].residuals[:, 1] < FINEST
    inset_m = fits[0].unknowns[INSETS:TURNS].max()
    return bool(near.mean() > 0.5 and inset_m < _MIDDLE * task.map_edges.half_width_m)


def calibrate(
    loaders: Sequence[Loader], prior: Mount, spread: Spread, rounds: int = 6, starts: int = 3
) -> tuple[Mount, list[Fit | None]]:
    """Mean unknowns of a drive from some of its images.

    Alternates between the poses of the images, each searched anew under the current mean, and
    the mean under their linearised misfits; stops when it no longer moves.

    Parameters
    ----------
    loaders : one for each image. prior : what is known beforehand. starts : of each search.

    Returns
    -------
    the mount, and the fit of each image, None where it was of no use

    Raises
    ------
    InputError : fewer than three images can be aligned.
    """
    mount = prior
    fits: list[Fit | None] = []
    for _ in range(rounds):
        information = mount.expected(spread)
        fits = []
        for loader in loaders:
            task = loader(mount.mean, information).coarser()
            minima = search(task, starts)
            fits.append(minima[0] if usable(task, minima) else None)
        used = [fit for fit in fits if fit is not None]
        if len(used) < 3:
            raise InputError(
                "too few images of the drive can be aligned with the road edges",
                where="camera calibration",
                found=f"{len(used)} of {len(loaders)}",
                allowed="at least 3",
                hint="give a baseline from the registration tool, or more images",
            )
        before, mount = mount, shared_mean(used, prior, spread)
        moved = np.abs(mount.mean - before.mean) / np.sqrt(np.diag(mount.covariance))
        if moved.max() < 0.1:
            break
    return mount, fits


def shared_mean(fits: Sequence[Fit], prior: Mount, spread: Spread) -> Mount:
    """Mean unknowns under the linearised misfits of the images.

    minimise over the mean m and each image's unknowns q: sum of the images' quadratic misfits
    + (q - m)' P (q - m) / 2 + the prior of m, where P holds the inverse squares of the spread.
    Images further from the mean than the others are weighed down (Geman and McClure).
    """
    pull = np.diag(1.0 / spread.vector() ** 2)
    known = np.linalg.inv(prior.covariance)
    # Information of each image on the mean, and that times the mean that it alone would give.
    # Images see the same stretch of road, and its errors, again and again; how they sway is their
    # own.
    parts = []
    for fit in fits:
        normal, gradient = fit.taught(OVERLAP, MARK_OVERLAP)
        gain = np.linalg.solve(normal + pull, np.eye(SIZE))
        information = pull - pull @ gain @ pull
        right = pull @ gain @ (normal @ fit.unknowns - gradient)
        parts.append((0.5 * (information + information.T), right))
    weights = np.ones(len(parts))
    mean = prior.mean
    for _ in range(10):
        total = known + sum(w * a for w, (a, _) in zip(weights, parts, strict=True))
        right = known @ prior.mean + sum(w * b for w, (_, b) in zip(weights, parts, strict=True))
        mean = np.linalg.solve(total, right)
        gaps = (fit.normal @ (fit.unknowns - mean) - fit.gradient for fit in fits)
        off = [np.linalg.solve(fit.normal + pull, gap) for fit, gap in zip(fits, gaps, strict=True)]
        apart = np.array([float(one @ pull @ one) for one in off])  # squared, in sigmas
        # An image four times as far off as is usual for so many unknowns counts a quarter.
        weights = (1.0 / (1.0 + apart / (4.0 * SIZE))) ** 2
    covariance = np.linalg.inv(total)
    return Mount(mean, 0.5 * (covariance + covariance.T), len(fits))


def find_focal(
    loaders: Sequence[Loader],
    prior: Mount,
    spread: Spread,
    width_px: int,
    hfovs_deg: tuple[float, float] = (15.0, 100.0),
) -> Mount:
    """Prior whose focal length, pitch and yaw are near the truth, when nobody knows the lens.

    Tries focal lengths a sixth apart; for each the best common pitch and yaw on a coarse scale,
    then the calibration of the drive; the least misfit of the same pixels wins.

    Raises
    ------
    InputError : no focal length aligns three images.
    """
    low, high = np.log(0.5 * width_px / np.tan(np.radians(np.sort(hfovs_deg)[::-1]) / 2))
    best: tuple[float, Mount] | None = None
    for log_focal in np.linspace(low, high, max(int(np.ceil((high - low) / 0.17)) + 1, 2)):
        # Trials are a sixth apart: the true length is within a sigma of one of them.
        mount = _aimed(loaders, with_known(prior, FOCAL, log_focal, 0.1), spread)
        try:
            mount, fits = calibrate(loaders, mount, spread, rounds=2, starts=1)
        except InputError:
            continue
        # Images of no use count as if none of their pixels were explained.
        worst = max(fit.cost for fit in fits if fit is not None)
        cost = sum(worst if fit is None else fit.cost for fit in fits)
        if best is None or cost < best[0]:
            best = cost, mount
    if best is None:
        raise InputError(
            "no field of view aligns three images with the road edges",
            where="camera calibration",
            allowed=f"{hfovs_deg[0]:g} to {hfovs_deg[1]:g} degrees",
            hint="give a baseline from the registration tool",
        )
    mean = best[1].mean.copy()
    # At a lens that is wrong, lines go where they fit: that is no news about the road.
    mean[INSETS:TURNS] = prior.mean[INSETS:TURNS]
    return Mount(mean, prior.covariance, 0)


def _aimed(loaders: Sequence[Loader], prior: Mount, spread: Spread) -> Mount:
    """Prior with the common pitch and yaw at which all images together fit best, coarsely."""
    pitch, yaw = np.meshgrid(np.arange(-8.0, 8.5, 1.0), np.arange(-5.0, 5.5, 1.0), indexing="ij")
    trials = np.repeat(prior.mean[None], pitch.size, axis=0)
    trials[:, PITCH] += pitch.ravel()
    trials[:, YAW] += yaw.ravel()
    information = prior.expected(spread)
    total = np.zeros(len(trials))
    for loader in loaders:
        task = loader(prior.mean, information).coarser()
        # In a grid of one degree the truth is at most 0.7 degrees from a trial.
        reach_px = np.exp(prior.mean[FOCAL]) * np.radians(0.7)
        total += task.scan(trials, max(8.0, reach_px / task.noise.pixel_px))
    mean = trials[int(np.argmin(total))]
    return Mount(mean, prior.covariance)
