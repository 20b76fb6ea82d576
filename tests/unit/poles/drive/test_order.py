import numpy as np
import pandas as pd
import pytest

from roadsight.base.errors import InputError
from roadsight.base.sections.poles import Videolog
from roadsight.io.images.videologs import ImageSource, read_videolog_table
from roadsight.poles.drive.videolog import (
    Site,
    build_frames,
    drive_order,
    seconds_of,
    turning_back,
    wandering,
)

EAST = np.column_stack([8.0 * np.arange(12), np.zeros(12)])


@pytest.mark.parametrize(
    "texts",
    [
        ["2024-05-01T10:00:00Z", "2024-05-01T10:00:00.5Z", "2024-05-01T10:00:02Z"],
        ["2024:05:01 10:00:00", "2024:05:01 10:00:00.5", "2024:05:01 10:00:02"],
        ["10:00:00", "10:00:00.5", "10:00:02"],
        ["1714557600", "1714557600.5", "1714557602"],
    ],
)
def test_times_of_usual_kinds(texts):
    np.testing.assert_allclose(np.diff(seconds_of(pd.Series(texts))), [0.5, 1.5])


def test_time_decides_before_number_and_row():
    route = pd.Series(["a"] * 4)
    time, number = np.array([3.0, 1, 2, 0]), np.array([0.0, 1, 2, 3])
    found, reasons = drive_order(route, number, time, False)
    assert found.tolist() == [3, 1, 2, 0]
    assert reasons == {"a": "time of capture"}
    lacking, _ = drive_order(route, number, np.array([3.0, np.nan, 2, 0]), False)
    assert lacking.tolist() == number.tolist()


def test_a_measure_that_falls_is_a_drive_against_it():
    route = pd.Series(["a"] * 3 + ["b"] * 3)
    miles = np.array([10.0, 9.995, 9.99, 1, 2, 3])
    found, _ = drive_order(route, miles, np.full(6, np.nan), True)
    assert found.tolist() == [0, 1, 2, 1, 2, 3]
    assert drive_order(route, miles, np.full(6, np.nan), False)[0].tolist() == miles.tolist()


def test_standing_and_wandering():
    rng = np.random.default_rng(0)
    assert wandering(rng.normal(0, 1.5, (30, 2))).mean() > 0.9
    assert not wandering(EAST + rng.normal(0, 1, EAST.shape)).any()
    stop = np.vstack([EAST, EAST[-1] + rng.normal(0, 1, (12, 2)), EAST + np.array([90.0, 0])])
    lost = wandering(stop)
    assert lost[14:22].mean() > 0.8
    assert not lost[:9].any()


def frames_of(xy):
    table = pd.DataFrame(
        {"image": [f"{n}.jpg" for n in range(len(xy))], "route": "r", "status": "ok"}
    ).assign(sequence=np.arange(len(xy), dtype=float), width_px=9, height_px=9)
    table["latitude"], table["longitude"] = xy[:, 1] / 1e3 + 1, xy[:, 0] / 1e3 + 1
    site = Site(
        lambda lat, lon: (np.column_stack([lon, lat]) - 1) * 1e3,
        lambda places: np.ones(len(places), bool),
        lambda places: np.zeros(len(places)),
    )
    return build_frames(table, site, Videolog())


def test_a_track_in_random_order_is_refused():
    order = np.random.default_rng(3).permutation(12)
    back, count = turning_back(EAST[order])
    assert back > 0.4 * count
    with pytest.raises(InputError, match="turns back at most images"):
        frames_of(EAST[order])
    assert (frames_of(EAST)["status"] == "ok").all()


def test_a_wandering_camera_has_no_heading():
    wander = np.random.default_rng(1).normal(0, 1.2, (12, 2))
    with pytest.raises(InputError, match="stood or wandered"):
        frames_of(wander)


def test_orders_of_the_cases(cases):
    folder = cases / "08-exif-images-named-at-random" / "images"
    table = read_videolog_table(folder, ImageSource(folder)).sort_values("sequence")
    assert (np.diff(table["longitude"]) > 0).all()
    path = cases / "10-mileposts-that-decrease" / "videolog.csv"
    table = read_videolog_table(path, ImageSource(folder)).sort_values("sequence")
    assert (np.diff(table["longitude"]) > 0).all()
