"""From a corridor's LAZ to voxels, overhead view and road edges, beside decoding the LAZ alone.

The corridor has the shape of the published one: 6.3 miles, 100 ft wide, 34,012,557 points in all;
the usual workload is its first tenth. Decoding is what bounds the whole: nothing can be faster. It
is given for all that the file holds, as a plain reader does, by one thread and by as many as ours
has, and for the layers alone that voxels need.
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
from roadsight.config.environment import prepare_environment
from roadsight.io.records.sources import stage_module

POINTS, LENGTH_M, WIDTH_M = 34_012_557, 10_139.0, 30.48
_BATCH = 1_000_000
_HALF_ROAD_M, _GROUND, _SHRUBS, _ROAD = 5.5, 2, 4, 11
_PULSES_HZ, _LATER_RETURNS, _LOST_PULSES = 300_000, 0.2, 0.02
_THREADS = 2
_LAYERS = {"all": Fields.all(), "voxels": Fields.base() | Fields.Z | Fields.CLASSIFICATION}
_READERS = (("all of it", "all", 1), ("all of it by two threads", "all", 2),
            ("x, y, z and class", "voxels", 1))  # fmt: skip


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
            record = _points(header, along, rng)
            _fly(record, first, rng)
            file.write_points(record)


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


def _fly(record: laspy.ScaleAwarePointRecord, first: int, rng: np.random.Generator) -> None:
    """Returns, times and angles of the scanner, whose mirror swings as the aircraft flies."""
    count = len(record)
    pulse = np.cumsum(rng.random(count) >= _LATER_RETURNS)
    starts = np.flatnonzero(np.diff(pulse, prepend=-1))
    returns = np.diff(np.append(starts, count))
    record.number_of_returns = np.repeat(np.minimum(returns, 15), returns)
    record.return_number = np.minimum(np.arange(count) - np.repeat(starts, returns) + 1, 15)
    sent = first + pulse + np.cumsum(rng.random(count) < _LOST_PULSES)
    record.gps_time = 3.2e8 + sent / _PULSES_HZ
    record.scan_angle = np.rint(3_000 * np.sin(sent / 500)).astype(np.int16)
    record.point_source_id[:] = 101


def decode(path: Path, layers: str) -> None:
    """Read coordinates and classes, or all there is, and keep nothing."""
    with laspy.open(
        path, laz_backend=laspy.LazBackend.LazrsParallel, decompression_selection=_LAYERS[layers]
    ) as file:
        for chunk in file.chunk_iterator(_BATCH):
            chunk.x.max(), chunk.y.max(), chunk.z.max(), chunk.classification.max()


def _stage(name: str, *arguments: str | Path) -> list[str]:
    return [sys.executable, "-m", stage_module(name), *map(str, arguments)]


def rows(size: Size) -> list[dict[str, Any]]:
    """Both ways on one corridor; full: all of it, and ten times the points on the same road."""
    with tempfile.TemporaryDirectory() as folder:
        if size == "quick":
            return _compare(Path(folder), 50_000)
        _compare(Path(folder), 50_000)  # compiles
        counts = [POINTS, 10 * POINTS] if size == "full" else [POINTS // 10]
        return [line for count in counts for line in _compare(Path(folder), count)]


def _compare(folder: Path, points: int) -> list[dict[str, Any]]:
    laz, cloud, frame = folder / "road.laz", folder / "cloud.parquet", folder / "frame.json"
    voxels, top = folder / "voxels.parquet", folder / "top.tif"
    edges, lines = folder / "edges.parquet", folder / "edges.gpkg"
    write_corridor(laz, points)
    steps = (
        _stage("ingest_cloud", "--site", "bench", "--vertical-units", "metre", "--cloud", cloud,
               "--frame", frame, "--clouds", laz),
        _stage("rasterise_lidar", "--cloud", cloud, "--frame", frame, "--voxels", voxels,
               "--top", top, "--threads", str(_THREADS)),
        _stage("extract_road_edges", "--top", top, "--frame", frame, "--edges", edges,
               "--lines", lines),
    )  # fmt: skip
    costs = [measured_apart(step, _THREADS) for step in steps]
    found = json.loads(frame.read_text())["points"]
    shares = ", ".join(f"{cost.cpu_s:.1f}" for cost in costs)
    name = f"ingest, raster, edges ({shares} s)"
    cpu_s, wall_s = sum(cost.cpu_s for cost in costs), sum(cost.wall_s for cost in costs)
    ours = (name, cpu_s, max(cost.peak_mib for cost in costs))
    arrived = (found / points, "share of the points that arrive")
    workload = f"{points} points, {laz.stat().st_size / 2**20:.0f} MiB, voxels of 1 ft"
    lines = []
    for what, layers, threads in _READERS:
        bound = measured_apart([sys.executable, __file__, layers, str(laz)], threads)
        against = (f"bound: decoding {what}", bound.cpu_s, bound.peak_mib)
        clock = (wall_s, bound.wall_s)
        lines.append(row("voxels and road edges from LAZ", ours, against, arrived, workload, clock))
    return lines


if __name__ == "__main__":
    if sys.argv[1:] and sys.argv[1] in _LAYERS:
        decode(Path(sys.argv[2]), sys.argv[1])
    else:
        prepare_environment()
        print(json.dumps(rows("full" if "--full" in sys.argv else "usual"), indent=2))
