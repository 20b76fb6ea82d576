"""Principal point of a drive's camera, as far as the whole drive tells it.

A principal point that is off and a camera that is turned show nearly the same: only near the
image's sides do they differ, by the square of the distance from the middle. Errors of the map, of
masks and of pairs do that as well, and images that show one thing share its error. How sure the
point is follows from parts of the drive: left out in turn, they move it by what they are worth.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from roadsight.base.arrays import Floats, Ints
from roadsight.base.doubts import Doubt
from roadsight.poles.alignment.landmarks import landmark_misfit
from roadsight.poles.alignment.pose import CX, FOCAL
from roadsight.poles.alignment.solve import FINEST, Fit
from roadsight.poles.calibration.calibration import Mount, no_surer, with_centre_open
from roadsight.poles.calibration.calibration_together import Tied

_PARTS = 6
"""Parts of a drive that are left out in turn. They differ in their columns, since all images that
show one share its error: on a street whose map is smeared by 0.2 m the point's sigma by parts is
6 px, where the misfit alone says 1.3 and the point is 7 px off."""
_BENT_PX = 0.3
"""What is left of a lens's bending at the image's sides, one standard deviation: images taken for
rectified are so to some tenths of a pixel. A principal point moves what is there by its shift times
(half the width / focal length)^2, so that a narrow lens hardly tells it: with a lens of 22 degrees,
where that is 0.04, a point 15 px off was found in the middle with 5.8 px as its sigma."""
_MATTERS_DEG = 0.1
"""Turn of the camera from which an open principal point is told: the limit of a right heading."""
_TOLD = 2.0
"""Standard deviations by which the point must be off the middle to be taken from the drive."""
Solver = Callable[[Sequence[Tied], Mount], Mount]
"""Mount of a drive from its images and what is known of it beforehand."""


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
    by_stretch = _moved([_silent_in(images, part) for part in stretches], prior, solve)
    columns = sorted({place for one in images for place in _columns(one)})
    if len(columns) < _PARTS:
        focal = max(own_focal, by_stretch[FOCAL])
        return float(np.sqrt(prior.covariance[CX, CX])), float(focal)
    parts = [set(columns[k::_PARTS]) for k in range(_PARTS)]
    by_column = _moved([[_without(one, part) for one in images] for part in parts], prior, solve)
    width_px = images[0].member.place.start.width_px
    bent_px = _BENT_PX / (0.5 * width_px / float(np.exp(mount.mean[FOCAL]))) ** 2
    focal = max(own_focal, by_stretch[FOCAL], by_column[FOCAL])
    return float(np.hypot(max(by_column[CX], own_px), bent_px)), float(focal)


def _moved(drives: Sequence[Sequence[Tied]], prior: Mount, solve: Solver) -> Floats:
    """Standard deviations (k,) of the mean unknowns, from drives of which a part is left out."""
    found = [solve(images, prior).mean for images in drives]
    return np.asarray(np.sqrt((len(found) - 1) * np.var(found, axis=0)), np.float64)


def _silent_in(images: Sequence[Tied], part: Ints) -> list[Tied]:
    """A drive that says nothing on a stretch."""
    found = list(images)
    for number in part.tolist():
        member = images[number].member
        found[number] = Tied(replace(member, shared=member.shared[:0]), None)
    return found


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
    kept = np.array([place not in left_out for place in _columns(one)], bool)
    if one.fit is None or kept.all():
        return one
    return replace(one, fit=_part(one, one.fit, kept))


def _part(one: Tied, fit: Fit, kept: np.ndarray) -> Fit:
    assert fit.matched is not None
    assert fit.matched_normal is not None
    assert fit.matched_gradient is not None
    matched = fit.matched.part(kept)
    start = one.member.place.start
    vector = start.vector(np.array([start.x_m, start.y_m, start.z_road_m]))
    _, normal, gradient, _ = landmark_misfit(
        fit.unknowns, vector, matched.observed, matched.mapped, matched.sigma_rad, FINEST, True
    )
    return replace(
        fit,
        matched=matched,
        normal=fit.normal - fit.matched_normal + normal,
        gradient=fit.gradient - fit.matched_gradient + gradient,
        matched_normal=normal,
        matched_gradient=gradient,
    )
