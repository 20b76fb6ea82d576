"""What a virtual LiDAR measures, and which targets it sees."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike
from scipy import sparse

from roadsight.api.clouds import Points, taken
from roadsight.base.arrays import Floats, Floats32
from roadsight.base.engines import OWN, Engine
from roadsight.base.errors import InputError
from roadsight.base.section import validated
from roadsight.base.sections.sensing import Lidar, Targets
from roadsight.placement.depth.surfel_lidar import SurfelLidar, lidar_of_points
from roadsight.placement.sensors.sensors import Sensor, load_sensor
from roadsight.placement.sight.sight import Sight, count_beams
from roadsight.scene.surfels import in_company

# Sensors by name, with the data sheets that they are from.
CATALOGUE = Path(__file__).parents[3] / "config" / "sensors.yaml"
# Points so far beyond the sensor's range still help to tell the surfaces at its end.
_MARGIN_M = 10.0


def depth_map(
    points: Points,
    sensor: Sensor | str,
    position_m: ArrayLike,
    yaw_deg: float = 0.0,
    *,
    engine: Engine = OWN,
    outlier_radius_m: float = Lidar().outlier_radius_m,
) -> Floats32:
    """What one sensor at one place would measure (paper 1, section 2.4).

    Parameters
    ----------
    points : a cloud, a path, or local metres, (n, 3) or columns x, y, z.
    sensor : a spinning LiDAR, or its name in the catalogue.
    position_m : (3,) local metres; ``cloud.frame.to_local`` turns native coordinates into them.
    yaw_deg : direction of the sensor's x axis, counter-clockwise from local x.
    engine : who casts the rays and looks for outliers: own or open3d.
    outlier_radius_m : points without two others within this are left out; 0: none are.

    Returns
    -------
    (rows, columns) range of every beam's first return, metres, 0 for none

    Raises
    ------
    InputError : no usable cloud, sensor or engine, or it stands out of reach of every point.

    Examples
    --------
    >>> import numpy as np, roadsight
    >>> x, y = np.meshgrid(np.arange(-15, 15, 0.1), np.arange(-15, 15, 0.1))
    >>> plain = np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)])
    >>> ranges = roadsight.depth_map(plain, "OS1-64", [0, 0, 4])
    >>> ranges.shape, round(float(ranges[ranges > 0].min()), 1)
    ((64, 2048), 10.5)
    """
    sensor, place = _sensor(sensor), np.asarray(position_m, np.float64)
    if place.shape != (3,) or not np.isfinite(place).all():
        raise InputError("is no place", where="position", found=position_m, allowed="x, y, z")
    xyz_m = in_company_of(taken(points).xyz_m, outlier_radius_m, engine)
    near_m = points_in_reach(xyz_m, sensor, place)
    return lidar_of_points(near_m, engine=engine).depth_map(sensor, place, yaw_deg)


def in_company_of(xyz_m: Floats, radius_m: float, engine: Engine) -> Floats:
    """Points (n, 3) without those that stand alone within a radius; all of them if it is 0.

    Raises
    ------
    InputError : the radius is negative, or the engine open3d cannot be loaded.
    """
    asked = validated(Lidar, {"outlier_radius_m": radius_m}, "points that stand alone")
    if radius_m == 0:
        return xyz_m
    nothing = np.empty((0, 3))
    return xyz_m[in_company(xyz_m, nothing, radius_m, asked.outlier_neighbours, engine)]


def points_in_reach(
    xyz_m: Floats, sensor: Sensor, position_m: Floats, where: str = "position"
) -> Floats:
    """Points that a sensor may measure, and those beyond that tell the surfaces at its end.

    Parameters
    ----------
    xyz_m : (n, 3). position_m : (3,); both local metres. where : what gave it, for the message.

    Raises
    ------
    InputError : the sensor stands out of reach of every point.
    """
    offset_m = np.linalg.norm(xyz_m - position_m, axis=1)
    if offset_m.min() > sensor.range_m:
        raise InputError(
            "the sensor stands out of reach of the cloud",
            where=where,
            found=f"{offset_m.min():.0f} m from the nearest point",
            allowed=f"within {sensor.range_m:g} m, the sensor's range",
            hint="give the position in the cloud's own coordinates and units",
        )
    return np.asarray(xyz_m[offset_m <= sensor.range_m + _MARGIN_M])


def detection_matrix(
    points: Points | SurfelLidar,
    sensor: Sensor | str,
    candidates: pd.DataFrame | ArrayLike,
    targets: pd.DataFrame | ArrayLike,
    settings: Targets | None = None,
    *,
    engine: Engine = OWN,
) -> sparse.csr_matrix:
    """Which candidates see which targets (paper 1, section 2.5).

    Parameters
    ----------
    points : a cloud, a path, local metres ((n, 3) or columns x, y, z), or a `SurfelLidar` that was
        made of them.
    sensor : a spinning LiDAR, or its name in the catalogue.
    candidates : (k, 3) places of the sensor, or (k, 4) with its yaw in degrees; or columns x, y, z
        and yaw_deg if there is one; local metres.
    targets : (m, 3) feet of the targets, or columns x, y, z; local metres.
    settings : radius and height of a target, and beams that it takes.
    engine : who casts the rays: own or open3d.

    Returns
    -------
    (k, m) bool: rows are candidates, columns targets

    Raises
    ------
    InputError : no usable cloud, sensor, candidates or targets.

    Examples
    --------
    >>> import numpy as np, roadsight
    >>> x, y = np.meshgrid(np.arange(-15, 15, 0.1), np.arange(-15, 15, 0.1))
    >>> plain = np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)])
    >>> feet = [[10, 0, 0], [0, 12, 0], [14, 14, 0]]
    >>> sees = roadsight.detection_matrix(plain, "OS1-64", [[0, 0, 4], [0, 2, 4]], feet)
    >>> roadsight.cover(sees).chosen.tolist()
    [0]
    """
    sensor, asked = _sensor(sensor), settings or Targets()
    poses = _rows(candidates, "candidates", ("x", "y", "z", "yaw_deg"))
    feet_m = _rows(targets, "targets", ("x", "y", "z"))
    lidar = points
    if not isinstance(lidar, SurfelLidar):
        lidar = lidar_of_points(taken(lidar).xyz_m, engine=engine)
    size_m, sight = (asked.radius_m, asked.height_m), Sight(sensor.range_m)
    seen = sparse.lil_matrix((len(poses), len(feet_m)), dtype=bool)
    for row, (x, y, z, *yaw) in enumerate(poses):
        place, yaw_deg = np.array([x, y, z]), yaw[0] if yaw else 0.0
        ranges = lidar.depth_map(sensor, place, yaw_deg)
        beams = count_beams(ranges, sensor, place, yaw_deg, feet_m, size_m, sight)
        seen[row, np.flatnonzero(beams > asked.min_beams)] = True
    return seen.tocsr()


def _sensor(sensor: Sensor | str) -> Sensor:
    return load_sensor(CATALOGUE, sensor) if isinstance(sensor, str) else sensor


def _rows(given: pd.DataFrame | ArrayLike, name: str, columns: tuple[str, ...]) -> Floats:
    """Places (n, 3 or more) of a table or an array."""
    if isinstance(given, pd.DataFrame):
        missing = [column for column in "xyz" if column not in given]
        if missing:
            raise InputError("lacks a column", where=name, found=missing[0], allowed=columns)
        given = given[[column for column in columns if column in given]].to_numpy(np.float64)
    rows = np.asarray(given, np.float64)
    if rows.ndim != 2 or not 3 <= rows.shape[1] <= len(columns) or not np.isfinite(rows).all():
        raise InputError(
            "are no places", where=name, found=f"shape {rows.shape}", allowed=", ".join(columns)
        )
    return rows
