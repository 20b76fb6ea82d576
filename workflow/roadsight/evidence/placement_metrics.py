"""Accuracies of the placement job, and the finished results that they are read from."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from scipy.spatial import cKDTree

from roadsight.base.arrays import Bools, Floats, Floats32
from roadsight.base.errors import InputError
from roadsight.base.sections.run import Sample
from roadsight.base.sections.sensing import Targets
from roadsight.config.schema import Settings
from roadsight.evidence.exact_highway import ExactHighway, sees_in_pose, share_wrong
from roadsight.evidence.paper import mean_distance_m  # noqa: F401  # a metric by its name
from roadsight.geometry.frames import Frame
from roadsight.io.raster.rasters import read_raster
from roadsight.io.records.atomic import read_json
from roadsight.io.records.depth_maps import DepthMaps
from roadsight.io.records.placement_tables import read_detections, read_poses
from roadsight.io.records.tables import read_table
from roadsight.placement.sensors.sensors import AnySensor, Sensor
from roadsight.placement.sight.kinds import room_for, shape_of
from roadsight.placement.sight.sight import beams_wanted
from roadsight_worlds.highway.highway import build_highway

_MAPS = 6  # Depth maps that are compared with exact ones; more would take longer to cast.
_STEP_M = 1.0  # Spacing of the places on the road where heights and coverage are compared.
# A target stands on the road when it is no farther above or below it: bridges clear 4 m.
_SAME_SURFACE_M = 1.0


@dataclass(frozen=True)
class Results:
    """Finished results of a site, and of the same site at its base settings.

    Parameters
    ----------
    folder, base : ``results/<site>`` of the two. settings : of the first.
    sample : the generated scene. plan : the plan that is looked at.
    sensors : definitions of its sensors, of all kinds.
    """

    folder: Path
    base: Path
    settings: Settings
    sample: Sample
    plan: str
    sensors: dict[str, AnySensor]

    @property
    def frame(self) -> Frame:
        """Local frame."""
        return Frame.from_dict(read_json(self.folder / "scene/frame.json"))

    @cached_property
    def scene(self) -> ExactHighway:
        """The exact scene."""
        own = self.sample
        highway = build_highway(
            self.settings.seed, own.length_m, own.radius_m, own.grade, own.tunnel, own.overhead
        )
        return ExactHighway(highway, self.frame)

    def tables(self, pattern: str) -> pd.DataFrame:
        """Tables whose names match a pattern, one below the other."""
        return pd.concat([read_table(path) for path in sorted(self.folder.glob(pattern))])


def dem_rmse_m(results: Results) -> float:
    """Root mean square height error of the terrain model on the carriageways."""
    raster = read_raster(results.folder / "scene/dem.tif", results.frame)
    xy_m, height_m = results.scene.road_heights(_STEP_M)
    error = raster.sample(*xy_m.T) - height_m
    return float(np.sqrt(np.mean(error[np.isfinite(error)] ** 2)))


def pavement_f1(results: Results) -> float:
    """F1 score of the pavement's area."""
    return float(read_json(results.folder / "scene/pavement_scores.json")["f1"])


def beams_wrong(results: Results) -> float:
    """Share of beams more than 0.5 m off, or that return where nothing is, or the reverse."""
    return float(np.mean([share_wrong(*pair) for pair in maps(results)]))


def range_rmse_m(results: Results) -> float:
    """Root mean square error of the ranges of beams that return both in truth and in the maps."""
    errors_m = [
        (range_m - exact_m)[(range_m > 0) & (exact_m > 0)].astype(np.float64)
        for range_m, exact_m in maps(results)
    ]
    return float(np.sqrt(np.mean(np.concatenate(errors_m) ** 2)))


def maps(results: Results) -> Iterator[tuple[Floats32, Floats32]]:
    """Beams (n,) of a few depth maps of the first spinning sensor, and the exact ones.

    Of every model those beams count that may meet a target: half of the others look into the sky,
    where any model is right.
    """
    name, sensor = _spinning(results)
    folder = results.folder / "placement/round-0"
    poses = read_poses(folder / "candidates.parquet")
    files = sorted((folder / "depth" / name).iterdir())
    targets = read_table(results.folder / "placement/targets.parquet")
    feet_m = targets[["x", "y", "z"]].to_numpy(np.float64)
    room_m = room_for(shape_of(Targets().model_dump()))
    scene, simulated = results.scene, sensor.thinned(results.settings.lidar.azimuth_stride)
    for candidate, range_m in _spread([pair for path in files for pair in DepthMaps(path)]):
        pose = poses[candidate]
        place = pose[:3], float(pose[3])
        wanted = beams_wanted(simulated, *place, feet_m, room_m)
        yield range_m[wanted], scene.depth_map(simulated, *place)[wanted]


def detections_wrong(results: Results) -> float:
    """Pairs of candidate and target that are wrongly seen or unseen, over those truly seen."""
    ours, exact = _decisions(results)
    return float((ours != exact).sum() / exact.sum()) if exact.any() else float("nan")


def detections_false(results: Results) -> float:
    """Share of the pairs said to be seen that are hidden in truth; NaN if none is said to be."""
    ours, exact = _decisions(results)
    return float(1 - exact[ours].mean()) if ours.any() else float("nan")


def _decisions(results: Results) -> tuple[Bools, Bools]:
    """Whether a few candidates see each target (candidates, targets): as detected, and in truth."""
    name, sensor = _spinning(results)
    folder = results.folder / "placement/round-0"
    poses = read_poses(folder / "candidates.parquet")
    targets = read_table(results.folder / "placement/targets.parquet")
    found = read_detections(sorted((folder / "detection" / name).iterdir()))
    feet_m, scene = targets[["x", "y", "z"]].to_numpy(np.float64), results.scene
    ours, exact = [], []
    for candidate, pose in _spread(list(poses.items())):
        own = found.loc[found["candidate"] == candidate, "target"]
        ours.append(targets["target"].isin(own).to_numpy())
        exact.append(scene.sees(sensor, pose[:3], float(pose[3]), feet_m))
    return np.array(ours), np.array(exact)


def _spinning(results: Results) -> tuple[str, Sensor]:
    """The first sensor of the plan that has depth maps of its own."""
    return next(
        (name, sensor) for name, sensor in results.sensors.items() if isinstance(sensor, Sensor)
    )


def _spread(items: list[Any]) -> list[Any]:
    """A few of them, evenly spread."""
    rows = np.linspace(0, len(items) - 1, min(_MAPS, len(items))).round().astype(int)
    return [items[row] for row in rows]


def targets_lost(results: Results) -> float:
    """Share of the targets said to be covered that the chosen sensors do not see in truth."""
    solution = _solution(results)
    feet_m = _claimed(results, solution)[["x", "y", "z"]].to_numpy(np.float64)
    return float(1 - _seen_in_truth(results, solution, feet_m).mean())


def road_unseen(results: Results) -> float:
    """Share of the carriageways, in cells of 1 m, where the sensors do not see a target in truth.

    Carriageways are the same at any density of the cloud; targets are only where a pavement was
    found.
    """
    xy_m, height_m = results.scene.road_heights(_STEP_M)
    feet_m = np.column_stack([xy_m, height_m])
    return float(1 - _seen_in_truth(results, _solution(results), feet_m).mean())


def road_unclaimed(results: Results) -> float:
    """Share of the same cells that lie in the cell of no target said to be covered.

    A target on what spans the road, such as a tunnel's roof, claims nothing below it.
    """
    claimed = _claimed(results, _solution(results))[["x", "y", "z"]].to_numpy(np.float64)
    xy_m, height_m = results.scene.road_heights(_STEP_M)
    if not len(claimed):
        return 1.0
    away_m, nearest = cKDTree(claimed[:, :2]).query(xy_m)
    # Half the diagonal of a target's cell: the two grids are turned against each other.
    half_m = results.settings.targets.cell_size_m * np.sqrt(0.5)
    above = np.abs(claimed[nearest, 2] - height_m) > _SAME_SURFACE_M
    return float((above | (away_m > half_m)).mean())


def _claimed(results: Results, solution: dict) -> pd.DataFrame:
    """Targets that the plan says are covered; one with a budget or prices does not list them."""
    targets = read_table(results.folder / "placement/targets.parquet")
    claimed = targets[~targets["target"].isin(solution["excluded"])]
    if len(claimed) != solution["covered_targets"]:
        raise InputError(
            "leaves targets unseen that candidates see, and does not list what it claims to cover",
            where=f"plan {results.plan}",
            found=f"{solution['covered_targets']} of {len(claimed)} targets",
            hint="measure unseen or road_unseen instead",
        )
    return claimed


def _seen_in_truth(results: Results, solution: dict, feet_m: Floats) -> Bools:
    """Whether any chosen sensor sees a default target at each foot (n, 3) in the exact scene."""
    scene, seen = results.scene, np.zeros(len(feet_m), bool)
    for chosen in solution["sensors"]:
        sensor = results.sensors[chosen["sensor"]]
        if isinstance(sensor, Sensor) and "pitch_deg" not in chosen:
            position_m = np.array([chosen[axis] for axis in "xyz"])
            seen |= scene.sees(sensor, position_m, float(chosen["yaw_deg"]), feet_m)
        else:
            seen |= sees_in_pose(scene, sensor, chosen, feet_m)
    return seen


def sensors(results: Results) -> float:
    """Number of sensors of the plan."""
    return float(len(_solution(results)["sensors"]))


def plan_cost(results: Results) -> float:
    """What the sensors of the plan cost, in their unit of cost."""
    return float(sum(results.sensors[one["sensor"]].cost for one in _solution(results)["sensors"]))


def unseen(results: Results) -> float:
    """Share of all targets that the sensors of the plan do not see."""
    solution = _solution(results)
    return 1.0 - float(solution["covered_targets"] / solution["targets"])


def lost_to_a_failure(results: Results) -> float:
    """Share of all targets that only one sensor sees, of the one whose failure costs most."""
    solution = _solution(results)
    return max((one["only"] for one in solution["sensors"]), default=0) / solution["targets"]


def lost_if_dark(results: Results) -> float:
    """Share of the seen targets that the plan would lose if they reflected 10 %."""
    return float(_data(results)["margins"]["dark"]["share"])


def lost_if_shorter(results: Results) -> float:
    """Share of the seen targets that the plan would lose with a third less range."""
    return float(_data(results)["margins"]["shorter"]["share"])


def _data(results: Results) -> dict:
    return dict(read_json(results.folder / "placement" / results.plan / "data.json"))


def sensor_positions_m(results: Results) -> list[list[float]]:
    """Where the chosen sensors stand, local metres."""
    return [[float(one[axis]) for axis in "xyz"] for one in _solution(results)["sensors"]]


def uncovered(results: Results) -> float:
    """Share of the targets that no candidate sees."""
    solution = _solution(results)
    return float(solution["uncoverable_targets"] / solution["targets"])


def _solution(results: Results) -> dict:
    return dict(read_json(results.folder / "placement" / results.plan / "solution.json"))
