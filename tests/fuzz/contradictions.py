"""Valid files with one contradiction each, beside the clean file that they are compared with."""

import struct
from pathlib import Path

import laspy
import numpy as np
from laspy.vlrs.known import WktCoordinateSystemVlr
from pyproj import CRS

from tests.helpers.las_files import patched

ZONES = (25831, 25832, 25833)
KEYS = 34735
HEADER = "lat,lon,bearing,depth"


def clean_cloud(path: Path, rng: np.random.Generator) -> tuple[Path, int]:
    """An uncompressed LAS file of format 1 or 6 and the EPSG code of its CRS."""
    code, point_format = int(rng.choice(ZONES)), int(rng.choice([1, 6]))
    header = laspy.LasHeader(point_format=point_format, version="1.4")
    header.scales, header.offsets = np.full(3, 0.001), np.array([500_000.0, 5_400_000.0, 0.0])
    header.vlrs.append(WktCoordinateSystemVlr(CRS.from_epsg(code).to_wkt("WKT1_GDAL")))
    header.global_encoding.wkt = True
    las = laspy.LasData(header)
    las.x, las.y, las.z = (rng.uniform(0, 50, (3, 40)).T + header.offsets).T
    las.return_number = np.ones(40, np.uint8)
    las.write(str(path))
    return path, code


def contradicted_cloud(path: Path, kind: str, rng: np.random.Generator) -> None:
    """Put one contradiction of a kind into a clean cloud."""
    las = laspy.read(path)
    code = CRS.from_wkt(las.header.vlrs[0].string).to_epsg()
    other = int(rng.choice([zone for zone in ZONES if zone != code]))
    if kind in ("stale keys", "stale keys, no bit"):
        las.header.vlrs.append(keys_of({3072: other}))
        las.header.global_encoding.wkt = kind == "stale keys"
    elif kind == "stale record 4224":
        wkt = CRS.from_epsg(other).to_wkt().encode()
        las.header.vlrs.append(laspy.VLR("LASF_Projection", 4224, "", wkt))
    elif kind == "one part":
        las.header.vlrs[0].string = f'COMPD_CS["x",{las.header.vlrs[0].string}]'
    las.write(str(path))
    if kind == "count in the old place":
        patched(path, (247, "<Q", 0), (107, "<I", 40))
    elif kind == "no count":
        patched(path, (247, "<Q", 0), (107, "<I", 0))


KINDS = (
    "stale keys", "stale keys, no bit", "stale record 4224", "one part", "count in the old place",
    "no count",
)  # fmt: skip


def keys_of(values: dict[int, int]) -> laspy.VLR:
    """Record of GeoTIFF keys."""
    entries = [(1, 1, 0, len(values)), *((key, 0, 1, value) for key, value in values.items())]
    data = struct.pack(f"<{4 * len(entries)}H", *np.ravel(entries))
    return laspy.VLR("LASF_Projection", KEYS, "", data)


def table(rng: np.random.Generator) -> tuple[str, bytes]:
    """A table of sightings, clean and as some spreadsheet writes it."""
    numbers = rng.uniform(1, 60, (int(rng.integers(1, 9)), 4)).round(4)
    rows = [HEADER, *(",".join(f"{value:.4f}" for value in row) for row in numbers)]
    clean = "\n".join(rows) + "\n"
    ends = "," * int(rng.integers(3))
    text = "".join(row + ends * bool(rng.integers(2)) + "\n" for row in rows)
    separator = str(rng.choice([",", ";", "\t"]))
    if separator != ",":
        text = text.replace(",", separator)
        text = text.replace(".", ",") if rng.integers(2) else text
    text = text.replace("\n", "\r\n") if rng.integers(2) else text
    return clean, text.encode(str(rng.choice(["utf-8", "utf-8-sig", "utf-16"])))
