from dataclasses import replace

import numpy as np
import pytest

from roadsight.poles.alignment.locate import locate
from roadsight.poles.alignment.pose import ALONG, FOCAL, LATERAL, SIZE, YAW
from roadsight.poles.alignment.solve import ImageEdges, Noise
from roadsight.poles.alignment.verdict import Limits, agreeing_landmarks, edge_doubt, heading_turns
from roadsight.stages.poles.align_cameras import aligned, judged
from tests.unit.poles.alignment.test_landmarks import bed, columns, tasks

__all__ = ["bed", "columns", "tasks"]
LIMITS = Limits()
WRONG_BY_DEG = -2.0
SURE = 0.1
"""What the others leave open, as a share of what is expected of a place alone."""


@pytest.fixture(scope="module")
def told(tasks):
    """Images as the others of the drive tell them: where they are, and sure of it."""
    sure = []
    for task in tasks:
        fit = locate(task)[0]
        sharper = task.prior_information.copy()
        sharper[:SIZE, :SIZE] /= SURE**2
        own = replace(task, prior_mean=fit.unknowns, prior_information=sharper)
        if agreeing_landmarks(task, fit) >= 1 and not edge_doubt(own, locate(own)[0], LIMITS):
            sure.append(own)
    assert len(sure) >= 3
    return sure


def elsewhere(task):
    """The same image with edges of something else, such as a wall."""
    rng = np.random.default_rng(4)
    uv = rng.uniform([0, 0.5 * task.start.height_px], task.start.width_px, (300, 2))
    uv[:, 1] = np.minimum(uv[:, 1], task.start.height_px)
    side = np.where(rng.random(300) < 0.5, -1, 1)
    return replace(task, image_edges=ImageEdges.from_pixels(uv, side, np.zeros(300, bool)))


def test_the_others_and_a_landmark_place_an_image_whose_edges_are_of_other_things(told):
    for task in told:
        used, fits, reason = judged(elsewhere(task), None, LIMITS)
        assert reason == ""
        assert len(used.image_edges.uv_px) == 0
        assert abs(fits[0].unknowns[YAW] - task.prior_mean[YAW]) < 0.1


@pytest.mark.parametrize(("along_m", "placed"), [(0.3, True), (0.8, False)])
def test_without_a_landmark_the_others_must_tell_the_place_along_the_road(told, along_m, placed):
    for task in told:
        expected = np.linalg.inv(task.prior_information)
        share = along_m / np.sqrt(expected[ALONG, ALONG])
        expected[ALONG] *= share
        expected[:, ALONG] *= share
        bare = replace(elsewhere(task), landmarks=None, prior_information=np.linalg.inv(expected))
        assert (judged(bare, None, LIMITS)[2] == "") == placed


def test_others_that_are_not_sure_place_no_image(told):
    for task in told:
        loose = replace(task, prior_information=task.prior_information * SURE**2)
        assert judged(elsewhere(loose), None, LIMITS)[2]


def test_edges_that_fit_nearby_contradict_the_others(told):
    """The others and landmarks tell a wrong heading: where it is right, the edges fit."""
    refused = 0
    for task in told:
        mean = task.prior_mean.copy()
        mean[YAW] += WRONG_BY_DEG
        axes, focal_px = task.landmarks.axes, np.exp(mean[FOCAL])
        shift_px = np.array([focal_px * np.tan(np.radians(WRONG_BY_DEG)), 0.0])
        axes = replace(axes, middle_px=axes.middle_px - shift_px)
        wrong = replace(task, prior_mean=mean, landmarks=replace(task.landmarks, axes=axes))
        refused += bool(judged(wrong, None, LIMITS)[2])
    assert refused > 0.7 * len(told)


@pytest.mark.parametrize(("spacing_m", "least", "most"), [(0.15, 0.99, 1.01), (0.7, 0.01, 0.3)])
def test_sparse_edges_that_neighbours_see_too_hardly_tell_the_place_along_the_road(
    told, spacing_m, least, most
):
    for task in told:
        loose = replace(task, prior_information=task.prior_information * SURE**2)
        bare = replace(loose, landmarks=None, noise=Noise.of_spacing(spacing_m))
        expected_m = np.sqrt(np.linalg.inv(bare.prior_information)[ALONG, ALONG])
        fit_m = np.sqrt(locate(bare)[0].covariance[ALONG, ALONG])
        row = aligned(bare, "road", LIMITS)
        assert row["edge_points"] > 0
        stated_m = row["sigma_along_m"]
        counted = (stated_m**-2 - expected_m**-2) / (fit_m**-2 - expected_m**-2)
        assert least <= counted <= most


def test_landmarks_tell_a_pose_in_full_over_sparse_edges(told):
    noise = Noise.of_spacing(0.7)
    for task in told:
        loose = replace(task, prior_information=task.prior_information * SURE**2, noise=noise)
        fit = locate(loose)[0]
        assert fit.matched_normal is not None
        edges = fit.normal - fit.matched_normal
        told_by = noise.own_share * edges + fit.matched_normal + loose.prior_information
        covariance = np.linalg.inv(told_by)
        turns = heading_turns(loose)
        row = aligned(loose, "road", LIMITS)
        stated = {name: row[name] for name in row if name.startswith("sigma_")}
        expected = {
            "sigma_along_m": np.sqrt(covariance[ALONG, ALONG]),
            "sigma_lateral_m": np.sqrt(covariance[LATERAL, LATERAL]),
            "sigma_heading_deg": np.sqrt(turns @ covariance @ turns),
            "sigma_focal_ratio": np.sqrt(covariance[FOCAL, FOCAL]),
        }
        assert {name: stated[name] for name in expected} == pytest.approx(expected, rel=0.02)
        by_focal = turns @ covariance[FOCAL] / expected["sigma_focal_ratio"]
        assert row["heading_by_focal_deg"] == pytest.approx(by_focal, rel=0.1, abs=1e-3)
