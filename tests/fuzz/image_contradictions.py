"""Valid images whose storage or size contradicts what they show, beside the clean image."""

import struct
import zlib
from pathlib import Path

import cv2
import numpy as np

from roadsight.base.errors import InputError
from roadsight.io.images.exif import decoded_image, image_facts
from roadsight.io.images.image_shards import LabelImages
from roadsight.poles.images.networks import LabelMap, folder_mask
from tests.helpers.tagged_images import chunk, exif_of, tagged

KINDS = ("bits", "palette", "orientation", "smaller", "sideways", "stretched")
_LABELS = LabelMap(labels=4, classes={0: "road", 1: "pole", 2: "sky", 3: "sign"})
_FORMATS = (".jpg", ".png", ".tif", ".webp")
_MOST_JPEG_ERROR = 12.0
"""Grey values, mean over an image: blocks of a turned JPEG are cut elsewhere."""


def check_image(folder: Path, number: int) -> None:
    """Read one image of that number as stored otherwise, and compare it with the clean one."""
    rng = np.random.default_rng(number)
    kind = str(rng.choice(KINDS))
    rows, columns = (int(side) for side in rng.integers(2, 40, 2))
    if kind in ("bits", "palette"):
        _check_bits(folder, rows, columns, kind == "palette", rng)
    elif kind == "orientation":
        _check_orientation(rows + 16, columns + 16, rng)
    else:
        _check_size(kind, rng)


def _check_bits(folder: Path, rows: int, columns: int, palette: bool, rng) -> None:
    """Labels are the stored numbers, whatever their bits, palette, filters and order of rows."""
    depth = int(rng.choice([1, 2, 4, 8] if palette else [1, 2, 4, 8, 16]))
    clean = rng.integers(0, min(2**depth, 65536), (rows, columns))
    (folder / "a.png").write_bytes(png(clean, depth, palette, rng))
    found = LabelImages(folder).read("a.jpg")
    np.testing.assert_array_equal(found, clean)


def png(pixels: np.ndarray, depth: int, palette: bool, rng) -> bytes:
    """A PNG of numbers (rows, columns), of so many bits, as grey values or places in a palette."""
    rows, columns = pixels.shape
    if depth == 16:
        lines = pixels.astype(">u2").view(np.uint8).reshape(rows, -1)
    else:
        bits = (pixels[..., None] >> np.arange(depth - 1, -1, -1)) & 1
        lines = np.packbits(bits.reshape(rows, -1).astype(np.uint8), axis=1)
    raw = b"".join(b"\0" + line.tobytes() for line in lines)
    header = struct.pack(">IIBBBBB", columns, rows, depth, 3 if palette else 0, 0, 0, 0)
    chunks = [(b"IHDR", header)]
    if rng.integers(2):
        chunks.append((b"tEXt", b"Software\0other"))
    if palette:
        colours = rng.integers(0, 256, 3 * 2**depth).astype(np.uint8)
        chunks.append((b"PLTE", colours.tobytes()))
        if rng.integers(2):
            chunks.append((b"tRNS", bytes(int(rng.integers(1, 2**depth + 1)))))
    elif rng.integers(2):
        chunks.append((b"tRNS", struct.pack(">H", int(rng.integers(2**depth)))))
    cut = int(rng.integers(1, 20))
    data = zlib.compress(raw)
    chunks += [(b"IDAT", data[:cut]), (b"IDAT", data[cut:]), (b"IEND", b"")]
    return b"\x89PNG\r\n\x1a\n" + b"".join(chunk(*one) for one in chunks)


def _check_orientation(rows: int, columns: int, rng) -> None:
    """An image that is stored turned, with the orientation that turns it back, is as the clean."""
    image_format, orientation = str(rng.choice(_FORMATS)), int(rng.integers(1, 9))
    coarse = rng.integers(0, 256, (rows // 8 + 1, columns // 8 + 1)).astype(np.uint8)
    grey = cv2.resize(coarse, (columns, rows), interpolation=cv2.INTER_LINEAR)
    clean = np.repeat(grey[..., None], 3, axis=2)
    order = str(rng.choice(["<", ">"]))
    exif = exif_of(orientation, order)
    content = tagged(image_format, laid(clean, orientation), orientation, exif, rng)
    facts = image_facts(content)
    assert (facts.height_px, facts.width_px) == (rows, columns), (image_format, orientation)
    assert facts.complete
    for flags in (cv2.IMREAD_COLOR, cv2.IMREAD_UNCHANGED):
        found = decoded_image(content, flags)
        assert found.shape[:2] == (rows, columns), (image_format, orientation, flags)
        error = np.abs(found.astype(float).reshape(rows, columns, -1)[..., :1] - grey[..., None])
        assert error.mean() <= _MOST_JPEG_ERROR, (image_format, orientation, flags)
        if image_format in (".png", ".tif"):
            assert not error.any(), (image_format, orientation, flags)


def laid(image: np.ndarray, orientation: int) -> np.ndarray:
    """How a camera stores an image that an orientation brings back: the inverse of turning it."""
    if orientation in (2, 3, 6, 7):
        image = image[:, ::-1]
    if orientation in (3, 4, 7, 8):
        image = image[::-1]
    return np.ascontiguousarray(np.swapaxes(image, 0, 1) if orientation >= 5 else image)


def _check_size(kind: str, rng) -> None:
    """A label image of another size than its image: scaled back, stretched back, or refused."""
    rows, columns = (int(side) for side in rng.integers(4, 30, 2))
    labels = rng.integers(0, 4, (rows, columns)).astype(np.uint8)
    factor, other = (int(side) for side in rng.integers(2, 5, 2))
    if kind == "smaller":
        image = np.kron(labels, np.ones((factor, factor), np.uint8))
    elif kind == "stretched":
        image = np.kron(labels, np.ones((factor, 1), np.uint8))
        if _nearer_turned(labels.shape, image.shape):
            return
    else:
        columns = rows + int(rng.integers(rows, 3 * rows))
        image = rng.integers(0, 4, (other * columns, other * rows)).astype(np.uint8)
        labels = np.ascontiguousarray(np.swapaxes(image, 0, 1))[::other, ::other]
        try:
            folder_mask(labels, _LABELS, image.shape, "a.png")
        except InputError as error:
            assert "lies on its side" in str(error)
            return
        raise AssertionError(f"{labels.shape} was taken for {image.shape}")
    found = folder_mask(labels, _LABELS, image.shape, "a.png")
    np.testing.assert_array_equal(found, _LABELS.lookup()[image])


def _nearer_turned(one: tuple[int, ...], other: tuple[int, ...]) -> bool:
    """Whether proportions agree better after a quarter turn, which is refused."""
    first, second = np.log(one[0] / one[1]), np.log(other[0] / other[1])
    return bool(abs(first - second) >= abs(first + second))
