import cv2
import laspy
import numpy as np
import pandas as pd
import pytest

import roadsight
from roadsight.__main__ import main
from roadsight.base.errors import InputError
from roadsight.io.records.atomic import write_json

BASELINE = {
    "hfov_deg": 65.2, "along_m": 0.0, "lateral_m": 0.0, "height_m": 2.0,
    "yaw_deg": 0.0, "pitch_deg": 0.0, "roll_deg": 0.0,
}  # fmt: skip


@pytest.fixture(scope="module")
def drive(tmp_path_factory):
    """A straight road of 8 m to the north, driven 1 m right of its middle; labels show it."""
    folder = tmp_path_factory.mktemp("drive")
    rng = np.random.default_rng(1)
    x, y = rng.uniform([-20, -20], [20, 150], (40_000, 2)).T
    cloud = laspy.create(point_format=6, file_version="1.4")
    cloud.x, cloud.y, cloud.z = x, y, rng.normal(0, 0.01, x.size)
    cloud.classification = np.where(np.abs(x) < 4, 11, 2)
    cloud.write(str(folder / "road.las"))
    right_m, ahead_m = np.array([[-5, -5, 3, 3], [3, 300, 300, 3]])
    corners = np.column_stack([320 + 500 * right_m / ahead_m, 240 + 500 * 2 / ahead_m])
    label = cv2.fillPoly(np.zeros((480, 640), np.uint8), [corners.round().astype(np.int32)], 1)
    (folder / "labels").mkdir()
    names = [f"{n}.png" for n in range(5)]
    for name in names:
        cv2.imwrite(str(folder / "labels" / name), label)
    table = pd.DataFrame({"image": names, "y": 10.0 * np.arange(5), "x": 1.0})
    table.to_csv(folder / "drive.csv", index=False)
    write_json(folder / "baseline.json", {"640x480": BASELINE})
    return folder


def test_cameras_from_a_registered_one(drive):
    labels = str(drive / "labels")
    cameras = roadsight.align(
        drive / "drive.csv", drive / "road.las", labels, masks=labels, crs="local",
        method="published", baseline=str(drive / "baseline.json"),
    )  # fmt: skip
    assert len(cameras) == 5
    assert cameras["accepted"].all()
    np.testing.assert_allclose(cameras["fx_px"], 320 / np.tan(np.radians(65.2 / 2)))
    np.testing.assert_allclose(cameras["x"], 1.0, atol=0.4)
    assert np.abs((cameras["heading_grid_deg"] + 180) % 360 - 180).max() < 0.2


def test_the_verb(drive, tmp_path, capsys):
    argv = ["align", drive / "drive.csv", "--cloud", drive / "road.las", "--crs", "local"]
    argv += ["--images", drive / "labels", "--masks", drive / "labels", "--method", "published"]
    out = tmp_path / "cameras.csv"
    assert main([str(part) for part in (*argv, "-o", out)]) == 2
    told = capsys.readouterr().err
    assert "roadsight register" in told
    assert not out.exists()
    argv += ["--baseline", drive / "baseline.json", "-o", out]
    assert main([str(part) for part in argv]) == 0
    assert pd.read_csv(out)["accepted"].all()


def test_a_known_lens_besides_is_refused_first():
    with pytest.raises(InputError, match="keeps its lens"):
        roadsight.align(
            "no.csv", "no.las", "no", method="published", baseline="b.json", intrinsics="lens.csv"
        )
