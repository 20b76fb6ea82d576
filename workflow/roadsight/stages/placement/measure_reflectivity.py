"""How far each sensor sees targets and the road's own surfaces, by their reflectivity."""

from __future__ import annotations

import logging
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import numpy as np
import pandas as pd
import shapely
from shapely import MultiPolygon

from roadsight.geometry.frames import Frame
from roadsight.io.cloud.tiles import CloudTiles, stack_xyz
from roadsight.io.records.atomic import read_json, write_json
from roadsight.io.records.tables import write_table
from roadsight.io.vector.vectors import read_layer
from roadsight.placement.sensors.light import reflectivity_range_m
from roadsight.placement.sensors.sensors import Rosette, Sensor, load_sensors
from roadsight.scene.pavement.reflectivity import reflectivity_of, voxel_means
from roadsight.stages.command import Command

log = logging.getLogger("measure_reflectivity")


def measure_reflectivity(
    cloud: Path,
    frame: Path,
    pavement: Path,
    sensors: str,
    names: Annotated[Sequence[str], "names of the sensors"],
    target_reflectivity: float,
    *,
    surfaces: Path,
    out: Path,
) -> None:
    """Write ranges by sensor, and the reflectivity of surfaces from the cloud's intensities."""
    definitions = load_sensors(sensors)
    rho = target_reflectivity
    lidars = {
        name: sensor for name in names if isinstance(sensor := definitions[name], Sensor | Rosette)
    }
    # Zero stands for the reflectivity at which the sensor's range is stated.
    ranges = {
        name: float(reflectivity_range_m(sensor, rho)) if rho else sensor.range_m
        for name, sensor in lidars.items()
    }
    write_table(surfaces, _surfaces(cloud, frame, pavement))
    for name, range_m in ranges.items():
        log.info("%s sees targets of reflectivity %g up to %.1f m", name, rho, range_m)
    write_json(out, {"target_reflectivity": rho, "target_range_m": ranges})


def _surfaces(cloud_path: Path, frame_path: Path, pavement_path: Path) -> pd.DataFrame:
    """Places of half a metre and the reflectivity of what is there."""
    frame = Frame.from_dict(read_json(frame_path))
    pavement = MultiPolygon(list(read_layer(pavement_path, "pavement", frame).geometry))
    shapely.prepare(pavement)
    cloud = CloudTiles(cloud_path)
    parts, paved = [], []
    for number in range(len(cloud.tiles)):
        points = cloud.read(("x", "y", "z", "intensity"), [number])
        means = voxel_means(stack_xyz(points), points["intensity"])
        inside = shapely.contains_xy(pavement, means["x"], means["y"])
        paved.append(means.loc[inside, "intensity"].to_numpy())
        parts.append(means)
    table = pd.concat(parts, ignore_index=True)
    table["reflectivity"] = reflectivity_of(table["intensity"].to_numpy(), np.concatenate(paved))
    return table.drop(columns="intensity")


main = Command(measure_reflectivity)


if __name__ == "__main__":
    sys.exit(main())
