"""Accuracies that a user cares about, read from a site's finished results.

Each list of jobs looks up what there is to measure, and needs none of the modules that measure it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
import shapely

from roadsight.io.records.atomic import read_json
from roadsight.io.records.tables import read_table

if TYPE_CHECKING:  # slow to load
    from roadsight.evidence.placement_metrics import Results

_MATCH_M = 3  # Threshold of the validation (a row of its table) at which poles count as found.
_STEP_M = 1.0  # Spacing of the places on true edges that are compared with found ones.


@dataclass(frozen=True)
class Metric:
    """One accuracy.

    Parameters
    ----------
    title, unit : for people. job : job whose results it reads.
    ideal : value of a perfect result, or None where a study's reference level says it.
    reference : what it is compared with, for people. value : reads it.
    targets : results that it reads, below ``results/<site>``; ``{plan}`` is replaced.
    against : where ``value`` reads something that means little by itself, the number that follows
        from it and the same of the study's reference level.
    default_targets : whether its truth is of targets as the settings have them by default.
    depth_maps : whether it reads depth maps of a spinning LiDAR as mounted.
    """

    title: str
    unit: str
    job: str
    ideal: float | None
    reference: str
    value: Callable[[Results], Any]
    targets: tuple[str, ...]
    against: Callable[[Any, Any], float] | None = None
    default_targets: bool = False
    depth_maps: bool = False

    @property
    def needs_reference(self) -> bool:
        """Whether a study must name its reference level."""
        return self.ideal is None or self.against is not None


def _edge_error_m(results: Results) -> float:
    """Median distance from the road's true edges to the nearest found edge point."""
    from roadsight.io.vector.vectors import read_layer  # noqa: PLC0415  # slow to load

    edges = read_layer(results.folder / "sample/truth.gpkg", "edges", results.frame)
    places = [line.interpolate(np.arange(0.0, line.length, _STEP_M)) for line in edges.geometry]
    found = read_table(results.folder / "poles/road_edges.parquet")
    tree = shapely.STRtree(shapely.points(found[["x", "y"]].to_numpy()))
    true = np.concatenate(places)
    _, distance = tree.query_nearest(true, return_distance=True, all_matches=False)
    return float(np.median(distance))


def _edge_points(results: Results) -> float:
    return float(len(read_table(results.folder / "poles/road_edges.parquet")))


def _pole_error_m(results: Results) -> float:
    """Mean geodesic error of the poles that match a known one; NaN without any."""
    mean = read_json(results.folder / "poles/validation.json")["mean_m"]
    return float("nan") if mean is None else float(mean)


def _at_match(results: Results) -> dict:
    rows = read_json(results.folder / "poles/validation.json")["thresholds"]
    return dict(next(row for row in rows if row["threshold_m"] == _MATCH_M))


def _missed_poles(results: Results) -> float:
    return float(_at_match(results)["fn"])


def _false_poles(results: Results) -> float:
    return float(_at_match(results)["fp"])


def _heading_error_deg(results: Results) -> float:
    """90th percentile of the heading error of accepted images; NaN without any."""
    spread = read_json(results.folder / "poles/camera_scores.json")["errors"]["yaw_deg"]
    return float("nan") if spread is None else float(spread["p90_abs"])


def _images_wrong(results: Results) -> float:
    """Share of the images that are not placed within 0.1 degrees and 2 px."""
    share = read_json(results.folder / "poles/camera_scores.json")["share_of_images_within_limits"]
    return 1.0 - float(share or 0.0)


def _images_with_fewer_poles(results: Results) -> float:
    """Share of the images that show fewer poles than at the base settings."""
    base = replace(results, folder=results.base)
    counts = [
        part.tables("poles/sightings/*.parquet").query("kept").groupby("image").size()
        for part in (base, results)
    ]
    before, after = counts[0].align(counts[1], fill_value=0)
    images = len(read_table(results.folder / "poles/frames.parquet")["image"].unique())
    return float((after < before).sum() / images)


def _pole_sightings(results: Results) -> float:
    return float(results.tables("poles/sightings/*.parquet")["kept"].sum())


_EXACT = "exact truth of the generated scene"  # What a measure is compared with.
_FINEST = "the study's reference level"  # What a measure without a truth is compared with.
# Files, below a site's results, that measures read.
_PLAN = ("placement/{plan}/solution.json",)
_DATA = ("placement/{plan}/data.json",)
_VALIDATION = ("poles/validation.json",)
_CAMERAS = ("poles/camera_scores.json",)
_EDGES = ("poles/road_edges.parquet",)


def _placement(
    name: str,
    title: str,
    unit: str = "share",
    ideal: float | None = 0.0,
    reference: str = _EXACT,
    targets: tuple[str, ...] = _PLAN,
    value: str = "",
    **more: Any,
) -> tuple[str, Metric]:
    """Accuracy of the placement job, by a function of `placement_metrics` of this name."""
    reads = partial(_value, value or name)
    return name, Metric(title, unit, "placement", ideal, reference, reads, targets, **more)


def _value(name: str, *results: Any) -> Any:
    from roadsight.evidence import placement_metrics  # noqa: PLC0415  # slow to load

    return getattr(placement_metrics, name)(*results)


_PLACEMENT = (
    _placement("dem_rmse_m", "Height error of the road", "m", targets=("scene/dem.tif",)),
    _placement(
        "pavement_f1",
        "F1 score of the pavement",
        "1",
        ideal=1.0,
        targets=("scene/pavement_scores.json",),
    ),
    _placement("beams_wrong", "Beams wrong by more than 0.5 m", depth_maps=True),
    _placement(
        "detections_wrong",
        "Decisions on targets that are wrong",
        default_targets=True,
        depth_maps=True,
    ),
    _placement(
        "detections_false",
        "False detections, of hidden targets",
        default_targets=True,
        depth_maps=True,
    ),
    _placement(
        "targets_lost", "Claimed targets that the sensors do not see in truth", default_targets=True
    ),
    _placement("sensors", "Sensors needed", "count", ideal=None, reference=_FINEST),
    _placement("range_rmse_m", "Root mean square error of ranges", "m", depth_maps=True),
    _placement(
        "baseline_distance_m",
        "Mean distance of sensors to those of the reference",
        "m",
        reference=_FINEST,
        value="sensor_positions_m",
        against=partial(_value, "mean_distance_m"),
    ),
    _placement("uncovered", "Targets that no candidate sees", ideal=None, reference=_FINEST),
    _placement("plan_cost", "Cost of the sensors", "cost", ideal=None, reference=_FINEST),
    _placement("unseen", "Targets that the plan leaves unseen", reference="all targets"),
    _placement(
        "road_unclaimed",
        "Road that the plan does not claim to cover",
        reference="the exact carriageways",
    ),
    _placement(
        "road_unseen", "Road that the plan's sensors do not see in truth", default_targets=True
    ),
    _placement(
        "lost_to_a_failure", "Targets lost when the worst sensor fails", reference="all targets"
    ),
    _placement(
        "lost_if_dark",
        "Seen targets lost if they are dark (10 %)",
        reference="the plan's own detections",
        targets=_DATA,
    ),
    _placement(
        "lost_if_shorter",
        "Seen targets lost with a third less range",
        reference="the plan's own detections",
        targets=_DATA,
    ),
)
METRICS: dict[str, Metric] = {
    **dict(_PLACEMENT),
    "edge_error_m": Metric(
        "Distance of found from true road edges", "m", "poles", 0.0, _EXACT, _edge_error_m, _EDGES
    ),
    "edge_points": Metric(
        "Road edge points", "count", "poles", None, _FINEST, _edge_points, _EDGES
    ),
    "pole_error_m": Metric(
        "Mean error of located poles", "m", "poles", 0.0, _EXACT, _pole_error_m, _VALIDATION
    ),
    "missed_poles": Metric(
        "Poles missed", "count", "poles", 0.0, _EXACT, _missed_poles, _VALIDATION
    ),
    "false_poles": Metric(
        "False positives among poles", "count", "poles", 0.0, _EXACT, _false_poles, _VALIDATION
    ),
    "heading_error_deg": Metric(
        "Heading error, 90th percentile", "deg", "poles", 0.0, _EXACT, _heading_error_deg, _CAMERAS
    ),
    "images_wrong": Metric(
        "Images off by more than 0.1 degrees or 2 px",
        "share",
        "poles",
        0.0,
        _EXACT,
        _images_wrong,
        _CAMERAS,
    ),
    "pole_sightings": Metric(
        "Sightings of poles", "count", "poles", None, _FINEST, _pole_sightings, _VALIDATION
    ),
    "images_with_fewer_poles": Metric(
        "Images that show fewer poles than at the base settings",
        "share",
        "poles",
        0.0,
        "the same images at the base settings",
        _images_with_fewer_poles,
        _VALIDATION,
    ),
}
