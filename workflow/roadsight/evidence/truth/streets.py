"""Labelled street scans: ten frames of a 64-channel scanner, thinned as their figures ask."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from roadsight.base.arrays import Bools, Floats, Ints
from roadsight.io.cloud.clouds import read_laz

ROAD = (40, 60)  # SemanticKITTI labels of the carriageway: road, lane marking.
GROUND = (40, 44, 48, 49, 60, 72)  # Road, parking, sidewalk, other ground, lane marking, terrain.
UNLABELLED = (0, 1)
OUTLIER = 1
FIRST_MOVING = 250  # Labels above this are of moving things.
NEAREST_M = 2.5  # Nearer points are of the vehicle itself.


@dataclass(frozen=True)
class Street:
    """Points of all frames in one local metre frame.

    Parameters
    ----------
    xyz_m : (n, 3). label, scan : (n,). intensity : (n,).
    scanner_m : (frames, 3) where each scan was taken. world_from_scanner : (frames, 3, 3).
    """

    xyz_m: Floats
    label: Ints
    scan: Ints
    intensity: Floats
    scanner_m: Floats
    world_from_scanner: Floats

    def select(self, keep: Bools | Ints) -> Street:
        """The same street with some of its points."""
        return Street(
            self.xyz_m[keep],
            self.label[keep],
            self.scan[keep],
            self.intensity[keep],
            self.scanner_m,
            self.world_from_scanner,
        )

    @property
    def still(self) -> Bools:
        """Points that are neither outliers nor of moving things."""
        return (self.label != OUTLIER) & (self.label <= FIRST_MOVING)

    @property
    def range_m(self) -> Floats:
        """Horizontal distance of each point from its scanner."""
        offset = self.xyz_m[:, :2] - self.scanner_m[self.scan, :2]
        return np.hypot(offset[:, 0], offset[:, 1])


def read_street(folder: Path) -> Street:
    """Read a street scan."""
    cloud = read_laz(folder / "frames.laz")
    poses = pd.read_csv(folder / "poses.csv")
    names = [f"world_from_sensor_r{i}{j}" for i in range(3) for j in range(3)]
    rotation = poses[names].to_numpy(np.float64)
    return Street(
        cloud.xyz,
        np.load(folder / "labels.npz")["label"].astype(np.int64),
        np.asarray(cloud.dims["point_source_id"], np.int64),
        np.asarray(cloud.dims["intensity"], np.float64),
        poses[["x_m", "y_m", "z_m"]].to_numpy(np.float64),
        rotation.reshape(-1, 3, 3),
    )


def first_per_cell(xyz_m: Floats, cell_m: float) -> Ints:
    """Numbers of the first point of each cubic cell, in their order."""
    cell = np.floor(xyz_m / cell_m).astype(np.int64)
    cell -= cell.min(axis=0)
    size = cell.max(axis=0) + 1
    key = (cell[:, 0] * size[1] + cell[:, 1]) * size[2] + cell[:, 2]
    return np.sort(np.unique(key, return_index=True)[1])


def ground_points(street: Street, cell_m: float = 0.04, farthest_m: float = 45.0) -> Street:
    """Points on which ground and pavement are judged: still, 2.5 to 45 m, one a 4 cm cell."""
    reach = street.range_m
    near = street.select(street.still & (reach >= NEAREST_M) & (reach <= farthest_m))
    return near.select(first_per_cell(near.xyz_m, cell_m))


def f1(found: Bools, truth: Bools) -> float:
    """Harmonic mean of precision and recall; 1 where there is nothing to find and nothing found."""
    both = int((found & truth).sum())
    total = int(found.sum()) + int(truth.sum())
    return 2 * both / total if total else 1.0
