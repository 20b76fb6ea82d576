"""Accuracies that a user cares about, read from a site's finished results."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import shapely

from roadsight.evidence.exact_highway import ExactHighway
from roadsight.evidence.posed_truth import sees_in_pose
from roadsight.geometry.frames import Frame
from roadsight.io.atomic import read_json
from roadsight.io.depth_maps import DepthMaps
from roadsight.io.detections import read_detections
from roadsight.io.poses import read_poses
from roadsight.io.rasters import read_raster
from roadsight.io.tables import read_table
from roadsight.io.vectors import read_layer
from roadsight.placement.sensors import Sensor

_MATCH_M = 3
_MAPS = 6
_STEP_M = 1.0


@dataclass(frozen=True)
class Results:
    """Finished results of a site, and of the same site at its base settings.

    Parameters
    ----------
    folder, base : ``results/<site>`` of the two. seed, length_m : of the generated scene.
    plan : the plan that is looked at. sensors : definitions of its sensors. stride : only every
        so many of their azimuths are simulated.
    """

    folder: Path
    base: Path
    seed: int
    length_m: float
    plan: str
    sensors: dict[str, Sensor]
    stride: int = 1

    @property
    def frame(self) -> Frame:
        """Local frame."""
        return Frame.from_dict(read_json(self.folder / "scene/frame.json"))

    @property
    def scene(self) -> ExactHighway:
        """The exact scene."""
        return ExactHighway(self.seed, self.length_m, self.frame)

    def tables(self, pattern: str) -> pd.DataFrame:
        """Tables whose names match a pattern, one below the other."""
        return pd.concat([read_table(path) for path in sorted(self.folder.glob(pattern))])


@dataclass(frozen=True)
class Metric:
    """One accuracy.

    Parameters
    ----------
    title, unit : for people. job : job whose results it reads.
    ideal : value of a perfect result, or None where a study's reference level says it.
    reference : what it is compared with, for people. value : reads it.
    targets : results that it reads, below ``results/<site>``; ``{plan}`` is replaced.
    """

    title: str
    unit: str
    job: str
    ideal: float | None
    reference: str
    value: Callable[[Results], float]
    targets: tuple[str, ...]


def _dem_rmse_m(results: Results) -> float:
    """Root mean square height error of the terrain model on the carriageways."""
    raster = read_raster(results.folder / "scene/dem.tif", results.frame)
    xy_m, height_m = results.scene.road_heights(_STEP_M)
    error = raster.sample(*xy_m.T) - height_m
    return float(np.sqrt(np.mean(error[np.isfinite(error)] ** 2)))


def _pavement_f1(results: Results) -> float:
    return float(read_json(results.folder / "scene/pavement_scores.json")["f1"])


def _beams_wrong(results: Results) -> float:
    """Share of beams more than 0.5 m off, or that return where nothing is, or the reverse."""
    (name, sensor), *_ = results.sensors.items()
    folder = results.folder / "placement/round-0"
    poses = read_poses(folder / "candidates.parquet")
    files = sorted((folder / "depth" / name).iterdir())
    maps = _spread([pair for path in files for pair in DepthMaps(path)])
    scene, simulated = results.scene, sensor.thinned(results.stride)
    shares = [
        scene.share_wrong(range_m, simulated, poses[candidate][:3], float(poses[candidate][3]))
        for candidate, range_m in maps
    ]
    return float(np.mean(shares))


def _detections_wrong(results: Results) -> float:
    """Pairs of candidate and target that are wrongly seen or unseen, over those truly seen."""
    (name, sensor), *_ = results.sensors.items()
    folder = results.folder / "placement/round-0"
    poses = read_poses(folder / "candidates.parquet")
    targets = read_table(results.folder / "placement/targets.parquet")
    found = read_detections(sorted((folder / "detection" / name).iterdir()))
    feet_m = targets[["x", "y", "z"]].to_numpy(np.float64)
    scene, wrong, seen = results.scene, 0, 0
    for candidate, pose in _spread(list(poses.items())):
        exact = scene.sees(sensor, pose[:3], float(pose[3]), feet_m)
        ours = targets["target"].isin(found.loc[found["candidate"] == candidate, "target"])
        wrong, seen = wrong + int((exact != ours).sum()), seen + int(exact.sum())
    return wrong / seen if seen else float("nan")


def _spread(items: list[Any]) -> list[Any]:
    """A few of them, evenly spread."""
    rows = np.linspace(0, len(items) - 1, min(_MAPS, len(items))).round().astype(int)
    return [items[row] for row in rows]


def _targets_lost(results: Results) -> float:
    """Share of the targets said to be covered that the chosen sensors do not see in truth."""
    solution = _solution(results)
    targets = read_table(results.folder / "placement/targets.parquet")
    claimed = targets[~targets["target"].isin(solution["excluded"])]
    feet_m = claimed[["x", "y", "z"]].to_numpy(np.float64)
    scene, seen = results.scene, np.zeros(len(feet_m), bool)
    for chosen in solution["sensors"]:
        sensor = results.sensors[chosen["sensor"]]
        if "pitch_deg" in chosen:
            seen |= sees_in_pose(scene, sensor, chosen, feet_m)
            continue
        position_m = np.array([chosen[axis] for axis in "xyz"])
        seen |= scene.sees(sensor, position_m, float(chosen["yaw_deg"]), feet_m)
    return float(1 - seen.mean())


def _sensors(results: Results) -> float:
    return float(len(_solution(results)["sensors"]))


def _uncovered(results: Results) -> float:
    """Share of the targets that no candidate sees."""
    solution = _solution(results)
    return float(solution["uncoverable_targets"] / solution["targets"])


def _solution(results: Results) -> dict:
    return dict(read_json(results.folder / "placement" / results.plan / "solution.json"))


def _edge_error_m(results: Results) -> float:
    """Median distance from the road's true edges to the nearest found edge point."""
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
    base = Results(results.base, results.base, results.seed, results.length_m, "", {})
    counts = [
        part.tables("poles/sightings/*.parquet").query("kept").groupby("image").size()
        for part in (base, results)
    ]
    before, after = counts[0].align(counts[1], fill_value=0)
    images = len(read_table(results.folder / "poles/frames.parquet")["image"].unique())
    return float((after < before).sum() / images)


def _pole_sightings(results: Results) -> float:
    return float(results.tables("poles/sightings/*.parquet")["kept"].sum())


_EXACT = "exact truth of the generated scene"
_FINEST = "the study's reference level"
_PLAN = ("placement/{plan}/solution.json",)
_VALIDATION = ("poles/validation.json",)
_CAMERAS = ("poles/camera_scores.json",)

METRICS: dict[str, Metric] = {
    "dem_rmse_m": Metric(
        "Height error of the road", "m", "placement", 0.0, _EXACT, _dem_rmse_m, ("scene/dem.tif",)
    ),
    "pavement_f1": Metric(
        "F1 score of the pavement", "1", "placement", 1.0, _EXACT, _pavement_f1,
        ("scene/pavement_scores.json",),
    ),
    "beams_wrong": Metric(
        "Beams wrong by more than 0.5 m", "share", "placement", 0.0, _EXACT, _beams_wrong, _PLAN
    ),
    "detections_wrong": Metric(
        "Decisions on targets that are wrong", "share", "placement", 0.0, _EXACT,
        _detections_wrong, _PLAN,
    ),
    "targets_lost": Metric(
        "Targets said to be seen that are not", "share", "placement", 0.0, _EXACT, _targets_lost,
        _PLAN,
    ),
    "sensors": Metric("Sensors needed", "count", "placement", None, _FINEST, _sensors, _PLAN),
    "uncovered": Metric(
        "Targets that no candidate sees", "share", "placement", None, _FINEST, _uncovered, _PLAN
    ),
    "edge_error_m": Metric(
        "Distance of found from true road edges", "m", "poles", 0.0, _EXACT, _edge_error_m,
        ("poles/road_edges.parquet",),
    ),
    "edge_points": Metric(
        "Road edge points", "count", "poles", None, _FINEST, _edge_points,
        ("poles/road_edges.parquet",),
    ),
    "pole_error_m": Metric(
        "Mean error of located poles", "m", "poles", 0.0, _EXACT, _pole_error_m, _VALIDATION
    ),
    "missed_poles": Metric(
        "Poles missed", "count", "poles", 0.0, _EXACT, _missed_poles, _VALIDATION
    ),
    "false_poles": Metric(
        "Poles that are none", "count", "poles", 0.0, _EXACT, _false_poles, _VALIDATION
    ),
    "heading_error_deg": Metric(
        "Heading error, 90th percentile", "deg", "poles", 0.0, _EXACT, _heading_error_deg, _CAMERAS
    ),
    "images_wrong": Metric(
        "Images off by more than 0.1 degrees or 2 px", "share", "poles", 0.0, _EXACT,
        _images_wrong, _CAMERAS,
    ),
    "pole_sightings": Metric(
        "Sightings of poles", "count", "poles", None, _FINEST, _pole_sightings, _VALIDATION
    ),
    "images_with_fewer_poles": Metric(
        "Images that show fewer poles than at the base settings", "share", "poles", 0.0,
        "the same images at the base settings", _images_with_fewer_poles, _VALIDATION,
    ),
}  # fmt: skip
