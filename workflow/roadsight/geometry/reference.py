"""In which CRS and units a site's native coordinates are: headers, configuration, assumptions.

Whatever had to be assumed is kept as a note, so that it can be read in ``scene/frame.json``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Literal

from pyproj import CRS

from roadsight.base.errors import InputError
from roadsight.geometry.crs import (
    METRES_PER_UNIT,
    StatedCrs,
    Unit,
    agree,
    linear_units,
    parse_crs,
    unit_name,
    with_linear_unit,
)
from roadsight.geometry.location import area_of_use

Source = Literal["header", "config", "local"]


@dataclass(frozen=True)
class UnitChoice:
    """What a site file says about CRS and units.

    Parameters
    ----------
    crs : ``auto`` (the headers decide), ``local`` (no CRS), or a CRS, which then wins.
    units, vertical_units : ``auto`` (the axes decide) or a name in `METRES_PER_UNIT`.
    """

    crs: Annotated[str, "auto, local, EPSG:nnnn or WKT"] = "auto"
    units: Unit = "auto"
    vertical_units: Unit = "auto"


@dataclass(frozen=True)
class Reference:
    """CRS and units that a site's native coordinates are read in.

    Parameters
    ----------
    crs : CRS, horizontal or compound, or None for a local system. A geographic CRS counts in
        degrees: `unit_m` is then meaningless and the coordinates must be reprojected.
    unit_m, vertical_unit_m : metres in one native unit of x and y, and of z.
    source : where the CRS came from.
    notes : assumptions and contradictions, one sentence each.
    """

    crs: CRS | None
    unit_m: float
    vertical_unit_m: float
    source: Source
    notes: tuple[str, ...] = ()

    @property
    def name(self) -> str:
        """Name of the CRS for people."""
        return "local" if self.crs is None else self.crs.name


def resolve(
    stated: Sequence[tuple[str, StatedCrs]], centre: tuple[float, float], choice: UnitChoice
) -> Reference:
    """CRS and units of a site from what its clouds state and what is configured.

    Parameters
    ----------
    stated : name and statement of each cloud, at least one.
    centre : native x, y in the middle of the clouds, where two CRSs are compared.

    Raises
    ------
    InputError : no CRS to be found, clouds that contradict each other, a CRS that has no lengths,
        or a vertical unit that must be stated.
    """
    notes = [f"{Path(name).name}: {note}" for name, cloud in stated for note in cloud.notes]
    header = _common_statement(stated, centre)
    source: Source
    if choice.crs == "local":
        return _local_reference(header, choice)
    if choice.crs == "auto":
        source, where = "header", stated[0][0]
        for name, statement in stated:
            if statement.crs is None:
                raise InputError(
                    "states no CRS" + (f": {statement.problem}" if statement.problem else ""),
                    where=name,
                    hint="set `crs: EPSG:...` in the site file, or `crs: local` if it has none",
                )
        crs = next(statement.crs for _, statement in stated if statement.crs is not None)
    else:
        source, where = "config", "crs"
        crs = parse_crs(choice.crs, where)
        if header.crs is not None and not agree(header.crs, crs, *centre):
            notes.append(f"the header states {header.crs.name}, the configured {crs.name} is used")
            header = StatedCrs()  # its vertical unit is void, too
    crs, unit_m, axis_vertical_m = _plan_units(crs, choice.units, where, notes)
    vertical_m = _vertical_unit(
        axis_vertical_m or header.vertical_unit_m, unit_m, crs, choice, notes
    )
    return Reference(crs, unit_m, vertical_m, source, tuple(notes))


def _plan_units(
    crs: CRS, units: str, where: str, notes: list[str]
) -> tuple[CRS, float, float | None]:
    """The CRS counting in the configured unit, and metres in one unit of its axes.

    A geographic CRS passes with a unit of 1, see `Reference`.
    """
    if crs.is_geographic:
        return crs, 1.0, None
    if not crs.is_projected:
        raise InputError(
            f"{crs.name} is a {crs.type_name}",
            where=where,
            allowed="a projected CRS, local, or a geographic CRS with `target_crs`",
        )
    unit_m, vertical_m = linear_units(crs, where)
    if units in ("auto", unit_name(unit_m)):
        return crs, unit_m, vertical_m
    notes.append(
        f"x and y are read in {units} as configured, although {crs.name} counts in "
        f"{unit_name(unit_m)}"
    )
    return with_linear_unit(crs, units), METRES_PER_UNIT[units], vertical_m


def _common_statement(
    stated: Sequence[tuple[str, StatedCrs]], centre: tuple[float, float]
) -> StatedCrs:
    """What the headers state together; two that contradict each other are named in an error."""
    common = StatedCrs()
    owner = vertical_owner = ""
    for name, statement in stated:
        if common.crs is None:
            common = replace(common, crs=statement.crs, problem=statement.problem)
            owner = name
        elif statement.crs is not None and not agree(common.crs, statement.crs, *centre):
            found = f"{common.crs.name} and {statement.crs.name}"
            raise _contradiction("in CRS", owner, name, found)
        if common.vertical_unit_m is None:
            common = replace(common, vertical_unit_m=statement.vertical_unit_m)
            vertical_owner = name
        elif statement.vertical_unit_m not in (None, common.vertical_unit_m):
            found = f"{common.vertical_unit_m:g} m and {statement.vertical_unit_m:g} m"
            raise _contradiction("in the unit of z", vertical_owner, name, found)
    return common


def _contradiction(what: str, first: str, second: str, found: str) -> InputError:
    return InputError(
        f"the clouds of one site differ {what}",
        where=f"{first} and {second}",
        found=found,
        hint="convert one of them, or make two sites",
    )


def _local_reference(header: StatedCrs, choice: UnitChoice) -> Reference:
    """Reference of a site that is configured as local."""
    notes = []
    if header.crs is not None:
        notes.append(f"the header states {header.crs.name}, ignored because crs is local")
    if choice.units == "auto":
        notes.append("local coordinates assumed to be in metres")
    unit_m = METRES_PER_UNIT[choice.units if choice.units != "auto" else "metre"]
    if choice.vertical_units == "auto":
        notes.append("z assumed to be in the unit of x and y")
        return Reference(None, unit_m, unit_m, "local", tuple(notes))
    return Reference(None, unit_m, METRES_PER_UNIT[choice.vertical_units], "local", tuple(notes))


def _vertical_unit(
    stated_m: float | None, unit_m: float, crs: CRS, choice: UnitChoice, notes: list[str]
) -> float:
    """Metres in one unit of z: configured, else stated, else that of x and y."""
    if choice.vertical_units != "auto":
        chosen_m = METRES_PER_UNIT[choice.vertical_units]
        if stated_m is not None and abs(chosen_m / stated_m - 1) > 1e-9:
            notes.append(
                f"z is read in {choice.vertical_units} as configured, although "
                f"{unit_name(stated_m)} is stated"
            )
        return chosen_m
    if stated_m is not None:
        return stated_m
    area = area_of_use(crs)
    if unit_name(unit_m) == "metre" and area is not None and "United States" in area.name:
        raise InputError(
            f"{crs.name} counts x and y in metres and says nothing about z, which is often "
            "in feet in the United States",
            where="vertical_units",
            found="auto",
            allowed="metre, foot or us-survey-foot",
            hint="state what z is in",
        )
    notes.append(f"z assumed to be in {unit_name(unit_m)}, as x and y")
    return unit_m
