"""What the chosen sensors of a plan see."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from scipy import sparse

from roadsight.base.arrays import Ints
from roadsight.placement.sight.coverage import detection_matrix


@dataclass(frozen=True)
class Sights:
    """Which sensor of a plan sees which target.

    Parameters
    ----------
    matrix : boolean, rows = sensors, columns = targets.
    range_m : distance from sensor to target where it is seen, same pattern as ``matrix``.
    """

    matrix: sparse.csr_matrix
    range_m: sparse.csr_matrix

    @property
    def times_seen(self) -> Ints:
        """How many sensors see each target, (n,)."""
        return np.asarray(self.matrix.sum(axis=0, dtype=np.int64)).ravel()

    @property
    def histogram(self) -> Ints:
        """Number of targets seen by 0, 1, 2 ... sensors; never empty."""
        return np.bincount(self.times_seen, minlength=1)

    def seen_by(self, sensor: int) -> Ints:
        """Increasing numbers of the targets that a sensor sees."""
        row = slice(self.matrix.indptr[sensor], self.matrix.indptr[sensor + 1])
        return np.sort(self.matrix.indices[row]).astype(np.int64)

    def figures(self, sensor: int) -> dict[str, Any]:
        """Targets seen, targets that no other sensor sees, mean and greatest range (or None)."""
        seen = self.seen_by(sensor)
        distance = self.range_m.data[self.range_m.indptr[sensor] : self.range_m.indptr[sensor + 1]]
        return {
            "targets": len(seen),
            "only": int((self.times_seen[seen] == 1).sum()),
            "range_mean_m": float(distance.mean()) if len(seen) else None,
            "range_max_m": float(distance.max()) if len(seen) else None,
        }


def sights_of(
    sensors: list[dict[str, Any]], detections: pd.DataFrame, targets: pd.DataFrame
) -> Sights:
    """What the sensors of a solution see.

    Parameters
    ----------
    sensors : entries of solution.json with candidate, sensor, x, y, z in local metres.
    detections : columns sensor, candidate, target; one row per seen target.
    targets : columns target, x, y, z, local metres.
    """
    pairs = [[entry[key] for entry in sensors] for key in ("sensor", "candidate")]
    choices = pd.MultiIndex.from_arrays(pairs, names=["sensor", "candidate"])
    matrix = detection_matrix(detections, choices, pd.Index(targets["target"]))
    positions = np.array([[entry[axis] for axis in "xyz"] for entry in sensors]).reshape(-1, 3)
    rows, columns = matrix.nonzero()
    apart = positions[rows] - targets[["x", "y", "z"]].to_numpy(np.float64)[columns]
    distance = np.linalg.norm(apart, axis=1)
    return Sights(matrix, sparse.csr_matrix((distance, (rows, columns)), shape=matrix.shape))
