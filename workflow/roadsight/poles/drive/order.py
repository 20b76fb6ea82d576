"""Order of the images of a route: time of capture, a number, a measure along the road, or rows."""

from __future__ import annotations

import re

import numpy as np
import pandas as pd

from roadsight.base.arrays import Floats

# Share of steps between rows of a table in which a measure falls where the drive is against it
_CLEAR = 0.9
_EXIF_DATE = re.compile(r"(\d{4}):(\d\d):(\d\d)")


def seconds_of(texts: pd.Series) -> Floats:
    """Times (n,) of a column as numbers that order them; NaN where one cannot be read.

    Reads numbers (GPS or Unix time, any unit), ISO 8601 and what is near it, EXIF dates, and times
    of day.
    """
    plain = texts.astype(str).str.strip()
    numbers = pd.to_numeric(plain, errors="coerce")
    if numbers.notna().any():
        return numbers.to_numpy(float)
    dates = plain.str.replace(_EXIF_DATE, r"\1-\2-\3", n=1, regex=True)
    day_only = dates.str.fullmatch(r"\d{1,2}:\d\d:\d\d(\.\d+)?")
    dates = dates.where(~day_only, "1970-01-01 " + dates)
    moments = pd.to_datetime(dates, errors="coerce", utc=True, format="mixed")
    found = moments.to_numpy("datetime64[us]").astype(np.int64) / 1e6
    return np.asarray(np.where(moments.isna(), np.nan, found))


def drive_order(
    route: pd.Series, sequence: Floats, time: Floats, is_measure: bool
) -> tuple[Floats, dict[str, str]]:
    """Number (n,) by which the images of each route are ordered, and what decided it by route.

    Times decide where every image of a route has one; images of the same time keep their order by
    number, then by row. A measure along the road that falls from row to row is a drive against it.

    Parameters
    ----------
    route : name (n,). sequence : number of each image, NaN where missing. time : seconds, NaN where
        missing. is_measure : whether the number is a measure such as a mile post.
    """
    found, reasons = sequence.copy(), {}
    for name, rows in route.groupby(route).groups.items():
        own = route.index.get_indexer(rows)
        if len(own) > 1 and np.isfinite(time[own]).all() and np.ptp(time[own]) > 0:
            number = sequence[own]
            order = np.lexsort([np.arange(len(own)), number, time[own]])
            told = number[order]
            reasons[str(name)] = "time of capture"
            if not (np.isfinite(told).all() and (np.diff(told) > 0).all()):
                found[own[order]] = np.arange(len(own), dtype=float)
        elif is_measure:
            steps = np.diff(sequence[own][np.isfinite(sequence[own])])
            steps = steps[steps != 0]
            falls = len(steps) > 0 and np.mean(steps < 0) >= _CLEAR
            reasons[str(name)] = "falling measure" if falls else "rising measure"
            if falls:
                ranks = pd.Series(-sequence[own]).rank(method="dense") - 1
                found[own] = ranks.to_numpy(float)
    return found, reasons
