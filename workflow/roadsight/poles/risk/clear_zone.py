"""Clear zone widths after the AASHTO Roadside Design Guide.

Source: AASHTO, Roadside Design Guide, table 3.1 (metric), "Suggested clear-zone distances in metres
from edge of through travelled lane". The guide gives a range for each cell; the wider end is taken,
since the guide's ranges are no hard limits and a missed hazard costs more than a false one. On the
outside of bends widths are multiplied by the guide's table 3.2 (`curve_factor`).

The guide is not freely available. The numbers were compared with figure 49-2A of the Indiana
Design Manual, in feet, which follows the guide's table, as an open project quotes it: of 100
cells 97 agree within a foot, which is what half metres round to; the others differ by 1.3 to 2.4
ft (80 km/h on flat foreslopes at 750 to 1,500 and above 6,000 vehicles a day, 90 km/h on
backslopes of 1V:3H at 1,500 to 6,000). Compare them with the tables of the road's owner before
they are used for a decision; the setting hazard.clear_zone_m replaces them by one width.

Table 3.2 was compared with rows that open projects quote from the guide's table in feet (radii of
2860, 1640, 1430 and 380 ft; 15 cells): 14 agree by the next row, one differs by 0.1. The guide's
limit of 900 m (2950 ft) is public (SDDC-TEA, tutorial on clear zones and curves). The other rows
are from memory.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from roadsight.base.arrays import Floats

# Where the widths are from, as written into results.
SOURCE = (
    "AASHTO Roadside Design Guide, table 3.1 (metric), wider end of each range;"
    " compared with the Indiana Design Manual, figure 49-2A"
)
RECOVERABLE_SLOPE = 0.25  # rise over run (1V:4H): vehicles can return from flatter foreslopes
TRAVERSABLE_SLOPE = 1 / 3  # 1V:3H: vehicles are likely to overturn on steeper foreslopes
_FLAT_SLOPE = 1 / 6  # 1V:6H: up to this either way the guide's flattest columns hold
# Greatest speed of each of the table's classes, metric or in miles an hour: 60 km/h or 40 mph, 80
# km/h or 50 mph, 90 km/h, 100 km/h.
_SPEEDS_KMH = (64.4, 80.5, 90.0, 100.0, np.inf)
# Least traffic of each of the table's classes but the first, vehicles a day: "under 750", "750 to
# 1500", "1500 to 6000", "over 6000". Of the two classes that name 1500 the wider one is taken.
_AADT = (750.0, 1500.0, np.nextafter(6000.0, np.inf))
# Columns: foreslope 1V:6H or flatter, foreslope 1V:5H to 1V:4H, backslope 1V:3H,
# backslope 1V:5H to 1V:4H, backslope 1V:6H or flatter.
_WIDTHS_M = np.array(
    [
        [
            [3.0, 3.0, 3.0, 3.0, 3.0],
            [3.5, 4.5, 3.5, 3.5, 3.5],
            [4.5, 5.0, 4.5, 4.5, 4.5],
            [5.0, 5.5, 5.0, 5.0, 5.0],
        ],
        [
            [3.5, 4.5, 3.0, 3.0, 3.5],
            [5.0, 6.0, 3.5, 4.5, 5.0],
            [5.5, 8.0, 4.5, 5.0, 5.5],
            [6.5, 8.5, 5.0, 6.0, 6.5],
        ],
        [
            [4.5, 5.5, 3.0, 3.5, 3.5],
            [5.5, 7.5, 3.5, 5.0, 5.5],
            [6.5, 9.0, 5.0, 5.5, 6.5],
            [7.5, 10.0, 5.5, 6.5, 7.5],
        ],
        [
            [5.5, 7.5, 3.5, 4.5, 5.0],
            [7.5, 10.0, 4.5, 5.5, 6.5],
            [9.0, 12.0, 5.5, 6.5, 8.0],
            [10.0, 13.5, 6.5, 8.0, 8.5],
        ],
        [
            [6.0, 8.0, 3.5, 5.0, 5.0],
            [8.0, 11.0, 5.0, 6.0, 6.5],
            [10.0, 13.0, 6.0, 7.5, 8.5],
            [10.5, 14.0, 7.5, 9.0, 9.0],
        ],
    ]
)


def clear_zone_m(design_speed_kmh: float, aadt: float, slope: ArrayLike) -> Floats:
    """Width that should be free of fixed objects beside the travelled way.

    Parameters
    ----------
    design_speed_kmh : speeds between the table's classes take the next higher one.
    aadt : annual average daily traffic, vehicles a day.
    slope : rise over run away from the road, shape (n,); negative is a foreslope, positive a
        backslope; NaN (unknown) counts as flat. Foreslopes steeper than 1V:4H have no width in the
        guide and take that of 1V:4H; see `slope_class` for what they mean.
    """
    rise = np.nan_to_num(np.asarray(slope, np.float64))
    speed = int(np.searchsorted(_SPEEDS_KMH, design_speed_kmh))
    traffic = int(np.searchsorted(_AADT, aadt, side="right"))
    back = np.where(rise <= _FLAT_SLOPE, 4, np.where(rise <= RECOVERABLE_SLOPE, 3, 2))
    column = np.where(rise <= 0, np.where(-rise <= _FLAT_SLOPE, 0, 1), back)
    return _WIDTHS_M[speed, traffic, column]


# Rows of the guide's table 3.2. Wider bends than 900 m need no adjustment.
_CURVE_RADII_M = (
    900.0, 700.0, 600.0, 500.0, 450.0, 400.0, 350.0, 300.0, 250.0, 200.0, 150.0, 100.0,
)  # fmt: skip
# Greatest speed of its columns: 60, 70 and 80 km/h stand beside 40, 45 and 50 mph.
_CURVE_SPEEDS_KMH = (64.4, 72.5, 80.5, 90.0, 100.0, 110.0)
# Of the table; taken where the table is empty because the bend is too tight for the speed.
_LARGEST_FACTOR = 1.5
_E = float("nan")
# Rows by radius, columns by speed.
_CURVE_FACTORS = np.array(
    [
        [1.1, 1.1, 1.1, 1.2, 1.2, 1.2],
        [1.1, 1.1, 1.2, 1.2, 1.2, 1.3],
        [1.1, 1.2, 1.2, 1.2, 1.3, 1.4],
        [1.1, 1.2, 1.2, 1.3, 1.3, 1.4],
        [1.2, 1.2, 1.3, 1.3, 1.4, 1.5],
        [1.2, 1.2, 1.3, 1.3, 1.4, _E],
        [1.2, 1.2, 1.3, 1.4, 1.5, _E],
        [1.2, 1.3, 1.4, 1.5, 1.5, _E],
        [1.3, 1.3, 1.4, 1.5, _E, _E],
        [1.3, 1.4, 1.5, _E, _E, _E],
        [1.4, 1.5, _E, _E, _E, _E],
        [1.5, _E, _E, _E, _E, _E],
    ]
)
# Where no design speed is known: from the table's slowest class to its fastest.
SPEED_RANGE_KMH = (60.0, 110.0)
AADT_RANGE = (0.0, 500_000.0)  # where no traffic is known: from none to the busiest roads there are


def curve_factor(radius_m: ArrayLike, design_speed_kmh: float, outside: ArrayLike) -> Floats:
    """What clear zones are multiplied by on the outside of bends (the guide's table 3.2).

    Parameters
    ----------
    radius_m : (n,) of the centreline; infinite or NaN (unknown) counts as straight.
    design_speed_kmh : between columns the next higher one counts; radii likewise the next smaller.
    outside : (n,) whether the place lies on the outside of its bend.
    """
    radius = np.asarray(radius_m, np.float64)
    column = int(np.searchsorted(_CURVE_SPEEDS_KMH, design_speed_kmh))
    column = min(column, len(_CURVE_SPEEDS_KMH) - 1)
    # Row of the largest radius that is not above the given one.
    row = np.searchsorted(-np.array(_CURVE_RADII_M), -np.nan_to_num(radius, nan=np.inf))
    row = np.minimum(row, len(_CURVE_RADII_M) - 1)
    factor = np.nan_to_num(_CURVE_FACTORS[row, column], nan=_LARGEST_FACTOR)
    bent = np.asarray(outside, bool) & (radius <= _CURVE_RADII_M[0])
    return np.where(bent, factor, 1.0)


def clear_zone_range(
    design_speed_kmh: tuple[float, float],
    aadt: tuple[float, float],
    slope: tuple[float, float],
    radius_m: float = float("inf"),
    outside: bool = False,
) -> tuple[float, float]:
    """Least and greatest clear zone (m) for inputs that are known as ranges.

    Parameters
    ----------
    design_speed_kmh, aadt, slope : least and greatest value, equal where known exactly. See
        `clear_zone_m`.
    """
    low, high = sorted(slope)
    breaks = [-_FLAT_SLOPE, 0.0, _FLAT_SLOPE, RECOVERABLE_SLOPE]
    near = [b + d for b in breaks for d in (-1e-9, 1e-9) if low <= b + d <= high]
    slopes = np.array([low, high, *near])
    found = [
        clear_zone_m(speed, traffic, slopes) * curve_factor([radius_m], speed, [outside])[0]
        for speed in design_speed_kmh
        for traffic in aadt
    ]
    return float(np.min(found)), float(np.max(found))


def slope_class(slope: ArrayLike) -> NDArray[np.object_]:
    """``flat``, ``backslope``, ``recoverable``, ``non-recoverable`` or ``critical`` foreslope.

    Flat is up to 1V:20H either way; unknown slopes give ``unknown``.
    """
    rise = np.asarray(slope, np.float64)
    conditions = [
        np.isnan(rise),
        np.abs(rise) <= 0.05,
        rise > 0,
        -rise <= RECOVERABLE_SLOPE,
        -rise <= TRAVERSABLE_SLOPE,
    ]
    names = ["unknown", "flat", "backslope", "recoverable", "non-recoverable"]
    return np.select(conditions, names, "critical").astype(object)
