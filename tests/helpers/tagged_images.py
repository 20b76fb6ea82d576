"""Images of any format with tags, written byte by byte."""

import struct
import zlib

import cv2
import numpy as np


def jpeg(shade=0, size=(48, 32)):
    image = np.full((size[1], size[0], 3), shade, np.uint8)
    return cv2.imencode(".jpg", image)[1].tobytes()


def gps_jpeg(latitude, longitude, order="<", orientation=1, size=(48, 32), plain=None):
    """JPEG with the EXIF of a camera that knows where it is, written byte by byte.

    ``plain`` is the JPEG that gets it, without EXIF; one of one shade if it is None.
    """

    def entry(tag, kind, count, value):
        return struct.pack(order + "HHI", tag, kind, count) + value

    def degrees(value):
        value = abs(value)
        d, m = int(value), int(value % 1 * 60)
        seconds = round((value - d - m / 60) * 3600 * 10_000)
        return struct.pack(order + "6I", d, 1, m, 1, seconds, 10_000)

    number = lambda value: struct.pack(order + "I", value)  # noqa: E731
    head = {"<": b"II", ">": b"MM"}[order] + struct.pack(order + "HI", 42, 8)
    gps_at = 8 + 2 + 24 + 4
    data_at = gps_at + 2 + 48 + 4
    ifd = struct.pack(order + "H", 2) + entry(
        0x0112, 3, 1, struct.pack(order + "HH", orientation, 0)
    )
    ifd += entry(0x8825, 4, 1, number(gps_at)) + number(0)
    letters = (b"N" if latitude >= 0 else b"S", b"E" if longitude >= 0 else b"W")
    gps = struct.pack(order + "H", 4)
    for tag, letter, place in ((1, letters[0], data_at), (3, letters[1], data_at + 24)):
        gps += entry(tag, 2, 2, letter + b"\0\0\0") + entry(tag + 1, 5, 3, number(place))
    tiff = head + ifd + gps + number(0) + degrees(latitude) + degrees(longitude)
    segment = b"\xff\xe1" + struct.pack(">H", len(tiff) + 8) + b"Exif\0\0" + tiff
    plain = jpeg(size=size) if plain is None else plain
    return plain[:2] + segment + plain[2:]


def chunk(name, data):
    """A chunk of a PNG."""
    return struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data))


def exif_of(orientation, order="<", date="", parts=""):
    """A TIFF directory with an orientation and, if given, a time of capture."""
    texts = [(0x9003, date), (0x9291, parts)] if date else []
    entries = struct.pack(order + "HHIHH", 0x0112, 3, 1, orientation, 0)
    start = 8 + 2 + 12 * (1 + bool(date)) + 4
    if date:
        entries += struct.pack(order + "HHII", 0x8769, 4, 1, start)
    tail, place = b"", start + 2 + 12 * len(texts) + 4
    inner = struct.pack(order + "H", len(texts))
    for tag, text in texts:
        data = text.encode() + b"\0"
        inline = len(data) <= 4
        inner += struct.pack(order + "HHI", tag, 2, len(data))
        inner += data.ljust(4, b"\0") if inline else struct.pack(order + "I", place + len(tail))
        tail += b"" if inline else data
    head = (b"II*\0" if order == "<" else b"MM\0*") + struct.pack(order + "I", 8)
    body = inner + bytes(4) + tail if date else b""
    return head + struct.pack(order + "H", 1 + bool(date)) + entries + bytes(4) + body


def tagged(image_format, image, orientation, exif, rng):
    """An image file with an orientation and EXIF where its format keeps them."""
    options = {".tif": [cv2.IMWRITE_TIFF_COMPRESSION, int(rng.choice([1, 5, 8]))]}
    options[".webp"] = [cv2.IMWRITE_WEBP_QUALITY, int(rng.choice([95, 101]))]
    content = cv2.imencode(image_format, image, options.get(image_format, []))[1].tobytes()
    if image_format == ".jpg":
        data = b"Exif\0\0" + exif
        mark = b"\xff\xe1" + struct.pack(">H", len(data) + 2) + data
        at = 4 + struct.unpack_from(">H", content, 4)[0] if rng.integers(2) else 2
        return content[:at] + mark + content[at:]
    if image_format == ".png":
        at = 33 if rng.integers(2) else len(content) - 12
        return content[:at] + chunk(b"eXIf", exif) + content[at:]
    if image_format == ".webp":
        return _webp(content, image.shape, exif)
    return _tiff(content, orientation)


def _webp(content, shape, exif):
    sides = b"".join((side - 1).to_bytes(3, "little") for side in (shape[1], shape[0]))
    data = b"Exif\0\0" + exif if len(exif) % 2 else exif
    body = b"WEBPVP8X" + struct.pack("<I", 10) + b"\x08\0\0\0" + sides + content[12:]
    body += b"EXIF" + struct.pack("<I", len(data)) + data + b"\0" * (len(data) % 2)
    return b"RIFF" + struct.pack("<I", len(body)) + body


def _tiff(content, orientation):
    """The directory with the orientation, written anew at the end of the file."""
    (start,) = struct.unpack_from("<I", content, 4)
    (count,) = struct.unpack_from("<H", content, start)
    old = [content[start + 2 + 12 * k : start + 14 + 12 * k] for k in range(count)]
    new = [entry for entry in old if struct.unpack_from("<H", entry)[0] != 0x0112]
    new.append(struct.pack("<HHIHH", 0x0112, 3, 1, orientation, 0))
    new.sort(key=lambda entry: struct.unpack_from("<H", entry)[0])
    at = len(content) + len(content) % 2
    directory = struct.pack("<H", len(new)) + b"".join(new) + bytes(4)
    return content[:4] + struct.pack("<I", at) + content[8:].ljust(at - 8, b"\0") + directory
