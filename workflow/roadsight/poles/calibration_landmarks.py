"""A drive's mount, side views and track error, once landmarks tell more than road edges alone."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from roadsight.poles.alignment.drive import Place
from roadsight.poles.alignment.landmarks import LandmarkNoise
from roadsight.poles.alignment.locate import locate
from roadsight.poles.alignment.pose import FOCAL
from roadsight.poles.alignment.solve import Fit, Task
from roadsight.poles.calibration import Loader, Mount, shared_mean, usable
from roadsight.poles.calibration_sides import side_turns
from roadsight.poles.calibration_table import DriveCalibration, drift_of

log = logging.getLogger(__name__)
_ROUNDS = 3
_STITCHED = 0.93
"""Turn of a side view as a share of the field of view, where views are made to be stitched."""


def with_landmarks(
    calibration: DriveCalibration,
    places: Sequence[Place],
    loaders: Sequence[Loader],
    prior: Mount,
    noise: LandmarkNoise,
    side_yaw_deg: tuple[float, float],
) -> DriveCalibration:
    """Calibration with what landmarks add; the same one if no image has any.

    Each round aligns every image under what the others say, then takes the mount, the yaw of the
    side views and the error of the track from all of them. Side views join once their yaw is
    known.

    Parameters
    ----------
    prior : what was known of the mount beforehand. side_yaw_deg : left and right, as far as known.
    """
    for number in range(_ROUNDS):
        images = [
            (place, load(*calibration.expected(place)))
            for place, load in zip(places, loaders, strict=True)
        ]
        if all(task.sight is None for _, task in images):
            return calibration
        found = [(p, t, locate(t, calibration.turns, noise)) for p, t in images]
        good = [(p, t, fits[0]) for p, t, fits in found if usable(fits, len(t.seen.uv_px))]
        if len(good) < 3:
            return calibration
        calibration = _improved(calibration, good, prior)
        if number < _ROUNDS - 1:
            posed = [(task, fit) for _, task, fit in good]
            turns = side_turns(posed, _guesses(calibration, side_yaw_deg, posed), noise)
            calibration = replace(calibration, turns=turns)
            log.info("side views: %s +- %s degrees", turns.deg, turns.sigma_deg)
    return calibration


def _improved(
    calibration: DriveCalibration, good: Sequence[tuple[Place, Task, Fit]], prior: Mount
) -> DriveCalibration:
    mount = calibration.mount
    if not calibration.problem:
        mount = shared_mean([fit for _, _, fit in good], prior, calibration.spread)
        mount = replace(mount, images=len(good))
    measured = [(place, fit) for place, _, fit in good]
    drift, numbers = drift_of(measured, mount, calibration.spread, calibration.drift.model)
    return replace(calibration, mount=mount, drift=drift, measured=numbers)


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
        if task.sight is not None
        for view in ("left", "right")
        if len(task.sight.axes.seen_by(view))
    }
    pairs = zip(("left", "right"), side_yaw_deg, (-_STITCHED, _STITCHED), strict=True)
    return {view: [given, share * hfov] for view, given, share in pairs if view in seen}
