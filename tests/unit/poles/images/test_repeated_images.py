import cv2
import numpy as np
import pandas as pd
import pytest

from roadsight.stages.poles.profile_drive import repeat_doubts, repeated_images
from tests.unit.poles.images.test_image_matches import SIZE, scenery

STEP_PX = 6
"""How far the scenery moves between two images."""


def as_jpeg(image, quality):
    return cv2.imdecode(cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, quality])[1], 1)


def stamped(image, text):
    """Image with a line of text, as recorders print it."""
    copy = image.copy()
    cv2.putText(copy, text, (6, SIZE[1] - 6), cv2.FONT_HERSHEY_PLAIN, 0.8, (255, 255, 255))
    return copy


def drive(steps_m, copies=()):
    """Frames some way apart, and their images; copies show the image before them."""
    wide, images = cv2.cvtColor(scenery(), cv2.COLOR_GRAY2BGR), {}
    names = [f"i{number}.jpg" for number in range(len(steps_m))]
    for number, name in enumerate(names):
        start = STEP_PX * number
        shown = wide[20:220, start : start + SIZE[0]]
        if number in copies:
            shown = as_jpeg(images[names[number - 1]], 50)
        images[name] = stamped(shown, f"12:00:{number:02d}")
    frames = pd.DataFrame(
        {"image": names, "path": names, "x": np.cumsum(steps_m, dtype=float), "y": 0.0}
    )
    width, height = SIZE
    frames = frames.assign(route="r", sequence=range(len(names)), status="ok")
    return frames.assign(width_px=width, height_px=height), images


def test_copies_are_found_and_nothing_else():
    frames, images = drive([8.0] * 9, copies=(3, 4, 7))
    assert repeated_images(frames, images.__getitem__) == ["i3.jpg", "i4.jpg", "i7.jpg"]
    frames, images = drive([1.1] * 9)
    assert repeated_images(frames, images.__getitem__) == []


def test_a_vehicle_that_stands_still_shows_the_same():
    frames, images = drive([8.0, 8.0, 0.6, 0.6, 8.0], copies=(2, 3))
    assert repeated_images(frames, images.__getitem__) == []


def test_each_image_is_read_once():
    frames, images = drive([8.0] * 5)
    read = []
    repeated_images(frames, lambda path: read.append(path) or images[path])
    assert read == list(images)


def test_the_warning_names_the_images():
    assert repeat_doubts([]) == []
    (doubt,) = repeat_doubts([f"i{number}" for number in range(5)])
    assert (doubt.code, doubt.severity, doubt.measured) == ("images_repeated", "doubt", 5)
    assert "i0, i1, i2 and 2 more" in doubt.message


@pytest.mark.parametrize("name", ["kitti_0009", "kitti_04"])
def test_a_recorder_that_hangs_on_a_real_street(data, name):
    folder = data / "videolog" / name
    track = pd.read_csv(folder / "truth_cameras.csv")
    track = track.rename(columns={"easting_m": "x", "northing_m": "y"})
    names = track["image"].tolist()
    images = {one: cv2.imread(str(folder / "images" / one)) for one in names}
    height, width = images[names[0]].shape[:2]
    frames = track.assign(path=names, route="r", sequence=range(len(names)), status="ok")
    frames = frames.assign(width_px=width, height_px=height)
    assert repeated_images(frames, images.__getitem__) == []
    for number in (20, 21, 22):
        images[names[number]] = stamped(as_jpeg(images[names[19]], 60), f"12:00:{number}")
    assert repeated_images(frames, images.__getitem__) == names[20:23]
