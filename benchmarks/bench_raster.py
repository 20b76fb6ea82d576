"""From a corridor's LAZ to voxels, overhead view and road edges, beside decoding the LAZ alone.

The corridor has the shape of the published one: 6.3 miles, 100 ft wide, 34,012,557 points in all;
the usual workload is its first tenth. Decoding is what bounds the whole: nothing can be faster.
"""

from __future__ import annotations

import json
import sys
import tempfile
from pathlib import Path
from typing import Any

import laspy
import numpy as np
from laspy import DecompressionSelection as Fields
from pyproj import CRS

from bench_measure import Size, measured_apart, row

POINTS, LENGTH_M, WIDTH_M = 34_012_557, 10_139.0, 30.48
_BATCH = 1_000_000
_HALF_ROAD_M, _GROUND, _SHRUBS, _ROAD = 5.5, 2, 4, 11


def write_corridor(path: Path, points: int, seed: int = 1) -> None:
    """A winding road amid ground and shrubs, EPSG:32119, in the order in which it was flown."""
    rng = np.random.default_rng(seed)
    header = laspy.LasHeader(version="1.4", point_format=6)
    header.offsets, header.scales = [500_000, 200_000, 0], [0.001] * 3
    header.add_crs(CRS.from_epsg(32119))
    with laspy.open(path, "w", header=header) as file:
        for first in range(0, points, _BATCH):
            last = min(first + _BATCH, points)
            along = np.sort(rng.uniform(first, last, last - first)) / max(points, POINTS) * LENGTH_M
            file.write_points(_points(header, along, rng))


def _points(
    header: laspy.LasHeader, along_m: np.ndarray, rng: np.random.Generator
) -> laspy.ScaleAwarePointRecord:
    across_m = rng.uniform(-WIDTH_M / 2, WIDTH_M / 2, len(along_m))
    cls = np.where(np.abs(across_m) < _HALF_ROAD_M, _ROAD, _GROUND)
    shrub = (cls == _GROUND) & (rng.random(len(cls)) < 0.2)
    cls[shrub] = _SHRUBS
    ground_m = 100 + 8 * np.sin(along_m / 300) - 0.02 * np.abs(across_m)
    record = laspy.ScaleAwarePointRecord.zeros(len(along_m), header=header)
    record.x = 500_000 + along_m
    record.y = 200_000 + across_m + 60 * np.sin(along_m / 200)
    record.z = ground_m + rng.normal(0, 0.02, len(cls)) + shrub * rng.uniform(0.3, 4, len(cls))
    record.classification = cls
    record.intensity = rng.integers(0, 4_000, len(cls))
    return record


def decode(path: Path) -> None:
    """Read coordinates and classes and keep nothing."""
    needed = Fields.base() | Fields.Z | Fields.CLASSIFICATION
    with laspy.open(path, decompression_selection=needed) as file:
        for chunk in file.chunk_iterator(_BATCH):
            chunk.x.max(), chunk.y.max(), chunk.z.max(), chunk.classification.max()


def _stage(name: str, *arguments: str | Path) -> list[str]:
    return [sys.executable, "-m", f"roadsight.stages.{name}", *map(str, arguments)]


def rows(size: Size) -> list[dict[str, Any]]:
    """Both ways on one corridor; full: all of it, and ten times the points on the same road."""
    with tempfile.TemporaryDirectory() as folder:
        if size == "quick":
            return [_compare(Path(folder), 50_000)]
        _compare(Path(folder), 50_000)  # compiles
        counts = [POINTS, 10 * POINTS] if size == "full" else [POINTS // 10]
        return [_compare(Path(folder), count) for count in counts]


def _compare(folder: Path, points: int) -> dict[str, Any]:
    laz, cloud, frame = folder / "road.laz", folder / "cloud.parquet", folder / "frame.json"
    voxels, top = folder / "voxels.parquet", folder / "top.tif"
    edges, lines = folder / "edges.parquet", folder / "edges.gpkg"
    write_corridor(laz, points)
    steps = (
        _stage("ingest_cloud", "--site", "bench", "--vertical-units", "metre", "--cloud", cloud,
               "--frame", frame, laz),
        _stage("rasterise_lidar", "--cloud", cloud, "--frame", frame, "--voxels", voxels,
               "--top", top),
        _stage("extract_road_edges", "--top", top, "--frame", frame, "--edges", edges,
               "--lines", lines),
    )  # fmt: skip
    costs = [measured_apart(step) for step in steps]
    decode_s, decode_mib = measured_apart([sys.executable, __file__, "--decode", str(laz)])
    found = json.loads(frame.read_text())["points"]
    shares = ", ".join(f"{cpu_s:.1f}" for cpu_s, _ in costs)
    return row(
        "voxels and road edges from LAZ",
        (
            f"ingest, raster, edges ({shares} s)",
            sum(c for c, _ in costs),
            max(mib for _, mib in costs),
        ),
        ("bound: decoding x, y, z and class", decode_s, decode_mib),
        (found / points, "share of the points that arrive"),
        f"{points} points, {laz.stat().st_size / 2**20:.0f} MiB, voxels of 1 ft",
    )


if __name__ == "__main__":
    if sys.argv[1:2] == ["--decode"]:
        decode(Path(sys.argv[2]))
    else:
        print(json.dumps(rows("full" if "--full" in sys.argv else "usual"), indent=2))
