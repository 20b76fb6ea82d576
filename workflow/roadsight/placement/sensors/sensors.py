"""Kinds of sensors, and the sensors file that defines them."""

from __future__ import annotations

import os
import re
from typing import Any

import numpy as np

from roadsight.base.errors import InputError, nearest
from roadsight.base.section import validated
from roadsight.base.texts import read_yaml
from roadsight.placement.sensors.aimed import AimedSensor, Camera, Radar, Rosette
from roadsight.placement.sensors.spinning import Sensor

__all__ = [
    "KINDS",
    "AimedSensor",
    "AnySensor",
    "Camera",
    "Radar",
    "Rosette",
    "Sensor",
    "define_sensor",
    "load_sensor",
    "load_sensors",
    "panorama_name",
    "what_it_sees",
]
AnySensor = Sensor | AimedSensor  # a sensor of any kind
# Schema of each kind of sensor.
KINDS: dict[str, type[Sensor] | type[AimedSensor]] = {
    "spinning": Sensor,
    "rosette": Rosette,
    "camera": Camera,
    "radar": Radar,
}
_PANORAMA = re.compile(r"panorama-(\d*\.?\d+)deg-(\d+)m")  # step and range, see `panorama_name`
_PANORAMA_TOP_DEG = 20.0  # highest elevation: targets are hardly ever above their sensor


# Keys of a spinning LiDAR, of which the first go where one of the second is given: each pair says
# the step, or the channels, in two ways.
_STEP, _TURN = {"azimuth_step_deg"}, {"columns_per_turn"}
_TABLE, _EVEN = {"elevations_deg"}, {"elevation_min_deg", "elevation_max_deg", "channels"}
_INSTEAD = ((_STEP, _TURN), (_TURN, _STEP), (_TABLE, _EVEN), (_EVEN, _TABLE))


def load_sensors(path: str | os.PathLike[str]) -> dict[str, AnySensor]:
    """Read the sensors file.

    Parameters
    ----------
    path : YAML file with one mapping ``sensors`` of names to definitions, each of a ``kind``.

    Raises
    ------
    InputError : malformed file, unknown kind or key, reversed limits, a resolution that is not
        positive.
    """
    content = read_yaml(path)
    if not isinstance(content, dict) or not isinstance(content.get("sensors"), dict):
        raise InputError("needs a mapping 'sensors' of names to definitions", where=str(path))
    if others := sorted(str(key) for key in content if key != "sensors"):
        raise InputError(
            f"unknown key {others[0]!r}", where=str(path), hint=nearest(others[0], ["sensors"])
        )
    if not content["sensors"]:
        raise InputError("defines no sensor", where=str(path))
    given = content["sensors"]
    return {
        _checked_name(name, path): define_sensor(
            _resolved(name, given, str(path)), f"{path}, sensor {name}"
        )
        for name in given
    }


def _resolved(name: object, given: dict[Any, Any], path: str) -> Any:
    """Definition of a sensor with the keys of the one that it is like.

    Raises
    ------
    InputError : it is like a sensor that is not there, or in a circle like itself.
    """
    chain, keys = [name], given[name]
    while isinstance(keys, dict) and "like" in keys:
        like = keys["like"]
        if like not in given or like in chain:
            raise InputError(
                "like: a circle of sensors" if like in given else "like: no such sensor",
                where=f"{path}, sensor {name}",
                found=repr(like),
                hint=nearest(str(like), [str(known) for known in given if known != name]),
            )
        chain.append(like)
        own = {key: value for key, value in keys.items() if key != "like"}
        base = given[like]
        if not isinstance(base, dict):
            return own
        gone = {key for one, other in _INSTEAD if other & own.keys() for key in one}
        keys = {key: value for key, value in base.items() if key not in gone} | own
    return keys


def load_sensor(path: str | os.PathLike[str], name: str) -> Sensor:
    """One spinning LiDAR of the sensors file, or the panorama of a name that `panorama_name` gave.

    Raises
    ------
    InputError : as `load_sensors`, no sensor of that name, or it is of another kind.
    """
    if matched := _PANORAMA.fullmatch(name):
        return _panorama(float(matched[1]), float(matched[2]))
    sensors = load_sensors(path)
    if name not in sensors:
        raise InputError(f"no sensor {name!r}", where=str(path), hint=nearest(name, sensors))
    sensor = sensors[name]
    if not isinstance(sensor, Sensor):
        raise InputError(
            f"sensor {name!r} has no depth map of its own",
            where=str(path),
            found=f"kind {sensor.to_dict()['kind']}",
            allowed="a sensor of kind spinning",
        )
    return sensor


# Keys of a definition that no depth map and no detection depends on.
_NOT_SEEN = frozenset({"cost", "price", "source", "points_per_s", "rotation_hz"})


def what_it_sees(sensor: AnySensor) -> dict[str, Any]:
    """Definition of a sensor without its cost and what else does not change what it sees.

    The points a second of a solid-state LiDAR do.
    """
    dropped = _NOT_SEEN - ({"points_per_s"} if isinstance(sensor, Rosette) else set())
    return {key: value for key, value in sensor.to_dict().items() if key not in dropped}


def panorama_name(step_deg: float, range_m: float) -> str:
    """Name of the depth map from which poses at a position are judged; it says all about it."""
    return f"panorama-{step_deg:g}deg-{np.ceil(range_m):.0f}m"


def _panorama(step_deg: float, range_m: float) -> Sensor:
    """All directions from straight down to 20 degrees above the horizon, the whole way around.

    Rows are twice as coarse below -20 and again below -45 degrees, where all that is seen is near.
    """
    columns = max(round(360 / step_deg), 4)
    step = 360 / columns
    bands = ((-90.0, -45.0, 4 * step), (-45.0, -20.0, 2 * step), (-20.0, _PANORAMA_TOP_DEG, step))
    rows: list[float] = []
    for low, high, height in bands:
        count = max(round((high - low) / height), 1)
        rows += (low + (np.arange(count) + 0.5) * (high - low) / count).tolist()
    beams = {"azimuth_step_deg": step, "elevations_deg": rows, "range_m": range_m}
    return Sensor.model_validate(beams)


def define_sensor(definition: Any, where: str) -> AnySensor:
    """A sensor by its definition, checked against the schema of its kind.

    Raises
    ------
    InputError : as `load_sensors`; ``where`` is told.
    """
    kind = definition.get("kind", "spinning") if isinstance(definition, dict) else "spinning"
    if not isinstance(kind, str) or kind not in KINDS:
        raise InputError(
            "kind: unknown",
            where=where,
            found=repr(kind),
            allowed=", ".join(KINDS),
            hint=nearest(str(kind), KINDS),
        )
    return validated(KINDS[kind], definition, where)


def _checked_name(name: object, path: str | os.PathLike[str]) -> str:
    """Names appear in file names."""
    text = str(name)
    if not text.replace("_", "a").replace(".", "a").replace("-", "a").isalnum() or text[0] in ".-":
        raise InputError(
            "a sensor's name appears in file names",
            where=str(path),
            found=repr(text),
            allowed="letters, digits, '-', '_' and '.', first a letter, digit or '_'",
        )
    if _PANORAMA.fullmatch(text):
        raise InputError("a sensor's name that is in use", where=str(path), found=repr(text))
    return text
