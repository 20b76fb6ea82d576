import json
from dataclasses import asdict

import numpy as np
import pytest
import shapely
from shapely import MultiPolygon, Polygon, box

from roadsight.base.errors import InputError
from roadsight.evidence.pavement_scores import binary_scores, outline_distances_m, pavement_scores

TRUE = box(0, 0, 100, 10)


@pytest.fixture
def ground():
    """One point in the middle of each square metre, 20 m around the road too."""
    x, y = np.meshgrid(np.arange(-20, 120) + 0.5, np.arange(-20, 30) + 0.5)
    return np.column_stack([x.ravel(), y.ravel()])


class TestBinaryScores:
    def test_by_hand(self):
        found = np.array([1, 1, 1, 0, 0, 0, 0, 0], bool)
        true = np.array([1, 1, 0, 1, 1, 0, 0, 0], bool)
        scores = binary_scores(found, true)
        assert scores.precision == pytest.approx(2 / 3)
        assert scores.recall == pytest.approx(2 / 4)
        assert scores.f1 == pytest.approx(2 * (2 / 3) * (1 / 2) / (2 / 3 + 1 / 2))
        assert scores.accuracy == pytest.approx(5 / 8)
        assert scores.points == 8

    def test_perfect_and_opposite(self, rng):
        true = rng.random(50) < 0.5
        assert list(asdict(binary_scores(true, true)).values()) == [1, 1, 1, 1, 50]
        assert list(asdict(binary_scores(~true, true)).values()) == [0, 0, 0, 0, 50]

    @pytest.mark.parametrize("found", [True, False])
    @pytest.mark.parametrize("true", [True, False])
    @pytest.mark.parametrize("n", [0, 4])
    def test_empty_classes_score_0_and_not_nan(self, n, found, true):
        scores = asdict(binary_scores(np.full(n, found), np.full(n, true)))
        assert np.isfinite(list(scores.values())).all()
        assert scores["f1"] == float(found and true and n > 0)


class TestOutlineDistances:
    def test_of_a_wider_outline(self):
        distance = outline_distances_m(box(0, -1, 100, 11), TRUE)
        assert len(distance) == 2 * (100 + 12) * 2
        assert np.median(distance) == pytest.approx(1.0)

    def test_holes_and_parts_count(self):
        found = MultiPolygon([TRUE.difference(box(40, 4, 60, 6)), box(200, 0, 210, 10)])
        distance = outline_distances_m(found, TRUE)
        assert distance.max() == pytest.approx(110)
        assert ((distance > 3.9) & (distance < 5.1)).any()

    def test_of_nothing(self):
        assert outline_distances_m(Polygon(), TRUE).shape == (0,)


class TestPavementScores:
    def test_the_truth_itself_scores_1(self, ground):
        scores = pavement_scores(ground, TRUE, TRUE, np.inf)
        assert scores["accuracy"] == scores["recall"] == scores["f1"] == 1
        assert scores["area_iou"] == pytest.approx(1)
        assert scores["outline_median_m"] == scores["outline_p90_m"] == 0
        assert scores["outline_found_within_1m"] == 1
        assert scores["points"] == len(ground)
        assert scores["reach_m"] is None

    def test_a_road_2_m_too_wide_on_one_side_by_hand(self, ground):
        scores = pavement_scores(ground, box(0, 0, 100, 12), TRUE, np.inf)
        assert scores["recall"] == 1
        assert scores["precision"] == pytest.approx(1000 / 1200)
        assert scores["accuracy"] == pytest.approx(1 - 200 / len(ground))
        assert scores["area_iou"] == pytest.approx(1000 / 1200)
        assert scores["outline_p90_m"] == pytest.approx(2.0, abs=0.01)

    def test_what_lies_out_of_reach_of_the_truth_does_not_count(self, ground):
        unknown = box(0, 25, 100, 29)  # a road that the survey leaves out
        found = MultiPolygon([TRUE, unknown])
        near = pavement_scores(ground, found, TRUE, 10.0)
        far = pavement_scores(ground, found, TRUE, np.inf)
        assert near["precision"] == near["area_iou"] == 1
        assert near["reach_m"] == 10.0
        assert far["precision"] == pytest.approx(1000 / 1400)
        assert near["outline_p90_m"] == pytest.approx(0, abs=1e-9)

    def test_truth_beyond_the_cloud_is_no_miss(self, ground):
        longer = box(0, 0, 1000, 10)
        scores = pavement_scores(ground, box(0, 0, 119.5, 10), longer, 10.0)
        assert scores["recall"] == 1
        assert scores["area_iou"] == pytest.approx(1, abs=1e-6)

    def test_a_truth_that_touches_the_cloud_s_corner_is_cut_to_polygons(self, ground):
        corner = box(119.5, 29.5, 140, 40)
        scores = pavement_scores(ground, TRUE, MultiPolygon([TRUE, corner]), np.inf)
        assert scores["f1"] == 1

    @pytest.mark.parametrize("found", [Polygon(), box(500, 500, 510, 510), box(-19, 25, -10, 29)])
    @pytest.mark.parametrize("reach_m", [5.0, np.inf])
    def test_a_pavement_elsewhere_scores_0_and_can_be_written(self, ground, found, reach_m):
        scores = pavement_scores(ground, found, TRUE, reach_m)
        assert scores["recall"] == scores["f1"] == scores["area_iou"] == 0
        assert scores["outline_found_within_1m"] == 0
        json.dumps(scores, allow_nan=False)

    @pytest.mark.parametrize("true", [Polygon(), shapely.affinity.translate(TRUE, 1000, 0)])
    def test_truth_that_misses_the_cloud_is_refused(self, ground, true):
        with pytest.raises(InputError, match="true pavement lies outside the cloud"):
            pavement_scores(ground, TRUE, true, np.inf)

    @pytest.mark.parametrize("n", [0, 1, 2])
    def test_too_few_ground_points_are_refused(self, ground, n):
        with pytest.raises(InputError, match="outside the cloud"):
            pavement_scores(ground[:n], TRUE, TRUE, np.inf)
