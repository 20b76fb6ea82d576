"""Roadside hazard rating, roadside inputs of the Highway Safety Manual, exposure.

Sources, and what they were compared with
-----------------------------------------
- FHWA-RD-99-207, appendix D: the seven ratings of Zegeer and others; compared with the page itself
  (fhwa.dot.gov/publications/research/safety/99207/appd.cfm).
- Highway Safety Manual, 1st edition (2010), equation 10-20: compared with an open implementation of
  the manual that cites the equation, agrees.
- The manual's table 12-20: the same implementation gives the fit of the manual's own spreadsheet,
  0.3566 x^-0.614 with x in feet; all seven rows agree within 0.001.
- NCHRP 492 (RSAP), after Wright and Robertson: encroachments on bends and grades. No public text
  with the numbers was found: they are from memory, and settings (`Encroachments`) replace them.
- The manual's rule that objects within 70 ft count as one was not found in public text either.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from roadsight.base.arrays import Bools, Floats, Ints
from roadsight.base.sections.poles import Hazard

_HAZARD = Hazard()
# Where the rules are from, by the mark that reasons carry.
SOURCES = {
    "RDG 3.1": "AASHTO Roadside Design Guide, 4th edition (2011), table 3-1, wider end",
    "RDG 3.2": "the same, table 3-2, on the outside of bends",
    "RDG 3.3": "the same, chapter 3: recoverable, non-recoverable, critical foreslopes",
    "RDG 5": "the same, chapter 5: length of need, table 5-10: runout lengths",
    "FHWA RHR": "FHWA-RD-99-207, appendix D, after Zegeer et al., FHWA/RD-87/008",
    "HSM 10-20": "Highway Safety Manual (2010), equation 10-20: factor of the hazard rating",
    "HSM 12-20": "the same, table 12-20: factor of the offset of fixed objects",
    "NCHRP 492": "Roadside Safety Analysis Program: encroachments on bends, grades (not verified)",
    "FHWA SE": "FHWA Safety Edge guidance: drop-offs of 2 inches",
    "site": "settings of the site",
}
_ABOUT_4 = 1 / 4.5  # flatter than between 1V:5H and 1V:4H is flatter than "about 1:4"
_ABOUT_3 = 1 / 2.5  # steeper than between 1V:3H and 1V:2H is "about 1:2"
_STEEPER_THAN_2 = 0.5  # 1V:2H
_FOOT_M = 0.3048
_MILE_KM = 1.609344
# Objects within 70 ft along the road are one (HSM chapter 12; from memory).
_MERGED_M = 70 * _FOOT_M
_F_OFFSET_FT = (2.0, 5.0, 10.0, 15.0, 20.0, 25.0, 30.0)
# HSM table 12-20, of urban arterials: it is used to compare offsets, not to predict crashes.
_F_OFFSET = (0.232, 0.133, 0.087, 0.068, 0.057, 0.049, 0.044)


def hazard_rating(
    clear_m: ArrayLike, foreslope: ArrayLike, guardrail_m: ArrayLike | None = None
) -> Ints:
    """Roadside hazard rating, 1 (best) to 7; 0 where neither clearance nor slope is known.

    Parameters
    ----------
    clear_m : (n,) from the road's edge to the first rigid object or ground that cannot be driven;
        NaN unknown, infinite where nothing was found.
    foreslope : (n,) rise over run, negative; NaN unknown.
    guardrail_m : (n,) offset of a guardrail before it, NaN for none.

    Notes
    -----
    The ratings have gaps (7.5 to 9 m, 3 to 6 m): what lies in one gets the worse of both. The
    rating is the worse of what clearance and slope give. A guardrail makes it 4 (1.5 m or more from
    the edge) or 5, unless the roadside is better without it.
    """
    clear, slope = np.broadcast_arrays(
        np.asarray(clear_m, np.float64), np.asarray(foreslope, np.float64)
    )
    steep = np.maximum(-slope, 0.0)
    by_slope = np.select(
        [np.isnan(slope), steep < _ABOUT_4, steep <= 0.2501, steep <= _ABOUT_3], [0, 1, 2, 3], 6
    )
    by_clear = np.select(
        [np.isnan(clear), clear >= 9.0, clear >= 6.0, clear >= 3.0, clear > 1.5], [0, 1, 2, 3, 4], 6
    )
    rating = np.maximum(by_slope, by_clear)
    # "Sideslope about 1:3", obstacles within 2 to 3 m: virtually non-recoverable.
    five = (by_clear == 4) & (steep > 1 / 3.5) & (steep <= _ABOUT_3)
    rating = np.where(five, 5, rating)
    seven = (clear <= 1.5) & (steep >= _STEEPER_THAN_2)
    rating = np.where(seven, 7, rating)
    if guardrail_m is not None:
        rail = np.asarray(guardrail_m, np.float64)
        shielded = np.where(rail >= 1.5, 4, 5)
        rating = np.where(np.isnan(rail), rating, np.minimum(rating, shielded))
    return rating.astype(np.int64)


def rating_factor(rating: ArrayLike) -> Floats:
    """Crash modification factor of a hazard rating on rural two-lane roads (HSM 10-20)."""
    number = np.asarray(rating, np.float64)
    factor = np.exp(-0.6869 + 0.0668 * number) / np.exp(-0.4865)
    return np.where(number > 0, factor, np.nan)


def offset_factor(offset_m: ArrayLike) -> Floats:
    """Factor of the offset of fixed objects (HSM table 12-20), straight in logarithms between rows.

    Nearer than 2 ft the value of 2 ft holds; beyond 30 ft the last rows' fall goes on.
    """
    feet = np.log(np.maximum(np.asarray(offset_m, np.float64) / _FOOT_M, _F_OFFSET_FT[0]))
    rows, values = np.log(_F_OFFSET_FT), np.log(_F_OFFSET)
    fall = (values[-1] - values[-2]) / (rows[-1] - rows[-2])
    beyond = np.maximum(feet - rows[-1], 0.0) * fall
    return np.exp(np.interp(feet, rows, values) + beyond)


@dataclass(frozen=True)
class Encroachments:
    """How many times more vehicles leave the road where it bends or falls (NCHRP 492, from memory).

    Parameters
    ----------
    outside, inside : of bends up to 290 m; 1 from 580 m on, straight between.
    downhill : from 6 % on; 1 up to 2 %, straight between. 1 leaves an influence out.
    """

    outside: float = _HAZARD.bend_outside
    inside: float = _HAZARD.bend_inside
    downhill: float = _HAZARD.downhill


_USUAL = Encroachments()


def curve_encroachments(
    radius_m: ArrayLike, outside: ArrayLike, times: Encroachments = _USUAL
) -> Floats:
    """How many times more vehicles leave the road on a bend; see `Encroachments`."""
    radius = np.nan_to_num(np.asarray(radius_m, np.float64), nan=np.inf)
    share = np.clip((580.0 - radius) / 290.0, 0.0, 1.0)
    return 1.0 + share * np.where(np.asarray(outside, bool), times.outside - 1, times.inside - 1)


def grade_encroachments(grade: ArrayLike, times: Encroachments = _USUAL) -> Floats:
    """How many times more vehicles leave the road downhill; see `Encroachments`.

    Parameters
    ----------
    grade : rise over run in the direction of the traffic beside the object; NaN counts as level.
    """
    down = -np.nan_to_num(np.asarray(grade, np.float64))
    return 1.0 + (times.downhill - 1) * np.clip((down - 0.02) / 0.04, 0.0, 1.0)


def leaving(
    offset_m: ArrayLike,
    radius_m: ArrayLike,
    outside: ArrayLike,
    grade: ArrayLike,
    times: Encroachments = _USUAL,
) -> Floats:
    """How likely a vehicle leaves the road and comes as far as an object, against others.

    The product of `offset_factor`, `curve_encroachments` and `grade_encroachments`; NaN where the
    offset is unknown.
    """
    bends = curve_encroachments(radius_m, outside, times) * grade_encroachments(grade, times)
    return np.asarray(bends * offset_factor(np.maximum(offset_m, 0.0)))


def exposure(aadt: ArrayLike, weight: ArrayLike, one_way: ArrayLike = False) -> Floats:
    """Vehicles a day in one direction times `leaving`: to rank by, no number of crashes.

    Parameters
    ----------
    aadt : of both directions; of one where ``one_way``.
    """
    share = np.where(np.asarray(one_way, bool), 1.0, 0.5)
    return np.asarray(np.asarray(aadt, np.float64) * share * np.asarray(weight, np.float64))


def fixed_objects(
    station_m: Floats, offset_m: Floats, counted: Bools, length_m: float
) -> dict[str, float]:
    """Inputs of the HSM's factor of fixed objects for a stretch of road, both sides together.

    Parameters
    ----------
    counted : objects that are fixed, 4 inches or more thick, and not shielded.

    Returns
    -------
    objects_per_km and objects_per_mile (those within 70 ft along the road are one), mean_offset_m
    (NaN without any) and offset_factor
    """
    own = np.flatnonzero(counted & np.isfinite(station_m))
    stations = np.sort(station_m[own])
    groups = 0 if len(stations) == 0 else 1
    first = stations[0] if len(stations) else 0.0
    for station in stations[1:]:
        if station - first > _MERGED_M:
            groups, first = groups + 1, station
    per_km = groups / max(length_m, 1e-3) * 1000
    offset = float(np.nanmean(offset_m[own])) if len(own) else float("nan")
    return {
        "objects_per_km": float(per_km),
        "objects_per_mile": float(per_km * _MILE_KM),
        "mean_offset_m": offset,
        "offset_factor": float(offset_factor(offset)) if np.isfinite(offset) else float("nan"),
    }


def rank_of(
    rating: ArrayLike, hazard: ArrayLike, exposed: ArrayLike, weight: ArrayLike | None = None
) -> Ints:
    """Rank of each object, 1 the worst: by rating, then exposure, then hazard rating.

    Objects of unknown exposure come after the others of their rating, by ``weight``.

    Parameters
    ----------
    rating : high, medium, low or unknown. hazard : 1 to 7. exposed : see `exposure`, NaN unknown.
    weight : see `leaving`; none counts as 0.
    """
    order = {"high": 0, "medium": 1, "low": 2}
    worst = np.array([order.get(str(one), 3) for one in np.asarray(rating, object)])
    known = np.nan_to_num(np.asarray(exposed, np.float64))
    share = np.zeros(len(worst)) if weight is None else np.nan_to_num(np.asarray(weight))
    keys = np.lexsort([-np.asarray(hazard, np.float64), -share, -known, worst])
    rank = np.empty(len(keys), np.int64)
    rank[keys] = np.arange(1, len(keys) + 1)
    return rank
