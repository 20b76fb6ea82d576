"""Numbers, names and units as people read them."""

from __future__ import annotations

import math
from typing import Any

MISSING = "\u2013"  # A dash where there is no value
_NARROW = "\u202f"  # Narrow space that does not break, between a number and its unit
_TIMES = "\u00d7"  # Multiplication sign
_MINUS = "\u2212"  # Minus sign, as wide as a plus

# Units as people write them, by the end of a value's name
_UNITS = {
    "per_m2": "/m²",
    "per_s": "/s",
    "m2": "m²",
    "m3": "m³",
    "m": "m",
    "km": "km",
    "deg": "°",
    "s": "s",
    "hz": "Hz",
    "mrad": "mrad",
    "mm": "mm",
    "nm": "nm",
    "mib": "MiB",
    "kmh": "km/h",
    "share": "%",
    "shares": "%",
}
# Values that are shares though their names do not end so
_SHARES = {"accuracy", "precision", "recall", "f1", "area_iou", "outline_found_within_1m"}
# Words of names that are not written in small letters, or not as they are said
_SPELLING = {
    "aadt": "AADT",
    "f1": "F1",
    "dem": "DEM",
    "fpfh": "FPFH",
    "crs": "CRS",
    "iou": "IoU",
    "lidar": "LiDAR",
    "p05": "5th percentile",
    "p90": "90th percentile",
    "p95": "95th percentile",
    "cpu": "CPU",
    "z": "z",
}
# Values whose names tell too little
_NAMES = {
    "area_iou": "Overlap of areas (IoU)",
    "area_m2": "Occupied area",
    "class_shares": "Cells with class",
    "f1": "F1 score",
    "has_colour": "Colour recorded",
    "has_intensity": "Intensity recorded",
    "outline_found_within_1m": "Outline within 1 m of the reference",
    "outline_median_m": "Distance of outlines, median",
    "outline_p90_m": "Distance of outlines, 90th percentile",
    "overhead_cover_share": "Cells with overhead cover",
    "cover_core_m2": "Area well under cover",
    "range_10_m": "Range, targets of 10 %",
    "range_m": "Range",
    "range_min_m": "Range, least",
    "range_reflectivity": "Reflectivity of targets at the range",
    "relief_m": "Relief, 5th to 95th percentile",
    "spacing_m": "Point spacing",
}


def label(key: str) -> str:
    """Name of a quantity from its key: ``pillar_width_m`` gives ``Pillar width``."""
    if key in _NAMES:
        return _NAMES[key]
    suffix = _suffix(key)
    without_unit = key.removesuffix(f"_{suffix}") if suffix not in ("", "share") else key
    text = " ".join(_SPELLING.get(word, word) for word in without_unit.split("_"))
    return text[:1].upper() + text[1:]


def unit(key: str) -> str:
    """Unit that a key ends in, empty if none."""
    if key in _SHARES:
        return "%"
    return _UNITS.get(_suffix(key), "")


def quantity(key: str, value: Any, default_unit: str = "") -> str:
    """Value with the unit of its key, or the default one; shares as percentages."""
    if value is None:
        return MISSING
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, dict):  # one value after the other with their names
        named = (f"{lower_first(label(k))} {quantity(k, v)}" for k, v in value.items())
        return "; ".join(named) or MISSING
    if isinstance(value, list | tuple):
        between = f" {_TIMES} " if key.startswith("extent") else ", "
        return between.join(quantity(key, part, default_unit) for part in value) or MISSING
    suffix = unit(key) or default_unit
    if not isinstance(value, int | float) or suffix == "%":
        return percent(value) if isinstance(value, int | float) else str(value)
    return number(value) + ("" if not suffix else suffix if suffix == "°" else f"{_NARROW}{suffix}")


def pose(pitch_deg: float, roll_deg: float) -> str:
    """Pitch and roll of a sensor in words."""
    where = "down" if pitch_deg < 0 else "up"
    pitched = f"{number(abs(pitch_deg))}° {where}" if pitch_deg else "level"
    return pitched if not roll_deg else f"{pitched}, roll {number(roll_deg)}°"


def number(value: float, decimals: int | None = None) -> str:
    """Number with thousands separated; four significant digits unless decimals are given.

    Whole numbers keep all their digits, very small ones get an exponent.
    """
    if not math.isfinite(value):
        return MISSING
    if decimals is None:
        if float(value).is_integer():
            return _signed(f"{value:,.0f}")
        size = math.floor(math.log10(abs(value)))
        if size < -4:
            return _signed(f"{value:.4g}")
        text = f"{value:,.{max(0, 3 - size)}f}"
        return _signed(text.rstrip("0").rstrip(".") if "." in text else text)
    return _signed(f"{value:,.{decimals}f}")


def short(value: float) -> str:
    """Number of three significant digits."""
    return number(float(f"{value:.3g}"))


def percent(share: float | None) -> str:
    """Share as a percentage that never rounds to 0 or 100 unless it is."""
    if share is None:
        return MISSING
    shown = f"{100 * share:.1f}"
    if shown == "100.0" and share < 1:
        shown = "> 99.9"
    elif shown == "0.0" and share > 0:
        shown = "< 0.1"
    return f"{shown.removesuffix('.0')}{_NARROW}%"


def seconds(value: float | None) -> str:
    """CPU time: seconds below two minutes, minutes above."""
    if value is None:
        return MISSING
    if value >= 120:
        return f"{number(value / 60, 1)}{_NARROW}min"
    if value < 0.05:
        return f"< 0.1{_NARROW}s"
    return f"{number(value, 1)}{_NARROW}s"


def metres(value: float | None, decimals: int = 1) -> str:
    """Length in metres."""
    return MISSING if value is None else f"{number(value, decimals)}{_NARROW}m"


def bearing(value_deg: float) -> str:
    """Whole degrees with the compass point: ``135° SE``."""
    points = ("N", "NE", "E", "SE", "S", "SW", "W", "NW")
    return f"{round(value_deg) % 360}° {points[round(value_deg / 45) % 8]}"


def counted(count: int, singular: str, plural: str = "") -> str:
    """Number and noun: ``1 target``, ``2 targets``."""
    return f"{number(count)} {singular if count == 1 else plural or singular + 's'}"


def _signed(text: str) -> str:
    """True minus sign, and no negative zero."""
    if text.startswith("-"):
        return text[1:] if not text.strip("-0.,") else f"{_MINUS}{text[1:]}"
    return text


def _suffix(key: str) -> str:
    """Longest ending of a key that is a unit and not the whole key."""
    endings = [ending for ending in _UNITS if key.endswith(f"_{ending}")]
    return max(endings, key=len, default="")


def lower_first(text: str) -> str:
    """Text as it reads within a sentence: ``Cell size`` gives ``cell size``, ``CRS`` stays."""
    return text if text[1:2].isupper() or text[1:2].isdigit() else text[:1].lower() + text[1:]
