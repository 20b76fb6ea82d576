from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from roadsight.poles.alignment.dense import (
    FLOOR_PX,
    YAW,
    DenseFit,
    DenseTask,
    GivenLens,
    align_dense,
    common_sigma,
    gather,
    moved,
)
from roadsight.poles.alignment.verdict import (
    AT_BOUND,
    NO_LEAD,
    TOO_LITTLE,
    UNHELD,
    VAGUE_HEADING,
    Limits,
    dense_doubt,
    lost_views,
)
from roadsight.poles.alignment.visible import SceneCloud
from roadsight.poles.images.evidence import ImageEvidence
from tests.helpers.dense_street import LENS, SIZE, DenseStreet

TRUE = np.array([0.6, 3.0, 1.7, 1.0, -1.5, 0.4])
EXPECTED = np.diag(np.array([0.7, 0.7, 0.1, 2.0, 1.0, 1.0]) ** 2)
OFF = np.array([0.6, -0.7, 0.05, 2.0, -1.0, 0.8])


@pytest.fixture(scope="module")
def street():
    return DenseStreet()


@pytest.fixture(scope="module")
def cloud(street):
    return street.cloud(0.15)


@pytest.fixture(scope="module")
def seen(street):
    return street.photograph(TRUE)


@pytest.fixture(scope="module")
def found(cloud, seen):
    """Task that starts 2 degrees and 0.9 m off, and its fit."""
    task = DenseTask(cloud, ImageEvidence(*seen), LENS, moved(TRUE, OFF), EXPECTED)
    return task, align_dense(task)


def test_the_true_pose_is_found_and_accepted(found):
    task, fit = found
    assert abs(fit.pose[YAW] - TRUE[YAW]) < 0.15
    assert np.abs(fit.pose[3:] - TRUE[3:]).max() < 0.3
    assert np.abs(fit.pose[:3] - TRUE[:3]).max() < 0.3
    assert np.hypot(*(fit.pose - TRUE)[:2]) < 4 * np.hypot(*fit.sigma[:2])
    assert dense_doubt(task, fit, Limits()) == ""


def test_the_stated_sigma_holds_what_all_samples_share(found):
    _, fit = found
    assert fit.sigma[YAW] > np.degrees(FLOOR_PX / LENS.focal_px)
    assert abs(fit.pose[YAW] - TRUE[YAW]) < 3 * fit.sigma[YAW]


def test_the_result_repeats(found):
    task, fit = found
    again = align_dense(replace(task, evidence=task.evidence))
    np.testing.assert_array_equal(again.pose, fit.pose)
    np.testing.assert_array_equal(again.covariance, fit.covariance)


def test_a_photograph_of_another_street_is_not_used(cloud):
    other = DenseStreet(seed=9).photograph(TRUE)
    task = DenseTask(cloud, ImageEvidence(*other), LENS, moved(TRUE, OFF), EXPECTED)
    assert dense_doubt(task, align_dense(task), Limits())


def test_a_blank_photograph_keeps_what_was_expected_and_is_not_used(cloud):
    blank = np.full(SIZE, 90, np.uint8)
    task = DenseTask(cloud, ImageEvidence(blank, blank * 0), LENS, TRUE, EXPECTED)
    fit = align_dense(task)
    np.testing.assert_allclose(fit.offsets, 0.0, atol=1e-4)
    assert dense_doubt(task, fit, Limits()) in (NO_LEAD, VAGUE_HEADING)


def test_an_empty_cloud_is_told(seen):
    task = DenseTask(SceneCloud.joined([]), ImageEvidence(*seen), LENS, TRUE, EXPECTED)
    assert dense_doubt(task, align_dense(task), Limits()) == TOO_LITTLE


def test_large_images_are_looked_at_small(street, cloud, found):
    factor = 2
    lens = GivenLens(*(np.array([LENS.focal_px, LENS.cx_px + 0.5, LENS.cy_px + 0.5]) * factor))
    lens = replace(lens, cx_px=lens.cx_px - 0.5, cy_px=lens.cy_px - 0.5)
    grey, classes = street.photograph(TRUE, lens, (SIZE[0] * factor, SIZE[1] * factor))
    evidence = ImageEvidence(grey, classes)
    assert evidence.shape[1] == 1400 and evidence.scale == pytest.approx(1400 / 2400)
    task = DenseTask(cloud, evidence, lens, moved(TRUE, OFF), EXPECTED)
    assert abs(align_dense(task).pose[YAW] - TRUE[YAW]) < 0.15


def fit_of(**changed):
    values = {
        "offsets": np.zeros(6), "pose": TRUE, "covariance": np.eye(6) * 1e-4, "cost": 0.0,
        "gain": 0.0, "second": np.inf, "lead": 20.0, "samples": 5000,
    }  # fmt: skip
    return DenseFit(**(values | changed))


@pytest.mark.parametrize(
    ("changed", "reason"),
    [
        ({}, ""),
        ({"samples": 10}, TOO_LITTLE),
        ({"covariance": np.full((6, 6), np.inf)}, UNHELD),
        ({"covariance": np.full((6, 6), np.nan)}, UNHELD),
        ({"offsets": np.array([0, 0, 0, np.nan, 0, 0])}, UNHELD),
        ({"offsets": np.array([0, 0, 0.45, 0, 0, 0])}, AT_BOUND),
        ({"offsets": np.array([0, 0, 0, -9.0, 0, 0])}, AT_BOUND),
        ({"lead": 2.0}, NO_LEAD),
        ({"second": 1.0}, "ambiguous: two poses fit about as well"),
        ({"covariance": np.eye(6)}, VAGUE_HEADING),
    ],
)
def test_reasons(found, changed, reason):
    assert dense_doubt(found[0], fit_of(**changed), Limits()) == reason


def test_what_a_drive_loses_is_said():
    assert lost_views(["", ""]) == "0 of 2 views are not used"
    told = lost_views(["", AT_BOUND, AT_BOUND, UNHELD])
    assert told.startswith("3 of 4 views are not used: ")
    assert f"2 x {AT_BOUND}" in told and f"1 x {UNHELD}" in told


def test_an_uncertain_lens_makes_an_uncertain_camera():
    sure = common_sigma(LENS)
    vague = common_sigma(replace(LENS, sigma_cx_px=5.0, sigma_cy_px=2.0, sigma_focal_px=10.0))
    assert vague[YAW] == pytest.approx(np.degrees(np.hypot(5.0, FLOOR_PX) / LENS.focal_px))
    assert (vague >= sure).all() and vague[0] > 5 * sure[0]


def test_moved_along_is_ahead_and_lateral_is_right():
    pose = np.array([5.0, 6.0, 7.0, 90.0, 0.0, 0.0])
    np.testing.assert_allclose(moved(pose, np.eye(6)[0])[:2], [6.0, 6.0], atol=1e-12)
    np.testing.assert_allclose(moved(pose, np.eye(6)[1])[:2], [5.0, 5.0], atol=1e-12)


@given(st.floats(-180, 360), st.lists(st.floats(-5, 5), min_size=6, max_size=6))
@settings(max_examples=50, deadline=None)
def test_a_move_has_its_length_and_goes_back(heading, offsets):
    pose, offsets = np.array([1.0, 2.0, 3.0, heading, 1.0, 2.0]), np.array(offsets)
    there = moved(pose, offsets)
    assert np.linalg.norm(there[:3] - pose[:3]) == pytest.approx(np.linalg.norm(offsets[:3]))
    np.testing.assert_allclose(there[3:] - pose[3:], offsets[3:], atol=1e-9)
    straight = np.append(offsets[:3], np.zeros(3))
    np.testing.assert_allclose(moved(moved(pose, straight), -straight), pose, atol=1e-9)


def test_thinned_samples_count_as_much(found):
    task, _ = found
    samples = gather(task, np.zeros(6))
    few = samples.thinned(4)
    assert few.weight.sum() == pytest.approx(samples.weight.sum(), rel=0.05)
    assert samples.tile.max() < samples.tiles


def test_pixels_keep_their_place_in_a_smaller_image():
    half = LENS.vector(0.5)
    # The left border of the image, -0.5, stays the left border.
    assert (half[1] + 0.5) / (LENS.cx_px + 0.5) == pytest.approx(0.5)
    assert half[0] == 0.5 * LENS.focal_px
