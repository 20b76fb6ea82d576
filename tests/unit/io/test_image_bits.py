import struct
import zlib

import cv2
import numpy as np
import pytest

from roadsight.io.images.exif import decoded_image, image_facts, turned
from roadsight.io.images.image_shards import LabelImages


def exif_of(orientation, date="", parts=""):
    """TIFF directory with an orientation and, if given, a time of capture."""
    texts = [(0x9003, date), (0x9291, parts)] if date else []
    count = 1 + bool(date)
    entries = struct.pack("<HHIHH", 0x0112, 3, 1, orientation, 0)
    start = 8 + 2 + 12 * count + 4
    if date:
        entries += struct.pack("<HHII", 0x8769, 4, 1, start)
    tail, place = b"", start + 2 + 12 * len(texts) + 4
    inner = struct.pack("<H", len(texts))
    for tag, text in texts:
        data = text.encode() + b"\0"
        inline = len(data) <= 4
        inner += struct.pack("<HHI", tag, 2, len(data))
        inner += data.ljust(4, b"\0") if inline else struct.pack("<I", place + len(tail))
        tail += b"" if inline else data
    body = inner + bytes(4) + tail if date else b""
    return b"II*\0\x08\0\0\0" + struct.pack("<H", count) + entries + bytes(4) + body


def chunk(name, data):
    return struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data))


def tagged(kind, image, exif, orientation):
    """An image file of a kind with EXIF."""
    options = [cv2.IMWRITE_TIFF_COMPRESSION, 1] if kind == ".tif" else []
    if kind == ".webp":
        options = [cv2.IMWRITE_WEBP_QUALITY, 101]
    content = cv2.imencode(kind, image, options)[1].tobytes()
    if kind == ".jpg":
        data = b"Exif\0\0" + exif
        return content[:2] + b"\xff\xe1" + struct.pack(">H", len(data) + 2) + data + content[2:]
    if kind == ".png":
        return content[:33] + chunk(b"eXIf", exif) + content[33:]
    if kind == ".webp":
        height, width = image.shape[:2]
        vp8x = (
            b"\x08\0\0\0" + (width - 1).to_bytes(3, "little") + (height - 1).to_bytes(3, "little")
        )
        body = b"WEBPVP8X" + struct.pack("<I", 10) + vp8x + content[12:]
        body += b"EXIF" + struct.pack("<I", len(exif)) + exif + b"\0" * (len(exif) % 2)
        return b"RIFF" + struct.pack("<I", len(body)) + body
    (start,) = struct.unpack_from("<I", content, 4)
    (count,) = struct.unpack_from("<H", content, start)
    old = [content[start + 2 + 12 * k : start + 14 + 12 * k] for k in range(count)]
    new = [entry for entry in old if struct.unpack_from("<H", entry)[0] != 0x0112]
    new.append(struct.pack("<HHIHH", 0x0112, 3, 1, orientation, 0))
    new.sort(key=lambda entry: struct.unpack_from("<H", entry)[0])
    at = len(content) + len(content) % 2
    directory = struct.pack("<H", len(new)) + b"".join(new) + bytes(4)
    return content[:4] + struct.pack("<I", at) + content[8:].ljust(at - 8, b"\0") + directory


IMAGE = np.kron(np.arange(0, 240, 40, np.uint8).reshape(2, 3), np.ones((16, 16), np.uint8))


@pytest.mark.parametrize("orientation", range(1, 9))
@pytest.mark.parametrize("kind", [".jpg", ".png", ".tif", ".webp"])
def test_orientation_is_applied_to_every_format(kind, orientation):
    image = np.repeat(IMAGE[..., None], 3, axis=2)
    content = tagged(kind, image, exif_of(orientation), orientation)
    found = decoded_image(content, cv2.IMREAD_COLOR)
    right = turned(image, orientation)
    facts = image_facts(content)
    assert facts.complete
    assert (facts.height_px, facts.width_px) == right.shape[:2] == found.shape[:2]
    np.testing.assert_allclose(found.astype(int), right, atol=4)


def test_orientations_are_those_of_opencv():
    for orientation in range(1, 9):
        content = tagged(".jpg", np.repeat(IMAGE[..., None], 3, axis=2), exif_of(orientation), 0)
        shown = cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_COLOR)
        np.testing.assert_array_equal(decoded_image(content, cv2.IMREAD_COLOR), shown)


def test_labels_are_turned_as_images_are(tmp_path):
    (tmp_path / "a.png").write_bytes(tagged(".png", IMAGE, exif_of(6), 6))
    np.testing.assert_array_equal(LabelImages(tmp_path).read("a.jpg"), turned(IMAGE, 6))


def png_of(labels, bits, palette):
    rows = b""
    for row in labels:
        packed = np.unpackbits(row[:, None], axis=1)[:, 8 - bits :].ravel()
        rows += b"\0" + np.packbits(packed).tobytes()
    height, width = labels.shape
    header = struct.pack(">IIBBBBB", width, height, bits, 3 if palette else 0, 0, 0, 0)
    colours = np.random.default_rng(0).integers(0, 255, 3 * 2**bits, np.uint8).tobytes()
    extra = chunk(b"PLTE", colours) + chunk(b"tRNS", b"\0\x80") if palette else b""
    parts = chunk(b"IHDR", header) + extra + chunk(b"IDAT", zlib.compress(rows))
    return b"\x89PNG\r\n\x1a\n" + parts + chunk(b"IEND", b"")


@pytest.mark.parametrize("bits", [1, 2, 4, 8])
@pytest.mark.parametrize("palette", [False, True])
def test_stored_numbers_of_few_bits_and_palettes(tmp_path, bits, palette):
    labels = np.random.default_rng(1).integers(0, 2**bits, (9, 13), np.uint8)
    (tmp_path / "a.png").write_bytes(png_of(labels, bits, palette))
    np.testing.assert_array_equal(LabelImages(tmp_path).read("a.jpg"), labels)


def test_bits_of_the_cases(cases):
    folder = cases / "11-label-png-of-4-bits"
    right = LabelImages(folder / "bit8").read("p00.jpg")
    np.testing.assert_array_equal(LabelImages(folder / "bit4").read("p00.jpg"), right)
    for bits in (1, 2):
        assert LabelImages(folder / f"bit{bits}").read("p00.jpg").max() < 2**bits


def test_time_of_capture_with_parts_of_a_second():
    image = np.repeat(IMAGE[..., None], 3, axis=2)
    times = [
        image_facts(tagged(kind, image, exif_of(1, "2024:05:01 10:00:01", parts), 1)).time_s
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
