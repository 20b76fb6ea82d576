"""Road edges on real data, one data set at a time."""

from __future__ import annotations

import sys
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import shapely

from roadsight.base.arrays import Floats
from roadsight.base.sections.scene import Edges
from roadsight.evidence.labelled_clouds import REACH_M, Survey, read_survey
from roadsight.evidence.truth_catalogue import Figure
from roadsight.scene.splines import outline_edges, spline_line
from roadsight.scene.whole import ground_of, published_road, settled_road
from roadsight.stages.truth.truth_stage import measuring

# Road edges beside surveyed ones, where an old town's paved area was surveyed.

WITHIN_M = (0.5, 1.0, 2.0)
"""A surveyed edge is found where one of ours lies this near."""

_EVERY_M = 0.5
"""Spacing of the places at which edges are compared."""


def measure_edges(dataset: str, files: Sequence[Path]) -> list[Figure]:
    """Median distance of found edges from surveyed ones, and shares of surveyed ones found."""
    survey = read_survey(files)
    started = time.process_time()
    ground = ground_of(survey.xyz_m)
    smooth = published_road(survey.xyz_m, ground, survey.intensity)
    road = settled_road(smooth, survey.xyz_m, ground, survey.intensity, survey.classification)
    traced = outline_edges(road.outline, road.surface_m, Edges())
    lines = [spline_line(line) for _, line in traced]
    used_s = time.process_time() - started
    ours = _figures(lines, survey)
    peer = _figures([survey.outline_of(survey.xyz_m[ground]).boundary], survey)
    return [Figure(name, ours[name], peer[name], used_s) for name in ours]


def _figures(lines: list[shapely.Geometry], survey: Survey) -> dict[str, float]:
    # Edges of streets that were not surveyed are neither right nor wrong.
    near = shapely.intersection(survey.judged, survey.paved.buffer(REACH_M))
    found = shapely.union_all(lines).intersection(near)
    truth = survey.paved.boundary.intersection(survey.judged)
    off = shapely.distance(_along(found), truth)
    missed = shapely.distance(_along(truth), found)
    figures = {"median_distance": float(np.median(off)) if len(off) else float("nan")}
    for limit in WITHIN_M:
        name = f"completeness_{limit:g}m"
        figures[name] = 100 * float((missed <= limit).mean()) if len(missed) else 0.0
    return figures


def _along(lines: shapely.Geometry) -> Floats:
    """Points every half metre along lines."""
    parts = [part for part in shapely.get_parts(lines) if part.length > 0]
    places = [
        shapely.line_interpolate_point(part, np.arange(0.0, part.length, _EVERY_M))
        for part in parts
    ]
    return np.concatenate(places) if places else np.empty(0, object)


main = measuring(measure_edges, __doc__)


if __name__ == "__main__":
    sys.exit(main())
