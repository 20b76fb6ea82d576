"""What limits a hazard file: roads that no inventory covers, and roads without edges."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd

from roadsight.base.doubts import Doubt, Severity, listed
from roadsight.poles.risk.inventory import SAME_M, Inventory
from roadsight.poles.risk.roads import Road

_Stretch = tuple[str, float, float]
"""Route, and the measures of its ends in metres."""

_QUANTITIES: tuple[tuple[str, str, Severity, str], ...] = (
    ("speed_kmh", "speed", "doubt", "clear zones there are ranges"),
    ("aadt", "AADT", "doubt", "clear zones there are ranges"),
    ("lanes", "number of lanes", "note", "two lanes are not assumed"),
)
"""Column, its name in words, how grave it is that it lacks, and what follows."""


def inventory_doubts(inventory: Inventory, roads: Sequence[Road], lines: bool) -> list[Doubt]:
    """Doubts about what an inventory says of roads; what it lacks elsewhere is no matter.

    Parameters
    ----------
    lines : whether it or the user's routes say where its measures lie.
    """
    found: list[Doubt] = []
    if not lines:
        text = (
            "measures of the inventory are counted from each road's first image, for it has no"
            " lines and no routes are given (roads.routes); routes with lines"
        )
        found.append(Doubt("measures_from_first_image", "doubt", text, 0, 1))
    named = [(road, inventory.route_of(road)) for road in roads]
    unnamed = [road for road, route in named if route is None]
    if unnamed:
        text = (
            f"the inventory does not name road {listed([road.name for road in unnamed])} (it names"
            f" {listed(inventory.routes())}): clear zones there are ranges; name the drives after"
            " the route, or give roads.routes; m of road"
        )
        length = sum(road.end_m - road.start_m for road in unnamed)
        found.append(Doubt("road_unnamed", "doubt", text, round(length, 1), SAME_M))
    own = inventory.segments
    covered = [(road, own[own["route"] == route]) for road, route in named if route is not None]
    gaps = [gap for road, segments in covered for gap in _unstated(segments, road)]
    if gaps:
        text = (
            f"the inventory states nothing for {_told(gaps)}:"
            f" clear zones there are ranges; it states {_told(_stated(covered))}; m of road"
        )
        found.append(Doubt("inventory_gaps", "doubt", text, _length_m(gaps), SAME_M))
    for column, title, severity, follows in _QUANTITIES:
        lacking = [
            part for road, rows in covered for part in _clipped(rows[rows[column].isna()], road)
        ]
        if lacking:
            text = f"the inventory states no {title} for {_told(lacking)}: {follows}; m of road"
            code = f"inventory_without_{column.removesuffix('_kmh')}"
            found.append(Doubt(code, severity, text, _length_m(lacking), SAME_M))
    return found


def traffic_notes(inventory: Inventory | None, speed_kmh: float, aadt: float) -> list[Doubt]:
    """A note that one speed and one traffic hold for all roads, where no inventory is given."""
    if inventory is not None:
        return []
    text = (
        "no inventory is given (roads.inventory): one design speed and one traffic hold for all"
        " roads (hazard.design_speed_kmh, hazard.aadt), which nothing measured"
    )
    told = f"{speed_kmh:g} km/h, {aadt:g} vehicles a day"
    return [Doubt("traffic_by_settings", "note", text, told)]


def edge_doubts(roads: Sequence[Road]) -> list[Doubt]:
    """A doubt where roads have no edge, not even one carried over a gap."""
    lacking = [road for road in roads if _bare_m(road) > 0]
    if not lacking:
        return []
    text = (
        f"no edge of road {listed([road.name for road in lacking])} is known along parts of it:"
        " offsets there are from the nearest edge of any pavement; m of roadside"
    )
    length = round(sum(_bare_m(road) for road in lacking), 1)
    return [Doubt("road_without_edge", "doubt", text, length, 0)]


def _bare_m(road: Road) -> float:
    """Length of roadside, of both sides, along which no edge is known."""
    sides = (np.full(len(road.station_m), side) for side in (-1, 1))
    bare = [np.isnan(road.bridged_edge_m(road.station_m, side)).mean() for side in sides]
    return float(sum(bare)) * (road.end_m - road.start_m)


def _unstated(segments: pd.DataFrame, road: Road) -> list[_Stretch]:
    """Stretches of a road between and beyond the segments of its route, which are in order."""
    found, reached = [], road.start_m
    route = str(segments["route"].iloc[0])
    for start, end in [*zip(segments["from_m"], segments["to_m"], strict=True), (road.end_m,) * 2]:
        if min(start, road.end_m) - reached > SAME_M:
            found.append((route, reached, float(min(start, road.end_m))))
        reached = max(reached, float(end))
    return found


def _clipped(segments: pd.DataFrame, road: Road) -> list[_Stretch]:
    """Segments as far as they lie on a road; those that follow each other are one."""
    found: list[_Stretch] = []
    low = segments["from_m"].clip(lower=road.start_m)
    high = segments["to_m"].clip(upper=road.end_m)
    for route, start, end in zip(segments["route"], low, high, strict=True):
        if end - start <= SAME_M:
            continue
        if found and start - found[-1][2] <= SAME_M:
            found[-1] = (route, found[-1][1], float(end))
        else:
            found.append((route, float(start), float(end)))
    return found


def _stated(covered: Sequence[tuple[Road, pd.DataFrame]]) -> list[_Stretch]:
    """From where to where each route is stated."""
    return [
        (str(rows["route"].iloc[0]), float(rows["from_m"].min()), float(rows["to_m"].max()))
        for _, rows in covered
    ]


def _told(stretches: Sequence[_Stretch]) -> str:
    return listed([f"{route} from {low:.0f} to {high:.0f} m" for route, low, high in stretches])


def _length_m(stretches: Sequence[_Stretch]) -> float:
    return round(sum(high - low for _, low, high in stretches), 1)
