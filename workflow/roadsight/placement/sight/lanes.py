"""Lanes on the pavement, and how often traffic stands in the lines of sight across them.

Passing vehicles are boxes that stand on the pavement, and a Poisson process.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd
import shapely
from numpy.typing import NDArray

from roadsight.base.arrays import Floats, Floats32, Ints, Ints32
from roadsight.base.kernels import compiled
from roadsight.placement.sight.kinds import Box
from roadsight.scene.grids import Grid

_STATION_M = 2.0  # distance of a lane's points
_ACROSS_M = 40.0  # how far across an edge, to either side, carriageways are looked for
_TANGENT_M = 1.0  # the edge's direction is taken from this far behind a station to this far ahead
_SHOULDERS_M = 1.0  # width of pavement, both sides together, that carries no lane
_CELL_M = 0.5  # cells of the raster of lanes: fine against the width of vehicles
_STEP_M = 0.25  # steps along lines of sight in plan, half a cell: hardly a cell is stepped over
_NO_LANE = -1  # what the raster of lanes holds elsewhere


def trace_lanes(
    edges: list[shapely.LineString], pavement: shapely.MultiPolygon, lane_width_m: float
) -> pd.DataFrame:
    """Middle lines of the lanes, as points every two metres.

    Across each edge, the longest first, every carriageway (a stretch of pavement up to 40 m off)
    carries as many lanes as fit its usual width, around its middle; road that has lanes already
    gets no more. Lanes that run alongside those of an earlier edge are of the same road.

    Returns
    -------
    lane (number), road (number), station_m, x, y, along_x, along_y (unit tangent)
    """
    from scipy.spatial import cKDTree  # noqa: PLC0415  # slow to load

    parts: list[pd.DataFrame] = []
    lanes, roads = 0, 0
    for edge in sorted(edges, key=lambda line: -line.length):
        points, road = _lanes_along(edge, pavement, lane_width_m), None
        if parts:
            known = pd.concat(parts)
            near, _ = cKDTree(known[["x", "y"]].to_numpy()).query(points[["x", "y"]].to_numpy())
            points = points[near > lane_width_m / 2]
            road = road_alongside(points, known) if len(points) else None
        if len(points):
            codes, _ = pd.factorize(points["lane"], sort=True)
            parts.append(points.assign(lane=codes + lanes, road=roads if road is None else road))
            lanes += int(codes.max()) + 1
            roads += road is None
    names = ["lane", "road", "station_m", "x", "y", "along_x", "along_y"]
    if not parts:
        return pd.DataFrame({name: [] for name in names})
    return pd.concat(parts, ignore_index=True)[names]


def _lanes_along(
    edge: shapely.LineString, pavement: shapely.MultiPolygon, lane_width_m: float
) -> pd.DataFrame:
    """Points of the lanes of all carriageways across one edge; lane is a number within it."""
    found = _carriageways(edge, pavement)
    # A rough outline must not change the number of lanes from station to station.
    usual = found.groupby(["abreast", "number"])["width_m"].transform("median")
    lanes = ((usual - _SHOULDERS_M) / lane_width_m).clip(lower=0).to_numpy(np.int64)
    points = found.loc[found.index.repeat(lanes)].reset_index(drop=True)
    within = np.concatenate([np.arange(count) for count in [*lanes, 0]]).astype(np.int64)
    aside = (within - (np.repeat(lanes, lanes) - 1) / 2) * lane_width_m
    points["x"] -= aside * points["along_y"]
    points["y"] += aside * points["along_x"]
    points["lane"] = points.groupby("station_m").cumcount()
    return points.drop(columns=["abreast", "number", "width_m"])


def _carriageways(edge: shapely.LineString, pavement: shapely.MultiPolygon) -> pd.DataFrame:
    """Middle and width of every carriageway across each station of an edge.

    Returns
    -------
    station_m, x, y, along_x, along_y; abreast and number (how many there are, and which); width_m
    """
    rows = []
    for station in np.arange(0.0, edge.length, _STATION_M):
        around = np.clip([station - _TANGENT_M, station, station + _TANGENT_M], 0.0, edge.length)
        before, here, after = shapely.get_coordinates(shapely.line_interpolate_point(edge, around))
        along = (after - before) / np.linalg.norm(after - before)
        reach = _ACROSS_M * np.array([-along[1], along[0]])
        across = shapely.LineString([here - reach, here + reach])
        parts = [p for p in shapely.get_parts(across.intersection(pavement)) if p.length > 0]
        parts.sort(key=lambda part: across.project(part.centroid))
        rows += [
            (station, part.centroid.x, part.centroid.y, *along, len(parts), number, part.length)
            for number, part in enumerate(parts)
        ]
    names = ["station_m", "x", "y", "along_x", "along_y", "abreast", "number", "width_m"]
    return pd.DataFrame(rows, columns=names)


@dataclass(frozen=True)
class Traffic:
    """Lanes as a raster, and what drives on them.

    Parameters
    ----------
    grid : cells of the raster.
    lane : number of the lane of each cell, -1 for none. station_m, offset_m, ground_m : place along
        and across it, and height of its surface; all (rows, columns).
    per_m : vehicles of each class on a metre of each lane (lanes, classes).
    vehicles : the classes.
    """

    grid: Grid
    lane: Ints32
    station_m: Floats32
    offset_m: Floats32
    ground_m: Floats32
    per_m: Floats
    vehicles: tuple[Box, ...]


def rasterise_lanes(lanes: pd.DataFrame, per_m: Floats, vehicles: tuple[Box, ...]) -> Traffic:
    """Lanes as a raster of half a metre: each cell belongs to the nearest point of a lane.

    Parameters
    ----------
    lanes : as `trace_lanes` gives them, with z, the height of the road. per_m : as in `Traffic`.
    """
    from scipy.spatial import cKDTree  # noqa: PLC0415  # slow to load

    xy = lanes[["x", "y"]].to_numpy(np.float64)
    reach = max(vehicle.width_m for vehicle in vehicles) / 2 + _CELL_M
    west, south = xy.min(axis=0) - reach
    east, north = xy.max(axis=0) + reach
    grid = Grid.over(west, south, east, north, _CELL_M)
    row, column = np.divmod(np.arange(grid.rows * grid.columns), grid.columns)
    cells = np.column_stack(grid.centres(column, row))
    limit = np.hypot(reach, _STATION_M)
    _, nearest = cKDTree(xy).query(cells, distance_upper_bound=limit)
    known = nearest < len(xy)
    point = np.where(known, nearest, 0)
    away = cells - xy[point]
    along = lanes[["along_x", "along_y"]].to_numpy()[point]
    station = lanes["station_m"].to_numpy()[point] + (away * along).sum(axis=1)
    offset = along[:, 0] * away[:, 1] - along[:, 1] * away[:, 0]
    lane = np.where(known, lanes["lane"].to_numpy()[point], _NO_LANE)
    ground = lanes["z"].to_numpy()[point]

    def raster(values: NDArray, kind: type) -> NDArray:
        return values.astype(kind).reshape(grid.shape)

    return Traffic(
        grid,
        raster(lane, np.int32),
        raster(station, np.float32),
        raster(offset, np.float32),
        raster(ground, np.float32),
        per_m,
        vehicles,
    )


def free_shares(traffic: Traffic, sensor_m: Floats, targets_m: Floats) -> Floats:
    """Share of the time (n,) in which no vehicle stands between a sensor and each target.

    The line of sight is walked from the target in steps of a quarter of a metre. Wherever it is
    within the width and below the height of a lane's vehicles it grows the stretch s of which
    per_m (s + L) vehicles stand in the way (`expected_in_the_way`); of vehicles in the target's own
    lane only those count that leave the target its place: per_m s. Counts of independent Poisson
    processes add up, and exp(-sum) of the time there is none.

    Parameters
    ----------
    sensor_m : (3,). targets_m : (n, 3) the points looked at. Local metres.
    """
    boxes = np.array([[v.length_m, v.width_m, v.height_m] for v in traffic.vehicles])
    grid = traffic.grid
    expected = _expected(
        traffic.lane,
        traffic.station_m,
        traffic.offset_m,
        traffic.ground_m,
        (grid.west, grid.south, grid.cell_size_m),
        traffic.per_m,
        boxes,
        np.asarray(sensor_m, np.float64),
        np.ascontiguousarray(targets_m, np.float64),
    )
    return np.exp(-expected)


@compiled()
def _expected(
    lane: Ints32,
    station_m: Floats32,
    offset_m: Floats32,
    ground_m: Floats32,
    corner: tuple[int, int, float],
    per_m: Floats,
    boxes: Floats,
    sensor: Floats,
    targets: Floats,
) -> Floats:
    """Mean number of vehicles in the way of each target."""
    expected = np.zeros(len(targets))
    west, south, size = corner
    for target in range(len(targets)):
        span = sensor - targets[target]
        length = np.sqrt(span[0] ** 2 + span[1] ** 2)
        steps = max(int(np.ceil(length / _STEP_M)), 1)
        for vehicle in range(len(boxes)):
            long, half, high = boxes[vehicle, 0], boxes[vehicle, 1] / 2, boxes[vehicle, 2]
            current, own, before, stretch = _NO_LANE, True, 0.0, 0.0
            for step in range(steps + 1):
                at = targets[target] + span * ((step + 0.5) / steps)
                column = int(np.floor(at[0] / size)) - west
                row = int(np.floor(at[1] / size)) - south
                here = _NO_LANE
                inside = 0 <= row < lane.shape[0] and 0 <= column < lane.shape[1]
                if (
                    inside
                    and step < steps
                    and abs(offset_m[row, column]) <= half
                    and at[2] - ground_m[row, column] < high
                ):
                    here = lane[row, column]
                if here != current:
                    if current != _NO_LANE:
                        room = stretch if own else stretch + long
                        expected[target] += per_m[current, vehicle] * room
                        own = False
                    elif step > 0:
                        own = False
                    current, stretch = here, 0.0
                elif here != _NO_LANE:
                    stretch += abs(station_m[row, column] - before)
                if here != _NO_LANE:
                    before = float(station_m[row, column])
    return expected


_APART_M = 40.0  # carriageways of one road are no farther apart, and all within twice of it
# Cosine of the angle up to which directions are about the same.
_PARALLEL = float(np.cos(np.radians(20.0)))
# Along the road, half the distance of a lane's points and a little for rounding: every lane abreast
# has a point so near.
_BESIDE_M = 1.0 + 1e-6
_ALONGSIDE_SHARE = 0.5  # share of new lanes' points that must run along a road for them to be its
# Places of a road at which lanes abreast are counted; their median needs no more.
_MOST_SAMPLES = 400
_NEIGHBOURS = 16  # nearest known points that are looked at; the nearest may be of a crossing road


def road_alongside(points: pd.DataFrame, known: pd.DataFrame) -> int | None:
    """Number of the road along which most of the new lanes' points run; None where none is.

    A point runs alongside a road if a lane of it lies no more than 40 m off and within 20 degrees
    of its direction, either way.

    Parameters
    ----------
    points, known : columns x, y, along_x, along_y; of the known ones road as well.
    """
    from scipy.spatial import cKDTree  # noqa: PLC0415  # slow to load

    tree = cKDTree(known[["x", "y"]].to_numpy(np.float64))
    count = min(_NEIGHBOURS, len(known))
    away, near = tree.query(points[["x", "y"]].to_numpy(np.float64), k=[*range(1, count + 1)])
    along = known[["along_x", "along_y"]].to_numpy(np.float64)
    ways = points[["along_x", "along_y"]].to_numpy(np.float64)
    found = away <= _APART_M
    near = np.where(found, near, 0)
    parallel = np.abs((along[near] * ways[:, None]).sum(axis=2)) >= _PARALLEL
    beside = found & parallel
    first = beside.argmax(axis=1)
    rows = np.flatnonzero(beside.any(axis=1))
    if len(rows) < _ALONGSIDE_SHARE * len(points):
        return None
    roads = known["road"].to_numpy(np.int64)[near[rows, first[rows]]]
    return int(np.bincount(roads).argmax())


def lanes_abreast(lanes: pd.DataFrame) -> pd.Series:
    """How many lanes lie abreast on each road: the median over its points, at least 1.

    Beside a point lie those lanes of its road that have a point no more than 1 m before or behind
    it and within 80 m across, in about its direction. Long roads are looked at in 400 places.

    Parameters
    ----------
    lanes : as `trace_lanes` gives them.
    """
    counts = {}
    for road, points in lanes.groupby("road"):
        chosen = np.unique(np.linspace(0, len(points) - 1, _MOST_SAMPLES).astype(np.int64))
        counts[road] = max(int(np.median(_abreast(points, chosen))), 1)
    return pd.Series(counts, dtype=np.int64)


def _abreast(points: pd.DataFrame, chosen: Ints) -> Ints:
    """Lanes beside each chosen point of a road, its own among them."""
    from scipy.spatial import cKDTree  # noqa: PLC0415  # slow to load

    xy = points[["x", "y"]].to_numpy(np.float64)
    along = points[["along_x", "along_y"]].to_numpy(np.float64)
    lane = points["lane"].to_numpy(np.int64)
    around = cKDTree(xy).query_ball_point(xy[chosen], 2 * _APART_M)
    counts = np.empty(len(chosen), np.int64)
    for number, (point, near) in enumerate(zip(chosen, around, strict=True)):
        ahead = np.abs((xy[near] - xy[point]) @ along[point])
        parallel = np.abs(along[near] @ along[point]) >= _PARALLEL
        beside = lane[near][(ahead <= _BESIDE_M) & parallel]
        counts[number] = len(np.unique(beside))
    return counts
