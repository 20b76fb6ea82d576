"""Speed, traffic and lanes along roads, as a road inventory states them by measures.

What neither an inventory nor the site states stays unknown: it gives ranges (`SPEED_RANGE_KMH`,
`AADT_RANGE`), not guesses. What contradicts itself is refused.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
import pandas as pd

from roadsight.base.arrays import Floats, Ints, Numbers
from roadsight.base.errors import InputError
from roadsight.base.sections.poles import Hazard
from roadsight.poles.risk.clear_zone import AADT_RANGE, SPEED_RANGE_KMH
from roadsight.poles.risk.roads import Road

# Of an inventory; numbers but from and to NaN where unknown, carriageway empty.
COLUMNS = ("route", "from_m", "to_m", "speed_kmh", "aadt", "lanes", "lane_width_m", "carriageway")
Carriageway = Literal["two-way", "divided", "one-way"]
# What traffic a road has: of both directions; the same, but none reaches the other's side; of one,
# which is that of its longest drive, and AADT is its own.
CARRIAGEWAYS: tuple[Carriageway, ...] = get_args(Carriageway)
# Segments may overlap or leave gaps up to this: measures in thousandths of a mile are 1.6 m, those
# in centimetres nothing.
SAME_M = 0.5
# Other values are slips of unit or column.
LIMITS = {
    "speed_kmh": (20.0, 140.0),
    "aadt": (0.0, 500_000.0),
    "lanes": (1.0, 20.0),
    "lane_width_m": (2.0, 6.0),
}
_NOT_STATED = Hazard()
# What route names of drives end in, after a digit or a mark: SR1427E, I40-EB, 12_n.
_DIRECTION = re.compile(r"(?:(?<=\d)|[-_ ])(?:[nsew]b?|[+-])$")


@dataclass(frozen=True)
class Inventory:
    """Segments of routes with what is known about them.

    Parameters
    ----------
    segments : columns `COLUMNS`, by route and measure.
    """

    segments: pd.DataFrame

    def routes(self) -> list[str]:
        """Names of the routes."""
        return sorted(set(self.segments["route"]))

    def route_of(self, road: Road) -> str | None:
        """The inventory's name of a road, by the road's name or its drives'; None for none."""
        names = {_plain(name): name for name in self.routes()}
        for wanted in (road.name, *road.drives):
            for key in (_plain(wanted), _plain(_DIRECTION.sub("", wanted.strip().lower()))):
                if key in names:
                    return names[key]
        return None

    def at(self, route: str | None, station_m: Floats, site: Hazard = _NOT_STATED) -> pd.DataFrame:
        """What is known at stations (n,) of a route.

        Parameters
        ----------
        site : states speed and traffic where no segment does, or nothing.

        Returns
        -------
        speed_low_kmh, speed_high_kmh, aadt_low, aadt_high (equal where known), lanes and
        lane_width_m (NaN where unknown), carriageway (empty likewise), segment (its number, -1 for
        none)
        """
        station = np.asarray(station_m, np.float64)
        number = np.full(len(station), -1, np.int64)
        own = self.segments[self.segments["route"] == route]
        for row, low, high in zip(own.index, own["from_m"], own["to_m"], strict=True):
            number[(number < 0) & (station >= low) & (station <= high)] = row
        found: dict[str, Numbers] = {"segment": number}
        for name, unit, stated, limits in (
            ("speed", "_kmh", site.design_speed_kmh, SPEED_RANGE_KMH),
            ("aadt", "", site.aadt, AADT_RANGE),
        ):
            values = self._values(f"{name}{unit}", number)
            if stated is not None:
                values = np.where(np.isnan(values), stated, values)
            for end, limit in zip(("low", "high"), limits, strict=True):
                found[f"{name}_{end}{unit}"] = np.where(np.isnan(values), limit, values)
        for column in ("lanes", "lane_width_m"):
            found[column] = self._values(column, number)
        ways = np.append(self.segments["carriageway"].to_numpy(object), "")
        return pd.DataFrame(found).assign(carriageway=ways[number])

    def _values(self, column: str, number: Ints) -> Floats:
        known = self.segments[column].to_numpy(np.float64)
        values = np.full(len(number), np.nan)
        values[number >= 0] = known[number[number >= 0]]
        return values


# States nothing of any road.
NO_INVENTORY = Inventory(
    pd.DataFrame({name: pd.Series(dtype=np.float64) for name in COLUMNS}).astype(
        {"route": object, "carriageway": object}
    )
)


def check_inventory(table: pd.DataFrame, where: str, places: Sequence[str] = ()) -> Inventory:
    """Segments in order.

    Parameters
    ----------
    table : columns `COLUMNS`, in any order; what lacks of the others is unknown.
    where : the file. places : of each row in it, such as "line 3"; "row 1" and so on if empty.

    Raises
    ------
    InputError : there is no segment, a measure is no number, measures fall, values are impossible,
        or segments overlap.
    """
    if not len(table):
        raise InputError("holds no segment", where=where, allowed="a row for each segment")
    places = list(places) or [f"row {n + 1}" for n in range(len(table))]
    table = table.reset_index(drop=True).assign(place=places)
    table = table.assign(**{name: np.nan for name in LIMITS if name not in table})
    if "carriageway" not in table:
        table = table.assign(carriageway="")
    for _, row in table.iterrows():
        _check_row(row, where)
    alike: dict[str, str] = {}
    for route, place in zip(table["route"], table["place"], strict=True):
        if alike.setdefault(_plain(route), route) != route:
            raise InputError(
                "two names of routes differ in blanks, hyphens or case alone",
                where=f"{where}, {place}",
                found=f"{alike[_plain(route)]} and {route}",
                allowed="one name for each route, and names that differ in letters or digits",
            )
    table = table.sort_values(["route", "from_m", "to_m"], kind="stable").reset_index(drop=True)
    for route, own in table.groupby("route", sort=True):
        _refuse_overlap(str(route), own, where)
    return Inventory(table[list(COLUMNS)])


def _check_row(row: pd.Series, where: str) -> None:
    place = f"{where}, {row['place']}"
    for name in ("from_m", "to_m"):
        if not np.isfinite(row[name]):
            raise InputError(f"{name} is no finite number", where=place, found=row[name])
    if row["to_m"] <= row["from_m"]:
        raise InputError(
            "measures fall along the segment",
            where=place,
            found=f"from {row['from_m']:g} m to {row['to_m']:g} m",
            allowed="a from below its to",
            hint="exchange from and to; of a line also turn its vertices round",
        )
    for name, (least, most) in LIMITS.items():
        if not np.isnan(row[name]) and not least <= row[name] <= most:
            raise InputError(
                f"{name} is impossible",
                where=place,
                found=f"{row[name]:g}",
                allowed=f"{least:g} to {most:g}, or empty for unknown",
                hint="check unit and column",
            )
    if row["carriageway"] not in ("", *CARRIAGEWAYS):
        raise InputError(
            "carriageway is of no kind",
            where=place,
            found=row["carriageway"],
            allowed=", ".join(CARRIAGEWAYS) + ", or empty for the site's own",
        )


def _refuse_overlap(route: str, own: pd.DataFrame, where: str) -> None:
    ends, starts = own["to_m"].to_numpy()[:-1], own["from_m"].to_numpy()[1:]
    reached = np.maximum.accumulate(ends) if len(ends) else ends
    over = np.flatnonzero(reached - starts > SAME_M)
    if len(over):
        row = int(over[0])
        before = int(np.argmax(own["to_m"].to_numpy()[: row + 1]))
        more = f" and {len(over) - 1} more" if len(over) > 1 else ""
        raise InputError(
            f"segments of route {route} overlap" + more,
            where=f"{where}, {own['place'].iloc[before]} and {own['place'].iloc[row + 1]}",
            found=f"one ends at {reached[row]:g} m, the next starts at {starts[row]:g} m",
            allowed="segments that end where the next starts",
            hint="correct the measures, or give the directions as routes of their own",
        )


def _plain(name: str) -> str:
    return re.sub(r"[\s_-]", "", str(name)).lower()
