"""Clear zone widths after the AASHTO Roadside Design Guide.

Source: AASHTO, Roadside Design Guide, table 3.1 (metric), "Suggested clear-zone distances in metres
from edge of through travelled lane". The guide gives a range for each cell; the wider end is taken,
since the guide's ranges are no hard limits and a missed hazard costs more than a false one. Curve
corrections (the guide's table 3.2) are left out.

The guide is not freely available. The numbers were compared with figure 49-2A of the Indiana
Design Manual, in feet, which follows the guide's table, as an open project quotes it: of 100
cells 97 agree within a foot, which is what half metres round to; the others differ by 1.3 to 2.4
ft (80 km/h on flat foreslopes at 750 to 1,500 and above 6,000 vehicles a day, 90 km/h on
backslopes of 1V:3H at 1,500 to 6,000). Compare them with the tables of the road's owner before
they are used for a decision.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from roadsight.base.arrays import Floats

SOURCE = (
    "AASHTO Roadside Design Guide, table 3.1 (metric), wider end of each range;"
    " compared with the Indiana Design Manual, figure 49-2A"
)
"""Where the widths are from, as written into results."""

RECOVERABLE_SLOPE = 0.25
"""Rise over run (1V:4H): vehicles can return from flatter foreslopes."""
TRAVERSABLE_SLOPE = 1 / 3
"""1V:3H: vehicles are likely to overturn on steeper foreslopes."""
_FLAT_SLOPE = 1 / 6
"""1V:6H: up to this either way the guide's flattest columns hold."""

_SPEEDS_KMH = (60.0, 80.0, 90.0, 100.0, np.inf)
"""Greatest speed of each of the table's classes."""
_AADT = (750.0, 1500.0, 6000.0, np.inf)
"""Greatest traffic of each of the table's classes, vehicles a day."""
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
    traffic = int(np.searchsorted(_AADT, aadt, side="right" if aadt < _AADT[0] else "left"))
    back = np.where(rise <= _FLAT_SLOPE, 4, np.where(rise <= RECOVERABLE_SLOPE, 3, 2))
    column = np.where(rise <= 0, np.where(-rise <= _FLAT_SLOPE, 0, 1), back)
    return _WIDTHS_M[speed, traffic, column]


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
