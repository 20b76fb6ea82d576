"""Pavement on real data, one data set at a time."""

from __future__ import annotations

import sys
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from roadsight.evidence.labelled_clouds import (
    ROAD,
    UNLABELLED,
    Survey,
    f1,
    ground_points,
    read_street,
    read_survey,
)
from roadsight.evidence.truth_catalogue import Figure
from roadsight.scene.whole import ground_of, published_road, road_of, settled_road
from roadsight.stages.truth.truth_stage import measuring

# Pavement beside the labels of people: street scans by points, a surveyed town by area.


def measure_pavement(dataset: str, files: Sequence[Path]) -> list[Figure]:
    """F1 of the road's points, from the cloud alone; the peer takes all ground for road."""
    if not dataset.startswith("street"):
        return _by_area(read_survey(files))
    street = ground_points(read_street(files[0].parent))
    judged = ~np.isin(street.label, UNLABELLED)
    truth = np.isin(street.label, ROAD)
    started = time.process_time()
    found, _ = road_of(street.xyz_m, street.intensity, street.scan)
    used_s = time.process_time() - started
    peer = ground_of(street.xyz_m)
    return [
        Figure(
            "f1",
            100 * f1(found.points[judged], truth[judged]),
            100 * f1(peer[judged], truth[judged]),
            used_s,
        )
    ]


def _by_area(survey: Survey) -> list[Figure]:
    """Recall and precision of paved area; the peer takes all ground for paved."""
    started = time.process_time()
    ground = ground_of(survey.xyz_m)
    smooth = published_road(survey.xyz_m, ground, survey.intensity)
    road = settled_road(smooth, survey.xyz_m, ground, survey.intensity, survey.classification)
    used_s = time.process_time() - started
    truth = survey.cells_of(survey.paved) & survey.known
    shares = []
    for cells in (survey.cells_of(road.outline), survey.area_of(survey.xyz_m[ground])):
        found = cells & survey.known
        both = int((found & truth).sum())
        shares.append((both / max(int(truth.sum()), 1), both / max(int(found.sum()), 1)))
    return [
        Figure(name, 100 * ours, 100 * peer, used_s)
        for name, ours, peer in zip(("recall_by_area", "precision_by_area"), *shares, strict=True)
    ]


main = measuring(measure_pavement, __doc__)


if __name__ == "__main__":
    sys.exit(main())
