"""Everything that the page shows of one site, as JSON content (``page.json``)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

import geopandas as gpd
import numpy as np
import pandas as pd
from numpy.typing import NDArray

from roadsight.geometry.frames import Frame
from roadsight.geometry.places import bearing_deg, longitudes_latitudes
from roadsight.report.packing import pack, pack_points
from roadsight.report.site.backdrops import Backdrop
from roadsight.report.site.cautions import (
    Caution,
    data_cautions,
    is_proven,
    plan_cautions,
    scene_cautions,
    told_cautions,
)
from roadsight.report.site.gaps import gaps_of, objects_in_the_way, obstacles_of
from roadsight.report.site.layers import (
    CloudSample,
    candidate_layer,
    cloud_layer,
    edge_layer,
    polygon_layer,
    relief_layer,
    target_layer,
)
from roadsight.report.site.options_view import goal_proven
from roadsight.report.site.sights import Sights, sights_of
from roadsight.report.site.tolerance_view import lost_classes

FORMAT = "roadsight.page/2"
"""Of the page's content; the report refuses others."""
IN_SIGHT = (0.5, 0.8, 0.9, 0.95)
"""Borders of the classes of the share of the time in sight, one fewer than the map has colours."""
_MOST_OBSTACLES = 300
"""Obstacles in the page: those that block most."""
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
        "cautions": [asdict(caution) for caution in _cautions(summary, scene, placement, plans)],
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
    return {
        "name": solution["plan"],
        "title": plan.title,
        **{key: solution[key] for key in kept},
        **({} if options is None else {"options": options}),
        "seconds_cpu": result["seconds_cpu"],
        **({"data": result["data"]} if "data" in result else {}),
        "at_least": at_least,
        "proven": proven,
        **_proven_for(solution, scene),
        "targets": len(placement.targets),
        "excluded": len(solution["excluded"]),
        "sensors": _sensors(solution["sensors"], sights, frame),
        "seen": [pack(sights.seen_by(n), "u4") for n in range(len(solution["sensors"]))],
        "histogram": sights.histogram.tolist(),
        **({} if plan.in_sight is None else _in_sight(plan.in_sight)),
        "objects": objects_in_the_way(result.get("objects", []), result.get("removals", [])),
        **({"second": solution["second"]} if "second" in solution else {}),
        **({"tolerance": result["tolerance"]} if "tolerance" in result else {}),
        **({} if plan.lost_share is None else lost_classes(plan.lost_share)),
        **({"availability": solution["availability"]} if "availability" in solution else {}),
        "gaps": gaps_of(
            placement.targets,
            sights.times_seen,
            _needs(placement.targets, at_least, options),
            frozenset(plan.uncovered),
            plan.explained,
        ),
        "obstacles": obstacles_of(plan.obstacles.iloc[:_MOST_OBSTACLES]),
        "all_obstacles": len(plan.obstacles),
        "returns": {
            **pack_points(plan.returns_xyz_m),
            "sensor": pack(plan.returns_sensor, "u2"),
        },
    }


def _proven_for(solution: dict[str, Any], scene: Scene) -> dict[str, Any]:
    """Pavement that the plan provably sees, and its share; nothing where nobody measured."""
    area_m2 = solution.get("proven_area_m2")
    if area_m2 is None:
        return {}
    whole_m2 = float(scene.pavement.geometry.area.sum())
    return {
        "proven_area_m2": area_m2,
        "proven_share": min(area_m2 / whole_m2, 1.0) if whole_m2 > 0 else 0.0,
    }


def _in_sight(shares: NDArray) -> dict[str, Any]:
    """Class of each target by its share of the time in sight, and targets by class."""
    classes = np.searchsorted(IN_SIGHT, shares, side="right")
    counts = np.bincount(classes, minlength=len(IN_SIGHT) + 1)
    return {"in_sight": pack(classes, "u1"), "in_sight_counts": counts.tolist()}


def _needs(targets: pd.DataFrame, at_least: int, options: dict[str, Any] | None) -> NDArray:
    """How many sensors must see each target (n,)."""
    own = {} if options is None else options["needs"]
    return np.array([own.get(str(name), at_least) for name in targets["target"]], np.int64)


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
    summary: dict[str, Any],
    scene: Scene,
    placement: Placement | None,
    plans: list[dict[str, Any]],
) -> list[Caution]:
    """Warnings first, then notes."""
    targets = positions = None
    if placement is not None:
        targets = len(placement.targets)
        positions = len(pd.unique(pd.concat([table["key"] for table in placement.rounds])))
    area_m2 = float(scene.pavement.geometry.area.sum())
    found = told_cautions(summary.get("warnings", [])) + plan_cautions(plans)
    examined_m2 = None
    if placement is not None and "area_m2" in placement.targets:
        examined_m2 = float(placement.targets["area_m2"].sum())
    found += data_cautions(targets, positions, area_m2, summary["settings"], examined_m2)
    found += scene_cautions(
        scene.about,
        summary["scene"].get("pavement_scores") is not None,
        summary["scene"].get("traffic"),
        set(scene.edges["source"]),
        {} if placement is None else placement.sensors,
    )
    return sorted(found, key=lambda caution: caution.level != "warning")
