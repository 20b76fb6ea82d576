"""A drive's mount, side views and track error from landmarks and points that images share."""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from roadsight.base.arrays import Floats
from roadsight.poles.alignment.drift import DriftModel
from roadsight.poles.alignment.drive import Place
from roadsight.poles.alignment.landmarks import VIEWS, LandmarkNoise
from roadsight.poles.alignment.locate import locate
from roadsight.poles.alignment.pose import CX, FOCAL, TURNS, Spread
from roadsight.poles.alignment.solve import Fit, Task
from roadsight.poles.alignment.ties import Member
from roadsight.poles.calibration.calibration import (
    Loader,
    Mount,
    shared_mean,
    usable,
    with_centre_open,
)
from roadsight.poles.calibration.calibration_centre import told_centre, with_lens_sigmas
from roadsight.poles.calibration.calibration_sides import side_turns
from roadsight.poles.calibration.calibration_spread import estimated_spread
from roadsight.poles.calibration.calibration_table import DriveCalibration, drift_of
from roadsight.poles.calibration.calibration_ties import Chain, Shared, in_order, is_tied
from roadsight.poles.calibration.calibration_together import Tied, mount_together

log = logging.getLogger(__name__)
_ROUNDS = 8
"""Rounds at most; on the generated roads three suffice
(`docs/decisions/033-a-drive-is-solved-together.md`)."""
_SETTLED = 0.1
"""Rounds end when the drive's mean moves by less than this, in standard deviations."""
_LENS_SCALES = (12.0, 12.0, 6.0, 3.0, 3.0, 3.0)
"""Scales of the rounds, as of `mount_together`, where it is solved for how sure the lens is: on two
generated drives the sigmas are within 4 % of those of all rounds, in 0.4 of the time."""
_STITCHED = 0.93
"""Turn of a side view as a share of the field of view, where views are made to be stitched."""
_TURN_SIGMA_DEG = 0.5
"""One standard deviation of a side view's yaw when the view joins. The vote's own is far smaller,
but it rests on a lens that is still to be solved."""
_Posed = tuple[Place, Task, Fit]


def with_landmarks(
    calibration: DriveCalibration,
    places: Sequence[Place],
    loaders: Sequence[Loader],
    prior: Mount,
    noise: LandmarkNoise,
    side_yaw_deg: tuple[float, float],
    starts: Mapping[str, Floats],
    model: DriftModel,
    shared: Shared,
    centre_px: float,
) -> tuple[DriveCalibration, Mapping[str, Floats]]:
    """Calibration with what landmarks and shared points add, and the images' unknowns.

    The same if there are neither.

    Each round aligns every image under what the others say, then takes mount, side views and the
    error of the track from all of them, until they no longer move. Lens, side views and poses are
    solved together: a longer lens with side views turned less looks almost the same, and solving
    one after the other would stop far from the best. Side views join once their yaw is known
    roughly.

    Parameters
    ----------
    prior : what was known of the mount beforehand. side_yaw_deg : left and right, as far as known.
    starts : unknowns of the images, as road edges alone give them. model : of the receiver, as said
    beforehand. shared : points of images that follow each other. centre_px : one standard deviation
    of the principal point, which ``prior`` and calibration have in the middle.
    """
    chain = in_order(places, shared)

    def settled(
        calibration: DriveCalibration, prior: Mount, starts: Mapping[str, Floats], opened: bool
    ) -> tuple[DriveCalibration, Mount, Mapping[str, Floats], Sequence[_Posed]]:
        good: Sequence[_Posed] = ()
        for _ in range(_ROUNDS):
            images = [
                (place, load(*calibration.expected(place)))
                for place, load in zip(places, loaders, strict=True)
            ]
            if all(task.landmarks is None for _, task in images) and not is_tied(chain):
                break
            found = [(p, t, locate(t, noise, starts.get(p.image))) for p, t in images]
            good = [(p, t, fits[0]) for p, t, fits in found if usable(t, fits)]
            if len(good) < 3:
                break
            starts = {**starts, **{place.image: fit.unknowns for place, _, fit in good}}
            before = calibration.mount
            calibration = _improved(calibration, good, prior, model, chain)
            if not opened:
                calibration, prior = _opened(calibration, good, prior, noise, side_yaw_deg)
                opened = True
            elif _moved(before, calibration.mount) < _SETTLED:
                break
        return calibration, prior, starts, good

    calibration, prior, starts, good = settled(calibration, prior, starts, opened=False)
    told = len(good) >= 3 and is_tied(chain) and not calibration.problem
    if not told:
        mount = with_centre_open(calibration.mount, centre_px)
        return replace(calibration, mount=mount), starts

    def solve(images: Sequence[Tied], prior: Mount) -> Mount:
        spread, drift = calibration.spread, calibration.drift.model
        return mount_together(images, prior, spread, drift, _LENS_SCALES)

    images = _chained(calibration, good, chain)
    mount, told = told_centre(images, calibration.mount, prior, centre_px, solve)
    calibration = replace(calibration, mount=mount)
    if told:
        prior = with_centre_open(prior, centre_px)
        calibration, prior, starts, good = settled(calibration, prior, starts, opened=True)
        images = _chained(calibration, good, chain)
        mount = with_lens_sigmas(images, calibration.mount, prior, solve)
        calibration = replace(calibration, mount=mount)
    point = calibration.mount.mean[CX], np.sqrt(calibration.mount.covariance[CX, CX])
    log.info("principal point %s: %.1f +- %.1f px", "found" if told else "not told", *point)
    return calibration, starts


def _moved(before: Mount, after: Mount) -> float:
    """How far the drive's mean moved, in standard deviations."""
    sigma = np.sqrt(np.diag(after.covariance))
    return float((np.abs(after.mean - before.mean) / sigma).max())


def _improved(
    calibration: DriveCalibration,
    good: Sequence[_Posed],
    prior: Mount,
    model: DriftModel,
    chain: Chain,
) -> DriveCalibration:
    mount, spread = calibration.mount, calibration.spread
    if not calibration.problem:
        fits = [fit for _, _, fit in good]
        if is_tied(chain):
            images = _chained(calibration, good, chain)
            mount = mount_together(images, prior, spread, calibration.drift.model)
        else:
            mount = shared_mean(fits, prior, spread)
        spread = estimated_spread(fits, mount, Spread())
    measured = [(place, fit) for place, _, fit in good]
    drift, numbers = drift_of(measured, mount, spread, model)
    return replace(calibration, mount=mount, spread=spread, drift=drift, measured=numbers)


def _chained(calibration: DriveCalibration, good: Sequence[_Posed], chain: Chain) -> list[Tied]:
    found = {place.image: fit for place, _, fit in good}
    return [_tied(calibration, place, found.get(place.image), points) for place, points in chain]


def _tied(calibration: DriveCalibration, place: Place, fit: Fit | None, points: Floats) -> Tied:
    unknowns = calibration.expected(place)[0] if fit is None else fit.unknowns
    return Tied(Member(place, unknowns, None, points), fit)


def _opened(
    calibration: DriveCalibration,
    good: Sequence[_Posed],
    prior: Mount,
    noise: LandmarkNoise,
    side_yaw_deg: tuple[float, float],
) -> tuple[DriveCalibration, Mount]:
    """Calibration that looks at the side views, and the prior that goes with it."""
    posed = [(task, fit) for _, task, fit in good]
    turns = side_turns(posed, _guesses(calibration, side_yaw_deg, posed), noise)
    log.info("side views: %s +- %s degrees", turns.deg, turns.sigma_deg)
    seen = np.flatnonzero(np.isfinite(turns.sigma_deg[1:])) + 1
    mounts = [calibration.mount, prior]
    for number, mount in enumerate(mounts):
        mean, covariance = mount.mean.copy(), mount.covariance.copy()
        for view in seen:
            at = TURNS - 1 + view
            mean[at] = turns.deg[view]
            covariance[at], covariance[:, at] = 0.0, 0.0
            covariance[at, at] = _TURN_SIGMA_DEG**2
        mounts[number] = replace(mount, mean=mean, covariance=covariance)
    return replace(calibration, mount=mounts[0]), mounts[1]


def _guesses(
    calibration: DriveCalibration,
    side_yaw_deg: tuple[float, float],
    images: Sequence[tuple[Task, Fit]],
) -> dict[str, list[float]]:
    """Where to look for the yaw of each side view: as given, and as for views that stitch."""
    width = calibration.key[1]
    hfov = 2 * np.degrees(np.arctan(0.5 * width / np.exp(calibration.mount.mean[FOCAL])))
    seen = {
        view
        for task, _ in images
        if task.landmarks is not None
        for view in VIEWS[1:]
        if len(task.landmarks.axes.seen_by(view))
    }
    pairs = zip(VIEWS[1:], side_yaw_deg, (-_STITCHED, _STITCHED), strict=True)
    return {view: [given, share * hfov] for view, given, share in pairs if view in seen}
