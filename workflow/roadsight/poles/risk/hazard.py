"""How dangerous objects beside the road are to vehicles that leave it.

Rating, first rule that applies:

- low: behind a barrier along its length of need;
- high: inside the clear zone and at most half its width from the road edge, or inside it on or
  beyond a foreslope from which vehicles cannot return, or inside it where fixed objects stand
  denser than ``dense_per_km``;
- medium: otherwise inside the clear zone, or outside it by less than the pole's own 1-sigma error,
  or beyond a foreslope steeper than 1V:3H;
- low: otherwise. ``unknown`` where no road edge is near.

The foreslope is the steepest straight piece of the cross-section before the object, not the line
from edge to object. Where speed or traffic is unknown the clear zone is a range: high asks for
the least, medium for the greatest clear zone of the range; ``rating_greatest`` asks for the
greatest throughout.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from roadsight.base.arrays import Bools, Floats, Ints
from roadsight.base.sections.poles import Hazard
from roadsight.poles.risk.clear_zone import (
    TRAVERSABLE_SLOPE,
    clear_zone_range,
    curve_factor,
    slope_class,
)
from roadsight.poles.risk.cross_sections import CrossSection, Height, slope_text
from roadsight.poles.risk.inventory import NO_INVENTORY
from roadsight.poles.risk.roads import Located, Roads
from roadsight.poles.risk.roadside import (
    Edges,
    Surroundings,
    bends_at,
    edges_at,
    first_trouble_m,
    governing_slope,
    lanes_at,
    nearest_ahead_m,
    object_sections,
    runout_width_m,
)
from roadsight.poles.risk.roadside_rating import (
    Encroachments,
    exposure,
    fixed_objects,
    hazard_rating,
    leaving,
    offset_factor,
    rank_of,
    rating_factor,
)
from roadsight.poles.risk.shielding import Demand, shielding

# The rating in words, as written into results.
RULE = __doc__.split("\n\n", 1)[1].strip() if __doc__ else ""
# What every version of the table has.
HAZARD_COLUMNS = [
    "offset_m", "side", "clear_zone_m", "inside_clear_zone", "slope_rise_over_run", "slope_class",
    "station_m", "objects_per_km", "rating",
]  # fmt: skip
_NAN = float("nan")
# Columns that tell an object's cross-section, and what they hold where there is none.
_UNKNOWN: dict[str, float | str] = {
    "foreslope_rise_over_run": _NAN,
    "sigma_foreslope": _NAN,
    "foreslope_ratio": "",
    "steepest_fall_1_5m_rise_over_run": _NAN,
    "sigma_steepest_fall": _NAN,
    "shoulder_width_m": _NAN,
    "ditch_depth_m": _NAN,
    "ditch_bottom_width_m": _NAN,
    "backslope_rise_over_run": _NAN,
    "kerb_m": _NAN,
    "drop_off_m": _NAN,
}
# What is told besides, with units in the names; see docs/poles/hazard.md.
ROADSIDE_COLUMNS = [
    "rating_greatest",
    "rank",
    "route",
    "shielded",
    "barrier_offset_m",
    "hazard_rating_1_to_7",
    "hazard_rating_least",
    "hazard_rating_greatest",
    "clear_zone_least_m",
    "clear_zone_greatest_m",
    "curve_factor",
    *_UNKNOWN,
    "design_speed_least_kmh",
    "design_speed_greatest_kmh",
    "aadt_least",
    "aadt_greatest",
    "lanes",
    "lanes_from",
    "carriageway",
    "offset_travelled_way_m",
    "sigma_travelled_way_m",
    "travelled_way_from",
    "radius_m",
    "grade_percent",
    "paved_width_m",
    "exposure_least_vehicles_per_day",
    "exposure_greatest_vehicles_per_day",
    "hsm_rating_factor",
    "hsm_offset_factor",
    "hsm_objects_per_mile",
    "hsm_mean_offset_m",
    "reasons",
]
# Stretch of road for the density of the Highway Safety Manual: its shortest segment is 0.1 mile;
# 0.2 miles let one object more or less change the density by 5 a mile, not 10.
_HSM_WINDOW_M = 322.0


_EDGE_REACH_M = 30.0  # a road edge further away is not the pole's
_SAMPLE_M = 0.5  # spacing of height samples between edge and pole


@dataclass(frozen=True)
class Rated:
    """Rated objects and what their rating rests on.

    Parameters
    ----------
    table : `HAZARD_COLUMNS` and `ROADSIDE_COLUMNS`. sections : cross-section of each, or None.
    edge_m, outward : (n, 2) where each section starts, and which way it runs. located : on roads.
    """

    table: pd.DataFrame
    sections: list[CrossSection | None] = field(repr=False)
    edge_m: Floats = field(repr=False)
    outward: Floats = field(repr=False)
    located: Located = field(repr=False)


def rate_roadside(
    poles: pd.DataFrame, edges_m: Floats, surroundings: Surroundings, settings: Hazard
) -> Rated:
    """Hazard of each object, with the cross-sections behind it.

    Parameters
    ----------
    poles : x, y (local metres) and sigma_major_m. edges_m : road edge points (n, 2 or 3).

    Returns
    -------
    table : columns `HAZARD_COLUMNS` and `ROADSIDE_COLUMNS`, rows as ``poles``. ``offset_m`` is
        negative on the road; ``side`` and ``station_m`` are along ``route``, whose measure both
        directions share.
    """
    xy_m = poles[["x", "y"]].to_numpy(np.float64)
    n, roads = len(poles), surroundings.roads
    located = roads.locate(xy_m)
    edges = edges_at(roads, located, xy_m, edges_m, _EDGE_REACH_M)
    offset_m = edges.offset_m
    mean_slope = side_slopes(edges.place_m, xy_m, surroundings.height, _SAMPLE_M)
    sections = object_sections(surroundings, edges.place_m, edges.outward, offset_m)
    governing = [
        governing_slope(section, offset, mean)
        for section, offset, mean in zip(sections, offset_m, mean_slope, strict=True)
    ]
    slope, sigma_slope = np.array(governing, np.float64).reshape(n, 2).T
    bends = bends_at(surroundings, located)
    known = _known_traffic(surroundings, located, settings)
    zone = _zones(slope, sigma_slope, sections, bends, known, settings.clear_zone_m)
    sigma_m = np.nan_to_num(poles["sigma_major_m"].to_numpy(np.float64))
    one_way = (known["carriageway"] == "one-way").to_numpy()
    # 1 where the traffic beside an object runs with rising measure, else -1.
    ways = np.array([road.travel for road in roads.roads] or [1])
    travel = np.where((located.side >= 0) != surroundings.left_hand_traffic, 1.0, -1.0)
    travel = np.where(one_way, ways[np.maximum(located.road, 0)], travel)
    shield = _shields(surroundings, located, edges, zone, known, travel, settings)
    shielded = np.array([status == "full" for status, _, _ in shield], bool)
    inside = (offset_m <= zone["clear_zone_m"].to_numpy()) if n else np.zeros(0, bool)
    density = _density(roads, located, inside & ~shielded, settings.window_m)
    rating, greatest = (
        _rating(offset_m, bounds, slope, density, sigma_m, settings, shielded)
        for bounds in (zone, zone.assign(sure_m=zone["clear_zone_m"]))
    )
    rhr = _hazard_ratings(
        located, offset_m, sigma_m, slope, sigma_slope, sections, shield, settings.window_m
    )
    weight = leaving(
        offset_m,
        bends["radius_m"].to_numpy(),
        bends["outside"].to_numpy(),
        bends["grade"].to_numpy() * travel,
        Encroachments(settings.bend_outside, settings.bend_inside, settings.downhill),
    )
    least, most = (
        exposure(known[f"aadt_{end}"].to_numpy(), weight, one_way) for end in ("low", "high")
    )
    exposed = np.where(least == most, most, np.nan)
    hsm = _hsm(located, roads, offset_m, ~shielded)
    lanes = lanes_at(surroundings, located, known)
    travelled = beside_travelled_way(located.offset_m, lanes)
    told = [_described(section) for section in sections]
    names = np.array([*(road.name for road in roads.roads), ""], object)
    table = pd.DataFrame(
        {
            "offset_m": offset_m,
            "side": located.side,
            "clear_zone_m": zone["clear_zone_m"].to_numpy(),
            "inside_clear_zone": inside,
            "slope_rise_over_run": mean_slope,
            "slope_class": slope_class(slope),
            "station_m": located.station_m,
            "objects_per_km": density,
            "rating": rating,
            "rating_greatest": greatest,
            "rank": rank_of(rating, rhr[:, 0], exposed, weight),
            "route": names[located.road],
            "shielded": np.array([status for status, _, _ in shield], object),
            "barrier_offset_m": np.array([offset for _, offset, _ in shield], np.float64),
            "hazard_rating_1_to_7": rhr[:, 0],
            "hazard_rating_least": rhr[:, 1],
            "hazard_rating_greatest": rhr[:, 2],
            "clear_zone_least_m": zone["least_m"].to_numpy(),
            "clear_zone_greatest_m": zone["greatest_m"].to_numpy(),
            "curve_factor": zone["factor"].to_numpy(),
            **{
                name: np.array([row[name] for row in told], object if none == "" else np.float64)
                for name, none in _UNKNOWN.items()
            },
            "design_speed_least_kmh": known["speed_low_kmh"].to_numpy(),
            "design_speed_greatest_kmh": known["speed_high_kmh"].to_numpy(),
            "aadt_least": known["aadt_low"].to_numpy(),
            "aadt_greatest": known["aadt_high"].to_numpy(),
            "lanes": lanes["lanes"].to_numpy(),
            "lanes_from": lanes["lanes_from"].to_numpy(),
            "carriageway": known["carriageway"].to_numpy(),
            **travelled,
            "radius_m": bends["radius_m"].to_numpy(),
            "grade_percent": 100 * bends["grade"].to_numpy(),
            "paved_width_m": bends["paved_width_m"].to_numpy(),
            "exposure_least_vehicles_per_day": least,
            "exposure_greatest_vehicles_per_day": most,
            "hsm_rating_factor": rating_factor(rhr[:, 0]),
            "hsm_offset_factor": np.where(
                np.isnan(offset_m), np.nan, offset_factor(np.maximum(offset_m, 0.0))
            ),
            **hsm,
        },
        index=poles.index,
    )
    table["reasons"] = [
        _reason(row, zone.iloc[n], shield[n], slope[n], sigma_slope[n], sections[n], settings)
        for n, (_, row) in enumerate(table.iterrows())
    ]
    columns = [*HAZARD_COLUMNS, *ROADSIDE_COLUMNS]
    return Rated(table[columns], sections, edges.place_m, edges.outward, located)


def side_slopes(foot_m: Floats, xy_m: Floats, height: Height | None, sample_m: float) -> Floats:
    """Rise over run from road edge to pole, by least squares over heights between them.

    Negative falls away from the road. NaN where fewer than three heights are known or the pole is
    nearer than three samples.
    """
    slopes = np.full(len(xy_m), np.nan)
    if height is None:
        return slopes
    run_m = np.hypot(*(xy_m - foot_m).T)
    for number in np.flatnonzero(run_m >= 2 * sample_m):
        run = np.linspace(0.0, run_m[number], int(run_m[number] / sample_m) + 1)
        way = (xy_m[number] - foot_m[number]) / run_m[number]
        places = foot_m[number] + run[:, None] * way
        heights = np.asarray(height(places[:, 0], places[:, 1]), np.float64)
        known = np.isfinite(heights)
        if known.sum() >= 3:
            centred = run[known] - run[known].mean()
            slopes[number] = (
                centred @ (heights[known] - heights[known].mean()) / (centred @ centred)
            )
    return slopes


def _known_traffic(surroundings: Surroundings, located: Located, settings: Hazard) -> pd.DataFrame:
    """Speed and traffic at each object: of the inventory, else of the site, else a range."""
    inventory = surroundings.inventory or NO_INVENTORY
    known = inventory.at(None, np.full(len(located.road), np.nan), settings)
    for number in np.unique(located.road[located.road >= 0]):
        own = np.flatnonzero(located.road == number)
        route = inventory.route_of(surroundings.roads.roads[number])
        found = inventory.at(route, located.station_m[own], settings)
        for name in known.columns:
            values = known[name].to_numpy().copy()
            values[own] = found[name].to_numpy()
            known[name] = values
    known["carriageway"] = known["carriageway"].replace("", surroundings.carriageway)
    return known


def _zones(
    slope: Floats,
    sigma_slope: Floats,
    sections: list[CrossSection | None],
    bends: pd.DataFrame,
    known: pd.DataFrame,
    given_m: float = 0.0,
) -> pd.DataFrame:
    """Clear zone of each object: of the guide's tables, or everywhere as given (``given_m``).

    Returns
    -------
    clear_zone_m (greatest for the measured slope), sure_m (least for it), least_m and greatest_m
    (within one sigma of the slope too), factor (of the bend), runout_m (added)
    """
    names = ["clear_zone_m", "sure_m", "least_m", "greatest_m", "factor", "runout_m"]
    if given_m > 0:
        same = [*[np.full(len(slope), given_m)] * 4, np.ones(len(slope)), np.zeros(len(slope))]
        return pd.DataFrame(dict(zip(names, same, strict=True)))
    rows = []
    for number in range(len(slope)):
        speed = (known["speed_low_kmh"].iloc[number], known["speed_high_kmh"].iloc[number])
        aadt = (known["aadt_low"].iloc[number], known["aadt_high"].iloc[number])
        radius, outside = bends["radius_m"].iloc[number], bool(bends["outside"].iloc[number])
        own = float(np.nan_to_num(slope[number]))
        spread = float(np.nan_to_num(sigma_slope[number]))
        sure, zone = clear_zone_range(speed, aadt, (own, own), radius, outside)
        more = runout_width_m(sections[number], zone)
        slopes = (own - spread, own + spread)
        least, greatest = clear_zone_range(speed, aadt, slopes, radius, outside)
        factor = float(curve_factor([radius], speed[1], [outside])[0])
        ends = (zone + more, sure + more, min(least, sure) + more, max(greatest, zone) + more)
        rows.append((*ends, factor, more))
    return pd.DataFrame(np.array(rows, np.float64).reshape(-1, 6), columns=names)


def _shields(
    surroundings: Surroundings,
    located: Located,
    edges: Edges,
    zone: pd.DataFrame,
    known: pd.DataFrame,
    travel: Floats,
    settings: Hazard,
) -> list[tuple[str, float, str]]:
    """Shielding of each object: status, offset of the barrier, why."""
    none = ("none", float("nan"), "")
    found = []
    for number, offset in enumerate(edges.offset_m):
        if located.road[number] < 0 or not np.isfinite(offset):
            found.append(none)
            continue
        demand = Demand(
            int(located.road[number]),
            int(located.side[number]),
            float(located.station_m[number]),
            float(offset),
            float(zone["greatest_m"].iloc[number]),
            float(known["speed_high_kmh"].iloc[number]),
            float(known["aadt_high"].iloc[number]),
            float(edges.half_m[number]),
            from_low=bool(travel[number] > 0),
            divided=known["carriageway"].iloc[number] != "two-way",
            runout_length_m=settings.runout_length_m,
            deflection_m=settings.deflection_m,
        )
        found.append(shielding(demand, surroundings.barriers))
    return found


def _density(roads: Roads, located: Located, counted: Bools, window_m: float) -> Floats:
    """Counted objects for each kilometre of road in a window around each; NaN without a road.

    At the ends of a road the window is only as long as the road reaches.
    """
    density = np.full(len(counted), np.nan)
    for number, road in enumerate(roads.roads):
        rows = np.flatnonzero(located.road == number)
        held = np.clip(located.station_m, road.start_m, road.end_m)
        stations = np.sort(held[rows[counted[rows]]])
        low, high = held[rows] - window_m / 2, held[rows] + window_m / 2
        count = np.searchsorted(stations, high, "right") - np.searchsorted(stations, low, "left")
        length_m = np.minimum(high, road.end_m) - np.maximum(low, road.start_m)
        density[rows] = count / np.maximum(length_m, 1e-3) * 1000
    return density


def _rating(
    offset_m: Floats,
    zone: pd.DataFrame,
    slope: Floats,
    density: Floats,
    sigma_m: Floats,
    settings: Hazard,
    shielded: Bools,
) -> NDArray[np.object_]:
    greatest, sure = zone["clear_zone_m"].to_numpy(), zone["sure_m"].to_numpy()
    inside, surely = offset_m <= greatest, offset_m <= sure
    kind = slope_class(slope)
    no_return = np.isin(kind, ["non-recoverable", "critical"])
    crowded = np.nan_to_num(density) > settings.dense_per_km
    near = offset_m - sigma_m <= greatest
    conditions = [
        np.isnan(offset_m),
        shielded,
        surely & ((offset_m <= sure / 2) | no_return | crowded),
        inside | near | (kind == "critical"),
    ]
    return np.select(conditions, ["unknown", "low", "high", "medium"], "low").astype(object)


def _hazard_ratings(
    located: Located,
    offset_m: Floats,
    sigma_m: Floats,
    slope: Floats,
    sigma_slope: Floats,
    sections: list[CrossSection | None],
    shield: list[tuple[str, float, str]],
    window_m: float,
) -> Ints:
    """Roadside hazard rating (n, 3) at each object: as measured, least, greatest within a sigma."""
    n = len(offset_m)
    if n == 0:
        return np.zeros((0, 3), np.int64)
    free = np.array([status != "full" for status, _, _ in shield], bool)
    counted = free & np.isfinite(offset_m)
    place = (located.road, located.side, located.station_m)
    trouble = np.array([first_trouble_m(section) for section in sections])
    # What a barrier shields in part may be hit beside or behind it: only a full one counts.
    rail = np.array([rail if status == "full" else np.nan for status, rail, _ in shield], float)
    unknown = np.isnan(offset_m)
    spread = np.nan_to_num(sigma_slope)
    found = []
    for sign in (0.0, 1.0, -1.0):
        objects = nearest_ahead_m(*place, offset_m + sign * sigma_m, counted, window_m)
        clear = np.where(unknown, np.nan, np.maximum(np.minimum(objects, trouble), 0.0))
        found.append(hazard_rating(clear, np.minimum(slope + sign * spread, 0.0), rail))
    ratings = np.column_stack(found)
    ratings[unknown] = 0
    ratings[:, 1] = ratings.min(axis=1)
    ratings[:, 2] = ratings.max(axis=1)
    return ratings


def _hsm(located: Located, roads: Roads, offset_m: Floats, counted: Bools) -> dict[str, Floats]:
    """Density and mean offset of fixed objects of both sides around each object."""
    per_mile, mean = np.full(len(offset_m), np.nan), np.full(len(offset_m), np.nan)
    for number in range(len(offset_m)):
        if located.road[number] < 0:
            continue
        road = roads.roads[located.road[number]]
        low = max(located.station_m[number] - _HSM_WINDOW_M / 2, road.start_m)
        high = min(located.station_m[number] + _HSM_WINDOW_M / 2, road.end_m)
        near = counted & np.isfinite(offset_m) & (located.road == located.road[number])
        near &= (located.station_m >= low) & (located.station_m <= high)
        found = fixed_objects(located.station_m, offset_m, near, max(high - low, 1.0))
        per_mile[number], mean[number] = found["objects_per_mile"], found["mean_offset_m"]
    return {"hsm_objects_per_mile": per_mile, "hsm_mean_offset_m": mean}


def beside_travelled_way(offset_m: Floats, lanes: pd.DataFrame) -> dict[str, NDArray]:
    """Distance (n,) from the travelled way's edge on an object's side, and how it is known.

    Parameters
    ----------
    offset_m : from the centreline, positive right. lanes : see `with_inventory`.

    Returns
    -------
    offset_travelled_way_m; sigma_travelled_way_m, of the edge, NaN where an inventory states it;
    travelled_way_from, empty where nobody does
    """
    edge, sigma, told_by = (
        np.where(offset_m < 0, lanes[name.format("left")], lanes[name.format("right")])
        for name in ("{}_m", "sigma_{}_m", "{}_from")
    )
    return {
        "offset_travelled_way_m": np.asarray(np.abs(offset_m) - edge, np.float64),
        "sigma_travelled_way_m": np.asarray(sigma, np.float64),
        "travelled_way_from": np.where(np.isnan(offset_m), "", told_by).astype(object),
    }


def _described(section: CrossSection | None) -> dict[str, Any]:
    """What is told about one cross-section: values of `_UNKNOWN`; 0 for what is not there."""
    if section is None:
        return dict(_UNKNOWN)
    fore, sigma = section.foreslope()
    heights = section.pieces.height_m(section.pieces.ends_m)
    steps = section.steps()
    has_ditch = any(e.kind == "backslope" for e in section.elements)
    return {
        "foreslope_rise_over_run": fore,
        "sigma_foreslope": sigma,
        "foreslope_ratio": slope_text(fore),
        "steepest_fall_1_5m_rise_over_run": section.fall[0],
        "sigma_steepest_fall": section.fall[1],
        "shoulder_width_m": section.width_m("shoulder"),
        "ditch_depth_m": float(heights[0] - heights.min()) if has_ditch else 0.0,
        "ditch_bottom_width_m": section.width_m("ditch bottom"),
        "backslope_rise_over_run": section.backslope()[0],
        "kerb_m": max((e.rise_m for e in steps if e.kind in ("kerb", "wall")), default=0.0),
        "drop_off_m": max((-e.rise_m for e in steps if e.kind == "drop-off"), default=0.0),
    }


def _reason(
    row: pd.Series,
    zone: pd.Series,
    shield: tuple[str, float, str],
    slope: float,
    sigma: float,
    section: CrossSection | None,
    settings: Hazard,
) -> str:
    """Why an object is rated as it is, in words; marks in brackets name the source of a rule."""
    if np.isnan(row["offset_m"]):
        return "no road edge is near"
    said = []
    if shield[0] != "none":
        said.append(f"{shield[2]} [RDG 5]")
    said.append(_zone_words(row, zone, "site" if settings.clear_zone_m > 0 else "RDG 3.1"))
    kind = row["slope_class"]
    if kind in ("critical", "non-recoverable"):
        spread = f" (± {sigma:.2f})" if np.isfinite(sigma) else ""
        said.append(
            f"foreslope of {slope_text(slope)}{spread} before it, {kind}:"
            f" steeper than {'1V:3H' if -slope > TRAVERSABLE_SLOPE else '1V:4H'} [RDG 3.3]"
        )
    elif section is None:
        said.append("the ground before it is unknown")
    if zone["runout_m"] > 0:
        said.append(f"{zone['runout_m']:.1f} m of non-recoverable slope are added [RDG 3.3]")
    if zone["factor"] > 1:
        said.append(
            f"outside of a bend of {row['radius_m']:.0f} m: clear zone times"
            f" {zone['factor']:.1f} [RDG 3.2]"
        )
    if row["inside_clear_zone"] and row["objects_per_km"] > settings.dense_per_km:
        said.append(
            f"{row['objects_per_km']:.0f} fixed objects a kilometre here, more than"
            f" {settings.dense_per_km:.0f} [site]"
        )
    if row["drop_off_m"] > 0:
        said.append(f"drop-off of {row['drop_off_m']:.2f} m [FHWA SE]")
    if row["hazard_rating_1_to_7"] >= 5:
        said.append(f"roadside hazard rating {row['hazard_rating_1_to_7']} of 7 [FHWA RHR]")
    return "; ".join(said)


def _zone_words(row: pd.Series, zone: pd.Series, source: str) -> str:
    low, high = zone["least_m"], zone["greatest_m"]
    width = f"{high:.1f} m" if high - low < 0.05 else f"{low:.1f} to {high:.1f} m"
    place = "on the road" if row["offset_m"] < 0 else f"{row['offset_m']:.1f} m from the edge"
    if low < row["offset_m"] <= high:
        verdict = f"perhaps inside the clear zone of {width}"
    else:
        inside = row["offset_m"] <= low
        verdict = f"{'inside' if inside else 'outside'} the clear zone of {width}"
    return f"{place}, {verdict} [{source}]"
