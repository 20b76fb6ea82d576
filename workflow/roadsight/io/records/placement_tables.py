"""Which sensor position sees which target: sparse rows by shard."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from pandas.api.types import union_categoricals

from roadsight.base.arrays import AnyPath, Floats
from roadsight.base.errors import InputError
from roadsight.io.records.tables import read_about, read_table, write_table
from roadsight.placement.sensors.poses import tilt_rotation
from roadsight.placement.sight.lanes import Traffic, rasterise_lanes
from roadsight.placement.sight.passing import CAR, TRUCK

_COLUMNS = ["candidate", "target", "hits"]
_AVAILABILITY = "availability"


def write_detections(path: AnyPath, detections: pd.DataFrame, about: dict[str, Any]) -> None:
    """Write the detections of one sensor.

    Parameters
    ----------
    detections : candidate, target (names, best as categories) and hits (beams, uint16); one row
        per seen target; and availability (share of the time that traffic leaves it in sight), if
        that was simulated.
    about : ``sensor`` (its name) and whatever else describes them.
    """
    optional = [name for name in (_AVAILABILITY,) if name in detections]
    write_table(path, detections[[*_COLUMNS, *optional]], about)


def read_seen_targets(path: AnyPath, allowed: set[str] | None = None) -> tuple[str, pd.Index]:
    """Sensor of one file and the targets that it sees from anywhere, each once.

    Parameters
    ----------
    allowed : only from these candidates, in whatever pose; None: from all of them.

    Raises
    ------
    InputError : as `read_detections`.
    """
    if allowed is None:
        targets = read_table(path, ["target"])["target"]
    else:
        table = read_table(path, ["candidate", "target"]).astype({"candidate": "category"})
        places = table["candidate"].cat.categories.astype(str)
        free = np.array([name.partition("@")[0] in allowed for name in places], bool)
        targets = table["target"][free[table["candidate"].cat.codes.to_numpy()]]
    return _sensor_of(path), pd.Index(targets.unique().astype(str))


def read_detections(paths: Iterable[AnyPath]) -> pd.DataFrame:
    """Detections of several files, one after the other.

    Returns
    -------
    columns sensor, candidate, target (categories, in the order in which files name them), hits and,
    where traffic was simulated, availability

    Raises
    ------
    InputError : a file is missing, damaged, or does not name its sensor.
    """
    parts = []
    for path in paths:
        part, sensor = read_table(path), pd.Index([_sensor_of(path)])
        part["sensor"] = pd.Categorical.from_codes(np.zeros(len(part), np.int8), sensor)
        if len(part):
            parts.append(part.astype({"candidate": "category", "target": "category"}))
    if not parts:
        return pd.DataFrame({name: [] for name in ("sensor", *_COLUMNS)})
    columns: dict[str, Any] = {
        name: union_categoricals([part[name] for part in parts])
        for name in ("sensor", "candidate", "target")
    }
    numbers = [name for name in ("hits", _AVAILABILITY) if all(name in part for part in parts)]
    for name in numbers:
        columns[name] = pd.concat([part[name] for part in parts], ignore_index=True)
    return pd.DataFrame(columns)


def _sensor_of(path: AnyPath) -> str:
    sensor = read_about(path).get("sensor")
    if not isinstance(sensor, str):
        raise InputError(
            "does not say of which sensor its detections are",
            where=str(path),
            hint="delete it and run the workflow again",
        )
    return sensor


@dataclass(frozen=True)
class SiteTraffic:
    """Traffic of a site.

    Parameters
    ----------
    lanes : where it drives and how much of it there is.
    availability : share of the time that a line of sight must be free of it.
    """

    lanes: Traffic
    availability: float


def read_traffic(path: AnyPath) -> SiteTraffic:
    """Read the lanes that `trace_lanes` wrote as points on their middle lines.

    Raises
    ------
    InputError : the table cannot be read.
    """
    points = read_table(path)
    # One row per lane: its vehicles are the same all along it.
    per_m = points.groupby("lane")[["cars_per_m", "trucks_per_m"]].first().sort_index()
    lanes = rasterise_lanes(points, per_m.to_numpy(np.float64), (CAR, TRUCK))
    return SiteTraffic(lanes, float(read_about(path)["availability"]))


_POSE = ["x", "y", "z", "yaw_deg"]
_NORMAL = ["normal_x", "normal_y", "normal_z"]
# Column of denser candidates: names of the sensors whose gaps they are for, blanks between.
FOR_SENSORS = "for_sensors"


def read_poses(path: AnyPath, sensor: str | None = None) -> dict[str, Floats]:
    """Pose (4,) of each candidate in the table's order: x, y, z in local metres and yaw in degrees.

    Parameters
    ----------
    sensor : only candidates that are for this sensor; None: all.

    Raises
    ------
    InputError : the table cannot be read, a pose is not finite, or two candidates share a name.
    """
    frame = read_table(path)
    if sensor is not None and FOR_SENSORS in frame:
        meant = [sensor in str(names).split() for names in frame[FOR_SENSORS]]
        frame = frame[np.array(meant, bool)]
    if missing := {"candidate", *_POSE} - set(frame):
        frame = read_table(path, sorted(missing))  # says what it lacks
    poses = frame[_POSE].to_numpy(np.float64)
    if not np.isfinite(poses).all():
        raise InputError("a candidate's pose is not finite", where=str(path))
    twice = frame["candidate"][frame["candidate"].duplicated()]
    if len(twice):
        raise InputError("two candidates share a name", where=str(path), found=repr(twice.iloc[0]))
    return dict(zip(frame["candidate"].astype(str), poses, strict=True))


def read_tilts(paths: Iterable[AnyPath]) -> dict[str, Floats]:
    """Rotation (3, 3) from the levelled to the mounted sensor of each candidate that is tilted.

    Without any file every mount is levelled, and the result empty.

    Raises
    ------
    InputError : a table cannot be read.
    """
    tilts: dict[str, Floats] = {}
    for path in paths:
        frame = read_table(path, ["candidate", *_NORMAL])
        normals = frame[_NORMAL].to_numpy(np.float64)
        tilts |= dict(zip(frame["candidate"].astype(str), map(tilt_rotation, normals), strict=True))
    return tilts
