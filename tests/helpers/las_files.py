"""Small LAS and LAZ files for the tests of ingest."""

import os
import struct
from pathlib import Path

import laspy
import lazrs
import numpy as np
import pytest
from laspy.vlrs.known import WktCoordinateSystemVlr
from pyproj import CRS

DATA = Path(os.environ.get("ROADSIGHT_DATA", "/nonexistent"))


def needs_data(test):
    """A test of the real data sets, skipped where there are none."""
    absent = pytest.mark.skipif(not DATA.is_dir(), reason="ROADSIGHT_DATA is not set")
    return pytest.mark.real(absent(test))


def random_points(count, seed=0, extent=(120.0, 80.0, 12.0), corner=(458000.0, 5428000.0, 100.0)):
    """Points in a box, to the millimetre, so that LAS integers hold them exactly."""
    rng = np.random.default_rng(seed)
    return np.round(rng.uniform(0, 1, (count, 3)) * extent, 3) + corner


def write_las(path, xyz, wkt=None, point_format=6, version="1.4", scale=0.001, offset=None, **dims):
    """Write points with a WKT record and further dimensions."""
    header = laspy.LasHeader(point_format=point_format, version=version)
    xyz = np.asarray(xyz, float).reshape(-1, 3)
    header.scales = np.full(3, scale)
    header.offsets = np.floor(xyz.min(axis=0)) if offset is None else np.array(offset, float)
    if wkt is not None:
        header.vlrs.append(WktCoordinateSystemVlr(wkt))
        header.global_encoding.wkt = True
    las = laspy.LasData(header)
    las.x, las.y, las.z = xyz.T
    for name, values in dims.items():
        las[name] = np.broadcast_to(values, len(xyz))
    las.write(str(path))
    return path


def patched(path, *fields):
    """A file with numbers at some places: (place, layout, value)."""
    data = bytearray(path.read_bytes())
    for at, layout, value in fields:
        struct.pack_into(layout, data, at, value)
    path.write_bytes(data)
    return path


def in_chunks(path, sizes):
    """Compress a LAZ file again, in chunks of so many points each, or of these sizes in turn."""
    with laspy.open(path) as reader:
        start = reader.header.offset_to_point_data
        record = reader.header.vlrs.get("LasZipVlr")[0].record_data
        points = reader.read().points.array
    varying = not isinstance(sizes, int)
    changed = record[:12] + struct.pack("<I", 2**32 - 1 if varying else sizes) + record[16:]
    head = path.read_bytes()[:start].replace(record, changed)
    with path.open("wb") as stream:
        stream.write(head)
        compressor = lazrs.LasZipCompressor(stream, lazrs.LazVlr(changed))
        for k, part in enumerate(np.split(points, np.cumsum(sizes)[:-1]) if varying else [points]):
            if k:
                compressor.finish_current_chunk()
            compressor.compress_many(np.frombuffer(part.tobytes(), np.uint8))
        compressor.done()
    return path


def wkt_of(code):
    """WKT 2 of a CRS."""
    return CRS.from_user_input(code).to_wkt()
