"""Where on Earth native coordinates lie, and whether their CRS can be right.

The tests use physics and the CRS's own area of use, so that a wrong CRS or a wrong unit is found
before anything is computed in it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from pyproj import CRS, Proj, Transformer
from pyproj.exceptions import CRSError, ProjError

from roadsight.base.errors import InputError
from roadsight.geometry.crs import horizontal, unit_name, with_linear_unit

# How far outside a CRS's area of use a cloud may lie: areas on record are drawn by borders of
# countries and states, which roads cross. A wrong zone or unit is off by more.
_AREA_TOLERANCE_DEG = 1.0
# Scale of a grid against the ground, less 1: UTM and state plane systems stay far below, Web
# Mercator away from the equator does not.
_LARGEST_SCALE_ERROR = 0.01
# Longest side of a site: beyond it, a stray point or a wrong unit is likelier than a road.
_LARGEST_EXTENT_M = 100_000.0
# Least confidence, per cent, at which PROJ's match for a datum counts. Its lowest grade, a similar
# name, is enough for an area of use, which only has to tell continents and states apart.
_GEODETIC_CONFIDENCE = 25


@dataclass(frozen=True)
class Location:
    """Where the middle of a site is and how its grid sits on the Earth.

    Parameters
    ----------
    lon_deg, lat_deg : WGS 84.
    convergence_deg : bearing of grid north, clockwise from true north.
    scale_north, scale_east : grid length over length on the ellipsoid, along each axis.
    """

    lon_deg: float
    lat_deg: float
    convergence_deg: float
    scale_north: float
    scale_east: float


@dataclass(frozen=True)
class Area:
    """Box in degrees, and its name; west exceeds east where it straddles the antimeridian."""

    west: float
    south: float
    east: float
    north: float
    name: str


def area_of_use(crs: CRS) -> Area | None:
    """Area that ``crs`` is made for; that of its datum where the projection has none on record."""
    own = _own_area(crs)
    datum = horizontal(crs).geodetic_crs
    if own is not None or datum is None:
        return own
    matches = datum.list_authority(min_confidence=_GEODETIC_CONFIDENCE)
    areas = (_own_area(CRS.from_authority(match.auth_name, match.code)) for match in matches)
    return next((area for area in areas if area is not None), None)


def _own_area(crs: CRS) -> Area | None:
    """Area on record for ``crs``, its horizontal part, or the EPSG code that either carries."""
    flat = horizontal(crs)
    code = flat.to_epsg()
    registered = CRS.from_epsg(code) if code else flat
    for candidate in (crs.area_of_use, flat.area_of_use, registered.area_of_use):
        if candidate is not None:
            return Area(*candidate.bounds, candidate.name or "unnamed area")
    return None


def longitude_latitude(crs: CRS, x: float, y: float) -> tuple[float, float]:
    """WGS 84 degrees of native (x, y); infinite where the projection does not reach."""
    try:
        to_wgs84 = Transformer.from_crs(horizontal(crs), "EPSG:4326", always_xy=True)
        lon_deg, lat_deg = to_wgs84.transform(x, y)
    except ProjError:
        return math.inf, math.inf
    return lon_deg, lat_deg


def utm_code(lon_deg: float, lat_deg: float) -> str:
    """EPSG code of the WGS 84 UTM zone of a place."""
    zone = int((lon_deg + 180) // 6) % 60 + 1
    return f"EPSG:{(32600 if lat_deg >= 0 else 32700) + zone}"


def check_extent(
    bounds_native: Sequence[float], unit_m: float, vertical_unit_m: float, where: str
) -> None:
    """Refuse coordinates that are no lengths of a road scene.

    Parameters
    ----------
    bounds_native : least x, y, z and greatest x, y, z, native units.

    Raises
    ------
    InputError : the numbers look like degrees, or the extent exceeds 100 km.
    """
    dx, dy, dz = (bounds_native[i + 3] - bounds_native[i] for i in range(3))
    within_degrees = all(abs(bounds_native[i]) <= 180 for i in (0, 3)) and all(
        abs(bounds_native[i]) <= 90 for i in (1, 4)
    )
    if within_degrees and max(dx, dy) < 1 and dz > 100 * max(dx, dy) > 0:
        raise InputError(
            "x and y look like longitude and latitude in degrees",
            where=where,
            found=f"{dx:g} x {dy:g} in plan, {dz:g} in height",
            allowed="projected or local coordinates",
            hint="state the geographic CRS with `crs:` and a projected one with `target_crs:`",
        )
    sizes_m = (dx * unit_m, dy * unit_m, dz * vertical_unit_m)
    if not all(size_m <= _LARGEST_EXTENT_M for size_m in sizes_m):
        raise InputError(
            "the cloud is too large for one site",
            where=where,
            found=" x ".join(f"{size_m / 1000:.3g}" for size_m in sizes_m) + " km",
            allowed=f"{_LARGEST_EXTENT_M / 1000:.0f} km along each axis",
            hint="look for stray points and a wrong scale in the header, or cut it",
        )


def check_location(
    crs: CRS, centre: tuple[float, float], units_stated: bool, where: str
) -> Location:
    """Locate the middle of a cloud and refuse a CRS that cannot be right there.

    Parameters
    ----------
    crs : geographic CRS, or projected CRS with east and north axes.
    centre : native x, y.
    units_stated : the user has stated the unit of x and y, so that it is beyond doubt.

    Raises
    ------
    InputError : the centre lies outside the area of use, or feet and metres fit equally well.
    """
    area = area_of_use(crs)
    lon_deg, lat_deg = longitude_latitude(crs, *centre)
    if not _inside(lon_deg, lat_deg, area, _AREA_TOLERANCE_DEG):
        allowed = "anywhere on Earth"
        if area is not None:
            name = area.name if len(area.name) <= 60 else area.name[:57] + "..."
            corners = f"{_place(area.west, area.south)} to {_place(area.east, area.north)}"
            allowed = f"{corners} ({name}), give or take {_AREA_TOLERANCE_DEG:g} degree"
        raise InputError(
            f"{crs.name} puts the cloud where its coordinates cannot be",
            where=where,
            found=_place(lon_deg, lat_deg),
            allowed=allowed,
            hint=_likely_cause(crs, centre, area),
        )
    if not units_stated:
        _check_ambiguity(crs, centre, where)
    factors = Proj(horizontal(crs)).get_factors(lon_deg, lat_deg)
    scales = (factors.meridional_scale, factors.parallel_scale)
    return Location(lon_deg, lat_deg, factors.meridian_convergence, *scales)


def check_scale(crs: CRS, location: Location, where: str) -> None:
    """Refuse a projection that stretches lengths by more than one per cent.

    Raises
    ------
    InputError : it does, as Web Mercator does away from the equator.
    """
    scales = (location.scale_north, location.scale_east)
    if not all(abs(scale - 1) <= _LARGEST_SCALE_ERROR for scale in scales):
        raise InputError(
            f"{crs.name} stretches lengths too much to be measured in",
            where=where,
            found=f"scale {scales[0]:.3f} north, {scales[1]:.3f} east",
            allowed=f"1 within {_LARGEST_SCALE_ERROR:.0%}",
            hint=f"set `target_crs: {utm_code(location.lon_deg, location.lat_deg)}`",
        )


def _inside(lon_deg: float, lat_deg: float, area: Area | None, tolerance_deg: float) -> bool:
    """Whether a place lies in an area that may straddle the antimeridian."""
    if not (abs(lon_deg) <= 360 and abs(lat_deg) <= 90):
        return False
    if area is None:
        return True
    width_deg = (area.east - area.west) % 360 or 360.0
    east_of_west_deg = (lon_deg - area.west + tolerance_deg) % 360
    return (
        east_of_west_deg <= width_deg + 2 * tolerance_deg
        and area.south - tolerance_deg <= lat_deg <= area.north + tolerance_deg
    )


def _check_ambiguity(crs: CRS, centre: tuple[float, float], where: str) -> None:
    """Refuse a CRS in feet whose own area also holds the coordinates when they are metres.

    Only an area of the projection itself is narrow enough to decide anything.
    """
    unit_m = crs.axis_info[0].unit_conversion_factor
    own_area = _own_area(crs)
    if not crs.is_projected or unit_name(unit_m) == "metre" or own_area is None:
        return
    as_metres = longitude_latitude(with_linear_unit(crs, "metre"), *centre)
    if _inside(*as_metres, own_area, 0.0):
        feet = _place(*longitude_latitude(crs, *centre))
        raise InputError(
            f"{crs.name} may put the cloud where its coordinates cannot be: its area has room for "
            "x and y both in feet and in metres",
            where=where,
            found=f"{feet} if in {unit_name(unit_m)}, {_place(*as_metres)} if in metres",
            hint=f"state `units: {unit_name(unit_m)}` if the former is right; "
            + _advice(crs, "metre"),
        )


def _likely_cause(crs: CRS, centre: tuple[float, float], area: Area | None) -> str:
    """Another reading of the coordinates that lies inside the area, as advice."""
    if not crs.is_projected:
        return "longitude is x and latitude is y, both in degrees"
    x, y = centre
    own = unit_name(crs.axis_info[0].unit_conversion_factor)
    rivals = ("metre",) if own != "metre" else ("us-survey-foot",)
    for unit in (*rivals, own):
        for swapped in (False, True):
            reading = longitude_latitude(
                with_linear_unit(crs, unit), *((y, x) if swapped else (x, y))
            )
            if area is not None and _inside(*reading, area, 0.0):
                if swapped:
                    return f"with x and y swapped it would lie inside ({_place(*reading)})"
                return f"in {unit} it would lie inside ({_place(*reading)}): {_advice(crs, unit)}"
    return "no other unit helps: the cloud is in another CRS"


def _advice(crs: CRS, unit: str) -> str:
    """What to set when x and y turn out to be in ``unit``."""
    twin = _twin(crs, unit)
    setting = f"`crs: {twin}`" if twin else f"`units: {unit}`"
    return (
        f"if x and y are in {unit}, set {setting}, and state `vertical_units`, because z may be "
        "in another unit than x and y"
    )


def _twin(crs: CRS, unit: str) -> str:
    """EPSG code of the CRS of the same name that counts in ``unit``; empty if there is none."""
    base = crs.name.removesuffix(" (ftUS)").removesuffix(" (ft)")
    for name in (base, f"{base} (ftUS)", f"{base} (ft)"):
        try:
            twin = CRS.from_user_input(name)
        except CRSError:
            continue
        code = twin.to_epsg()
        if (
            code
            and twin.is_projected
            and unit_name(twin.axis_info[0].unit_conversion_factor) == unit
        ):
            return f"EPSG:{code}"
    return ""


def _place(lon_deg: float, lat_deg: float) -> str:
    if not (math.isfinite(lon_deg) and math.isfinite(lat_deg)):
        return "no place on Earth"
    north, east = "N" if lat_deg >= 0 else "S", "E" if lon_deg >= 0 else "W"
    return f"{abs(lat_deg):.3f} {north} {abs(lon_deg):.3f} {east}"
