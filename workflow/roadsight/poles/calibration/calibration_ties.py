"""A drive's calibration with what its images tell each other."""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from roadsight.base.arrays import Floats
from roadsight.poles.alignment.drift import MARK_OVERLAP, OVERLAP
from roadsight.poles.alignment.drive import Place
from roadsight.poles.alignment.epipolar import POSED
from roadsight.poles.alignment.landmarks import LandmarkNoise
from roadsight.poles.alignment.locate import locate
from roadsight.poles.alignment.pose import INSETS
from roadsight.poles.alignment.ties import LENS, Member, pose_misfit, told_by_others
from roadsight.poles.calibration.calibration import Loader, usable
from roadsight.poles.calibration.calibration_table import DriveCalibration

log = logging.getLogger(__name__)
Shared = Mapping[tuple[str, str], Floats]
"""Pixels (n, 4) that two images share, by the names of both."""

Chain = list[tuple[Place, Floats]]
"""Places in the order of travel, each with the pixels (n, 4) that it shares with the next one."""


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
