"""What lies beside the road at each object and station: cross-sections, speed, bends, barriers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import pandas as pd
from scipy.spatial import cKDTree

from roadsight.base.arrays import Bools, Floats, Ints
from roadsight.base.sections.poles import Hazard
from roadsight.poles.risk.clear_zone import RECOVERABLE_SLOPE, TRAVERSABLE_SLOPE
from roadsight.poles.risk.cross_sections import (
    CrossSection,
    Height,
    cross_section,
    profile_from_heights,
    profile_from_points,
    slope_text,
)
from roadsight.poles.risk.inventory import NO_INVENTORY, Inventory
from roadsight.poles.risk.marked_lanes import LANE_COLUMNS, marked_lanes, with_inventory
from roadsight.poles.risk.road_geometry import COLUMNS as GEOMETRY_COLUMNS
from roadsight.poles.risk.road_geometry import road_geometry
from roadsight.poles.risk.roads import Located, Roads
from roadsight.poles.risk.shielding import Barrier

# Cross-sections reach so far from the edge, or 3 m beyond their object: the guide's clear zone is
# 11 m wide at 100 km/h on flat ground.
REACH_M = 12.0
_LONGEST_M = 25.0  # they never reach further
# A profile goes on behind its object, so that what a vehicle meets beyond it is told.
_BEYOND_M = 3.0
# Markings further beyond the pavement's edge are of another road, or no markings.
_BESIDE_EDGE_M = 0.5
_DEM_STEP_M = 0.25  # spacing of heights from a terrain model: half its usual cell
# Of the table of cross-sections, one element a row.
SECTION_COLUMNS = (
    "section", "object", "route", "station_m", "side", "element", "kind", "start_m", "end_m",
    "width_m", "sigma_width_m", "slope_rise_over_run", "sigma_slope", "slope_ratio", "rise_m",
    "start_x", "start_y", "end_x", "end_y",
)  # fmt: skip
# Columns of `with_inventory`, and their names in the table of road geometry.
LANE_TITLES = {
    "lanes": "lanes",
    "lane_width_m": "lane_width_m",
    "sigma_lane_width_m": "sigma_lane_width_m",
    "lanes_from": "lanes_from",
    "left_m": "travelled_left_m",
    "right_m": "travelled_right_m",
    "sigma_left_m": "sigma_travelled_left_m",
    "sigma_right_m": "sigma_travelled_right_m",
    "travelled_from": "travelled_from",
}
# Of the table of road geometry, what inventory or site state.
TRAFFIC_COLUMNS = ("speed_least_kmh", "speed_greatest_kmh", "aadt_least", "aadt_greatest")


@dataclass
class Surroundings:
    """What a site knows about its roads and roadsides.

    Parameters
    ----------
    roads : see `roadsight.poles.risk.roads`. height : see `Height`, or None.
    points_m : (n, 3) ground points near the roads, or None; cross-sections prefer them.
    inventory : speed and traffic by measures, or None. barriers : along the roads.
    left_hand_traffic : on which side vehicles drive.
    markings : x, y and image of points on lane markings, or None.
    carriageway : one of `roadsight.poles.risk.inventory.CARRIAGEWAYS`, where the inventory states
        none.
    """

    roads: Roads
    height: Height | None = None
    points_m: Floats | None = None
    inventory: Inventory | None = None
    barriers: Sequence[Barrier] = ()
    left_hand_traffic: bool = False
    carriageway: str = "two-way"
    markings: pd.DataFrame | None = None
    _tree: cKDTree | None = field(default=None, repr=False)
    _geometry: dict[int, pd.DataFrame] = field(default_factory=dict, repr=False)
    _marked: dict[int, pd.DataFrame] = field(default_factory=dict, repr=False)

    def __post_init__(self) -> None:
        if self.points_m is not None and len(self.points_m):
            self._tree = cKDTree(self.points_m[:, :2])

    def geometry(self, road: int) -> pd.DataFrame:
        """Geometry of a road by station, made once."""
        if road not in self._geometry:
            self._geometry[road] = road_geometry(self.roads.roads[road], self.height)
        return self._geometry[road]

    def marked(self, road: int) -> pd.DataFrame:
        """Lanes that markings show, at the stations of `geometry`; made once."""
        if not self._marked and self.markings is not None:
            located = self.roads.locate(self.markings[["x", "y"]].to_numpy(np.float64))
            for number, own in enumerate(self.roads.roads):
                beside = located.station_m, located.side
                near = np.abs(located.offset_m) <= own.bridged_edge_m(*beside) + _BESIDE_EDGE_M
                on = near & (located.road == number)
                at = self.geometry(number)["station_m"].to_numpy()
                sides = [own.bridged_edge_m(at, np.full(len(at), side)) for side in (-1, 1)]
                self._marked[number] = marked_lanes(
                    located.station_m[on],
                    located.offset_m[on],
                    self.markings["image"].to_numpy()[on],
                    at,
                    np.column_stack(sides),
                )
        if road not in self._marked:
            return _no_lanes(len(self.geometry(road)))
        return self._marked[road]

    def section(self, edge_m: Floats, outward: Floats, reach_m: float) -> CrossSection | None:
        """Cross-section from an edge outwards; from ground points, else from heights."""
        found = None
        if self._tree is not None:
            assert self.points_m is not None
            found = cross_section(
                profile_from_points(edge_m, outward, self.points_m, reach_m, tree=self._tree)
            )
        if found is None and self.height is not None:
            found = cross_section(
                profile_from_heights(edge_m, outward, self.height, reach_m, _DEM_STEP_M)
            )
        return found


@dataclass(frozen=True)
class Edges:
    """The road's edge beside each object.

    Parameters
    ----------
    offset_m : (n,) from it, negative inside the road's edges; NaN where no edge is near.
    place_m, outward : (n, 2) of the edge, and the way outwards; NaN where unknown.
    half_m : (n,) from the located road's edge to its centreline; NaN where unknown.
    """

    offset_m: Floats
    place_m: Floats
    outward: Floats
    half_m: Floats


def edges_at(
    roads: Roads, located: Located, xy_m: Floats, edges_m: Floats, reach_m: float
) -> Edges:
    """The edge of each object's own road; where that is unknown, the nearest edge of any road.

    Other pavement beside the road, such as a frontage road, a car park or the mouth of a side
    road, decides about nothing where the road's own edge is known.

    Parameters
    ----------
    located, xy_m : the objects. edges_m : (n, 2 or more) edge points of all roads.
    reach_m : an edge further away is not the object's.
    """
    half, place = np.full(len(xy_m), np.nan), np.full((len(xy_m), 2), np.nan)
    outward, beyond = place.copy(), np.zeros(len(xy_m), bool)
    for number, road in enumerate(roads.roads):
        own = located.road == number
        station, side = located.station_m[own], located.side[own]
        half[own] = road.bridged_edge_m(station, side)
        # Beyond its ends a road may bend: the nearest edge tells more there.
        beyond[own] = (station < road.start_m) | (station > road.end_m)
        way = road.direction(station)
        away = np.where(side == 0, np.nan, side)
        outward[own] = away[:, None] * np.column_stack([way[:, 1], -way[:, 0]])
        place[own] = road.place(station, np.where(side < 0, -1, 1) * half[own])
    offset = np.abs(located.offset_m) - half
    other = np.isnan(offset) | beyond
    if len(edges_m) and other.any():
        distance, row = cKDTree(edges_m[:, :2]).query(xy_m[other])
        place[other] = edges_m[row, :2]
        away = xy_m[other] - place[other]
        # On the road is what lies before the edge as seen from the centreline.
        before = (away * (xy_m[other] - located.foot_m[other])).sum(axis=1) < 0
        offset[other] = np.where(before, -distance, distance)
        outward[other] = np.where(before | (distance < 1e-6), np.nan, 1.0)[:, None] * away
        outward[other] /= np.maximum(distance, 1e-6)[:, None]
    far = ~(np.abs(offset) <= reach_m)
    offset[far], place[far], outward[far] = np.nan, np.nan, np.nan
    return Edges(offset, place, outward, half)


def object_sections(
    surroundings: Surroundings, edge_m: Floats, outward: Floats, offset_m: Floats
) -> list[CrossSection | None]:
    """Cross-section at each object, to beyond it; None where nothing is known."""
    found: list[CrossSection | None] = []
    for edge, way, offset in zip(edge_m, outward, offset_m, strict=True):
        if not (np.isfinite(edge).all() and np.isfinite(way).all() and np.isfinite(offset)):
            found.append(None)
            continue
        reach = float(np.clip(offset + _BEYOND_M, REACH_M, _LONGEST_M))
        found.append(surroundings.section(edge, way, reach))
    return found


def section_table(
    surroundings: Surroundings,
    names: Sequence[str],
    located: Located,
    edge_m: Floats,
    outward: Floats,
    sections: Sequence[CrossSection | None],
    every_m: float,
) -> pd.DataFrame:
    """Elements of the cross-sections at objects and, every ``every_m``, along the roads.

    Parameters
    ----------
    names : of the objects; the others as returned by `edges_at` and `object_sections`.
    every_m : 0 for none along the roads.
    """
    roads = surroundings.roads.roads
    places = zip(located.road, located.station_m, located.side, strict=True)
    found = [
        (f"at {name}", str(name), int(road), float(station), int(side), edge, way, section)
        for name, (road, station, side), edge, way, section in zip(
            names, places, edge_m, outward, sections, strict=True
        )
        if section is not None
    ]
    rows: list[tuple] = []
    for name, owner, road, station, side, edge, way, section in [
        *found,
        *(_along_roads(surroundings, every_m) if every_m > 0 else []),
    ]:
        route = roads[road].name if road >= 0 else ""
        for number, e in enumerate(section.elements, start=1):
            ratio = "" if np.isnan(e.slope) else slope_text(e.slope)
            width, slope = (e.width_m, e.sigma_width_m), (e.slope, e.sigma_slope, ratio)
            element = (number, e.kind, e.start_m, e.end_m, *width, *slope, e.rise_m)
            ends = (*(edge + e.start_m * way), *(edge + e.end_m * way))
            rows.append((name, owner, route, station, side, *element, *ends))
    return pd.DataFrame(rows, columns=list(SECTION_COLUMNS))


def _along_roads(
    surroundings: Surroundings, every_m: float
) -> list[tuple[str, str, int, float, int, Floats, Floats, CrossSection]]:
    """Name, no owner, road, station, side, edge, way outwards and section, every so many metres."""
    found = []
    for number, road in enumerate(surroundings.roads.roads):
        first = np.ceil(road.start_m / every_m) * every_m
        stations = np.arange(first, road.end_m + 1e-6, every_m)
        way = road.direction(stations)
        for side, word in ((-1, "left"), (1, "right")):
            half = road.edge_m(stations, np.full(len(stations), side))
            edges = road.place(stations, side * np.nan_to_num(half))
            outward = side * np.column_stack([way[:, 1], -way[:, 0]])
            for row in np.flatnonzero(np.isfinite(half)):
                section = surroundings.section(edges[row], outward[row], REACH_M)
                if section is not None:
                    name = f"{road.name} {stations[row]:.0f} {word}"
                    place = (float(stations[row]), side, edges[row], outward[row])
                    found.append((name, "", number, *place, section))
    return found


def geometry_table(surroundings: Surroundings, site: Hazard | None = None) -> pd.DataFrame:
    """Geometry of all roads by station, with lanes, speed and traffic.

    Parameters
    ----------
    site : states speed and traffic where the inventory does not; None: they are of no use here.

    Returns
    -------
    columns of `road_geometry`; values of `LANE_TITLES`: lanes as markings show them, else as the
    inventory states them (`with_inventory`), and the edges of the travelled way as distances from
    the centreline; paved_shoulder_m, the mean of both sides; `TRAFFIC_COLUMNS`, ranges where nobody
    states them. NaN where unknown
    """
    parts = []
    for number, road in enumerate(surroundings.roads.roads):
        table = surroundings.geometry(number)
        inventory = surroundings.inventory or NO_INVENTORY
        stations, paved = table["station_m"].to_numpy(), table["paved_width_m"].to_numpy()
        known = inventory.at(inventory.route_of(road), stations, site or Hazard())
        lanes = with_inventory(surroundings.marked(number), known, paved)
        ends = ("speed_low_kmh", "speed_high_kmh", "aadt_low", "aadt_high")
        traffic = known[list(ends)].set_axis(list(TRAFFIC_COLUMNS), axis=1)
        told = {name: lanes[own].to_numpy() for own, name in LANE_TITLES.items()}
        travelled = (lanes["left_m"] + lanes["right_m"]).to_numpy()
        table = table.assign(**told, paved_shoulder_m=(paved - travelled) / 2)
        parts.append(table.assign(**(traffic if site else traffic * np.nan)))
    if parts:
        return pd.concat(parts, ignore_index=True)
    columns = [*GEOMETRY_COLUMNS, *LANE_TITLES.values(), "paved_shoulder_m", *TRAFFIC_COLUMNS]
    return pd.DataFrame(columns=columns, dtype=np.float64)


def lanes_at(surroundings: Surroundings, located: Located, known: pd.DataFrame) -> pd.DataFrame:
    """Lanes at located objects, as `with_inventory`, by the nearest station.

    Parameters
    ----------
    known : lanes and lane_width_m of the inventory at each.
    """
    n = len(located.road)
    marked, paved = _no_lanes(n), np.full(n, np.nan)
    for number in np.unique(located.road[located.road >= 0]):
        geometry = surroundings.geometry(int(number))
        own = np.flatnonzero(located.road == number)
        if len(geometry):
            row = _nearest_rows(geometry, located.station_m[own])
            marked.iloc[own] = surroundings.marked(int(number)).iloc[row].to_numpy()
            paved[own] = geometry["paved_width_m"].to_numpy()[row]
    return with_inventory(marked, known, paved)


def _no_lanes(n: int) -> pd.DataFrame:
    return pd.DataFrame(np.full((n, len(LANE_COLUMNS)), np.nan), columns=list(LANE_COLUMNS))


def _nearest_rows(geometry: pd.DataFrame, station_m: Floats) -> Ints:
    """Row of the nearest station of a road's geometry (n,)."""
    at = geometry["station_m"].to_numpy()
    return np.asarray(np.abs(at[None, :] - station_m[:, None]).argmin(axis=1), np.int64)


def bends_at(surroundings: Surroundings, located: Located) -> pd.DataFrame:
    """Radius, whether on the outside of the bend, grade and paved width at located objects.

    Returns
    -------
    radius_m (infinite where straight or unknown), outside, grade (rise over run along the measure),
    paved_width_m
    """
    n = len(located.road)
    radius, outside = np.full(n, np.inf), np.zeros(n, bool)
    grade, width = np.full(n, np.nan), np.full(n, np.nan)
    for number in np.unique(located.road[located.road >= 0]):
        geometry = surroundings.geometry(int(number))
        own = np.flatnonzero(located.road == number)
        if not len(geometry):
            continue
        near = geometry.iloc[_nearest_rows(geometry, located.station_m[own])]
        curvature = near["curvature_per_km"].to_numpy() / 1000
        radius[own] = np.nan_to_num(near["radius_m"], nan=np.inf, posinf=np.inf)
        left_bend = curvature > 0
        outside[own] = np.isfinite(radius[own]) & (left_bend == (located.offset_m[own] > 0))
        grade[own] = near["grade_percent"].to_numpy() / 100
        width[own] = near["paved_width_m"].to_numpy()
    columns = {"radius_m": radius, "outside": outside, "grade": grade, "paved_width_m": width}
    return pd.DataFrame(columns)


def governing_slope(
    section: CrossSection | None, offset_m: float, mean_slope: float
) -> tuple[float, float]:
    """Slope that decides about an object, and its sigma: what a vehicle meets before it.

    The steepest foreslope before the object; else the steepest backslope; else the mean slope from
    edge to object (sigma NaN).
    """
    if section is None:
        return mean_slope, float("nan")
    reach = offset_m if np.isfinite(offset_m) else REACH_M
    for slope, sigma in (section.foreslope(reach), section.backslope(reach)):
        if np.isfinite(sigma):
            return slope, sigma
    level = [e for e in section.elements if e.start_m < reach and np.isfinite(e.slope)]
    if not level:
        return mean_slope, float("nan")
    widest = max(level, key=lambda e: min(e.end_m, reach) - e.start_m)
    return widest.slope, widest.sigma_slope


def runout_width_m(section: CrossSection | None, within_m: float) -> float:
    """Width of non-recoverable foreslopes (1V:4H to 1V:3H) that start within a clear zone.

    Vehicles do not stop on them: the guide gives their width back beyond the toe (RDG 3.2).
    """
    if section is None:
        return 0.0
    fores = [e for e in section.elements if e.kind == "foreslope" and e.start_m < within_m]
    steep = [e for e in fores if RECOVERABLE_SLOPE < -e.slope <= TRAVERSABLE_SLOPE]
    return float(sum(e.width_m for e in steep))


def first_trouble_m(section: CrossSection | None) -> float:
    """Distance from the edge to the first ground that cannot be driven; infinite for none.

    That is a foreslope steeper than 1V:3H, a wall, or a drop of 0.3 m and more.
    """
    if section is None:
        return float("inf")
    starts = [
        e.start_m
        for e in section.elements
        if (e.kind == "foreslope" and -e.slope > TRAVERSABLE_SLOPE)
        or e.kind == "wall"
        or (e.kind == "drop-off" and e.rise_m <= -0.3)
    ]
    return min(starts, default=float("inf"))


def nearest_ahead_m(
    road: Ints, side: Ints, station_m: Floats, offset_m: Floats, counted: Bools, window_m: float
) -> Floats:
    """Least offset of the counted objects of the same side within a window; infinite if none."""
    least = np.full(len(road), np.inf)
    for number in range(len(road)):
        near = counted & (road == road[number]) & (side == side[number])
        near &= np.abs(station_m - station_m[number]) <= window_m / 2
        if near.any():
            least[number] = float(np.nanmin(offset_m[near]))
    return least
