"""The local frame of a site from its clouds' corners and reference, or why it can have none."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pyproj import Transformer

from roadsight.base.arrays import Floats
from roadsight.base.errors import InputError
from roadsight.geometry.crs import horizontal, linear_units, parse_crs
from roadsight.geometry.frames import Frame
from roadsight.geometry.location import (
    Location,
    check_extent,
    check_location,
    check_scale,
    utm_code,
)
from roadsight.geometry.reference import Reference

# Native x, y, z of one CRS to those of another, shape (n, 3).
Reprojection = Callable[[Floats], Floats]


@dataclass(frozen=True)
class SiteFrame:
    """A site's frame and how it came about.

    Parameters
    ----------
    frame : local frame with its origin at the least corner.
    reference : CRS and units of the native coordinates.
    location : where on Earth the middle is; None for a local system.
    """

    frame: Frame
    reference: Reference
    location: Location | None


def centre_of(lower: ArrayLike, upper: ArrayLike) -> tuple[float, float]:
    """Middle of a native box in plan."""
    x, y = (np.asarray(lower)[:2] + np.asarray(upper)[:2]) / 2
    return float(x), float(y)


def site_frame(
    reference: Reference,
    lower: Sequence[float] | NDArray,
    upper: Sequence[float] | NDArray,
    where: str,
    units_stated: bool = False,
) -> SiteFrame:
    """Local frame with its origin at the least corner of the points.

    Parameters
    ----------
    lower, upper : least and greatest native x, y, z of the points.
    where : name of the cloud or site for messages.
    units_stated : the user has stated the unit of x and y.

    Raises
    ------
    InputError : the coordinates are degrees, too far apart, outside the CRS's area of use, in a
        unit that cannot be told, or in a projection that distorts lengths.
    """
    crs, location = reference.crs, None
    centre = centre_of(lower, upper)
    if crs is not None and crs.is_geographic:
        raise InputError(
            f"{crs.name} counts in degrees, which are no lengths",
            where=where,
            found=f"x {centre[0]:g}, y {centre[1]:g}",
            allowed="a projected CRS",
            hint=f"set `target_crs: {utm_code(*centre)}` to reproject it",
        )
    check_extent([*lower, *upper], reference.unit_m, reference.vertical_unit_m, where)
    if crs is not None:
        location = check_location(crs, centre, units_stated, where)
        check_scale(crs, location, where)
    x, y, z = (float(value) for value in lower)
    wkt = None if crs is None else crs.to_wkt()
    frame = Frame((x, y, z), reference.unit_m, reference.vertical_unit_m, wkt)
    return SiteFrame(frame, reference, location)


def reprojection(
    reference: Reference, target_crs: str, centre: tuple[float, float], units_stated: bool
) -> tuple[Reference, Reprojection]:
    """Reference in another CRS and the way there; z keeps its value and unit.

    Parameters
    ----------
    target_crs : horizontal projected CRS.
    centre : native x, y of the middle of the clouds.

    Raises
    ------
    InputError : the site is local, its own CRS cannot be right, or the target is of another kind.
    """
    target = parse_crs(target_crs, "target_crs")
    if not target.is_projected or len(target.axis_info) != 2:
        raise InputError(
            f"{target.name} is no horizontal projected CRS",
            where="target_crs",
            allowed="a projected CRS without heights, such as EPSG:32632",
        )
    if reference.crs is None:
        raise InputError("a local site cannot be reprojected", where="target_crs")
    check_location(reference.crs, centre, units_stated, "crs")
    unit_m, _ = linear_units(target, "target_crs")
    transformer = Transformer.from_crs(horizontal(reference.crs), target, always_xy=True)
    transformer.transform(*centre)  # PROJ chooses among operations by place
    how = transformer.get_last_used_operation().description
    note = f"reprojected from {reference.name} to {target.name} by {how}"
    moved = replace(reference, crs=target, unit_m=unit_m, notes=(*reference.notes, note))

    def reproject(xyz: Floats) -> Floats:
        x, y = transformer.transform(xyz[:, 0], xyz[:, 1])
        return np.stack([x, y, xyz[:, 2]], axis=1)

    return moved, reproject
