"""What the images of each drive share: lens, mount, and the slow error of the track."""

from __future__ import annotations

import logging
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, TypeVar

import numpy as np
import pandas as pd

from roadsight.base.errors import InputError
from roadsight.base.sections.poles import Calibration, SideViews
from roadsight.io.images.camera_tables import read_baselines
from roadsight.io.records.atomic import write_json
from roadsight.io.records.tables import read_table
from roadsight.poles.alignment.dense import GivenLens
from roadsight.poles.alignment.drift import Drift, DriftModel
from roadsight.poles.alignment.drive import Place
from roadsight.poles.alignment.landmarks import LandmarkNoise
from roadsight.poles.alignment.pose import CX, FOCAL, UNKNOWNS, Spread
from roadsight.poles.calibration.calibration import (
    Loader,
    Mount,
    calibrate,
    find_focal,
    weak_mount,
    with_centre_held,
    with_centre_open,
)
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
from roadsight.poles.calibration.calibration_together import Shared, centre_doubts, with_ties
from roadsight.poles.calibration.calibration_upright import aimed
from roadsight.stages.command import Command, tell
from roadsight.stages.poles.shared.alignment_inputs import SceneFiles, read_scene
from roadsight.stages.poles.shared.dense_inputs import DenseFiles, DenseScene, method_of

log = logging.getLogger("calibrate_drive")
_Item = TypeVar("_Item")
_FEW = 12
"""Images that tell the focal length roughly: all are aligned anew for each of 14 focal lengths."""
_TOLD = ("hfov_deg", "cx_shift_px", "yaw_deg", "pitch_deg", "height_m")
"""What the log says of a drive's camera."""
_SURE_LENS = 1e-4
"""Least standard deviation of the logarithm of a known focal length; zero has no inverse."""


def calibrate_drives(
    files: SceneFiles,
    given: DenseFiles,
    settings: Calibration,
    left_yaw_deg: Annotated[float, SideViews],
    right_yaw_deg: Annotated[float, SideViews],
    baseline: Annotated[str | None, 'JSON by image size, {"2000x1200": {...}}, or "all"'] = None,
    matches: Annotated[Sequence[Path], "tables of shared points"] = (),
    doubts_path: Annotated[Path | None, "what the drives leave open"] = None,
    *,
    out: Path,
) -> None:
    """Calibrate each drive (route and image size) and measure the error of its track."""
    scene = read_scene(files, given.intrinsics)
    baselines = read_baselines(baseline) if baseline else {}
    shared: Shared = {}
    if matches:
        pixels = ["u", "v", "u_other", "v_other"]
        table = pd.concat([read_table(path, ["image", "other", *pixels]) for path in matches])
        groups = table.groupby(["image", "other"], sort=True)
        shared = {(str(a), str(b)): own[pixels].to_numpy(np.float64) for (a, b), own in groups}
    method = method_of(given.method, bool(scene.lenses))
    dense = DenseScene(files, given, scene.lenses) if method == "dense" else None
    drives: dict[Key, list[tuple[Place, Loader]]] = {}
    for place, load in scene.loaders():
        key = place.route, place.start.width_px, place.start.height_px
        drives.setdefault(key, []).append((place, load))
    content, sides, doubts = [], (left_yaw_deg, right_yaw_deg), []
    for key, images in sorted(drives.items(), key=lambda item: item[0]):
        lenses = [scene.lenses[p.image] for p, _ in images if p.image in scene.lenses]
        prior = _prior(key, settings, baselines, lenses)
        if method == "published":
            calibration = _registered(key, settings, baselines, baseline)
        elif dense is not None:
            calibration = _densely(key, [p for p, _ in images], settings, prior, dense)
        else:
            known = bool(lenses) or settings.hfov_deg or _baseline(key, baselines)
            focal = None if known else _FEW
            calibration = _calibrated(
                key, images, settings, prior, focal, scene.landmarks, shared, sides
            )
            mount = _lens_held(calibration.mount, lenses)
            row_px = max((lens.sigma_cy_px for lens in lenses), default=settings.principal_point_px)
            calibration = replace(calibration, mount=mount, sigma_cy_px=row_px)
        told, mount = to_content(calibration), calibration.mount
        numbers = ", ".join(f"{name} {told[name]:.3f}" for name in _TOLD)
        counts = mount.images, len(calibration.measured)
        log.info("%s %d x %d: %d images, %d track errors, %s", *key, *counts, numbers)
        doubts += centre_doubts(key[0], mount)
        content.append(told)
    if doubts_path:
        tell(doubts, doubts_path, "poles", log)
    write_json(out, {"drives": content})


def _baseline(key: Key, baselines: dict[str, Any]) -> dict[str, Any] | None:
    found: dict[str, Any] | None = baselines.get(f"{key[1]}x{key[2]}", baselines.get("all"))
    return found


def _registered(
    key: Key, settings: Calibration, baselines: dict[str, Any], path: str | None
) -> DriveCalibration:
    """The registered camera alone: the pole study finds nothing that a drive shares.

    Raises
    ------
    InputError : there is none of this image size, or one of its numbers is missing.
    """
    found = _baseline(key, baselines) or {}
    lens = {"log_focal"} if {"focal_px", "hfov_deg"} & set(found) else set()
    if missing := [n for n in UNKNOWNS[: FOCAL + 1] if n not in found and n not in lens]:
        size = f"{key[1]}x{key[2]}"
        raise InputError(
            "the published alignment starts from a registered camera of each image size",
            where=f"{path or 'poles.baseline'}: {size}",
            found=f"no {', '.join(missing)}"
            if found
            else f"sizes {', '.join(baselines) or 'none'}",
            hint=f"register an image of {size} px: roadsight register, or the studio",
        )
    weak = weak_mount(settings.hfov_deg or None, key[1], settings.principal_point_px)
    mount = with_centre_held(baseline_mount(found, weak, key[1]))
    return DriveCalibration(key, mount, Spread(), _no_drift(settings), {})


def _no_drift(settings: Calibration) -> Drift:
    model = DriftModel(settings.gps_sigma_m, settings.gps_length_m, settings.gps_own_m)
    return Drift(np.empty(0), np.empty((0, 2)), np.empty((0, 2, 2)), model)


def _prior(
    key: Key, settings: Calibration, baselines: dict[str, Any], given: list[GivenLens]
) -> tuple[Mount, str]:
    """What is known of a drive's mount beforehand, and what is wrong with its baseline."""
    baseline = _baseline(key, baselines)
    prior = weak_mount(settings.hfov_deg or None, key[1], settings.principal_point_px)
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
    mount = with_lens(mount, float(np.exp(np.median(focal))), sigma)
    return with_centre_open(with_centre_held(mount), max(lens.sigma_cx_px for lens in given))


def _densely(
    key: Key,
    places: list[Place],
    settings: Calibration,
    known: tuple[Mount, str],
    scene: DenseScene,
) -> DriveCalibration:
    """Calibration of a drive with a known lens, from photographs and cloud."""
    spread, (prior, problem) = SPREAD, known
    mount, chosen = prior, _evenly(places, min(settings.images, IMAGES))
    if len(chosen) < FEWEST:
        problem = problem or f"{len(chosen)} images do not tell how the camera is mounted"
    if problem:
        log.warning("%s: %s", key[0], problem)
    else:
        mount, _ = calibrate_dense([scene.loader(place) for place in chosen], prior, spread)
    return DriveCalibration(key, mount, spread, _no_drift(settings), {}, problem)


def _calibrated(
    key: Key,
    images: list[tuple[Place, Loader]],
    settings: Calibration,
    known: tuple[Mount, str],
    focal_images: int | None,
    noise: LandmarkNoise,
    shared: Shared,
    sides: tuple[float, float],
) -> DriveCalibration:
    """Calibration from road edges; the focal length is sought on some images if on any."""
    places, loaders = [p for p, _ in images], [load for _, load in images]
    spread, (weak, problem) = Spread(), known
    # Where edges and poles are paired anew each time, a free principal point drifts with the yaw.
    prior = with_centre_held(weak)
    mount, chosen = prior, _evenly(loaders, settings.images)
    try:
        if problem:
            raise InputError(problem)
        if focal_images:
            prior = find_focal(_evenly(loaders, focal_images), prior, spread, key[1])
        if settings.start == "landmarks":
            prior = aimed(prior, loaders, noise, spread)
        mount, _ = calibrate(chosen, prior, spread)
    except InputError as error:
        log.warning("%s: %s", key[0], error)
        mount, problem = prior, str(error)
    model = DriftModel(settings.gps_sigma_m, settings.gps_length_m, settings.gps_own_m)
    drift, measured, starts = measure_drift(places, loaders, mount, spread, model)
    centre_px = float(np.sqrt(weak.covariance[CX, CX]))
    calibration = DriveCalibration(key, mount, spread, drift, measured, problem)
    calibration, found = with_landmarks(
        calibration, places, loaders, prior, noise, sides, starts, model, shared, centre_px
    )
    return with_ties(calibration, places, loaders, noise, found, shared)


def _evenly(items: list[_Item], count: int) -> list[_Item]:
    index = np.unique(np.linspace(0, len(items) - 1, min(count, len(items))).round())
    return [items[int(number)] for number in index]


main = Command(calibrate_drives)


if __name__ == "__main__":
    sys.exit(main())
