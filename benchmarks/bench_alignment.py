"""Camera alignment beside the published Nelder-Mead, on the same images of an analytic road.

The mount of the drive is known to both as a calibration leaves it; what changes from image to image
(place to a metre, yaw, pitch and roll by a few tenths of a degree) is to be found. A fifth of the
edge pixels are astray.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bench_measure import Size, measured, row
from roadsight.base.sections.poles import Reach
from roadsight.geometry.cameras import wrap_deg
from roadsight.poles.alignment.drive import near_edges, places_of
from roadsight.poles.alignment.pose import (
    FOCAL,
    HEIGHT,
    INSETS,
    LATERAL,
    PITCH,
    ROLL,
    SIZE,
    YAW,
    Spread,
    pose_of,
)
from roadsight.poles.alignment.published import nelder_mead
from roadsight.poles.alignment.roadside import RoadEdges
from roadsight.poles.alignment.search import search
from roadsight.poles.alignment.solve import ImageEdges, Noise, Task
from roadsight.poles.alignment.verdict import Limits, doubt

sys.path.insert(0, str(Path(__file__).parents[1]))
from tests.helpers.road_bed import RoadBed, frames_of

YAW_DEG = 0.1
_CROWN_DEG = 1.146
"""Roll of a lane whose road falls 2 % to either side."""


def rows(size: Size) -> list[dict[str, Any]]:
    """All comparisons; quick ones use few images."""
    bed = RoadBed(seed=7, images=6 if size == "quick" else 40, gps_m=0.3)
    tasks = _tasks(bed)
    _ours(tasks[:1]), _theirs(tasks[:1])  # Compilation is not what is measured.
    (ours, accepted), ours_s, ours_peak = measured(lambda: _ours(tasks))
    theirs, theirs_s, theirs_peak = measured(lambda: _theirs(tasks))
    right, theirs_right = (_right(bed, tasks, found) for found in (ours, theirs))
    metric = f"headings within {YAW_DEG} degrees (theirs {theirs_right:.4f})"
    work = f"mean of {len(tasks)} images, {accepted} accepted by ours, 20 % of pixels astray"
    return [
        row(
            "camera alignment, one image",
            ("robust least squares", ours_s / len(tasks), ours_peak),
            ("Nelder-Mead as published", theirs_s / len(tasks), theirs_peak),
            (right, metric),
            work,
        )
    ]


def _tasks(bed: RoadBed) -> list[Task]:
    """The images under what a calibrated drive expects of them."""
    mount, mean = bed.mount, np.zeros(SIZE)
    mean[[LATERAL, HEIGHT, YAW, PITCH, ROLL, FOCAL]] = (
        mount.lateral_m, mount.height_m, mount.yaw_deg, mount.pitch_deg,
        mount.roll_deg - _CROWN_DEG, np.log(bed.intrinsics.focal_px),
    )  # fmt: skip
    mean[INSETS : INSETS + 2] = mount.lane_inset_m
    information = np.diag(1.0 / Spread(along_m=0.3).vector() ** 2)
    edges = RoadEdges.from_points(bed.road_edges)
    tasks = []
    for place, pixels in zip(places_of(frames_of(bed), edges), bed.seen, strict=True):
        seen = ImageEdges.from_pixels(pixels[:, :2], pixels[:, 2], pixels[:, 3] > 0.5)
        there = near_edges(place, edges, Reach())
        tasks.append(Task(place.start, seen, there, Noise(), mean, information))
    return tasks


def _ours(tasks: Sequence[Task]) -> tuple[list[NDArray[np.float64]], int]:
    """Unknowns of each image, and how many are accepted."""
    fits = [search(task) for task in tasks]
    accepted = [not doubt(t, f, Limits()) for t, f in zip(tasks, fits, strict=True)]
    return [found[0].unknowns for found in fits], sum(accepted)


def _theirs(tasks: Sequence[Task]) -> list[NDArray[np.float64]]:
    align: Callable[..., tuple[NDArray[np.float64], float]] = nelder_mead
    given = ((task.start, task.image_edges, task.map_edges, task.prior_mean) for task in tasks)
    return [align(*one)[0] for one in given]


def _right(bed: RoadBed, tasks: Sequence[Task], found: Sequence[NDArray[np.float64]]) -> float:
    """Share of the images whose heading is right."""
    gaps = [
        abs(float(wrap_deg(pose_of(task.start, unknowns).heading_deg - truth.heading_deg)))
        for task, unknowns, truth in zip(tasks, found, bed.truth, strict=True)
    ]
    return float(np.mean(np.array(gaps) <= YAW_DEG))
