"""What the CRS records of one cloud state together, and which counts where they contradict.

The LAS specification decides: the WKT bit of the header says whether WKT or GeoTIFF keys count,
and point formats 6 to 10 have WKT. What it does not decide is refused.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from pyproj import CRS
from pyproj.exceptions import CRSError

from roadsight.geometry.crs import (
    METRES_PER_UNIT,
    StatedCrs,
    agree,
    horizontal,
    unit_name,
    with_linear_unit,
)

_COMPOUND = re.compile(r"\s*(COMPD_CS|COMPOUNDCRS)\s*\[", re.IGNORECASE)
_HORIZONTAL = ("PROJCS", "GEOGCS", "PROJCRS", "PROJECTEDCRS", "GEOGCRS", "GEODCRS", "BOUNDCRS")
_UNREADABLE = "its WKT record cannot be read"
_WKT_1, _WKT_2, _KEYS = "its WKT record", "its WKT 2 record (4224)", "its GeoTIFF keys"


def stated_crs(
    wkt: str | None,
    geo_keys: Keys,
    *,
    wkt_2: str | None = None,
    wkt_bit: bool = True,
    only_wkt: bool = False,
    centre: tuple[float, float] | None = None,
) -> StatedCrs:
    """CRS that LAS records state.

    Parameters
    ----------
    wkt, wkt_2 : text of the records 2112 and 4224, or None.
    geo_keys : GeoTIFF keys with their values.
    wkt_bit : whether the header says that WKT counts. only_wkt : whether the point format asks for
        WKT. centre : native x, y at which two CRSs are compared.
    """
    texts = [(_WKT_1, wkt), (_WKT_2, wkt_2)]
    told = [(name, from_wkt(text)) for name, text in texts if text]
    by_keys = (_KEYS, from_geo_keys(geo_keys)) if geo_keys else None
    records = [*told, by_keys] if wkt_bit or only_wkt else [by_keys, *told]
    present = [record for record in records if record is not None]
    if not present:
        return StatedCrs()
    undecided = only_wkt and not wkt_bit
    (first_name, first), *others = present
    for name, other in others:
        is_of_keys = _KEYS in (first_name, name)
        if undecided and is_of_keys and _differ(first, other, centre):
            return _refused(first_name, first, name, other, "the WKT bit is not set")
        reason = "as LAS up to 1.4 knows no other record"
        if is_of_keys:
            reason = f"as the WKT bit of the header says ({int(wkt_bit)})"
        first_name, first = _both(first_name, first, name, other, centre, reason)
    return first


def _differ(first: StatedCrs, other: StatedCrs, centre: tuple[float, float] | None) -> bool:
    """Whether both name a CRS and the two are not the same."""
    if first.crs is None or other.crs is None:
        return False
    if horizontal(first.crs).equals(horizontal(other.crs), ignore_axis_order=True):
        return False
    return centre is None or not agree(first.crs, other.crs, *centre)


def _refused(name: str, first: StatedCrs, other_name: str, other: StatedCrs, why: str) -> StatedCrs:
    states = f"{name}: {_shown(first)}; {other_name}: {_shown(other)}"
    return StatedCrs(problem=f"{states}, and {why}")


def _shown(stated: StatedCrs) -> str:
    return stated.problem if stated.crs is None else stated.crs.name


def _both(
    name: str,
    first: StatedCrs,
    other_name: str,
    other: StatedCrs,
    centre: tuple[float, float] | None,
    reason: str,
) -> tuple[str, StatedCrs]:
    """The record that counts with what another one adds."""
    if first.crs is None and other.crs is None:
        return name, first if first.problem else replace(other, notes=first.notes + other.notes)
    if first.crs is None:
        if first.problem and first.problem != _UNREADABLE and name != _KEYS:
            return name, _refused(name, first, other_name, other, "the first is no place on Earth")
        notes = (*first.notes, *other.notes)
        if first.problem == _UNREADABLE:
            notes = (*notes, f"{name} cannot be read; {other_name} is taken: {_shown(other)}")
        unit = first.vertical_unit_m or other.vertical_unit_m
        return other_name, replace(other, vertical_unit_m=unit, notes=notes)
    if other.crs is not None and _differ(first, other, centre):
        note = (
            f"{name}: {first.crs.name}, but {other_name}: {other.crs.name};"
            f" {first.crs.name} is taken, {reason}"
        )
        return name, replace(first, notes=(*first.notes, note))
    if other.crs is None and other.problem and other.vertical_unit_m is None:
        return name, first
    return name, _with_heights(name, first, other_name, other, reason)


def _with_heights(
    name: str, first: StatedCrs, other_name: str, other: StatedCrs, reason: str
) -> StatedCrs:
    """A statement with the unit of z of another one that means the same place."""
    if first.vertical_unit_m is None:
        return replace(
            first, vertical_unit_m=other.vertical_unit_m, notes=first.notes + other.notes
        )
    unit_m = other.vertical_unit_m
    if unit_m is None or abs(unit_m / first.vertical_unit_m - 1) < 1e-9:
        return first
    note = (
        f"{name}: z in {unit_name(first.vertical_unit_m)}, but {other_name}: z in"
        f" {unit_name(unit_m)}; {unit_name(first.vertical_unit_m)} is taken, {reason}"
    )
    return replace(first, notes=(*first.notes, note))


def from_wkt(text: str) -> StatedCrs:
    """CRS of a WKT text; of a compound that PROJ refuses, the horizontal part alone."""
    notes: tuple[str, ...] = ()
    try:
        crs = CRS.from_wkt(text)
    except CRSError:
        parts = compound_parts(text)
        flat = [part for part in parts if part.lstrip().upper().startswith(_HORIZONTAL)]
        try:
            if len(flat) != 1:
                return StatedCrs(problem=_UNREADABLE)
            crs = CRS.from_wkt(flat[0])
        except CRSError:
            return StatedCrs(problem=_UNREADABLE)
        others = [part for part in parts if part is not flat[0] and "CRS" in _keyword(part)]
        others += [part for part in parts if part is not flat[0] and _keyword(part) == "VERT_CS"]
        if others:
            notes = (f"the heights of its compound CRS cannot be read; {crs.name} is taken",)
    if crs.is_engineering:
        return StatedCrs(problem=f"its WKT record describes the local system {crs.name!r}")
    up = [axis for axis in crs.axis_info if axis.direction == "up"]
    return StatedCrs(crs, up[0].unit_conversion_factor if up else None, "", notes)


def _keyword(part: str) -> str:
    return part.partition("[")[0].strip().upper()


def compound_parts(text: str) -> list[str]:
    """What stands between the commas of a compound CRS, its name first; nothing of another text."""
    opened = _COMPOUND.match(text)
    if opened is None:
        return []
    parts, depth, quoted, start = [], 0, False, opened.end()
    for at in range(opened.end(), len(text)):
        letter = text[at]
        if letter == '"':
            quoted = not quoted
        elif quoted:
            continue
        elif letter in "[(":
            depth += 1
        elif letter in "])" and depth > 0:
            depth -= 1
        elif letter in "])" or (letter == "," and depth == 0):
            parts.append(text[start:at])
            start = at + 1
            if letter != ",":
                break
    return parts


# CRS that GeoTIFF keys of a LAS header state: by EPSG code, or by parameters of its own.
#
# Numbers and meanings of keys are those of OGC 19-008r4 (GeoTIFF 1.1), which LAS refers to.

Keys = Mapping[int, int | float | str]  # Value of each key: a short integer, a double or a text.
_USER_DEFINED = 32767
_EPSG_UNITS = {9001: "metre", 9002: "foot", 9003: "us-survey-foot"}
_MODEL, _CITATION = 1024, 1026
_GEOGRAPHIC, _DATUM, _SPHEROID, _AXIS_A, _AXIS_B, _FLATTENING = 2048, 2050, 2056, 2057, 2058, 2059
_PROJECTED, _PROJECTED_CITATION, _PROJECTION, _METHOD = 3072, 3073, 3074, 3075
_LINEAR_UNIT, _LINEAR_UNIT_M = 3076, 3077
_VERTICAL_CRS, _VERTICAL_UNIT = 4096, 4099
_MODELS = {1: "projected", 2: "geographic", 3: "geocentric"}
# Before the WKT of a CRS of its own, which ArcGIS puts into the citation.
_ESRI_TEXT = "ESRI PE String ="
_LATITUDE, _LONGITUDE = (3081, 3085, 3089), (3080, 3084, 3088, 3095)
_EASTING, _NORTHING = (3082, 3086, 3090), (3083, 3087, 3091)
_SCALE, _PARALLEL_1, _PARALLEL_2, _AZIMUTH = (3092, 3093), (3078,), (3079,), (3094,)
_RECTIFIED = (3096,)
# Method of PROJ and its parameters by keys, by number of the method (ProjMethodGeoKey).
_METHODS: dict[int, tuple[str, dict[str, tuple[int, ...]]]] = {
    1: ("tmerc", {"lat_0": _LATITUDE, "lon_0": _LONGITUDE, "k_0": _SCALE}),
    3: (
        "omerc",
        {
            "lat_0": _LATITUDE,
            "lonc": _LONGITUDE,
            "alpha": _AZIMUTH,
            "gamma": _RECTIFIED,
            "k_0": _SCALE,
        },
    ),
    7: ("merc", {"lon_0": _LONGITUDE, "k_0": _SCALE}),
    8: (
        "lcc",
        {"lat_1": _PARALLEL_1, "lat_2": _PARALLEL_2, "lat_0": _LATITUDE, "lon_0": _LONGITUDE},
    ),
    9: ("lcc", {"lat_1": _LATITUDE, "lat_0": _LATITUDE, "lon_0": _LONGITUDE, "k_0": _SCALE}),
    10: ("laea", {"lat_0": _LATITUDE, "lon_0": _LONGITUDE}),
    11: (
        "aea",
        {"lat_1": _PARALLEL_1, "lat_2": _PARALLEL_2, "lat_0": _LATITUDE, "lon_0": _LONGITUDE},
    ),
    16: ("sterea", {"lat_0": _LATITUDE, "lon_0": _LONGITUDE, "k_0": _SCALE}),
    18: ("cass", {"lat_0": _LATITUDE, "lon_0": _LONGITUDE}),
}
_METHODS[2] = _METHODS[1]
_OPTIONAL = ("gamma", "k_0")  # Parameters that may be left to their usual value.


def from_geo_keys(keys: Keys) -> StatedCrs:
    """CRS that GeoTIFF keys name, by EPSG code or parameters, in the linear unit that they name.

    Returns
    -------
    the CRS, or why there is none; contradictions between keys are notes, or the reason
    """
    vertical_unit_m, notes = _vertical_unit(keys)
    code, model = _code(keys, _PROJECTED), _code(keys, _MODEL)
    # Parameters say it where this is `_USER_DEFINED`; 0 where there is none.
    named = _code(keys, _PROJECTED if _PROJECTED in keys else _GEOGRAPHIC)
    if model in (2, 3) and code not in (0, _USER_DEFINED):
        problem = f"its GeoTIFF keys say {_MODELS[model]} (1024) and name EPSG:{code} (3072)"
        return StatedCrs(None, vertical_unit_m, problem, notes)
    if named == _USER_DEFINED or (named == 0 and _METHOD in keys):
        crs, problem = _user_defined(keys)
        return StatedCrs(crs, vertical_unit_m, problem, notes)
    if named == 0:
        return StatedCrs(None, vertical_unit_m, "its GeoTIFF keys name no EPSG code", notes)
    try:
        crs = CRS.from_epsg(named)
    except CRSError:
        problem = f"its GeoTIFF keys name the unknown EPSG:{named}"
        return StatedCrs(None, vertical_unit_m, problem, notes)
    if not crs.is_projected:
        return StatedCrs(crs, vertical_unit_m, "", notes)
    unit_m = _linear_unit_m(keys)
    own_m = crs.axis_info[0].unit_conversion_factor
    if (
        unit_m is not None
        and abs(unit_m / own_m - 1) > 1e-9
        and unit_name(unit_m) in METRES_PER_UNIT
    ):
        notes = (
            *notes,
            f"its GeoTIFF keys name EPSG:{named} in {unit_name(own_m)} and the unit"
            f" {unit_name(unit_m)}; the unit is taken, as the specification of the key says",
        )
        crs = with_linear_unit(crs, unit_name(unit_m))
    return StatedCrs(crs, vertical_unit_m, "", notes)


def _code(keys: Keys, key: int) -> int:
    value = keys.get(key, 0)
    return value if isinstance(value, int) else 0


def _number(keys: Keys, *wanted: int) -> float | None:
    """Value of the first of the keys that is a number."""
    for key in wanted:
        value = keys.get(key)
        if isinstance(value, int | float):
            return float(value)
    return None


def _linear_unit_m(keys: Keys) -> float | None:
    """Metres in one unit of x and y, where the keys say it."""
    name = _EPSG_UNITS.get(_code(keys, _LINEAR_UNIT))
    if name is not None:
        return METRES_PER_UNIT[name]
    return _number(keys, _LINEAR_UNIT_M) if _code(keys, _LINEAR_UNIT) == _USER_DEFINED else None


def _user_defined(keys: Keys) -> tuple[CRS | None, str]:
    """CRS by parameters, or what they lack."""
    for key in (_PROJECTED_CITATION, _CITATION):
        _, found, text = str(keys.get(key, "")).partition(_ESRI_TEXT)
        if found:
            try:
                return CRS.from_wkt(text.strip().rstrip("|")), ""
            except CRSError:
                return None, "the ESRI WKT in its GeoTIFF keys cannot be read"
    base, problem = _base(keys)
    if base is None:
        return None, problem
    unit_m = _linear_unit_m(keys)
    try:
        conversion = _coded_conversion(keys)
        if conversion is None:
            conversion, problem = _conversion(keys, unit_m or 1.0)
        if conversion is None:
            return None, problem
        content: dict[str, Any] = {
            "type": "ProjectedCRS",
            "name": str(keys.get(_PROJECTED_CITATION, keys.get(_CITATION, ""))).strip("| ")
            or "projection of its own",
            "base_crs": base.to_json_dict(),
            "conversion": conversion,
            "coordinate_system": CRS.from_epsg(32631).to_json_dict()["coordinate_system"],
        }
        crs = CRS.from_json_dict(content)
        name = unit_name(unit_m or 1.0)
        known = name in METRES_PER_UNIT
        problem = "" if known else f"its GeoTIFF keys count in a {name}"
        return (with_linear_unit(crs, name) if known else None), problem
    except (CRSError, KeyError, ValueError) as error:
        return None, f"the projection in its GeoTIFF keys cannot be used ({error})"


def _base(keys: Keys) -> tuple[CRS | None, str]:
    """Geographic CRS below the projection: by code, datum or ellipsoid."""
    code = _code(keys, _GEOGRAPHIC)
    try:
        if code not in (0, _USER_DEFINED):
            return CRS.from_epsg(code).to_2d(), ""
        datum = _code(keys, _DATUM)
        if datum not in (0, _USER_DEFINED):
            base = CRS.from_epsg(4326).to_json_dict()
            base.pop("datum_ensemble", None)
            base.pop("id", None)
            named = CRS.from_user_input(f"urn:ogc:def:datum:EPSG::{datum}").to_json_dict()
            return CRS.from_json_dict(base | {"datum": named, "name": named["name"]}), ""
    except (CRSError, KeyError):
        return None, "its GeoTIFF keys name a geographic CRS or datum that PROJ does not know"
    a, b, flat = _number(keys, _AXIS_A), _number(keys, _AXIS_B), _number(keys, _FLATTENING)
    if a is None or (b is None and flat is None):
        return None, "its GeoTIFF keys describe a projection without datum (keys 2048, 2050, 2057)"
    shape = f"+rf={flat}" if flat is not None else f"+b={b}"
    try:
        return CRS.from_proj4(f"+proj=longlat +a={a} {shape} +no_defs +type=crs"), ""
    except CRSError:
        return None, "its GeoTIFF keys describe an impossible ellipsoid (keys 2057 to 2059)"


def _coded_conversion(keys: Keys) -> dict[str, Any] | None:
    """Conversion that one EPSG code names, such as 16032 for UTM zone 32N."""
    code = _code(keys, _PROJECTION)
    if code in (0, _USER_DEFINED):
        return None
    if 16001 <= code <= 16060 or 16101 <= code <= 16160:
        zone, south = code % 100, code > 16100
        text = f"+proj=utm +zone={zone} {'+south ' if south else ''}+datum=WGS84 +type=crs"
        return dict(CRS.from_proj4(text).to_json_dict()["conversion"])
    from pyproj.crs import CoordinateOperation  # noqa: PLC0415  # rarely wanted

    return dict(CoordinateOperation.from_epsg(code).to_json_dict())


def _conversion(keys: Keys, unit_m: float) -> tuple[dict[str, Any] | None, str]:
    """Conversion by method and parameters, or what is missing."""
    method = _code(keys, _METHOD)
    if method not in _METHODS:
        return None, (
            "its GeoTIFF keys name no EPSG code, and the projection method"
            f" {method or 'none'} (key 3075)"
        )
    name, parameters = _METHODS[method]
    parts = [f"+proj={name}"]
    wanted = parameters | {"x_0": _EASTING, "y_0": _NORTHING}
    for parameter, places in wanted.items():
        value = _number(keys, *places)
        if value is None and parameter in _OPTIONAL:
            continue
        if value is None:
            return None, (
                f"its GeoTIFF keys describe a projection without {parameter}"
                f" (key {' or '.join(map(str, places))})"
            )
        parts.append(f"+{parameter}={value * (unit_m if parameter in ('x_0', 'y_0') else 1)!r}")
    crs = CRS.from_proj4(" ".join([*parts, "+datum=WGS84", "+units=m", "+type=crs"]))
    return dict(crs.to_json_dict()["conversion"]), ""


def _vertical_unit(keys: Keys) -> tuple[float | None, tuple[str, ...]]:
    """Metres in one unit of z by the vertical keys, and a contradiction between them."""
    unit = _EPSG_UNITS.get(_code(keys, _VERTICAL_UNIT))
    stated_m = None if unit is None else METRES_PER_UNIT[unit]
    code = _code(keys, _VERTICAL_CRS)
    try:
        vertical = CRS.from_epsg(code)
    except CRSError:
        return stated_m, ()
    if not vertical.is_vertical:
        return stated_m, ()
    own_m = float(vertical.axis_info[0].unit_conversion_factor)
    if stated_m is None or abs(stated_m / own_m - 1) < 1e-9:
        return own_m, ()
    note = (
        f"its GeoTIFF keys name the heights EPSG:{code} in {unit_name(own_m)} and the unit"
        f" {unit_name(stated_m)}; the unit is taken, as the specification of the key says"
    )
    return stated_m, (note,)
