"""JPEG and PNG images from their bytes: size, place and completeness without decoding; pixels."""

from __future__ import annotations

import math
import struct
from dataclasses import dataclass

import cv2
import numpy as np

from roadsight.base.arrays import Numbers

_MOST_PIXELS = 1 << 28
"""Larger images are refused before they are decoded: a damaged header may announce any size."""
_JPEG = b"\xff\xd8"
"""First bytes of a JPEG."""
_PNG = b"\x89PNG\r\n\x1a\n"
"""First bytes of a PNG."""
_FRAME_MARKERS = frozenset(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}
"""JPEG markers that begin a frame and tell the size; of the three left out, two begin tables and
one is reserved."""
_BARE_MARKERS = frozenset({0x01, *range(0xD0, 0xD9)})
"""JPEG markers without a length and content."""
_ORIENTATION = 0x0112
"""EXIF tag: how the image is to be turned; from 5 on, by a quarter."""
_GPS_IFD = 0x8825
"""EXIF tag: place of the directory of GPS tags."""
_TYPE_BYTES = {1: 1, 2: 1, 3: 2, 4: 4, 5: 8, 6: 1, 7: 1, 8: 2, 9: 4, 10: 8}
"""Length of a value of each TIFF type."""


@dataclass(frozen=True)
class ImageFacts:
    """What an image says about itself.

    Parameters
    ----------
    width_px, height_px : as it is shown, turned as its EXIF orientation says.
    latitude, longitude : WGS 84 degrees, or None.
    complete : whether its end is there.
    """

    width_px: int
    height_px: int
    latitude: float | None = None
    longitude: float | None = None
    complete: bool = True


def image_facts(content: bytes) -> ImageFacts:
    """Facts of a JPEG or PNG image.

    Raises
    ------
    ValueError : the bytes are of neither kind, or end before the image's size.
    """
    try:
        if content.startswith(_PNG):
            width, height = struct.unpack(">II", content[16:24])
            return ImageFacts(width, height, complete=content.rfind(b"IEND") > 24)
        if content.startswith(_JPEG):
            return _jpeg_facts(content)
    except (struct.error, IndexError) as error:
        raise ValueError("it ends before its size") from error
    raise ValueError("it is neither JPEG nor PNG")


def decoded_image(content: bytes, flags: int) -> Numbers | None:
    """Pixels of an image as OpenCV reads it by ``flags``; None if it is none or beyond 268 Mpx."""
    try:
        facts = image_facts(content)
        if facts.width_px * facts.height_px > _MOST_PIXELS:
            return None
        return cv2.imdecode(np.frombuffer(content, np.uint8), flags)
    except (ValueError, cv2.error):
        return None


def _jpeg_facts(content: bytes) -> ImageFacts:
    """Facts from the segments before the first scan."""
    at, size, exif = 2, None, b""
    while True:
        while content[at] == 0xFF and content[at + 1] == 0xFF:
            at += 1
        if content[at] != 0xFF:
            raise ValueError("its segments are damaged")
        marker = content[at + 1]
        if marker in _BARE_MARKERS:
            at += 2
            continue
        (length,) = struct.unpack(">H", content[at + 2 : at + 4])
        if marker in _FRAME_MARKERS:
            height, width = struct.unpack(">HH", content[at + 5 : at + 9])
            size = (width, height)
        elif marker == 0xE1 and content[at + 4 : at + 10] == b"Exif\0\0":
            exif = exif or content[at + 10 : at + 2 + length]
        elif marker in (0xDA, 0xD9):
            break
        at += 2 + length
    if size is None:
        raise ValueError("it has no size")
    turned, latitude, longitude = _exif_facts(exif)
    # Within a scan 0xFF is always followed by 0 or a restart, so that this can only be its end.
    complete = content.rfind(b"\xff\xd9") > at
    return ImageFacts(*(size[::-1] if turned else size), latitude, longitude, complete)


def _exif_facts(tiff: bytes) -> tuple[bool, float | None, float | None]:
    """Whether the image lies on its side, latitude and longitude; damaged EXIF says nothing."""
    try:
        order = {b"II": "<", b"MM": ">"}[tiff[:2]]
        entries = _directory(tiff, order, struct.unpack(order + "I", tiff[4:8])[0])
        turned = int((entries.get(_ORIENTATION) or [1])[0]) >= 5
    except (KeyError, struct.error, ValueError):
        return False, None, None
    try:
        gps = _directory(tiff, order, int(entries[_GPS_IFD][0]))
        return turned, _degrees(gps[2], gps[1], "S"), _degrees(gps[4], gps[3], "W")
    except (KeyError, IndexError, struct.error, ValueError, ZeroDivisionError):
        return turned, None, None


def _directory(tiff: bytes, order: str, start: int) -> dict[int, list[float]]:
    """Numbers of each tag of a TIFF directory; text comes as character codes."""
    (count,) = struct.unpack_from(order + "H", tiff, start)
    entries = {}
    for number in range(count):
        at = start + 2 + 12 * number
        tag, kind, values = struct.unpack_from(order + "HHI", tiff, at)
        size = _TYPE_BYTES.get(kind, 0) * values
        if not 0 < size <= len(tiff):
            continue
        place = at + 8 if size <= 4 else struct.unpack_from(order + "I", tiff, at + 8)[0]
        entries[tag] = _values(tiff[place : place + size], order, kind)
    return entries


def _values(content: bytes, order: str, kind: int) -> list[float]:
    if kind in (5, 10):
        letter = "I" if kind == 5 else "i"
        pairs = struct.iter_unpack(order + 2 * letter, content)
        return [top / bottom if bottom else float("nan") for top, bottom in pairs]
    letter = {1: "B", 2: "B", 3: "H", 4: "I", 6: "b", 7: "B", 8: "h", 9: "i"}[kind]
    return [value for (value,) in struct.iter_unpack(order + letter, content)]


def _degrees(parts: list[float], reference: list[float], negative: str) -> float | None:
    """Degrees from degrees, minutes, seconds; None if one of them is missing or undefined."""
    value = sum(part / 60**power for power, part in enumerate(parts[:3]))
    if not parts or math.isnan(value):
        return None
    return -value if reference and chr(int(reference[0])).upper() == negative else value
