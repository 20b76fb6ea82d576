"""What detection stages take alike: targets with their shape, and effects."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
import pandas as pd

from roadsight.base.arrays import Floats
from roadsight.base.errors import InputError
from roadsight.base.sections.sensing import Targets
from roadsight.io.records.atomic import read_json
from roadsight.io.records.tables import read_table
from roadsight.placement.sensors.light import contrast_range_m, range_in_air_m
from roadsight.placement.sensors.sensors import AnySensor, Camera, Radar, Rosette, Sensor
from roadsight.placement.sight.kinds import Box, Cylinder, Shape
from roadsight.placement.sight.sight import Sight


@dataclass(frozen=True, kw_only=True)
class SightFiles:
    """What every stage takes that asks what a sensor measures of targets."""

    targets: Path
    radius_m: Annotated[float, Targets]
    height_m: Annotated[float, Targets]
    box: Annotated[tuple[float, float, float] | None, "length, width, height instead, m"] = None
    tilts: Annotated[Sequence[Path], "how mounts lean"] = ()
    air: Annotated[Sequence[Path], "what rain and fog take out of beams"] = ()
    reflectivity: Annotated[Sequence[Path], "ranges to dark targets"] = ()
    partial_hits: Literal["simulate", "skip"] = "skip"
    curvature: Literal["simulate", "skip"] = "skip"


@dataclass(frozen=True, kw_only=True)
class DetectionFiles(SightFiles):
    """What every stage takes that asks which targets a sensor sees."""

    depth: Path
    candidates: Path
    sensor: str
    sensors: Path
    min_beams: Annotated[int, Targets]
    lanes: Annotated[Sequence[Path], "lanes and their traffic"] = ()


def sight_of(given: SightFiles, name: str, sensor: AnySensor) -> Sight:
    """How far and how a sensor sees targets under the effects that are simulated."""
    curved = given.curvature == "simulate"
    if isinstance(sensor, Radar):
        return Sight(sensor.range_m, curved=curved)
    air = sum(read_json(path)["extinction_per_m"][name] for path in given.air)
    if isinstance(sensor, Camera):
        return Sight(min(sensor.range_m, contrast_range_m(air)), curved=curved)
    clear_m = sensor.range_m
    for path in given.reflectivity:
        clear_m = read_json(path)["target_range_m"][name]
    wide = isinstance(sensor, Sensor | Rosette) and sensor.divergence_mrad is not None
    wide = wide and given.partial_hits == "simulate"
    near_m = sensor.range_min_m if isinstance(sensor, Sensor) else 0.0
    return Sight(float(range_in_air_m(clear_m, air)), wide, curved, near_m)


def read_shaped_targets(given: SightFiles) -> tuple[pd.DataFrame, Floats, Shape]:
    """Targets, their feet and their shape; feet of boxes have headings, (n, 4).

    Raises
    ------
    InputError : boxes without headings.
    """
    targets = read_table(given.targets)
    names = ["x", "y", "z"]
    if not given.box:
        feet_m = targets[names].to_numpy(np.float64)
        return targets, feet_m, Cylinder(given.radius_m, given.height_m)
    if "heading_rad" not in targets:
        raise InputError(
            "has no headings of targets that are boxes",
            where=str(given.targets),
            hint="run the workflow again",
        )
    feet_m = targets[[*names, "heading_rad"]].to_numpy(np.float64)
    return targets, feet_m, Box(*given.box)


def said_of_shape(given: DetectionFiles, shape: Shape) -> dict[str, float]:
    """What a table of detections says of its targets."""
    about = {"height_m": shape.height_m, "min_beams": given.min_beams}
    if isinstance(shape, Box):
        return about | {"length_m": shape.length_m, "width_m": shape.width_m}
    return {"radius_m": shape.radius_m} | about
