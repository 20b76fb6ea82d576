"""What the images of each drive share: lens, mount, and the slow error of the track."""

from __future__ import annotations

import argparse
import logging
import sys
from dataclasses import replace
from typing import Any, TypeVar

import numpy as np
import pandas as pd

from roadsight.base.errors import InputError
from roadsight.base.options import add_settings
from roadsight.config.sections.poles import Calibration
from roadsight.io.images.baselines import read_baselines
from roadsight.io.records.atomic import write_json
from roadsight.io.records.tables import read_table
from roadsight.poles.alignment.dense import GivenLens
from roadsight.poles.alignment.drift import Drift, DriftModel
from roadsight.poles.alignment.drive import Place
from roadsight.poles.alignment.landmarks import LandmarkNoise
from roadsight.poles.alignment.pose import Spread
from roadsight.poles.calibration.calibration import Loader, Mount, calibrate, find_focal, weak_mount
from roadsight.poles.calibration.calibration_dense import (
    FEWEST,
    IMAGES,
    SPREAD,
    calibrate_dense,
    with_lens,
)
from roadsight.poles.calibration.calibration_landmarks import with_landmarks
from roadsight.poles.calibration.calibration_table import (
    DriveCalibration,
    Key,
    baseline_mount,
    measure_drift,
    to_content,
)
from roadsight.poles.calibration.calibration_ties import Shared, with_ties
from roadsight.poles.calibration.calibration_upright import aimed
from roadsight.poles.images.stitching import ViewOffsets
from roadsight.stages.command import run_stage
from roadsight.stages.poles.alignment_inputs import add_arguments, read_scene
from roadsight.stages.poles.dense_inputs import DenseScene, add_dense_arguments, method_of

log = logging.getLogger("calibrate_drive")
_Item = TypeVar("_Item")
_FEW = 12
"""Images that tell the focal length roughly: all are aligned anew for each of 14 focal lengths."""
_SURE_LENS = 1e-4
"""Least standard deviation of the logarithm of a known focal length; zero has no inverse."""


def calibrate_drives(arguments: argparse.Namespace) -> None:
    """Calibrate each drive (route and image size) and measure the error of its track."""
    scene = read_scene(arguments)
    baselines = read_baselines(arguments.baseline) if arguments.baseline else {}
    shared = _shared_points(arguments.matches)
    method = method_of(arguments.method, bool(scene.lenses))
    dense = DenseScene(arguments, scene.lenses) if method == "dense" else None
    drives: dict[Key, list[tuple[Place, Loader]]] = {}
    for place, load in scene.loaders():
        key = place.route, place.start.width_px, place.start.height_px
        drives.setdefault(key, []).append((place, load))
    content = []
    for key, images in sorted(drives.items(), key=lambda item: item[0]):
        given = [scene.lenses[p.image] for p, _ in images if p.image in scene.lenses]
        prior = _prior(key, arguments, baselines, given)
        if dense is not None:
            calibration = _densely(key, [p for p, _ in images], arguments, prior, dense)
        else:
            known = bool(given) or arguments.hfov_deg or _baseline(key, baselines)
            focal = None if known else _FEW
            calibration = _calibrated(key, images, arguments, prior, focal, scene.landmarks, shared)
            mount = _lens_held(calibration.mount, given)
            calibration = replace(calibration, mount=mount)
        log.info("%s %d x %d: %s", *key, _summary(calibration))
        content.append(to_content(calibration))
    write_json(arguments.out, {"drives": content})


def _baseline(key: Key, baselines: dict[str, Any]) -> dict[str, Any] | None:
    found: dict[str, Any] | None = baselines.get(f"{key[1]}x{key[2]}", baselines.get("all"))
    return found


def _prior(
    key: Key, arguments: argparse.Namespace, baselines: dict[str, Any], given: list[GivenLens]
) -> tuple[Mount, str]:
    """What is known of a drive's mount beforehand, and what is wrong with its baseline."""
    prior, baseline = weak_mount(arguments.hfov_deg or None, key[1]), _baseline(key, baselines)
    problem = ""
    if baseline is not None:
        try:
            prior = baseline_mount(baseline, prior, key[1])
        except InputError as error:
            problem = str(error)
    return _lens_held(prior, given), problem


def _lens_held(mount: Mount, given: list[GivenLens]) -> Mount:
    """Mount with the known lens, if there is one: no calibration may touch it."""
    if not given:
        return mount
    focal = np.log([lens.focal_px for lens in given])
    # Images may have lenses of their own: the drive's spread holds all of them.
    sigma = max(_SURE_LENS, float(np.ptp(focal)))
    return with_lens(mount, float(np.exp(np.median(focal))), sigma)


def _densely(
    key: Key,
    places: list[Place],
    arguments: argparse.Namespace,
    known: tuple[Mount, str],
    scene: DenseScene,
) -> DriveCalibration:
    """Calibration of a drive with a known lens, from photographs and cloud."""
    spread, (prior, problem) = SPREAD, known
    mount, chosen = prior, _evenly(places, min(arguments.images, IMAGES))
    if len(chosen) < FEWEST:
        problem = problem or f"{len(chosen)} images do not tell how the camera is mounted"
    if problem:
        log.warning("%s: %s", key[0], problem)
    else:
        mount, _ = calibrate_dense([scene.loader(place) for place in chosen], prior, spread)
    model = DriftModel(arguments.gps_sigma_m, arguments.gps_length_m, arguments.gps_own_m)
    drift = Drift(np.empty(0), np.empty((0, 2)), np.empty((0, 2, 2)), model)
    return DriveCalibration(key, mount, spread, drift, {}, problem)


def _calibrated(
    key: Key,
    images: list[tuple[Place, Loader]],
    arguments: argparse.Namespace,
    known: tuple[Mount, str],
    focal_images: int | None,
    noise: LandmarkNoise,
    shared: Shared,
) -> DriveCalibration:
    """Calibration from road edges; the focal length is sought on some images if on any."""
    places, loaders = [p for p, _ in images], [load for _, load in images]
    spread, (prior, problem) = Spread(), known
    mount, chosen = prior, _evenly(loaders, arguments.images)
    try:
        if problem:
            raise InputError(problem)
        if focal_images:
            prior = find_focal(_evenly(loaders, focal_images), prior, spread, key[1])
        if arguments.start == "landmarks":
            prior = aimed(prior, loaders, noise, spread)
        mount, _ = calibrate(chosen, prior, spread)
    except InputError as error:
        log.warning("%s: %s", key[0], error)
        mount, problem = prior, str(error)
    model = DriftModel(arguments.gps_sigma_m, arguments.gps_length_m, arguments.gps_own_m)
    drift, measured, starts = measure_drift(places, loaders, mount, spread, model)
    calibration = DriveCalibration(key, mount, spread, drift, measured, problem)
    sides = arguments.left_yaw_deg, arguments.right_yaw_deg
    calibration, found = with_landmarks(
        calibration, places, loaders, prior, noise, sides, starts, model
    )
    return with_ties(calibration, places, loaders, noise, found, shared)


def _shared_points(paths: list[str]) -> Shared:
    """Pixels that pairs of images share, by the names of both."""
    if not paths:
        return {}
    names = ["u", "v", "u_other", "v_other"]
    table = pd.concat([read_table(path, ["image", "other", *names]) for path in paths])
    groups = table.groupby(["image", "other"], sort=True)
    return {
        (str(one), str(other)): part[names].to_numpy(np.float64) for (one, other), part in groups
    }


def _evenly(items: list[_Item], count: int) -> list[_Item]:
    index = np.unique(np.linspace(0, len(items) - 1, min(count, len(items))).round())
    return [items[int(number)] for number in index]


def _summary(calibration: DriveCalibration) -> str:
    mount: Mount = calibration.mount
    table = pd.Series(to_content(calibration))[["hfov_deg", "yaw_deg", "pitch_deg", "height_m"]]
    numbers = ", ".join(f"{name} {value:.3f}" for name, value in table.items())
    return f"{mount.images} images, {len(calibration.measured)} track errors, {numbers}"


def main(argv: list[str] | None = None) -> int:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    add_arguments(parser)
    add_dense_arguments(parser)
    help_ = 'JSON by image size, {"2000x1200": {...}}, or "all"'
    parser.add_argument("--baseline", nargs="?", help=help_)
    parser.add_argument("--matches", nargs="*", default=[], help="tables of shared points")
    add_settings(parser, Calibration, "images", "hfov_deg", "start")
    model, sides = DriftModel(), ViewOffsets()
    parser.add_argument("--gps-sigma-m", type=float, default=model.sigma_m, help="slow error")
    parser.add_argument("--gps-length-m", type=float, default=model.length_m, help="of its path")
    parser.add_argument("--gps-own-m", type=float, default=model.own_m, help="of each position")
    parser.add_argument("--left-yaw-deg", type=float, default=sides.left_deg, help="first guess")
    parser.add_argument("--right-yaw-deg", type=float, default=sides.right_deg, help="first guess")
    return run_stage(parser, calibrate_drives, argv)


if __name__ == "__main__":
    sys.exit(main())
