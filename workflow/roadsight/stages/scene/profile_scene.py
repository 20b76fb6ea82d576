"""Measure what a scene is like, tile by tile."""

from __future__ import annotations

import logging
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from roadsight.base.arrays import Floats, Ints
from roadsight.base.errors import InputError
from roadsight.io.cloud.tiles import COLOUR, CloudTiles, stack_xyz
from roadsight.io.records.atomic import read_json, write_json
from roadsight.scene.pavement.scan_levels import count_scans
from roadsight.scene.profile import (
    Cells,
    count_cells,
    density,
    describe_scene,
    join_cells,
    sample_distances,
)
from roadsight.stages.command import Command

log = logging.getLogger(__name__)

_INTENSITIES = 65_536
"""Intensities that there are: LAS holds them in 16 bits."""


def profile_scene(cloud_path: Path, frame: Path, *, out: Path) -> None:
    """Write the profile of a tiled cloud."""
    cloud = CloudTiles(cloud_path)
    about = read_json(frame)
    if about["points"] != cloud.points:
        raise InputError(
            "is of another cloud",
            where=str(frame),
            found=f"{about['points']} points",
            allowed=str(cloud.points),
            hint="run the workflow again",
        )
    cells, intensity = _cells(cloud)
    profile = describe_scene(
        cells,
        _distances(cloud, cells),
        about["bounds_m"],
        intensity,
        has_colour=set(COLOUR) <= set(cloud.columns),
    )
    profile["scans"] = count_scans(lambda: _scans(cloud))
    log.info(
        "%.2f points per m2, %.3f m apart",
        profile["density_per_m2"]["median"],
        profile["spacing_m"],
    )
    write_json(out, profile)


def _cells(cloud: CloudTiles) -> tuple[Cells, Ints]:
    """Occupied cells of the whole cloud, and how many points have each intensity."""
    parts, intensity = [], np.zeros(_INTENSITIES, np.int64)
    for number in range(len(cloud.tiles)):
        points = cloud.read(("x", "y", "z", "intensity", "classification"), [number])
        parts.append(count_cells(stack_xyz(points), points["classification"]))
        intensity += np.bincount(points["intensity"], minlength=_INTENSITIES)
    return join_cells(parts), intensity


def _scans(cloud: CloudTiles) -> Iterator[tuple[Floats, Ints]]:
    """Points and their scan numbers, tile by tile; one scan where the cloud tells none apart."""
    told = "scan" in cloud.columns
    for number in range(len(cloud.tiles)):
        points = cloud.read(("x", "y", "z", *(["scan"] if told else [])), [number])
        xyz_m = stack_xyz(points).astype(np.float64)
        yield xyz_m, points["scan"] if told else np.zeros(len(xyz_m), np.int64)


def _distances(cloud: CloudTiles, cells: Cells) -> Floats:
    """Distances of sampled points to their nearest neighbours."""
    ends = np.cumsum([tile.rows for tile in cloud.tiles])

    def place(rank: int) -> tuple[float, float]:
        number = int(np.searchsorted(ends, rank, side="right"))
        tile = cloud.read(("x", "y"), [number])
        at = rank - ends[number] + cloud.tiles[number].rows
        return float(tile["x"][at]), float(tile["y"][at])

    return sample_distances(
        cloud.points,
        density(cells.column, cells.row, cells.count)["median"],
        place,
        lambda box: stack_xyz(cloud.read_within(box, ("x", "y", "z"))),
    )


main = Command(profile_scene)


if __name__ == "__main__":
    sys.exit(main())
