"""Everything that the page shows of one site, as JSON content (``page.json``)."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import geopandas as gpd
import numpy as np
import pandas as pd
import shapely
from numpy.typing import NDArray
from scipy import sparse

from roadsight.base.arrays import Ints
from roadsight.geometry.frames import Frame
from roadsight.geometry.north import bearing_deg, longitudes_latitudes
from roadsight.placement.sight.detection import detection_matrix
from roadsight.report.packing import pack, pack_points
from roadsight.report.site.backdrops import Backdrop
from roadsight.report.site.cautions import (
    data_cautions,
    is_proven,
    page_cautions,
    plan_cautions,
    scene_cautions,
    told_cautions,
)
from roadsight.report.site.layers import (
    CloudSample,
    candidate_layer,
    cloud_layer,
    edge_layer,
    polygon_layer,
    relief_layer,
    target_layer,
)
from roadsight.report.site.options_view import goal_proven, lost_classes

FORMAT = "roadsight.page/2"  # Of the page's content; the report refuses others
# Borders of the classes of the share of the time in sight, one fewer than the map has colours
IN_SIGHT = (0.5, 0.8, 0.9, 0.95)
_MOST_OBSTACLES = 300  # Obstacles in the page: those that block most
_OPTIONAL = ("cost", "loses", "mandatory", "pole")
_POSE = ("position", "pitch_deg", "roll_deg")


@dataclass(frozen=True)
class Relief:
    """Terrain model, local metres; first row north, NaN = no data."""

    heights_m: NDArray
    west_m: float
    north_m: float
    cell_size_m: float


@dataclass(frozen=True)
class Scene:
    """What every site has.

    Parameters
    ----------
    about : content of frame.json.
    cloud : sample of the cloud. relief : terrain model.
    pavement : polygons, edges : lines with edge, kind, source; local metres.
    below : pictures that the map may lie on, by name, the best first.
    """

    about: dict[str, Any]
    cloud: CloudSample
    relief: Relief
    pavement: gpd.GeoDataFrame
    edges: gpd.GeoDataFrame
    below: Mapping[str, Backdrop] = field(default_factory=dict)

    @property
    def frame(self) -> Frame:
        """The site's local frame."""
        return Frame.from_dict(self.about)


@dataclass(frozen=True)
class PlanResult:
    """One solved plan.

    Parameters
    ----------
    title : name for people. solution : content of solution.json.
    uncovered : names of the targets that no candidate of the plan sees.
    explained, obstacles : as `gaps_of` and `obstacles_of` take them; of the obstacles, the greatest
        first, the page keeps 300.
    returns_xyz_m, returns_sensor : (n, 3) and (n,) sample of what the sensors would see, and the
        number of the sensor, from 0.
    in_sight : (n,) share of the time in which each target is in sight, None without traffic.
    lost_share : (n,) share of the changes of a sensor that lose each target.
    """

    title: str
    solution: dict[str, Any]
    uncovered: Sequence[str]
    explained: pd.DataFrame
    obstacles: gpd.GeoDataFrame
    returns_xyz_m: NDArray
    returns_sensor: NDArray
    in_sight: NDArray | None
    lost_share: NDArray | None = None


@dataclass(frozen=True)
class Placement:
    """What a site with the placement job has.

    Parameters
    ----------
    targets : columns target, x, y, z. rounds : candidates of each round.
    detections : columns sensor, candidate, target of the chosen sensors at least.
    sensors : definitions by name of the sensors that plans may use. plans : solved plans, in order.
    unexamined : polygons of the pavement that no target stands for.
    """

    targets: pd.DataFrame
    rounds: Sequence[pd.DataFrame]
    detections: pd.DataFrame
    sensors: dict[str, dict[str, Any]]
    plans: Sequence[PlanResult]
    unexamined: gpd.GeoDataFrame | None = None


def build_page(
    title: str, summary: dict[str, Any], scene: Scene, placement: Placement | None
) -> dict[str, Any]:
    """Content of ``page.json``.

    Parameters
    ----------
    summary : content of summary.json.
    placement : None for a site that asks only for its scene.
    """
    layers = {
        "cloud": cloud_layer(scene.cloud),
        "relief": relief_layer(**vars(scene.relief)),
        "pavement": polygon_layer(scene.pavement),
        "edges": edge_layer(scene.edges),
        "below": {name: picture.packed() for name, picture in scene.below.items()},
    }
    plans = []
    if placement is not None:
        layers["candidates"] = candidate_layer(placement.rounds)
        layers["targets"] = target_layer(placement.targets)
        if placement.unexamined is not None:
            layers["unexamined"] = polygon_layer(placement.unexamined)
        results = summary["placement"]
        plans = [
            _plan(plan, placement, scene, results[plan.solution["plan"]])
            for plan in placement.plans
        ]
    return {
        "format": FORMAT,
        "title": title,
        "summary": summary,
        "frame": scene.about,
        "pavement_area_m2": float(scene.pavement.geometry.area.sum()),
        "sensors": {} if placement is None else placement.sensors,
        "layers": layers,
        "plans": plans,
        "cautions": _cautions(summary, scene, placement, plans),
    }


def _plan(
    plan: PlanResult, placement: Placement, scene: Scene, result: dict[str, Any]
) -> dict[str, Any]:
    """One plan's result with what its sensors see."""
    solution, frame = plan.solution, scene.frame
    sights = sights_of(solution["sensors"], placement.detections, placement.targets)
    costs = [placement.sensors[name]["cost"] for name in solution["sensor_types"]]
    at_least = int(solution["at_least"])
    kept = ("sensor_types", "status", "objective", "bound", "gap", "reductions")
    options = solution.get("options")
    # Masts and cables may cost a part of a sensor.
    costs += [entry["cost"] for entry in solution["sensors"] if "cost" in entry]
    whole = all(float(cost).is_integer() for cost in costs)
    if options is None:
        proven = is_proven(solution["status"], solution["objective"], solution["bound"], whole)
    else:
        proven = goal_proven(options["goal"], solution["status"])
    needs = {} if options is None else options["needs"]
    needed = [needs.get(str(name), at_least) for name in placement.targets["target"]]
    area_m2, proven_for = solution.get("proven_area_m2"), {}
    if area_m2 is not None:
        whole_m2 = float(scene.pavement.geometry.area.sum())
        share = min(area_m2 / whole_m2, 1.0) if whole_m2 > 0 else 0.0
        proven_for = {"proven_area_m2": area_m2, "proven_share": share}
    in_sight = {}
    if plan.in_sight is not None:
        classes = np.searchsorted(IN_SIGHT, plan.in_sight, side="right")
        counts = np.bincount(classes, minlength=len(IN_SIGHT) + 1).tolist()
        in_sight = {"in_sight": pack(classes, "u1"), "in_sight_counts": counts}
    return {
        "name": solution["plan"],
        "title": plan.title,
        **{key: solution[key] for key in kept},
        **{key: solution[key] for key in ("second", "availability") if key in solution},
        **{key: result[key] for key in ("data", "tolerance") if key in result},
        **({} if options is None else {"options": options}),
        "seconds_cpu": result["seconds_cpu"],
        "at_least": at_least,
        "proven": proven,
        **proven_for,
        "targets": len(placement.targets),
        "excluded": len(solution["excluded"]),
        "sensors": _sensors(solution["sensors"], sights, frame),
        "seen": [pack(sights.seen_by(n), "u4") for n in range(len(solution["sensors"]))],
        "histogram": sights.histogram.tolist(),
        **in_sight,
        "objects": objects_in_the_way(result.get("objects", []), result.get("removals", [])),
        **({} if plan.lost_share is None else lost_classes(plan.lost_share)),
        "gaps": gaps_of(
            placement.targets,
            sights.times_seen,
            np.array(needed, np.int64),
            frozenset(plan.uncovered),
            plan.explained,
        ),
        "obstacles": obstacles_of(plan.obstacles.iloc[:_MOST_OBSTACLES]),
        "all_obstacles": len(plan.obstacles),
        "returns": {**pack_points(plan.returns_xyz_m), "sensor": pack(plan.returns_sensor, "u2")},
    }


def _sensors(sensors: list[dict[str, Any]], sights: Sights, frame: Frame) -> list[dict[str, Any]]:
    """Chosen sensors in the solution's order, numbered from 1."""
    xyz = np.array([[entry[axis] for axis in "xyz"] for entry in sensors]).reshape(-1, 3)
    degrees = longitudes_latitudes(frame, xyz[:, :2])
    kept = ("candidate", "sensor", "x", "y", "z", "height_m", "yaw_deg", "edge")
    return [
        {
            **{key: entry[key] for key in kept},
            **{key: entry[key] for key in (*_POSE, *_OPTIONAL) if key in entry},
            "number": number + 1,
            "bearing_deg": bearing_deg(entry["yaw_deg"]),
            "native": frame.to_native(xyz[number]).tolist(),
            "lon_lat_deg": None if degrees is None else degrees[number].tolist(),
            **sights.figures(number),
        }
        for number, entry in enumerate(sensors)
    ]


def _cautions(
    summary: dict[str, Any], scene: Scene, placement: Placement | None, plans: list[dict[str, Any]]
) -> list[dict[str, str]]:
    targets = positions = None
    if placement is not None:
        targets = len(placement.targets)
        positions = len(pd.unique(pd.concat([table["key"] for table in placement.rounds])))
    area_m2 = float(scene.pavement.geometry.area.sum())
    warnings, notes = told_cautions(summary.get("warnings", []))
    examined_m2 = None
    if placement is not None and "area_m2" in placement.targets:
        examined_m2 = float(placement.targets["area_m2"].sum())
    warnings += plan_cautions(plans)
    warnings += data_cautions(targets, positions, area_m2, summary["settings"], examined_m2)
    notes += scene_cautions(
        scene.about,
        summary["scene"].get("pavement_scores") is not None,
        summary["scene"].get("traffic"),
        set(scene.edges["source"]),
        {} if placement is None else placement.sensors,
    )
    return page_cautions(warnings, notes)


# Targets that a plan leaves out, why, and what stands in the way (paper 1, Appendix B).

OUT_OF_SIGHT = "no candidate sees it"
NOT_CHOSEN = "candidates see it, the chosen sensors do not"
TOO_FEW = "fewer sensors see it than asked for"
_TEXTS = ("kind", "target", "candidate")
_NUMBERS = ("height_m", "targets", "sensors", "sight_lines")
_DETAILS = ("nearest_m", "blocked_share", "obstacle_x", "obstacle_y")


def gaps_of(
    targets: pd.DataFrame,
    times_seen: NDArray,
    needed: NDArray | int,
    uncovered: Collection[str],
    explained: pd.DataFrame,
) -> list[dict[str, Any]]:
    """Targets seen by fewer sensors than asked for, in the order of ``targets``.

    Parameters
    ----------
    targets : columns target, x, y, z, local metres.
    times_seen : (n,) how many chosen sensors see each target.
    needed : how many must, one number or (n,).
    uncovered : names of the targets that no candidate sees.
    explained : columns target, reason, nearest_m (distance of the nearest candidate), blocked_share
        (of its sight lines), obstacle_x and obstacle_y (local metres) of uncovered targets.
    """
    details = explained.set_index("target")[["reason", *_DETAILS]].to_dict("index")
    must = np.broadcast_to(needed, len(targets))
    named = zip(targets["target"], targets["x"], targets["y"], times_seen, must, strict=True)
    gaps = []
    for name, x, y, seen, need in named:
        if seen >= need:
            continue
        known = details.get(name, {})
        reason = TOO_FEW if seen else NOT_CHOSEN
        if name in uncovered:
            reason = f"{OUT_OF_SIGHT}: {known['reason']}" if known else OUT_OF_SIGHT
        gaps.append(
            {
                "target": str(name),
                "x": float(x),
                "y": float(y),
                "seen": int(seen),
                "reason": reason,
                **{key: _known(known.get(key)) for key in _DETAILS},
            }
        )
    return gaps


def _known(value: Any) -> float | None:
    return None if pd.isna(value) else float(value)


def obstacles_of(features: gpd.GeoDataFrame) -> list[dict[str, Any]]:
    """Obstacles as records, in the layer's order.

    Parameters
    ----------
    features : points in local metres with columns kind, height_m, targets, sensors, sight_lines
        (how many of each it cuts off), target and candidate (one of each, by name).
    """
    xy = shapely.get_coordinates(features.geometry.to_numpy())
    columns = features[[*_TEXTS, *_NUMBERS]].to_dict("records")
    return [
        {
            "x": float(x),
            "y": float(y),
            **{key: str(record[key]) for key in _TEXTS},
            **{key: _known(record[key]) for key in _NUMBERS},
        }
        for (x, y), record in zip(xy, columns, strict=True)
    ]


def objects_in_the_way(
    objects: Sequence[dict[str, Any]], removals: Sequence[dict[str, Any]]
) -> list[dict[str, Any]]:
    """Objects with what a plan would save without them; ``without`` is None where nobody tried.

    Parameters
    ----------
    objects : name, kind, targets and sensors of the greatest. removals : object, sensors,
        sensors_before and more_targets of those that were tried.
    """
    tried = {row["object"]: row for row in removals}
    listed = {entry["name"] for entry in objects}
    # What was tried is told even where greater objects fill the list.
    further = [
        {"name": row["object"], "kind": row["kind"], "targets": row["hidden_targets"]}
        for row in removals
        if row["object"] not in listed
    ]
    return [
        {"sensors": None, **entry, "without": tried.get(entry["name"])}
        for entry in [*objects, *further]
    ]


# What the chosen sensors of a plan see.


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
