"""Images from their bytes: size, place, time and completeness without decoding; pixels.

JPEG, PNG, TIFF and WebP. The orientation that EXIF states is applied here, to sizes and pixels of
images, labels and depth alike, and nowhere else.
"""

from __future__ import annotations

import math
import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import UTC, datetime

import cv2
import numpy as np

from roadsight.base.arrays import Numbers

# Larger images are refused before they are decoded: a damaged header may announce any size.
_MOST_PIXELS = 1 << 28
_JPEG = b"\xff\xd8"  # first bytes of a JPEG
_PNG = b"\x89PNG\r\n\x1a\n"  # first bytes of a PNG
# JPEG markers that begin a frame and tell the size; of the three left out, two begin tables and one
# is reserved.
_FRAME_MARKERS = frozenset(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}
_BARE_MARKERS = frozenset({0x01, *range(0xD0, 0xD9)})  # JPEG markers without a length and content
_ORIENTATION = 0x0112  # EXIF tag: how the image is to be turned; from 5 on, by a quarter
_WIDTH, _HEIGHT = 0x0100, 0x0101  # TIFF tags: columns and rows
# TIFF tags: places and lengths of the pixels' parts.
_STRIPS, _STRIP_BYTES, _TILES, _TILE_BYTES = 0x0111, 0x0117, 0x0144, 0x0145
_EXIF_IFD = 0x8769  # EXIF tag: place of the directory of capture
# EXIF tags: DateTimeOriginal, DateTimeDigitized, and their parts of a second.
_TAKEN, _DIGITISED, _TAKEN_PARTS, _DIGITISED_PARTS = 0x9003, 0x9004, 0x9291, 0x9292
_TIFF = {b"II*\0": "<", b"MM\0*": ">"}  # first bytes of a TIFF, and the order of its bytes
_GPS_IFD = 0x8825  # EXIF tag: place of the directory of GPS tags
_PALETTE = 3  # kind of a PNG whose pixels are places in a palette
# Length of a value of each TIFF type.
_TYPE_BYTES = {1: 1, 2: 1, 3: 2, 4: 4, 5: 8, 6: 1, 7: 1, 8: 2, 9: 4, 10: 8}


@dataclass(frozen=True)
class ImageFacts:
    """What an image says about itself.

    Parameters
    ----------
    width_px, height_px : as it is shown, turned as its EXIF orientation says.
    latitude, longitude : WGS 84 degrees, or None.
    complete : whether its end is there.
    orientation : of EXIF, 1 to 8. time_s : of capture, seconds from 1970 on the camera's clock.
    """

    width_px: int
    height_px: int
    latitude: float | None = None
    longitude: float | None = None
    complete: bool = True
    orientation: int = 1
    time_s: float | None = None


def image_facts(content: bytes) -> ImageFacts:
    """Facts of a JPEG, PNG, TIFF or WebP image.

    Raises
    ------
    ValueError : the bytes are of neither kind, or end before the image's size.
    """
    try:
        if content.startswith(_PNG):
            size = struct.unpack(">II", content[16:24])
            exif = next((data for kind, data in _png_chunks(content) if kind == b"eXIf"), b"")
            return _facts(size, exif, content.rfind(b"IEND") > 24)
        if content.startswith(_JPEG):
            return _jpeg_facts(content)
        if content[:4] in _TIFF:
            return _tiff_facts(content)
        if content[:4] == b"RIFF" and content[8:12] == b"WEBP":
            return _webp_facts(content)
    except (struct.error, IndexError) as error:
        raise ValueError("it ends before its size") from error
    raise ValueError("it is neither JPEG, PNG, TIFF nor WebP")


def decoded_image(content: bytes, flags: int) -> Numbers | None:
    """Pixels of an image as OpenCV reads it by ``flags``; None if it is none or beyond 268 Mpx.

    It is turned as its orientation says. With ``IMREAD_UNCHANGED``, a PNG of fewer than 8 bits or
    with a palette gives the numbers that are stored.
    """
    try:
        facts = image_facts(content)
        if facts.width_px * facts.height_px > _MOST_PIXELS:
            return None
        factor = 1
        if content[:4] in _TIFF:
            content = _upright_tiff(content)
        elif flags == cv2.IMREAD_UNCHANGED and content.startswith(_PNG):
            content, factor = _plain_png(content)
        if flags != cv2.IMREAD_UNCHANGED:
            flags |= cv2.IMREAD_IGNORE_ORIENTATION
        pixels = cv2.imdecode(np.frombuffer(content, np.uint8), flags)
    except (ValueError, cv2.error, struct.error, IndexError):
        return None
    if pixels is None:
        return None
    return turned(pixels if factor == 1 else pixels // factor, facts.orientation)


def turned(pixels: Numbers, orientation: int) -> Numbers:
    """Pixels (rows, columns, ...) as stored, turned and mirrored as an EXIF orientation says."""
    if orientation >= 5:
        pixels = np.swapaxes(pixels, 0, 1)
    if orientation in (3, 4, 7, 8):
        pixels = pixels[::-1]
    if orientation in (2, 3, 6, 7):
        pixels = pixels[:, ::-1]
    return np.ascontiguousarray(pixels)


def _facts(size: tuple[int, int], exif: bytes, complete: bool) -> ImageFacts:
    """Facts by width and height as stored and the EXIF directory."""
    orientation, latitude, longitude, time_s = _exif_facts(exif)
    shown = size[::-1] if orientation >= 5 else size
    return ImageFacts(*shown, latitude, longitude, complete, orientation, time_s)


def _png_chunks(content: bytes) -> Iterator[tuple[bytes, bytes]]:
    """Kind and data of the chunks of a PNG, as far as they are there."""
    at = len(_PNG)
    while at + 8 <= len(content):
        (length,) = struct.unpack_from(">I", content, at)
        yield content[at + 4 : at + 8], content[at + 8 : at + 8 + length]
        at += 12 + length


def _plain_png(content: bytes) -> tuple[bytes, int]:
    """A PNG whose decoded pixels are multiples of the stored numbers, and the factor.

    Decoders stretch 1, 2 and 4 bits to 0 to 255 and look colours up in the palette, which is
    therefore taken out.
    """
    chunks = list(_png_chunks(content))
    header = dict(chunks).get(b"IHDR", b"")
    if len(header) < 13:
        return content, 1
    depth, kind = header[8], header[9]
    if depth not in (1, 2, 4, 8, 16):
        raise ValueError(f"its bit depth is {depth}")
    if kind == _PALETTE:
        header = header[:9] + bytes([0]) + header[10:]
    elif kind != 0 or depth >= 8:
        return content, 1
    parts = [_PNG]
    for name, data in chunks:
        if name in (b"PLTE", b"tRNS", b"bKGD", b"hIST", b"sBIT"):
            continue
        content_of = header if name == b"IHDR" else data
        check = struct.pack(">I", zlib.crc32(name + content_of))
        parts.append(struct.pack(">I", len(content_of)) + name + content_of + check)
    return b"".join(parts), 255 // (2**depth - 1) if depth < 8 else 1


def _tiff_facts(content: bytes) -> ImageFacts:
    order = _TIFF[content[:4]]
    entries = _directory(content, order, struct.unpack_from(order + "I", content, 4)[0])
    if not (entries.get(_WIDTH) and entries.get(_HEIGHT)):
        raise ValueError("it has no size")
    places = entries.get(_STRIPS) or entries.get(_TILES) or []
    lengths = entries.get(_STRIP_BYTES) or entries.get(_TILE_BYTES) or []
    ends = [int(at + size) for at, size in zip(places, lengths, strict=False)]
    size = (int(entries[_WIDTH][0]), int(entries[_HEIGHT][0]))
    return _facts(size, content, bool(ends) and max(ends) <= len(content))


def _upright_tiff(content: bytes) -> bytes:
    """The same TIFF without its orientation, which decoders apply in ways of their own."""
    order = _TIFF[content[:4]]
    (start,) = struct.unpack_from(order + "I", content, 4)
    (count,) = struct.unpack_from(order + "H", content, start)
    data = bytearray(content)
    for number in range(count):
        at = start + 2 + 12 * number
        if struct.unpack_from(order + "H", content, at)[0] == _ORIENTATION:
            struct.pack_into(order + "H", data, at + 8, 1)
    return bytes(data)


def _webp_facts(content: bytes) -> ImageFacts:
    """Facts of the chunks of a RIFF file."""
    at, size, exif = 12, None, b""
    while at + 8 <= len(content):
        kind = content[at : at + 4]
        (length,) = struct.unpack_from("<I", content, at + 4)
        data = content[at + 8 : at + 8 + length]
        if kind == b"VP8X":
            size = tuple(1 + int.from_bytes(data[k : k + 3], "little") for k in (4, 7))
        elif kind == b"VP8 " and size is None:
            size = tuple(side & 0x3FFF for side in struct.unpack_from("<HH", data, 6))
        elif kind == b"VP8L" and size is None:
            bits = int.from_bytes(data[1:5], "little")
            size = ((bits & 0x3FFF) + 1, (bits >> 14 & 0x3FFF) + 1)
        elif kind == b"EXIF":
            exif = data.removeprefix(b"Exif\0\0")
        at += 8 + length + length % 2
    if size is None:
        raise ValueError("it has no size")
    whole = len(content) >= struct.unpack_from("<I", content, 4)[0] + 8
    return _facts((size[0], size[1]), exif, whole)


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
    # Within a scan 0xFF is always followed by 0 or a restart, so that this can only be its end.
    complete = content.rfind(b"\xff\xd9") > at
    return _facts(size, exif, complete)


def _exif_facts(tiff: bytes) -> tuple[int, float | None, float | None, float | None]:
    """Orientation, latitude, longitude and time of capture; damaged EXIF says nothing."""
    try:
        order = {b"II": "<", b"MM": ">"}[tiff[:2]]
        entries = _directory(tiff, order, struct.unpack(order + "I", tiff[4:8])[0])
        orientation = int((entries.get(_ORIENTATION) or [1])[0])
    except (KeyError, struct.error, ValueError, OverflowError):
        return 1, None, None, None
    orientation = orientation if 1 <= orientation <= 8 else 1
    time_s = _capture_s(tiff, order, entries)
    try:
        gps = _directory(tiff, order, int(entries[_GPS_IFD][0]))
        latitude, longitude = _degrees(gps[2], gps[1], "S"), _degrees(gps[4], gps[3], "W")
    except (KeyError, IndexError, struct.error, ValueError, ZeroDivisionError, OverflowError):
        return orientation, None, None, time_s
    return orientation, latitude, longitude, time_s


def _capture_s(tiff: bytes, order: str, entries: dict[int, list[float]]) -> float | None:
    """Seconds from 1970 on the camera's clock, with parts of a second; None without a time."""
    try:
        exif = _directory(tiff, order, int(entries[_EXIF_IFD][0]))
    except (KeyError, IndexError, struct.error, ValueError, OverflowError):
        return None
    for tag, parts in ((_TAKEN, _TAKEN_PARTS), (_DIGITISED, _DIGITISED_PARTS)):
        text = "".join(chr(int(code)) for code in exif.get(tag, [])).rstrip("\0 ")
        digits = "".join(chr(int(code)) for code in exif.get(parts, [])).strip("\0 ")
        try:
            moment = datetime.strptime(text[:19], "%Y:%m:%d %H:%M:%S").replace(tzinfo=UTC)
        except ValueError:
            continue
        return moment.timestamp() + (
            float(f"0.{digits}") if digits.isascii() and digits.isdigit() else 0.0
        )
    return None


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
        content = tiff[place : place + size]
        if kind in (5, 10):
            pairs = struct.iter_unpack(order + ("II" if kind == 5 else "ii"), content)
            entries[tag] = [top / bottom if bottom else float("nan") for top, bottom in pairs]
        else:
            letter = {1: "B", 2: "B", 3: "H", 4: "I", 6: "b", 7: "B", 8: "h", 9: "i"}[kind]
            entries[tag] = [value for (value,) in struct.iter_unpack(order + letter, content)]
    return entries


def _degrees(parts: list[float], reference: list[float], negative: str) -> float | None:
    """Degrees from degrees, minutes, seconds; None if one of them is missing or undefined."""
    value = sum(part / 60**power for power, part in enumerate(parts[:3]))
    if not parts or math.isnan(value):
        return None
    return -value if reference and chr(int(reference[0])).upper() == negative else value
