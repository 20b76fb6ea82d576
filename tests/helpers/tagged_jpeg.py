"""Plain and geotagged JPEG images of one shade."""

import struct

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
