"""The calibration of the drives of a site as JSON content, and the expectation it gives."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from roadsight.base.arrays import Floats
from roadsight.base.errors import InputError
from roadsight.poles.alignment.drift import Drift, DriftModel, expect_place, measured_offset
from roadsight.poles.alignment.drive import Place
from roadsight.poles.alignment.epipolar import POSED
from roadsight.poles.alignment.landmarks import Turns
from roadsight.poles.alignment.pose import ALONG, FOCAL, LATERAL, SIZE, UNKNOWNS, Spread
from roadsight.poles.alignment.solve import Fit, search
from roadsight.poles.calibration.calibration import Loader, Mount, apart_from_centre, usable
from roadsight.poles.drive.drive_lenses import Key
from roadsight.poles.images.views import VIEWS


@dataclass(frozen=True)
class DriveCalibration:
    """Mount of one drive, and the errors of its track where images measured them.

    Attributes
    ----------
    measured : numbers of the drift's measurements by image. problem : why there is no better
    mount than the one given beforehand, or "".
    told : pose (6,) of each image as the others tell it, and its covariance (6, k) with all
        unknowns, see `ties`.
    sigma_cy_px : 1 sigma of the principal point's row, which no drive tells.
    """

    key: Key
    mount: Mount
    spread: Spread
    drift: Drift
    measured: Mapping[str, int]
    problem: str = ""
    told: Mapping[str, tuple[Floats, Floats]] = field(default_factory=dict)
    sigma_cy_px: float = 0.0

    @property
    def turns(self) -> Turns:
        """Yaw of the side views."""
        return Turns.of(self.mount.mean, apart_from_centre(self.mount.covariance)[0])

    def expected(self, place: Place) -> tuple[Floats, Floats]:
        """Expected unknowns of an image and the inverse of their covariance.

        They rest on the drive and on what other images say about its track, not on the image, and
        hold for the drive's principal point: no image can tell it. `by_centre` has what it moves.
        """
        mean, covariance = self._expected(place)
        known = apart_from_centre(covariance)[0]
        return mean, np.asarray(np.linalg.inv(known), np.float64)

    def by_centre(self, place: Place) -> Floats:
        """What one standard deviation of the principal point moves (k,) in an image's unknowns."""
        return apart_from_centre(self._expected(place)[1])[1]

    def _expected(self, place: Place) -> tuple[Floats, Floats]:
        variance = self.spread.vector() ** 2
        variance[[ALONG, LATERAL]] = 0.0
        error = self.drift.at(place.station_m, self.measured.get(place.image))
        mean, covariance = expect_place(
            self.mount.mean,
            self.mount.covariance + np.diag(variance),
            error,
            place.start.heading_deg,
        )
        if place.image in self.told:
            mean[:POSED], covariance[:POSED] = self.told[place.image]
            covariance[POSED:, :POSED] = covariance[:POSED, POSED:].T
        return mean, covariance


def measure_drift(
    places: Sequence[Place],
    loaders: Sequence[Loader],
    mount: Mount,
    spread: Spread,
    model: DriftModel,
) -> tuple[Drift, dict[str, int], dict[str, Floats]]:
    """Errors of the track of one drive from all images that can be aligned.

    Returns
    -------
    the drift, the number of each image's measurement, and the unknowns of each image
    """
    information = mount.expected(spread)
    found = []
    for place, load in zip(places, loaders, strict=True):
        task = load(mount.mean, information).coarser()
        fits = search(task)
        if usable(task, fits):
            found.append((place, fits[0]))
    starts = {place.image: fit.unknowns for place, fit in found}
    return *drift_of(found, mount, spread, model), starts


def drift_of(
    images: Sequence[tuple[Place, Fit]], mount: Mount, spread: Spread, model: DriftModel
) -> tuple[Drift, dict[str, int]]:
    """Errors of the track from aligned images, and the number of each image's measurement.

    Parameters
    ----------
    model : of the receiver, as said beforehand; the drift's own is fitted to the images.
    """
    covariance = mount.covariance + np.diag(spread.vector() ** 2)
    names, stations, offsets, covariances = [], [], [], []
    for place, fit in images:
        offset = measured_offset(fit, mount.mean, covariance, place.start.heading_deg)
        names.append(place.image)
        stations.append(place.station_m)
        offsets.append(offset[0])
        covariances.append(offset[1])
    measured = Drift(
        np.array(stations, float),
        np.array(offsets, float).reshape(-1, 2),
        np.array(covariances, float).reshape(-1, 2, 2),
        model,
    )
    drift, kept = measured.fitted().without_outliers()
    left = [name for name, stays in zip(names, kept, strict=True) if stays]
    return drift, {name: number for number, name in enumerate(left)}


def to_content(calibration: DriveCalibration) -> dict[str, Any]:
    """JSON content; `from_content` reads it back."""
    mount, drift, turns = calibration.mount, calibration.drift, calibration.turns
    route, width, height = calibration.key
    sigma = np.sqrt(np.diag(mount.covariance))
    names = sorted(calibration.measured, key=lambda name: calibration.measured[name])
    focal = float(np.exp(mount.mean[FOCAL]))
    return {
        "route": route,
        "width_px": width,
        "height_px": height,
        "focal_px": focal,
        "hfov_deg": float(np.degrees(2 * np.arctan2(0.5 * width, focal))),
        "images": mount.images,
        "problem": calibration.problem,
        **{name: float(v) for name, v in zip(UNKNOWNS, mount.mean, strict=True)},
        "sigma": {name: float(v) for name, v in zip(UNKNOWNS, sigma, strict=True)},
        "sigma_cy_px": calibration.sigma_cy_px,
        "covariance": mount.covariance.tolist(),
        "spread": vars(calibration.spread),
        "side_views": {
            view: {"yaw_deg": deg, "sigma_deg": sigma}
            for view, deg, sigma in zip(VIEWS, turns.deg, turns.sigma_deg, strict=True)
            if view != "front" and np.isfinite(sigma)
        },
        "drift_model": vars(drift.model),
        "drift": [
            {"image": name, "station_m": float(s), "offset_m": o.tolist(), "covariance_m2": c}
            for name, s, o, c in zip(
                names, drift.station_m, drift.offset_m, drift.covariance_m2.tolist(), strict=True
            )
        ],
        "told": [
            {"image": name, "pose": pose.tolist(), "covariance": own.tolist()}
            for name, (pose, own) in sorted(calibration.told.items())
        ],
    }


def from_content(content: Mapping[str, Any]) -> DriveCalibration:
    """Calibration of one drive.

    Raises
    ------
    InputError : the content is not what `to_content` makes.
    """
    try:
        rows = content["drift"]
        drift = Drift(
            np.array([row["station_m"] for row in rows], float),
            np.array([row["offset_m"] for row in rows], float).reshape(-1, 2),
            np.array([row["covariance_m2"] for row in rows], float).reshape(-1, 2, 2),
            DriftModel(**content["drift_model"]),
        )
        mount = Mount(
            np.array([content[name] for name in UNKNOWNS], float),
            np.array(content["covariance"], float).reshape(SIZE, SIZE),
            int(content["images"]),
        )
        key = str(content["route"]), int(content["width_px"]), int(content["height_px"])
        measured = {row["image"]: number for number, row in enumerate(rows)}
        spread = Spread(**content["spread"])
        told = {
            row["image"]: (np.array(row["pose"], float), np.array(row["covariance"], float))
            for row in content["told"]
        }
        rest = content["problem"], told, float(content["sigma_cy_px"])
        return DriveCalibration(key, mount, spread, drift, measured, *rest)
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(
            f"is no calibration of a drive ({error!r})",
            where="calibration",
            hint="delete it and run the workflow again",
        ) from error


def baseline_mount(content: Mapping[str, Any], prior: Mount, width_px: int) -> Mount:
    """Prior with the numbers of a baseline put in, each trusted to its sigma.

    Parameters
    ----------
    content : ``focal_px`` or ``hfov_deg``, and any of ``pitch_deg``, ``roll_deg``, ``yaw_deg``,
        ``height_m``, ``lateral_m``, ``along_m`` relative to the vehicle; ``sigma`` with any of
        these names (``log_focal`` for the lens) to replace the defaults of 2 %, 1 degree, 0.2 m.

    Raises
    ------
    InputError : a number is not finite or the lens is not positive.
    """
    mean, variance = prior.mean.copy(), np.diag(prior.covariance).copy()
    given = dict(content)
    if "hfov_deg" in given and "focal_px" not in given:
        given["focal_px"] = 0.5 * width_px / np.tan(np.radians(given["hfov_deg"]) / 2)
    if "focal_px" in given:
        given["log_focal"] = np.log(given["focal_px"]) if given["focal_px"] > 0 else np.nan
    for number, name in enumerate(UNKNOWNS):
        if name not in given:
            continue
        sigma = given.get("sigma", {}).get(name)
        default = 0.02 if name == "log_focal" else 1.0 if name.endswith("deg") else 0.2
        mean[number] = given[name]
        variance[number] = (default if sigma is None else sigma) ** 2
    if not (np.isfinite(mean).all() and np.isfinite(variance).all() and (variance > 0).all()):
        raise InputError("a number is not finite or not positive", where="baseline")
    return Mount(mean, np.diag(variance))
