"""Poles from published sightings on real data, one data set at a time."""

from __future__ import annotations

import sys
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pandas as pd

from roadsight.evidence.truth_catalogue import Figure
from roadsight.io.records.text_tables import read_sightings
from roadsight.poles.risk.validation import score_thresholds
from roadsight.poles.triangulate.geographic import (
    TangentFrame,
    triangulate_geographic,
    triangulate_published,
)
from roadsight.poles.triangulate.published import PUBLISHED_DISTANCE
from roadsight.poles.triangulate.rays import UNAIDED
from roadsight.stages.truth.truth_stage import measuring

# Poles from published street-view sightings beside the code published with them.

THRESHOLDS_M = (2, 4, 6)

_SEEDS = 10
"""Random orders of the published code, on which its answer depends."""


def measure_sightings(dataset: str, files: Sequence[Path]) -> list[Figure]:
    """Precision and recall at 2, 4 and 6 m, one-to-one; the peer's are means over random orders."""
    paths = {path.stem.rpartition("_")[2]: path for path in files}
    sightings = read_sightings(paths["sightings"])
    truth = pd.read_csv(paths["truth"])
    frame = TangentFrame(sightings["lat"].to_numpy(), sightings["lon"].to_numpy())
    truth_m = frame.to_metres(truth["lat"].to_numpy(), truth["lon"].to_numpy())

    def scores(poles: pd.DataFrame) -> dict[str, float]:
        found_m = frame.to_metres(poles["lat"].to_numpy(), poles["lon"].to_numpy())
        rows = score_thresholds(found_m, truth_m, THRESHOLDS_M)
        return {
            f"{name}_{row['threshold_m']}m": float(row[name] or 0.0)
            for row in rows
            for name in ("precision", "recall")
        }

    started = time.process_time()
    ours = scores(triangulate_geographic(sightings, UNAIDED))
    used_s = time.process_time() - started
    own = UNAIDED.model_copy(update={"max_distance_m": PUBLISHED_DISTANCE})
    theirs = [scores(triangulate_published(sightings, own, seed)) for seed in range(_SEEDS)]
    return [
        Figure(name, value, float(np.mean([score[name] for score in theirs])), used_s)
        for name, value in ours.items()
    ]


main = measuring(measure_sightings, __doc__)


if __name__ == "__main__":
    sys.exit(main())
