import json
from dataclasses import asdict
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import shapely
from pyproj import CRS
from shapely import MultiPolygon, Polygon, box

from roadsight.base.errors import InputError
from roadsight.evidence.scores import (
    binary_scores,
    camera_errors,
    camera_scores,
    outline_distances_m,
    pavement_scores,
)
from roadsight.geometry.frames import Frame
from roadsight.io.images.camera_tables import read_cameras

STATIONS = np.arange(0.0, 120.0, 0.5)
EDGES = np.concatenate(
    [np.column_stack([np.full(240, x), STATIONS, np.zeros(240)]) for x in (-4.0, 4.0)]
)
FOUND_ONLY = ["accepted", "width_px", "height_px"]
TANGENTS = np.tile([0.0, 1.0], (480, 1))


def camera(**changes: float) -> dict[str, object]:
    return {
        "image": "a.jpg", "x": 0.0, "y": 0.0, "z": 2.0, "heading_deg": 0.0, "pitch_deg": -2.0,
        "roll_deg": 0.0, "focal_px": 800.0, "cx_px": 319.5, "cy_px": 239.5, "width_px": 640,
        "height_px": 480, "accepted": True,
    } | changes  # fmt: skip


def errors_of(found: dict, true: dict) -> pd.Series:
    truth = pd.DataFrame([true]).drop(columns=FOUND_ONLY)
    return camera_errors(pd.DataFrame([found]), truth, EDGES, TANGENTS).iloc[0]


def test_the_right_pose_has_no_error() -> None:
    row = errors_of(camera(), camera())
    names = [
        "yaw_deg", "pitch_deg", "roll_deg", "along_m", "right_m", "up_m", "point_px", "edge_px",
    ]  # fmt: skip
    assert row[names].abs().max() == pytest.approx(0.0, abs=1e-9)
    assert row["focal_ratio"] == 1.0


def test_errors_have_their_signs_and_wrap() -> None:
    row = errors_of(
        camera(heading_deg=0.05, x=1.0, y=2.0, z=2.5), camera(heading_deg=359.95, y=0.0)
    )
    assert row["yaw_deg"] == pytest.approx(0.1)
    assert row["along_m"] == pytest.approx(2.0, abs=2e-3)
    assert row["right_m"] == pytest.approx(1.0, abs=2e-3)
    assert row["up_m"] == pytest.approx(0.5)


def test_a_turn_moves_every_edge_by_focal_length_times_angle() -> None:
    row = errors_of(camera(heading_deg=0.2), camera())
    assert row["point_px"] == pytest.approx(800 * np.radians(0.2), rel=0.1)
    assert row["edge_px"] < row["point_px"]


def test_moving_along_a_straight_edge_costs_nothing_across_it_and_unseen_ones_no_pixels() -> None:
    row = errors_of(camera(y=0.5), camera())
    assert row["point_px"] > 0.5
    assert row["edge_px"] < 0.05
    behind = errors_of(camera(heading_deg=180.0), camera(heading_deg=180.0))
    assert behind[["point_px", "edge_px"]].isna().all()


def test_scores_count_accepted_images_only() -> None:
    tables = [
        camera(image="good.jpg"),
        camera(image="turned.jpg", heading_deg=0.3),
        camera(image="rejected.jpg", heading_deg=5.0, accepted=False),
        camera(image="unknown.jpg"),
    ]
    truth = [camera(image=name) for name in ("good.jpg", "turned.jpg", "rejected.jpg")]
    errors = camera_errors(
        pd.DataFrame(tables), pd.DataFrame(truth).drop(columns=FOUND_ONLY), EDGES, TANGENTS
    )
    scores = camera_scores(errors, len(tables))
    assert (scores["images"], scores["known"], scores["accepted"]) == (4, 3, 2)
    assert scores["within_limits"] == 1
    assert scores["share_of_images_within_limits"] == pytest.approx(1 / 3)
    assert scores["share_of_accepted_within_yaw_limit"] == 0.5
    assert scores["errors"]["yaw_deg"]["mean"] == pytest.approx(0.15)


def test_no_known_camera_gives_no_shares() -> None:
    truth = pd.DataFrame([camera(image="b.jpg")]).drop(columns=FOUND_ONLY)
    errors = camera_errors(pd.DataFrame([camera()]), truth, EDGES, TANGENTS)
    scores = camera_scores(errors, 1)
    assert scores["share_of_images_within_limits"] is None
    assert scores["errors"]["yaw_deg"] is None


FRAME = Frame((1000.0, 2000.0, 50.0), 0.3048, 0.3048, CRS.from_epsg(32119).to_wkt())
HEAD = (
    "image,easting_ft,northing_ft,height_above_road_m,height_ft,heading_grid_deg,pitch_deg,roll_deg"
)


def test_tables_are_read_into_the_local_frame(tmp_path: Path) -> None:
    (tmp_path / "t.csv").write_text(
        f"{HEAD},focal_px,cx_px,cy_px,width_px,height_px\n"
        "a,1010,2020,2,60,90,1,2,700,320,240,640,480\n"
    )
    row = read_cameras(tmp_path / "t.csv", FRAME).iloc[0]
    np.testing.assert_allclose(row[["x", "y", "z"]].to_numpy(float), [3.048, 6.096, 3.048])
    assert row["heading_deg"] == 90
    assert row["focal_px"] == 700


def test_one_lens_for_all_images(tmp_path: Path) -> None:
    (tmp_path / "t.csv").write_text(f"{HEAD}\na,1010,2020,2,60,90,1,2\nb,1010,2020,2,60,91,1,2\n")
    (tmp_path / "lens.csv").write_text("fx_px,fy_px,cx_px,cy_px\n720,720,600,170\n")
    table = read_cameras(tmp_path / "t.csv", FRAME, tmp_path / "lens.csv")
    assert table["focal_px"].tolist() == [720.0, 720.0]


def test_bad_tables_are_told(tmp_path: Path) -> None:
    (tmp_path / "t.csv").write_text(f"{HEAD}\na,1010,2020,2,60,north,1,2\n")
    (tmp_path / "lens.csv").write_text("fx_px,cx_px,cy_px\n720,600,170\n")
    with pytest.raises(InputError, match="no finite number"):
        read_cameras(tmp_path / "t.csv", FRAME, tmp_path / "lens.csv")
    with pytest.raises(InputError, match="lacks a column"):
        read_cameras(tmp_path / "t.csv", FRAME)
    with pytest.raises(InputError, match="cannot be read"):
        read_cameras(tmp_path / "none.csv", FRAME)


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
