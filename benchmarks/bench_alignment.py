"""Camera alignment beside the published Nelder-Mead, on the same edges of an analytic road.

The mount of the drive is known to both, to the one as a calibration leaves it, to the other as a
registered camera; what changes from image to image
(place to a metre, yaw, pitch and roll by a few tenths of a degree) is to be found. A fifth of the
edge pixels are astray.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bench_measure import Size, measured, row
from roadsight.base.sections.poles import Reach
from roadsight.geometry.cameras import wrap_deg
from roadsight.poles.alignment import published
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
from roadsight.poles.alignment.roadside import RoadEdges
from roadsight.poles.alignment.solve import ImageEdges, Noise, Task, search
from roadsight.poles.alignment.verdict import Limits, doubt
from roadsight.stages.poles.align_cameras import ways_ahead

sys.path.insert(0, str(Path(__file__).parents[1]))
from tests.helpers.road_bed import RoadBed, frames_of

YAW_DEG = 0.1
_CROWN_DEG = 1.146
"""Roll of a lane whose road falls 2 % to either side."""


def rows(size: Size) -> list[dict[str, Any]]:
    """All comparisons; quick ones use few images."""
    bed = RoadBed(seed=7, images=6 if size == "quick" else 40, gps_m=0.3)
    tasks = _tasks(bed)
    axes = _axes(bed)
    _ours(tasks[:1]), _theirs(tasks[:1], axes)  # Compilation is not what is measured.
    (ours, accepted), ours_s, ours_peak = measured(lambda: _ours(tasks))
    theirs, theirs_s, theirs_peak = measured(lambda: _theirs(tasks, axes))
    headings = [pose_of(task.start, one).heading_deg for task, one in zip(tasks, ours, strict=True)]
    right, theirs_right = (_right(bed, found) for found in (headings, theirs))
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


def _axes(bed: RoadBed) -> list[published.Axes]:
    """Lines from each image to the next, on the road."""
    places = np.column_stack([bed.track, bed.z_road])
    ways = ways_ahead(places)
    return [
        published.Axes.along(place, way)
        for place, way in zip(places, ways, strict=True)
        if way is not None
    ]


def _theirs(tasks: Sequence[Task], axes: Sequence[published.Axes]) -> list[float]:
    """Heading of each image by Nelder-Mead, from the mount as a registered camera."""
    found = []
    for number, (task, own) in enumerate(zip(tasks, axes, strict=False)):
        points, left, seen = task.map_edges.xyz_m, task.map_edges.left, task.image_edges
        parts = np.split(published.whole_pixels(seen.uv_px), seen.groups[1:-1])
        edges = published.Edges(
            (own.feet(points[:left]), own.feet(points[left:])),
            (
                published.by_row(np.concatenate(parts[0::2])),
                published.by_row(np.concatenate(parts[1::2])),
            ),
            (task.start.width_px, task.start.height_px),
        )
        start, focal_px = published.start_of(task.prior_mean)
        parameters, _ = published.nelder_mead(edges, start, focal_px, number)
        found.append(published.pose_in(own, parameters)["heading_deg"])
    return found


def _right(bed: RoadBed, headings_deg: Sequence[float]) -> float:
    """Share of the images whose heading is right."""
    truth = [pose.heading_deg for pose in bed.truth[: len(headings_deg)]]
    return float(np.mean(np.abs(wrap_deg(np.subtract(headings_deg, truth))) <= YAW_DEG))
