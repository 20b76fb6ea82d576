"""Coordinates, units and places on the Earth."""

from __future__ import annotations

import numpy as np
import pandas as pd
from pyproj import CRS, Geod, Proj, Transformer

from roadsight.base.arrays import Numbers
from roadsight.base.errors import InputError
from roadsight.geometry.crs import linear_units, parse_crs
from roadsight.geometry.frames import Frame
from roadsight.geometry.location import area_of_use, check_location, longitude_latitude, utm_code
from roadsight.geometry.north import SiteNorth
from roadsight.geometry.stated import stated_crs
from roadsight.poles.drive.videolog import OK, Site, locate
from roadsight.poles.risk.validation import geodesic_m
from roadsight_hardcases.case import Errors, fails, hard_case

_GEOD = Geod(ellps="WGS84")


@hard_case("ingest_cloud", bound=0.01, unit="m")
def survey_feet_as_feet(rng: np.random.Generator) -> Errors:
    """US survey feet taken for feet shift a place 2,000 km from the origin by 4 m."""
    x_ft = 2_000_000.0 / (1200 / 3937)
    unit_m, _ = linear_units(parse_crs("EPSG:6543", "case"), "case")
    return abs(x_ft * 0.3048 - 2_000_000), abs(x_ft * unit_m - 2_000_000)


@hard_case("ingest_cloud", bound=0.01, unit="m")
def feet_in_plan_metres_in_height(rng: np.random.Generator) -> Errors:
    """A cloud in feet with heights in metres loses two thirds of every height."""
    stated = stated_crs(CRS.from_user_input("EPSG:6543+5703").to_wkt(), {})
    unit_m, vertical_m = linear_units(parse_crs("EPSG:6543", "case"), "case")[0], 100.0
    frame = Frame((0.0, 0.0, 0.0), unit_m, stated.vertical_unit_m or unit_m)
    return abs(vertical_m * unit_m - 100), abs(frame.to_local([0, 0, vertical_m])[2] - 100)


@hard_case("ingest_cloud", bound=1.5, unit="m per km")
def utm_zone_at_the_antimeridian(rng: np.random.Generator) -> Errors:
    """The formula of the UTM zone gives zone 61 at 180 degrees, whose code is a polar grid."""
    lon_deg, lat_deg = 180.0, -17.0
    naive = 32700 + int((lon_deg + 180) / 6) + 1
    codes = f"EPSG:{naive}", utm_code(lon_deg, lat_deg)
    factors = [Proj(CRS.from_user_input(c)).get_factors(lon_deg, lat_deg) for c in codes]
    first, second = (abs(factor.meridional_scale - 1) * 1000 for factor in factors)
    return first, second


@hard_case("ingest_cloud", bound=0.5, unit="good places refused")
def area_across_the_antimeridian(rng: np.random.Generator) -> Errors:
    """An area of use that straddles 180 degrees has its west east of its east."""
    crs = CRS.from_epsg(3460)
    to_grid = Transformer.from_crs(4326, crs, always_xy=True)
    area = area_of_use(crs)
    naive = ours = 0.0
    for lon_deg in (177.5, 179.0, -179.5, -178.5):
        naive += not (area is not None and area.west <= lon_deg <= area.east)
        place = to_grid.transform(lon_deg, -17.5)
        ours += fails(check_location, crs, place, True, "case")
    return naive, ours


@hard_case("read_videolog", bound=0.05, unit="m")
def drive_across_a_zone_border(rng: np.random.Generator) -> Errors:
    """Images placed in the UTM zone of each jump by hundreds of kilometres at the border."""
    lon, lat = np.linspace(5.9995, 6.0005, 11), np.full(11, 48.0)
    zone = (np.floor(lon / 6) + 31).astype(int)
    own = [
        Transformer.from_crs(4326, 32600 + int(z), always_xy=True).transform(x, y)
        for z, x, y in zip(zone, lon, lat, strict=True)
    ]
    frame = Frame((0.0, 0.0, 0.0), crs_wkt=CRS.from_epsg(32631).to_wkt())
    return _steps_off_m(np.array(own), frame, lat, lon)


def _steps_off_m(own_m: Numbers, frame: Frame, lat: Numbers, lon: Numbers) -> Errors:
    """Greatest errors of the ways from image to image: of given places, and of ours."""
    true = geodesic_m(lat[:-1], lon[:-1], lat[1:], lon[1:])
    ours = SiteNorth(frame).to_local(lat, lon)
    steps = [np.hypot(*np.diff(xy, axis=0).T) for xy in (own_m, ours)]
    return np.abs(steps[0] - true).max(), np.abs(steps[1] - true).max()


@hard_case("read_videolog", bound=0.05, unit="m")
def drive_across_state_plane_zones(rng: np.random.Generator) -> Errors:
    """Survey feet of Virginia North and South go on from each other by a thousand kilometres."""
    lat, lon = np.linspace(37.8496, 37.8504, 11), np.full(11, -78.6)
    zones = [Transformer.from_crs(4326, code, always_xy=True) for code in (2284, 2283)]
    places = zip(lon, lat, strict=True)
    own_ft = np.array([zones[int(y > 37.85)].transform(x, y) for x, y in places])
    unit_m = 1200 / 3937
    frame = Frame((0.0, 0.0, 0.0), unit_m, crs_wkt=CRS.from_epsg(2283).to_wkt())
    return _steps_off_m(own_ft * unit_m, frame, lat, lon)


@hard_case("measure_poles", bound=0.01, unit="deg")
def bearing_across_a_zone_border(rng: np.random.Generator) -> Errors:
    """At their border the grids of two UTM zones are turned by twice the convergence."""
    lat, lon = np.full(20, 48.0), rng.uniform(5.999, 6.001, 20)
    south, north = lat - 1e-4, lat + 1e-4
    to_zone = [Transformer.from_crs(4326, 32631 + zone, always_xy=True) for zone in (0, 1)]
    bearing = []
    for x, a, b in zip(lon, south, north, strict=True):
        zone = to_zone[int(x > 6.0)]
        gap = np.subtract(zone.transform(x, b), zone.transform(x, a))
        bearing.append(np.degrees(np.arctan2(*gap)))
    frame = Frame((0.0, 0.0, 0.0), crs_wkt=CRS.from_epsg(32631).to_wkt())
    site = SiteNorth(frame)
    gap_m = site.to_local(north, lon) - site.to_local(south, lon)
    middle_m = site.to_local(lat, lon)
    ours = np.degrees(np.arctan2(*gap_m.T)) + site.convergence_deg(middle_m)
    return np.ptp(bearing), np.abs(ours).max()


@hard_case("read_videolog", bound=0.5, unit="images at a wrong place")
def swapped_and_missing_positions(rng: np.random.Generator) -> Errors:
    """A swapped pair, a zero pair and an unknown one put images on other continents."""
    lat = np.append(np.linspace(35.5, 35.501, 10), [-78.9, 0.0, np.nan])
    lon = np.append(np.full(10, -78.9), [35.5, 0.0, np.nan])
    north = SiteNorth(Frame((640_000.0, 220_000.0, 0.0), crs_wkt=CRS.from_epsg(32119).to_wkt()))
    middle = north.to_local(35.5005, -78.9)

    def covers(xy: np.ndarray) -> np.ndarray:
        return np.hypot(*(xy - middle).T) < 200

    table = pd.DataFrame({"latitude": lat, "longitude": lon})
    _, status = locate(table, Site(north.to_local, covers, lambda xy: xy[:, 0]))
    naive = np.nan_to_num(north.to_local(lat, lon), nan=0.0)
    wrong = ~covers(naive)
    return wrong.sum(), (wrong == (status == OK)).sum()


@hard_case("validate_poles", bound=1e-3, unit="m")
def distances_of_centimetres(rng: np.random.Generator) -> Errors:
    """The law of cosines on the sphere cannot tell places 5 cm apart from equal ones."""
    lat, step_m = np.linspace(30.0, 60.0, 200), 0.05
    bend = 1 - 0.00669437999014 * np.sin(np.radians(lat)) ** 2
    radius_m = 6378137 * (1 - 0.00669437999014) / bend**1.5
    there = lat + np.degrees(step_m / radius_m)
    a, b = np.radians(lat), np.radians(there)
    cosine = np.sin(a) * np.sin(b) + np.cos(a) * np.cos(b)
    naive = 6371000 * np.arccos(np.minimum(cosine, 1.0))
    ours = geodesic_m(lat, np.zeros(200), there, np.zeros(200))
    return np.abs(naive - step_m).max(), np.abs(ours - step_m).max()


@hard_case("measure_poles", bound=0.01, unit="deg")
def grid_north_is_not_north(rng: np.random.Generator) -> Errors:
    """Grid bearings taken for true ones turn every ray by the convergence of the grid."""
    frame = Frame((1_000_000.0, 700_000.0, 0.0), 1200 / 3937, crs_wkt=CRS.from_epsg(6543).to_wkt())
    north = SiteNorth(frame)
    xy = rng.uniform(0, 2000, (20, 2))
    latitude, longitude = north.to_geographic(xy)
    ahead = north.to_geographic(np.add(xy, [0.0, 10.0]))
    true, _, _ = _GEOD.inv(longitude, latitude, ahead[1], ahead[0])
    return np.abs(true).max(), np.abs(north.convergence_deg(xy) - true).max()


@hard_case("ingest_cloud", bound=1.0, unit="km")
def metres_read_as_survey_feet(rng: np.random.Generator) -> Errors:
    """A cloud in metres whose header says feet lies in another county, and nobody notices."""
    true = -78.9, 35.5
    place = Transformer.from_crs(4326, 32119, always_xy=True).transform(*true)
    stated = CRS.from_epsg(2264)
    there = longitude_latitude(stated, *place)
    off_km = _GEOD.inv(*true, *there)[2] / 1000
    told_apart = _is_refused(stated, place) and not _is_refused(CRS.from_epsg(32119), place)
    return off_km, 0.0 if told_apart else off_km


def _is_refused(crs: CRS, place: tuple[float, float]) -> bool:
    try:
        check_location(crs, place, False, "case")
    except InputError:
        return True
    return False
