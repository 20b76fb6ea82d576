import numpy as np
import pytest

from roadsight.base.errors import InputError
from roadsight.poles.alignment.dense import DenseTask, moved
from roadsight.poles.alignment.pose import FOCAL
from roadsight.poles.calibration.calibration import weak_mount
from roadsight.poles.calibration.calibration_dense import SPREAD, calibrate_dense, with_lens
from roadsight.poles.images.evidence import ImageEvidence
from tests.helpers.dense_street import LENS, SIZE, DenseStreet

MOUNT = np.array([0.2, -0.1, 1.7, 1.6, -2.4, 0.9])
"""Along, lateral, height, yaw, pitch, roll."""


@pytest.fixture(scope="module")
def loaders():
    street = DenseStreet(seed=3)
    cloud, random = street.cloud(0.18), np.random.default_rng(5)
    made = []
    for n in range(4):
        track = np.array([0.8, 4.0 * n, 0.0, 0.0, 0.0, 0.0])
        sway = random.normal(0.0, [0.2, 0.2, 0.03, 0.3, 0.3, 0.2])
        evidence = ImageEvidence(*street.photograph(moved(track, MOUNT + sway)))

        def load(mean, covariance, track=track, evidence=evidence):
            return DenseTask(cloud, evidence, LENS, moved(track, mean), covariance)

        made.append(load)
    return made


def test_the_mount_is_found_from_a_wrong_guess(loaders):
    prior = with_lens(weak_mount(None, SIZE[1]), LENS.focal_px, 1e-4)
    mount, images = calibrate_dense(loaders, prior, SPREAD)
    sigma = np.sqrt(np.diag(mount.covariance))[:6]
    assert mount.images == len(images) == 4
    assert np.abs(mount.mean[3:6] - MOUNT[3:]).max() < 0.5
    assert abs(mount.mean[2] - MOUNT[2]) < 0.2
    assert (np.abs(mount.mean[:6] - MOUNT) < 4 * sigma).all()
    # The lens holds: nothing may touch it.
    assert mount.mean[FOCAL] == np.log(LENS.focal_px)
    assert mount.covariance[FOCAL, FOCAL] == pytest.approx(1e-8)


def test_too_few_images_are_told(loaders):
    with pytest.raises(InputError, match="found 2; allowed: at least 3"):
        calibrate_dense(loaders[:2], weak_mount(None, SIZE[1]), SPREAD)
