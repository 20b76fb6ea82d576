"""``roadsight accept``: whether an installed sensor stands and sees as planned."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from scipy.spatial.transform import Rotation

from roadsight.api.sight import CATALOGUE
from roadsight.base.arrays import Floats
from roadsight.base.errors import InputError
from roadsight.base.sections.sensing import Targets, Tolerance
from roadsight.commands.verb import Verb
from roadsight.geometry.frames import Frame
from roadsight.io.cloud.clouds import read_laz
from roadsight.io.records.atomic import read_json, write_json
from roadsight.io.records.placement_tables import read_tilts
from roadsight.io.records.tables import read_about
from roadsight.io.vector.vectors import read_layer
from roadsight.placement.plans.acceptance import (
    SAME_PLACE,
    SAME_STRUCTURE,
    Planned,
    Registered,
    Target,
    lost_targets,
    planned_scan,
    register,
)
from roadsight.placement.sensors.poses import Turn, local_from_sensor
from roadsight.placement.sensors.sensors import AnySensor, Sensor, load_sensors

_LEAN = "mount_tilt"  # effect by which mounts lean with the road
# Share of the beams that must agree: a parked truck in the way hides less of a turn, leaves that
# fell or grew since the survey more.
_AGREEING = 0.8
_SENSOR_FRAME_M = 1_000.0  # scans in the sensor's own frame lie within this of its origin


@dataclass(frozen=True)
class Installed:
    """An installed sensor of a plan, and how far off it may be."""

    plan: Annotated[Path, "solution.json of the plan, amid its results"]
    sensor: Annotated[int, "number of the sensor, from 1"]
    move_m: Annotated[float, Tolerance]
    turn_deg: Annotated[float, Tolerance]


def run(
    scan: Annotated[Path, "LAS or LAZ scan of one turn or more of the sensor"],
    /,
    given: Installed,
    scans: Annotated[Path | None, "planned scans; default scans.laz beside the plan"] = None,
    frame_path: Annotated[Path | None, "default scene/frame.json of the same results"] = None,
    sensors: Annotated[Path, "sensors file"] = CATALOGUE,
    *,
    out: Annotated[Path, "JSON file to write"],
) -> None:
    """Write the pose found, what agrees, what is lost, and the verdict.

    Raises
    ------
    InputError : a file is not usable, there is no such sensor, or the scan is of another place.
    """
    folder = given.plan.parent
    frame_file = frame_path or folder.parent.parent / "scene" / "frame.json"
    frame = Frame.from_dict(read_json(frame_file))
    placed: list[dict[str, Any]] = read_json(given.plan)["sensors"]
    if not 1 <= given.sensor <= len(placed):
        raise InputError(
            "is no sensor of the plan",
            where="--sensor",
            found=given.sensor,
            allowed=f"1 to {len(placed)}",
        )
    place = placed[given.sensor - 1]
    position_m = np.array([place[axis] for axis in "xyz"], np.float64)
    sensor = _sensor(sensors, place["sensor"])
    path = scans or folder / "scans.laz"
    cloud = read_laz(path)
    own = cloud.dims["point_source_id"] == given.sensor
    if not own.any():
        raise InputError("has no scan of the sensor", where=str(path), found=given.sensor)
    step = None
    if isinstance(sensor, Sensor):
        rows = float(np.median(np.abs(np.diff(np.sort(sensor.elevation_deg)))))
        step = np.array([360.0 / sensor.columns, rows])
    planned = planned_scan(frame.to_local(cloud.xyz[own]), position_m, step)
    found, scan_m = _fitted(scan, frame, _rotation(folder, place), planned)
    placed_m = scan_m @ found.rotation.T + found.shift_m
    moved_m = found.rotation @ position_m + found.shift_m - position_m
    targets = read_layer(folder / "solution.gpkg", "targets", frame)
    feet_m = np.array([(p.x, p.y, p.z) for p in targets.geometry]).reshape(-1, 3)
    target = _target(folder, place["sensor"])
    seen, lost = lost_targets(planned, placed_m, position_m + moved_m, feet_m, target)
    alone = lost & (targets["sensors"].to_numpy() <= 1)
    content = _content(scan, given, place, found, moved_m)
    content["target"] = target._asdict()
    content["targets"] = {"seen": int(seen.sum()), "lost": int(lost.sum())}
    content["targets"]["lost_to_the_plan"] = int(alone.sum())
    content["lost"] = targets["target"][lost].astype(str).tolist()
    content["reasons"] = _reasons(given, content, whole_turn=isinstance(sensor, Sensor))
    content["verdict"] = "not accepted" if content["reasons"] else "accepted"
    write_json(out, content)
    _tell(content)
    print(f"  {out}")


def _sensor(path: Path, name: str) -> AnySensor:
    """Definition of the plan's model."""
    sensors = load_sensors(path)
    if name not in sensors:
        raise InputError(
            "lacks the model of the plan",
            where=str(path),
            found=name,
            allowed=", ".join(sensors),
            hint="give the sensors file of the plan with --sensors",
        )
    return sensors[name]


def _rotation(folder: Path, place: dict[str, Any]) -> Floats:
    """Axes (3, 3) of the sensor as planned, local frame, the lean of its mount included."""
    effects = folder.parent.parent / "effects.json"
    decided = read_json(effects) if effects.is_file() else []
    tilts: dict[str, Floats] = {}  # upright where the results skip the effect
    if not any(one["effect"] == _LEAN and one["decision"] == "skip" for one in decided):
        tilts = read_tilts(sorted(folder.parent.glob("round-*/tilts.parquet")))
    turn = Turn(0.0, float(place.get("pitch_deg", 0.0)), float(place.get("roll_deg", 0.0)))
    tilt = tilts.get(str(place.get("position", place["candidate"])))
    return local_from_sensor(float(place["yaw_deg"]), turn, tilt)


def _target(folder: Path, model: str) -> Target:
    """What the plan's detections say of its targets; the settings' defaults without any.

    Of boxes, a cylinder as wide as their shorter side.
    """
    shards = sorted(folder.parent.glob(f"round-*/detection/{model}/*.parquet"))
    usual = Targets()
    said = read_about(shards[0]) if shards else {}
    boxes = "width_m" in said
    radius_m = min(said["length_m"], said["width_m"]) / 2 if boxes else said.get("radius_m")
    return Target(
        float(usual.radius_m if radius_m is None else radius_m),
        float(said.get("height_m", usual.height_m)),
        int(said.get("min_beams", usual.min_beams)),
    )


def _fitted(
    scan: Path, frame: Frame, rotation: Floats, planned: Planned
) -> tuple[Registered, Floats]:
    """The scan, in the sensor's or in the site's frame, whichever fits, and its points (n, 3)."""
    cloud = read_laz(scan).xyz
    tries = []
    if np.abs(np.median(cloud, axis=0)).max() < _SENSOR_FRAME_M:
        tries.append(cloud @ rotation.T + planned.position_m)
    tries.append(frame.to_local(cloud))
    fits = [(register(points, planned), points) for points in tries]
    found, points = max(fits, key=lambda fit: fit[0].share)
    if not found.same_place:
        raise InputError(
            "is a scan of another place, or of another sensor of the plan",
            where=str(scan),
            found=f"{100 * found.share:.0f} % of its beams end where the plan's do,"
            f" {100 * found.structure_share:.0f} % of those beside the ground",
            allowed=f"{100 * SAME_PLACE:.0f} and {100 * SAME_STRUCTURE:.0f} % or more",
            hint="scans are in the sensor's own frame, x ahead and z up, or in the site's",
        )
    return found, points


def _content(
    scan: Path, given: Installed, place: dict[str, Any], found: Registered, moved_m: Floats
) -> dict[str, Any]:
    yaw, pitch, roll = Rotation.from_matrix(found.rotation).as_euler("ZYX", degrees=True)
    tilt = np.degrees(np.arccos(np.clip(found.rotation[2, 2], -1.0, 1.0)))
    return {
        "scan": scan.name,
        "sensor": given.sensor,
        "model": place["sensor"],
        "candidate": place["candidate"],
        "moved_m": {axis: float(d) for axis, d in zip("xyz", moved_m, strict=True)},
        "moved_by_m": float(np.linalg.norm(moved_m)),
        "turned_deg": {"yaw": float(yaw), "about_y": float(pitch), "about_x": float(roll)},
        "tilted_deg": float(tilt),
        "agreeing_share": found.share,
        "agreeing_share_beside_ground": found.structure_share,
        "tolerance": {"move_m": given.move_m, "turn_deg": given.turn_deg},
    }


def _reasons(given: Installed, content: dict[str, Any], *, whole_turn: bool) -> list[str]:
    """What keeps the sensor from being accepted; a full turn sees the same at any heading."""
    reasons = []
    if max(abs(part) for part in content["moved_m"].values()) > given.move_m:
        reasons.append(f"stands {content['moved_by_m']:.2f} m from its place")
    if content["tilted_deg"] > given.turn_deg:
        reasons.append(f"leans by {content['tilted_deg']:.1f} degrees")
    if not whole_turn and abs(content["turned_deg"]["yaw"]) > given.turn_deg:
        reasons.append(f"looks {content['turned_deg']['yaw']:.1f} degrees aside")
    if content["agreeing_share"] < _AGREEING:
        reasons.append(f"{100 * content['agreeing_share']:.0f} % of its beams end as planned")
    lost = content["targets"]["lost_to_the_plan"]
    if lost:
        reasons.append(f"{lost} targets that only it was to see are out of its sight")
    return reasons


def _tell(content: dict[str, Any]) -> None:
    turned, targets = content["turned_deg"], content["targets"]
    print(
        f"sensor {content['sensor']} ({content['model']} at {content['candidate']}):"
        f" {content['verdict']}"
    )
    print(
        f"  {content['moved_by_m']:.3f} m from its place, tilted by {content['tilted_deg']:.2f}"
        f" degrees, heading off by {turned['yaw']:.2f} degrees"
    )
    print(
        f"  {100 * content['agreeing_share']:.1f} % of its beams end as planned;"
        f" {targets['lost']} of {targets['seen']} targets lost"
    )
    for reason in content["reasons"]:
        print(f"  not accepted: {reason}")


VERB = Verb("accept", "compare an installed sensor's scan with the plan", run)
