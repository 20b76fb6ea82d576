import struct
import zlib

import cv2
import numpy as np
import pytest

from roadsight.io.images.exif import decoded_image, image_facts, turned
from roadsight.io.images.image_shards import LabelImages
from tests.helpers.tagged_images import exif_of, tagged

IMAGE = np.kron(np.arange(0, 240, 40, np.uint8).reshape(2, 3), np.ones((16, 16), np.uint8))


@pytest.mark.parametrize("orientation", range(1, 9))
@pytest.mark.parametrize("kind", [".jpg", ".png", ".tif", ".webp"])
def test_orientation_is_applied_to_every_format(kind, orientation, rng):
    image = np.repeat(IMAGE[..., None], 3, axis=2)
    content = tagged(kind, image, orientation, exif_of(orientation), rng)
    found = decoded_image(content, cv2.IMREAD_COLOR)
    right = turned(image, orientation)
    facts = image_facts(content)
    assert facts.complete
    assert (facts.height_px, facts.width_px) == right.shape[:2] == found.shape[:2]
    np.testing.assert_allclose(found.astype(int), right, atol=4)


def test_orientations_are_those_of_opencv(rng):
    for orientation in range(1, 9):
        image = np.repeat(IMAGE[..., None], 3, axis=2)
        content = tagged(".jpg", image, orientation, exif_of(orientation), rng)
        shown = cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_COLOR)
        np.testing.assert_array_equal(decoded_image(content, cv2.IMREAD_COLOR), shown)


def test_labels_are_turned_as_images_are(tmp_path, rng):
    (tmp_path / "a.png").write_bytes(tagged(".png", IMAGE, 6, exif_of(6), rng))
    np.testing.assert_array_equal(LabelImages(tmp_path).read("a.jpg"), turned(IMAGE, 6))


def test_bits_of_the_cases(cases):
    folder = cases / "11-label-png-of-4-bits"
    right = LabelImages(folder / "bit8").read("p00.jpg")
    np.testing.assert_array_equal(LabelImages(folder / "bit4").read("p00.jpg"), right)
    for bits in (1, 2):
        assert LabelImages(folder / f"bit{bits}").read("p00.jpg").max() < 2**bits


def test_time_of_capture_with_parts_of_a_second(rng):
    image = np.repeat(IMAGE[..., None], 3, axis=2)
    date = "2024:05:01 10:00:01"
    times = [
        image_facts(tagged(kind, image, 1, exif_of(1, "<", date, parts), rng)).time_s
        for kind in (".jpg", ".png", ".webp")
        for parts in ("25", "", "750")
    ]
    np.testing.assert_allclose(np.array(times) - 1714557601, [0.25, 0, 0.75] * 3)


@pytest.mark.parametrize("depth", [0, 3, 255])
def test_a_png_of_no_such_depth_is_no_image(depth):
    content = bytearray(cv2.imencode(".png", np.zeros((3, 4), np.uint8))[1].tobytes())
    content[24] = depth
    content[29:33] = struct.pack(">I", zlib.crc32(bytes(content[12:29])))
    assert decoded_image(bytes(content), cv2.IMREAD_UNCHANGED) is None
