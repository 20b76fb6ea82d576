"""CRS and the units of their axes.

`roadsight.geometry.stated` reads what a header states, `roadsight.geometry.reference` decides which
CRS a site is in, `roadsight.geometry.location` whether its coordinates can be in it.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Any, Literal

from pyproj import CRS, Transformer
from pyproj.crs import CompoundCRS
from pyproj.exceptions import CRSError, ProjError

from roadsight.base.errors import InputError
from roadsight.geometry.frames import Frame

# What may be said of units; auto: the axes of the CRS decide.
Unit = Literal["auto", "metre", "foot", "us-survey-foot"]
# Metres in one unit of each name that a site file may state.
METRES_PER_UNIT = {"metre": 1.0, "foot": 0.3048, "us-survey-foot": 1200 / 3937}
_LOCAL = "local"  # CRS of a site without one.
_OF_THE_CLOUD = "as in the cloud"  # Vertical datum of a site whose CRS names none.
# CRSs that put a place no farther apart mean the same: clouds are less accurate than that.
_AGREEMENT_M = 0.01
_SAME_UNIT = 1e-9  # Units nearer than this are one: the two feet differ by 2e-6.


@dataclass(frozen=True)
class StatedCrs:
    """What the header of one cloud states about its coordinates.

    Parameters
    ----------
    crs : CRS, or None if the header names none that can be used.
    vertical_unit_m : metres in one unit of z, or None if the header does not say.
    problem : why a CRS record that is there cannot be used; empty otherwise.
    notes : contradictions within the header and how they were decided, one sentence each.
    """

    crs: CRS | None = None
    vertical_unit_m: float | None = None
    problem: str = ""
    notes: tuple[str, ...] = ()


def unit_name(metres: float) -> str:
    """Name of the unit that is ``metres`` long."""
    for name, length in METRES_PER_UNIT.items():
        if abs(metres / length - 1) < _SAME_UNIT:
            return name
    return f"unit of {metres:g} m"


def parse_crs(text: str, where: str) -> CRS:
    """CRS from an EPSG code, a name, WKT, PROJJSON or a PROJ string.

    Raises
    ------
    InputError : PROJ does not know it.
    """
    try:
        return CRS.from_user_input(text)
    except CRSError as error:
        raise InputError(
            "is no CRS that PROJ knows",
            where=where,
            found=repr(text if len(text) <= 60 else text[:57] + "..."),
            allowed="an EPSG code such as EPSG:25832, or WKT; for a cloud also local",
        ) from error


def horizontal(crs: CRS) -> CRS:
    """Horizontal part of ``crs``, without the datum shift that old WKT may bind to it."""
    flat = crs.sub_crs_list[0] if crs.is_compound else crs
    if flat.is_bound and flat.source_crs is not None:
        flat = flat.source_crs
    return flat if len(flat.axis_info) == 2 else flat.to_2d()


def vertical(crs: CRS, unit_m: float) -> CRS | None:
    """Vertical part of ``crs``, None where it has none of its own or counts in another unit.

    Parameters
    ----------
    unit_m : metres in one unit of the heights: a site may say that a header's unit is wrong.
    """
    up = next((part for part in crs.sub_crs_list if part.is_vertical), None)
    if up is None or abs(up.axis_info[0].unit_conversion_factor / unit_m - 1) > _SAME_UNIT:
        return None
    return up


def with_heights(crs: CRS, unit_m: float) -> CRS:
    """CRS of places with heights: horizontal and vertical part, or the horizontal one alone."""
    flat, up = horizontal(crs), vertical(crs, unit_m)
    if up is not None and not any(part.is_bound for part in crs.sub_crs_list):
        return crs
    return flat if up is None else CompoundCRS(f"{flat.name} + {up.name}", [flat, up])


@cache
def code(crs: CRS) -> str:
    """Code of ``crs``, such as ``EPSG:32632``, empty where it has none.

    Told once for each: a CRS without a code is compared with all that there are, for 0.1 CPU s.
    """
    return ":".join(crs.to_authority() or ())


def label(crs: CRS) -> str:
    """Name of ``crs`` with its code, where it has one: ``WGS 84 / UTM zone 32N (EPSG:32632)``."""
    return f"{crs.name} ({code(crs)})" if code(crs) else crs.name


def counted_in(frame: Frame) -> dict[str, str]:
    """What native coordinates are counted in, as columns of tables say it.

    Returns
    -------
    crs, vertical (reference systems; ``local`` and ``as in the cloud`` where none is named), unit,
    vertical_unit
    """
    crs = None if frame.crs_wkt is None else CRS.from_wkt(frame.crs_wkt)
    up = None if crs is None else vertical(crs, frame.vertical_unit_m)
    return {
        "crs": _LOCAL if crs is None else label(horizontal(crs)),
        "vertical": _OF_THE_CLOUD if up is None else label(up),
        "unit": unit_name(frame.unit_m),
        "vertical_unit": unit_name(frame.vertical_unit_m),
    }


def linear_units(crs: CRS, where: str) -> tuple[float, float | None]:
    """Metres in one unit of x and y, and of z (None where ``crs`` has no vertical axis).

    Raises
    ------
    InputError : the axes are not east and north (and up), or x and y differ in unit.
    """
    axes = crs.axis_info
    directions = [axis.direction for axis in axes]
    if sorted(directions[:2]) != ["east", "north"] or directions[2:] not in ([], ["up"]):
        raise InputError(
            f"{crs.name} has axes that point {', '.join(directions)}",
            where=where,
            allowed="a projected CRS with axes east and north, and up if there is a third",
        )
    x_m, y_m = (axis.unit_conversion_factor for axis in axes[:2])
    if x_m != y_m:
        raise InputError(f"x and y of {crs.name} differ in unit", where=where)
    return x_m, axes[2].unit_conversion_factor if len(axes) == 3 else None


def with_linear_unit(crs: CRS, unit: str) -> CRS:
    """Copy of the projected ``crs`` whose x and y axes count in ``unit``.

    The projection and its parameters stay, only the numbers along the axes change. A CRS that
    counts in that unit already comes back as it is.
    """
    if unit_name(crs.axis_info[0].unit_conversion_factor) == unit:
        return crs
    new_unit: Any = "metre"
    if unit != "metre":
        length = METRES_PER_UNIT[unit]
        new_unit = {"type": "LinearUnit", "name": unit, "conversion_factor": length}
    content = crs.to_json_dict()
    _relabel(content, new_unit)
    return CRS.from_json_dict(content)


def _relabel(node: dict[str, Any], unit: Any) -> None:
    """Set the unit of the first two axes of the projected CRS inside ``node``."""
    node.pop("id", None)
    if node["type"] == "ProjectedCRS":
        for axis in node["coordinate_system"]["axis"][:2]:
            axis["unit"] = unit
    for child in [node.get("source_crs"), *node.get("components", [])[:1]]:
        if child is not None:
            _relabel(child, unit)


def agree(first: CRS, second: CRS, x: float, y: float) -> bool:
    """Whether two CRSs give native (x, y) the same meaning to within 1 cm."""
    try:
        transformer = Transformer.from_crs(horizontal(first), horizontal(second), always_xy=True)
        to_x, to_y = transformer.transform(x, y)
    except ProjError:
        return False
    tolerance = _AGREEMENT_M
    if second.is_projected:
        tolerance /= second.axis_info[0].unit_conversion_factor
    return first.is_projected == second.is_projected and bool(
        abs(to_x - x) <= tolerance and abs(to_y - y) <= tolerance
    )
