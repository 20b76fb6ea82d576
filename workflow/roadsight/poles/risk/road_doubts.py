"""What limits a hazard file: roads without inventory, edges, or lanes that all agree on."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd

from roadsight.base.doubts import Doubt, Severity, listed
from roadsight.base.sections.poles import Hazard
from roadsight.poles.risk.clear_zone import SPEED_RANGE_KMH
from roadsight.poles.risk.inventory import SAME_M, Inventory
from roadsight.poles.risk.marked_lanes import WINDOW_M
from roadsight.poles.risk.road_geometry import STATION_M
from roadsight.poles.risk.roads import Road
from roadsight.poles.risk.roadside import Surroundings

_Stretch = tuple[str, float, float]  # route, and the measures of its ends in metres
# Column, and its name in words.
_QUANTITIES = (("speed_kmh", "speed"), ("aadt", "AADT"), ("lanes", "number of lanes"))
# What a site may state of all roads.
_SETTINGS = {"speed": "design speed (hazard.design_speed_kmh)", "traffic": "traffic (hazard.aadt)"}
# What holds where nobody states it.
_WHOLE = {
    "speed": f"{SPEED_RANGE_KMH[0]:g} to {SPEED_RANGE_KMH[1]:g} km/h",
    "traffic": "any traffic",
}
# Where lanes begin or end, markings are judged by so much road, half of it on either side.
_MIXED_M = 2 * WINDOW_M


def inventory_doubts(
    inventory: Inventory, roads: Sequence[Road], lines: bool, site: Hazard
) -> list[Doubt]:
    """Doubts about what an inventory says of roads; what it lacks elsewhere is no matter.

    Parameters
    ----------
    lines : whether it or the user's routes say where its measures lie.
    site : states speed and traffic where the inventory does not; then it is a note.
    """
    said = {
        "speed_kmh": _follows(site, "speed"),
        "aadt": _follows(site, "traffic"),
        "lanes": ("note", "where markings do not show it, it is unknown"),
    }
    severity, follows = _follows(site, "speed", "traffic")
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
            f" {listed(inventory.routes())}): {follows}; name the drives after"
            " the route, or give roads.routes; m of road"
        )
        length = sum(road.end_m - road.start_m for road in unnamed)
        found.append(Doubt("road_unnamed", severity, text, round(length, 1), SAME_M))
    own = inventory.segments
    covered = [(road, own[own["route"] == route]) for road, route in named if route is not None]
    gaps = [gap for road, segments in covered for gap in _unstated(segments, road)]
    if gaps:
        stated = [
            (str(rows["route"].iloc[0]), float(rows["from_m"].min()), float(rows["to_m"].max()))
            for _, rows in covered
        ]
        text = (
            f"the inventory states nothing for {_told(gaps)}:"
            f" {follows}; it states {_told(stated)}; m of road"
        )
        found.append(Doubt("inventory_gaps", severity, text, _length_m(gaps), SAME_M))
    for column, title in _QUANTITIES:
        severity, follows = said[column]
        lacking = [
            part for road, rows in covered for part in _clipped(rows[rows[column].isna()], road)
        ]
        if lacking:
            text = f"the inventory states no {title} for {_told(lacking)}: {follows}; m of road"
            code = f"inventory_without_{column.removesuffix('_kmh')}"
            found.append(Doubt(code, severity, text, _length_m(lacking), SAME_M))
    return found


def _follows(site: Hazard, *lacking: str) -> tuple[Severity, str]:
    """How grave it is that an inventory lacks what a site may state, and what follows."""
    stated = _stated_by(site)
    if set(lacking) <= set(stated):
        return "note", f"the site's {' and '.join(stated[name] for name in lacking)} hold there"
    follows = _unstated_means(site, [name for name in lacking if name not in stated])
    if not follows:
        return "note", "the site's clear zone and runout length hold there"
    return "doubt", f"{follows} there"


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


def traffic_doubts(site: Hazard) -> list[Doubt]:
    """What no inventory states: a note where the site does for all roads, a doubt where none."""
    stated = _stated_by(site)
    found = []
    if stated:
        text = (
            "no inventory is given (roads.inventory): what the site states holds for all roads,"
            " which nothing measured"
        )
        found.append(Doubt("traffic_by_settings", "note", text, ", ".join(stated.values())))
    lacking = [name for name in _SETTINGS if name not in stated]
    follows = _unstated_means(site, lacking)
    if follows:
        named = " and no ".join(_SETTINGS[name] for name in lacking)
        text = f"no inventory is given (roads.inventory), and the site states no {named}: {follows}"
        found.append(Doubt("traffic_not_stated", "doubt", text))
    return found


def _stated_by(site: Hazard) -> dict[str, str]:
    """Speed and traffic as far as the site states them, in words."""
    found = {}
    if site.design_speed_kmh is not None:
        found["speed"] = f"{site.design_speed_kmh:g} km/h"
    if site.aadt is not None:
        found["traffic"] = f"{site.aadt:,.0f} vehicles a day"
    return found


def _unstated_means(site: Hazard, lacking: Sequence[str]) -> str:
    """What follows where speed or traffic are stated by nobody; empty for nothing."""
    if lacking and not site.clear_zone_m:
        also = ", ratings and exposure" if "traffic" in lacking else " and ratings"
        return f"clear zones{also} are ranges for {' and '.join(_WHOLE[name] for name in lacking)}"
    if "traffic" in lacking:
        return "exposure is a range"
    if lacking and not site.runout_length_m:
        return "barriers are judged by the longest runout lengths"
    return ""


def lane_doubts(surroundings: Surroundings) -> list[Doubt]:
    """A doubt where markings show another number of lanes than the inventory states."""
    if surroundings.inventory is None:
        return []
    found: list[str] = []
    length_m = 0.0
    for number, road in enumerate(surroundings.roads.roads):
        station_m = surroundings.geometry(number)["station_m"].to_numpy()
        known = surroundings.inventory.at(surroundings.inventory.route_of(road), station_m)
        stated, shown = (
            lanes.to_numpy() for lanes in (known["lanes"], surroundings.marked(number)["lanes"])
        )
        differ = np.isfinite(stated) & np.isfinite(shown) & (stated != shown)
        ends = np.flatnonzero(np.diff(np.r_[False, differ, False].astype(np.int8)))
        for start, end in ends.reshape(-1, 2):
            stretch = (road.name, station_m[start], station_m[end - 1])
            found.append(f"{_told([stretch])} ({shown[start]:.0f}, not {stated[start]:.0f})")
        length_m += STATION_M * float(differ.sum())
    if length_m <= _MIXED_M:
        return []
    text = (
        f"markings show another number of lanes than the inventory states for {listed(found)}:"
        " what they show is taken; m of road"
    )
    return [Doubt("lanes_contradicted", "doubt", text, length_m, _MIXED_M)]


def edge_doubts(roads: Sequence[Road]) -> list[Doubt]:
    """A doubt where roads have no edge, not even one carried over a gap."""
    lacking = [road for road in roads if _bare_m(road) > 0]
    if not lacking:
        return []
    text = (
        f"no edge of road {listed([road.name for road in lacking])} is known along parts of it:"
        " offsets there are from the nearest edge of any pavement, and markings there tell no"
        " lanes; m of roadside"
    )
    length = round(sum(_bare_m(road) for road in lacking), 1)
    return [Doubt("road_without_edge", "doubt", text, length, 0)]


def _bare_m(road: Road) -> float:
    """Length of roadside, of both sides, along which no edge is known."""
    sides = (np.full(len(road.station_m), side) for side in (-1, 1))
    bare = [np.isnan(road.bridged_edge_m(road.station_m, side)).mean() for side in sides]
    return float(sum(bare)) * (road.end_m - road.start_m)


def _told(stretches: Sequence[_Stretch]) -> str:
    return listed([f"{route} from {low:.0f} to {high:.0f} m" for route, low, high in stretches])


def _length_m(stretches: Sequence[_Stretch]) -> float:
    return round(sum(high - low for _, low, high in stretches), 1)
