from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from pyproj import CRS

from roadsight.base.errors import InputError
from roadsight.evidence.camera_scores import camera_errors, camera_scores
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
