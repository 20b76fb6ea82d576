import numpy as np
import pytest

from roadsight.base.arrays import Floats
from roadsight.poles.alignment.drift import Drift, DriftModel
from roadsight_worlds.rural.videolog import GpsNoise, drifting

STATION_M = np.arange(0.0, 1000.0, 8.0)
RECEIVERS = [GpsNoise(), drifting(3.0), GpsNoise(0.1, 100.0, 0.03)]


def measured(gps: GpsNoise, rng: np.random.Generator) -> tuple[Floats, Drift]:
    """True errors, and each measured to 0.25 m but for one in seventeen that took another pole."""
    true = gps.draw(STATION_M, rng)
    offset = true + rng.normal(0.0, 0.25, true.shape)
    offset[::17] += rng.normal(0.0, 6.0, offset[::17].shape)
    covariance = np.tile(np.eye(2) * 0.25**2, (len(true), 1, 1))
    return true, Drift(STATION_M, offset, covariance, DriftModel())


def surprises(true: Floats, drift: Drift) -> Floats:
    """Squared errors of what the others say of each place, in their stated variances."""
    drift, kept = drift.without_outliers()
    number = np.cumsum(kept) - 1
    found = []
    for k, station in enumerate(STATION_M):
        mean, covariance = drift.at(station, int(number[k]) if kept[k] else None)
        found.append((true[k] - mean) @ np.linalg.solve(covariance, true[k] - mean) / 2.0)
    return np.array(found)


@pytest.mark.parametrize("gps", RECEIVERS, ids=lambda gps: f"{gps.slow_sigma_m:g} m")
def test_what_is_said_of_a_place_is_as_good_as_it_says(gps):
    usual = [
        surprises(true, drift.fitted()).mean()
        for true, drift in (measured(gps, np.random.default_rng(seed)) for seed in range(30, 36))
    ]
    assert 0.15 < np.mean(usual) < 1.3


def test_a_receiver_that_drifts_is_told_from_one_that_does_not():
    models = [measured(gps, np.random.default_rng(5))[1].fitted().model for gps in RECEIVERS]
    assert models[2].sigma_m < 0.3 < models[0].sigma_m < models[1].sigma_m
    assert models[2].own_m < models[0].own_m < models[1].own_m


def test_few_measurements_leave_the_model_as_it_is_said():
    drift = Drift(STATION_M[:7], np.full((7, 2), 5.0), np.tile(np.eye(2), (7, 1, 1)), DriftModel())
    assert drift.fitted() is drift


def test_order_of_the_places_does_not_matter(rng):
    _, drift = measured(drifting(3.0), rng)
    order = rng.permutation(len(STATION_M))
    mixed = Drift(
        STATION_M[order], drift.offset_m[order], drift.covariance_m2[order], drift.model
    ).fitted()
    assert mixed.model == drift.fitted().model
