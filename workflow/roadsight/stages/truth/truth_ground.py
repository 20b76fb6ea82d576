"""Ground labels on real data, one data set at a time."""

from __future__ import annotations

import sys
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from scipy import ndimage

from roadsight.base.arrays import Bools, Floats
from roadsight.evidence.labelled_clouds import GROUND, UNLABELLED, f1, ground_points, read_street
from roadsight.evidence.truth_catalogue import ISPRS, Figure
from roadsight.io.cloud.clouds import read_laz
from roadsight.scene.grids import Grid, fill_gaps, lowest_per_cell, sample_bilinear
from roadsight.scene.whole import ground_of
from roadsight.stages.truth.truth_stage import measuring

# Ground labels beside those of people: ISPRS samples and labelled streets.

# SMRF (Pingel, Clarke, McBride 2013): the fixed parameters of its table 4 and section 4.
_CELL_M = 1.0
_WINDOW_M = 18.0
_SLOPE = 0.15
_THRESHOLD_M = 0.5
_SCALE = 1.25


def measure_ground(dataset: str, files: Sequence[Path]) -> list[Figure]:
    """Figures of one data set."""
    if dataset in ISPRS:
        cloud, labels = sorted(files, key=lambda path: path.suffix)
        xyz_m = read_laz(cloud).xyz
        xyz_m = xyz_m - xyz_m.min(axis=0)
        truth = np.load(labels)["ground"].astype(bool)
    else:
        street = ground_points(read_street(files[0].parent))
        xyz_m, truth = street.xyz_m, np.isin(street.label, GROUND)
    started = time.process_time()
    found = ground_of(xyz_m)
    used_s = time.process_time() - started
    peer = smrf(xyz_m)
    if dataset in ISPRS:
        wrong, peer_wrong = 100 * (found != truth).mean(), 100 * (peer != truth).mean()
        agreed, peer_agreed = 100 * kappa(found, truth), 100 * kappa(peer, truth)
        return [
            Figure("total_error", wrong, peer_wrong, used_s),
            Figure("kappa", agreed, peer_agreed, used_s),
        ]
    judged = ~np.isin(street.label, UNLABELLED)
    ours, theirs = (f1(mask[judged], truth[judged]) for mask in (found, peer))
    return [Figure("f1", 100 * ours, 100 * theirs, used_s)]


def kappa(found: Bools, truth: Bools) -> float:
    """Cohen's kappa: agreement beyond what shares alone explain."""
    agreed = float((found == truth).mean())
    chance = float(found.mean() * truth.mean() + (1 - found.mean()) * (1 - truth.mean()))
    return (agreed - chance) / (1 - chance) if chance < 1 else 1.0


def smrf(xyz_m: Floats) -> Bools:
    """Ground by SMRF with its fixed parameters, written from the paper.

    Opening of the lowest surface with discs of growing radius marks objects where the step exceeds
    the slope; the surface without them decides by height and slope.
    """
    grid = Grid.around(xyz_m[:, 0], xyz_m[:, 1], _CELL_M)
    lowest = lowest_per_cell(grid, *xyz_m.T)
    filled = fill_gaps(lowest)
    low = _objects(-filled, 1, 5.0)
    surface = fill_gaps(np.where(low, np.nan, filled))
    objects = _objects(surface, round(_WINDOW_M / _CELL_M), _SLOPE) | low
    ground = fill_gaps(np.where(objects | ~np.isfinite(lowest), np.nan, surface))
    gradient = np.hypot(*np.gradient(ground, _CELL_M))
    height = sample_bilinear(grid, ground, xyz_m[:, 0], xyz_m[:, 1])
    slope = sample_bilinear(grid, gradient, xyz_m[:, 0], xyz_m[:, 1])
    return np.abs(xyz_m[:, 2] - height) <= _THRESHOLD_M + _SCALE * slope


def _objects(surface: Floats, widest: int, slope: float) -> Bools:
    """Cells that an opening with some disc up to ``widest`` cells lowers beyond the slope."""
    found = np.zeros(surface.shape, bool)
    last = surface
    for radius in range(1, widest + 1):
        disc = np.hypot(*np.mgrid[-radius : radius + 1, -radius : radius + 1]) <= radius
        opened = ndimage.grey_opening(last, footprint=disc)
        found |= last - opened > slope * radius * _CELL_M
        last = opened
    return found


main = measuring(measure_ground, __doc__)


if __name__ == "__main__":
    sys.exit(main())
