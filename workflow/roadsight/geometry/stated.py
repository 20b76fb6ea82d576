"""What the CRS records of one cloud state together, and which counts where they contradict.

The LAS specification decides: the WKT bit of the header says whether WKT or GeoTIFF keys count,
and point formats 6 to 10 have WKT. What it does not decide is refused.
"""

from __future__ import annotations

import re
from dataclasses import replace

from pyproj import CRS
from pyproj.exceptions import CRSError

from roadsight.geometry.crs import StatedCrs, agree, horizontal, unit_name
from roadsight.geometry.geo_keys import Keys, from_geo_keys

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
    reason = _reason(wkt_bit)
    (first_name, first), *others = present
    for name, other in others:
        is_of_keys = _KEYS in (first_name, name)
        if undecided and is_of_keys and _differ(first, other, centre):
            return _refused(first_name, first, name, other, "the WKT bit is not set")
        first_name, first = _both(
            first_name, first, name, other, centre, reason if is_of_keys else _REASON_OF_WKT
        )
    return first


_REASON_OF_WKT = "as LAS up to 1.4 knows no other record"


def _reason(wkt_bit: bool) -> str:
    return f"as the WKT bit of the header says ({int(wkt_bit)})"


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
