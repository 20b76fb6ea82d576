"""Small LAS and LAZ files for the tests of ingest."""

from __future__ import annotations

import os
from pathlib import Path

import laspy
import numpy as np
import pytest
from laspy.vlrs.known import WktCoordinateSystemVlr
from pyproj import CRS

DATA = Path(os.environ.get("ROADSIGHT_DATA", "/nonexistent"))
needs_data = pytest.mark.skipif(not DATA.is_dir(), reason="ROADSIGHT_DATA is not set")


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


def wkt_of(code):
    """WKT 2 of a CRS."""
    return CRS.from_user_input(code).to_wkt()
