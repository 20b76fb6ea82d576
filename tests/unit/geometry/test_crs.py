import numpy as np
import pytest
from pyproj import CRS, Transformer

from roadsight.base.errors import InputError
from roadsight.geometry.crs import (
    StatedCrs,
    agree,
    counted_in,
    horizontal,
    linear_units,
    parse_crs,
    unit_name,
    with_linear_unit,
)
from roadsight.geometry.frames import Frame
from roadsight.geometry.location import (
    area_of_use,
    check_extent,
    check_location,
    check_scale,
    longitude_latitude,
    utm_code,
)
from roadsight.geometry.reference import UnitChoice, resolve
from roadsight.geometry.site import reprojection, site_frame
from roadsight.geometry.stated import stated_crs

US_FOOT = 1200 / 3937
RALEIGH_M = (638750.0, 221750.0)  # NAD83 / North Carolina
RALEIGH_FT = (638750.0 / US_FOOT, 221750.0 / US_FOOT)
DELFT = (84900.0, 447500.0)


NOTHING = StatedCrs()


def reference(crs="auto", units="auto", vertical="auto", stated=NOTHING, centre=(0.0, 0.0)):
    return resolve([("a.laz", stated)], centre, UnitChoice(crs, units, vertical))


@pytest.mark.parametrize(
    ("code", "unit_m", "vertical_m"),
    [
        ("EPSG:25832", 1.0, None),
        ("EPSG:2264", US_FOOT, None),
        ("EPSG:2992", 0.3048, None),
        ("EPSG:6543+6360", US_FOOT, US_FOOT),
        ("EPSG:6543+5703", US_FOOT, 1.0),
        ("EPSG:2193", 1.0, None),  # axes north, east
    ],
)
def test_units_come_from_the_axes(code, unit_m, vertical_m):
    found = linear_units(CRS.from_user_input(code), "x")
    assert found[0] == pytest.approx(unit_m, rel=1e-12)
    assert found[1] == (None if vertical_m is None else pytest.approx(vertical_m, rel=1e-12))


@pytest.mark.parametrize("code", ["EPSG:2048", "EPSG:5041"])
def test_axes_that_are_not_east_and_north_are_refused(code):
    with pytest.raises(InputError, match="axes that point"):
        linear_units(CRS.from_user_input(code), "x")


def test_unit_names():
    assert [unit_name(m) for m in (1.0, 0.3048, US_FOOT)] == ["metre", "foot", "us-survey-foot"]
    assert unit_name(0.9144) == "unit of 0.9144 m"


@pytest.mark.parametrize("text", ["", "EPSG:", "EPSG:999999", "Delft", "PROJCS[", "None"])
def test_unknown_crs_is_one_message(text):
    with pytest.raises(InputError, match="no CRS that PROJ knows"):
        parse_crs(text, "crs")


@pytest.mark.parametrize("code", ["EPSG:2264", "EPSG:6543+6360"])
def test_with_linear_unit_keeps_the_place(code):
    feet = CRS.from_user_input(code)
    metres = with_linear_unit(feet, "metre")
    assert linear_units(metres, "x")[0] == 1.0
    assert linear_units(metres, "x")[1] == linear_units(feet, "x")[1]
    np.testing.assert_allclose(
        longitude_latitude(metres, *RALEIGH_M), longitude_latitude(feet, *RALEIGH_FT), atol=1e-9
    )
    np.testing.assert_allclose(
        longitude_latitude(metres, *RALEIGH_M),
        longitude_latitude(CRS.from_epsg(32119), *RALEIGH_M),
        atol=1e-7,
    )
    assert with_linear_unit(metres, "metre") is metres


def test_international_and_survey_feet_differ_by_metres_at_state_plane_distances():
    survey = CRS.from_epsg(2264)
    international = with_linear_unit(survey, "foot")
    assert not agree(survey, international, *RALEIGH_FT)
    to_survey = Transformer.from_crs(international, survey, always_xy=True)
    moved = np.array(to_survey.transform(*RALEIGH_FT)) - RALEIGH_FT
    assert 1.0 < np.hypot(*moved) * US_FOOT < 2.0


def test_stated_crs_prefers_wkt_and_reads_its_vertical_unit():
    stated = stated_crs(CRS.from_user_input("EPSG:6543+6360").to_wkt(), {3072: 25832})
    assert stated.crs.is_compound
    assert stated.vertical_unit_m == pytest.approx(US_FOOT)


@pytest.mark.parametrize(
    ("keys", "code", "unit_m", "vertical_m"),
    [
        ({3072: 25832}, 25832, 1.0, None),
        ({3072: 2264, 4099: 9003}, 2264, US_FOOT, US_FOOT),
        ({3072: 26910, 3076: 9002}, None, 0.3048, None),  # UTM counted in feet
        ({3072: 25832, 4096: 5703}, 25832, 1.0, 1.0),
        ({3072: 25832, 4096: 6360}, 25832, 1.0, US_FOOT),
        ({3072: 25832, 4096: 5103}, 25832, 1.0, None),  # a datum code, often misused
    ],
)
def test_stated_crs_from_geotiff_keys(keys, code, unit_m, vertical_m):
    stated = stated_crs(None, keys)
    assert stated.crs.to_epsg() == code
    assert linear_units(stated.crs, "x")[0] == pytest.approx(unit_m, rel=1e-12)
    assert stated.vertical_unit_m == (None if vertical_m is None else pytest.approx(vertical_m))


@pytest.mark.parametrize(
    ("wkt", "keys", "problem"),
    [
        ("rubbish", {}, "cannot be read"),
        ('LOCAL_CS["site grid",UNIT["metre",1]]', {}, "local system"),
        (None, {1024: 1, 3072: 32767, 2048: 4152}, "no EPSG code"),
        (None, {3072: 9}, "unknown EPSG:9"),
    ],
)
def test_unusable_records_state_no_crs_but_a_problem(wkt, keys, problem):
    stated = stated_crs(wkt, keys)
    assert stated.crs is None
    assert problem in stated.problem


def test_nothing_stated():
    assert stated_crs(None, {}) == StatedCrs()


def test_horizontal_of_compound_bound_and_three_dimensional():
    compound = CRS.from_user_input("EPSG:7415")
    assert horizontal(compound).to_epsg() == 28992
    three = CRS.from_epsg(25832).to_3d()
    assert len(horizontal(three).axis_info) == 2
    gauss = CRS.from_epsg(31467).to_wkt("WKT1_GDAL")
    bound = CRS.from_wkt(gauss.replace('AUTHORITY["EPSG","6314"]', "TOWGS84[598,73,418,0,0,0,0]"))
    assert bound.is_bound
    assert not horizontal(bound).is_bound


def test_area_survives_wkt_1_and_custom_names():
    from_wkt_1 = CRS.from_wkt(CRS.from_epsg(2154).to_wkt("WKT1_GDAL"))
    assert from_wkt_1.area_of_use is None
    assert "France" in area_of_use(from_wkt_1).name
    custom = CRS.from_proj4("+proj=tmerc +lat_0=49 +lon_0=9 +k=1 +x_0=0 +y_0=0 +ellps=bessel")
    assert area_of_use(custom) is None


# --- resolve ---


def test_header_decides_and_assumption_about_z_is_noted():
    found = reference(stated=StatedCrs(CRS.from_epsg(2992)), centre=(636000.0, 853000.0))
    assert (found.source, found.unit_m, found.vertical_unit_m) == ("header", 0.3048, 0.3048)
    assert any("z assumed" in note for note in found.notes)


def test_vertical_axis_of_compound_crs_is_used_without_note():
    found = reference("EPSG:6543+5703", centre=RALEIGH_FT)
    assert found.vertical_unit_m == 1.0
    assert found.notes == ()


def test_configured_crs_wins_over_a_different_header_with_a_note():
    stated = StatedCrs(CRS.from_epsg(2992), 0.3048)
    found = reference("EPSG:25832", stated=stated, centre=(458000.0, 5428000.0))
    assert found.crs.to_epsg() == 25832
    assert found.source == "config"
    assert found.vertical_unit_m == 1.0  # the void header's feet are not taken over
    assert any("configured" in note for note in found.notes)


def test_configured_horizontal_crs_takes_vertical_unit_of_an_agreeing_header():
    stated = StatedCrs(CRS.from_user_input("EPSG:32119+6360"), US_FOOT)
    found = reference("EPSG:32119", stated=stated, centre=RALEIGH_M)
    assert found.vertical_unit_m == pytest.approx(US_FOOT)
    assert found.notes == ()


def test_configured_vertical_unit_wins_with_a_note():
    found = reference("EPSG:6543+6360", vertical="metre", centre=RALEIGH_FT)
    assert found.vertical_unit_m == 1.0
    assert any("z is read in metre" in note for note in found.notes)


def test_configured_unit_changes_the_axes_of_the_crs():
    found = reference("EPSG:2264", "metre", "us-survey-foot", centre=RALEIGH_M)
    assert found.unit_m == 1.0
    assert linear_units(found.crs, "x")[0] == 1.0
    assert found.vertical_unit_m == pytest.approx(US_FOOT)
    location = check_location(found.crs, RALEIGH_M, True, "a.laz")
    assert (location.lon_deg, location.lat_deg) == pytest.approx((-78.678, 35.749), abs=1e-3)


def test_local_assumes_metres_and_notes_it():
    found = reference("local")
    assert (found.crs, found.unit_m, found.vertical_unit_m, found.source) == (None, 1, 1, "local")
    assert len(found.notes) == 2
    feet = reference("local", "foot", "metre")
    assert (feet.unit_m, feet.vertical_unit_m, feet.notes) == (0.3048, 1.0, ())


def test_no_crs_anywhere_is_an_error_with_a_way_out():
    with pytest.raises(InputError, match=r"states no CRS.*EPSG.*crs: local"):
        reference()
    with pytest.raises(InputError, match="its WKT record cannot be read"):
        reference(stated=StatedCrs(problem="its WKT record cannot be read"))


def test_us_metres_without_vertical_axis_demand_the_unit_of_z():
    with pytest.raises(InputError, match=r"vertical_units.*feet in the United States"):
        reference("EPSG:32119", centre=RALEIGH_M)
    assert reference("EPSG:32119", vertical="metre", centre=RALEIGH_M).vertical_unit_m == 1.0
    assert reference("EPSG:2264", centre=RALEIGH_FT).vertical_unit_m == pytest.approx(US_FOOT)
    assert reference("EPSG:28992", centre=DELFT).vertical_unit_m == 1.0


@pytest.mark.parametrize(("code", "kind"), [("EPSG:4978", "Geocentric"), ("EPSG:5703", "Vertical")])
def test_crs_without_plan_coordinates_is_refused(code, kind):
    with pytest.raises(InputError, match=kind):
        reference(code)


def test_contradicting_clouds_are_both_named():
    utm, delft = StatedCrs(CRS.from_epsg(25832)), StatedCrs(CRS.from_epsg(28992))
    with pytest.raises(InputError, match=r"a\.laz and c\.laz.*differ in CRS"):
        resolve([("a.laz", utm), ("b.laz", utm), ("c.laz", delft)], DELFT, UnitChoice())
    feet, metres = StatedCrs(CRS.from_epsg(25832), 0.3048), StatedCrs(CRS.from_epsg(25832), 1.0)
    with pytest.raises(InputError, match=r"a\.laz and b\.laz.*unit of z"):
        resolve([("a.laz", feet), ("b.laz", metres)], (458000, 5428000), UnitChoice())
    with pytest.raises(InputError, match=r"b\.laz: states no CRS"):
        resolve([("a.laz", utm), ("b.laz", StatedCrs())], (458000, 5428000), UnitChoice())


def test_the_same_crs_under_two_names_is_no_contradiction():
    first = StatedCrs(CRS.from_epsg(25832))
    second = StatedCrs(CRS.from_wkt(CRS.from_epsg(32632).to_wkt("WKT1_GDAL")))
    centre = (458000.0, 5428000.0)
    assert resolve([("a", first), ("b", second)], centre, UnitChoice()).source == "header"


# --- location ---


def test_location_of_a_known_place():
    location = check_location(CRS.from_epsg(28992), DELFT, False, "a.laz")
    assert (location.lon_deg, location.lat_deg) == pytest.approx((4.3661, 52.0114), abs=1e-3)
    assert location.scale_north == pytest.approx(0.99994, abs=1e-5)


def test_convergence_is_the_bearing_of_grid_north():
    crs = CRS.from_epsg(25832)
    x, y = Transformer.from_crs(4326, crs, always_xy=True).transform(11.0, 50.0)
    location = check_location(crs, (x, y), False, "a.laz")
    north_lon, north_lat = longitude_latitude(crs, x, y + 100)
    east_m = (north_lon - 11.0) * np.cos(np.radians(50)) * 111320
    north_m = (north_lat - 50.0) * 111250
    assert location.convergence_deg == pytest.approx(
        np.degrees(np.arctan2(east_m, north_m)), abs=0.01
    )


def test_cloud_outside_the_area_names_place_area_and_cause():
    with pytest.raises(InputError) as caught:
        check_location(CRS.from_epsg(32119), RALEIGH_FT, False, "a.laz")
    for part in ("39.138 N 61.763 W", "North Carolina", "EPSG:2264", "vertical_units", "a.laz"):
        assert part in str(caught.value)
    with pytest.raises(InputError, match="x and y swapped"):
        check_location(CRS.from_epsg(28992), DELFT[::-1], False, "a.laz")
    with pytest.raises(InputError, match="another CRS"):
        check_location(CRS.from_epsg(28992), (458000.0, 5428000.0), False, "a.laz")


def test_a_degree_outside_the_area_is_tolerated():
    crs = CRS.from_epsg(25832)  # from 6 E on
    to_native = Transformer.from_crs(4326, crs, always_xy=True)
    check_location(crs, to_native.transform(5.2, 50.0), False, "a.laz")
    with pytest.raises(InputError):
        check_location(crs, to_native.transform(4.8, 50.0), False, "a.laz")


def test_area_across_the_antimeridian():
    crs = CRS.from_epsg(3832)  # PDC Mercator, whole world
    fiji = CRS.from_epsg(3460)
    to_native = Transformer.from_crs(4326, fiji, always_xy=True)
    area = area_of_use(fiji)
    assert area.west > area.east
    for lon in (178.5, -179.5):
        check_location(fiji, to_native.transform(lon, -17.5), False, "a.laz")
    with pytest.raises(InputError):
        check_location(fiji, to_native.transform(150.0, -17.5), False, "a.laz")
    assert crs.is_projected


def test_feet_and_metres_that_both_fit_must_be_stated():
    """The publisher's EPSG:2264 puts Raleigh's metres into Georgia, inside the box of the CRS."""
    crs = CRS.from_epsg(2264)
    with pytest.raises(InputError) as caught:
        check_location(crs, RALEIGH_M, False, "trap.laz")
    for part in ("cannot be", "34.274 N 83.507 W", "35.749 N 78.678 W", "EPSG:32119", "vertical"):
        assert part in str(caught.value)
    check_location(crs, RALEIGH_M, True, "trap.laz")
    check_location(crs, RALEIGH_FT, False, "real.laz")


@pytest.mark.parametrize("centre", [(np.inf, 0.0), (np.nan, 1.0), (1e30, 1e30), (0.0, -1e12)])
def test_no_place_on_earth(centre):
    with pytest.raises(InputError, match="cannot be"):
        check_location(CRS.from_epsg(25832), centre, False, "a.laz")


def test_web_mercator_stretches_too_much():
    crs = CRS.from_epsg(3857)
    location = check_location(crs, (900000.0, 6300000.0), False, "a.laz")
    with pytest.raises(InputError, match=r"stretches.*EPSG:32632"):
        check_scale(crs, location, "a.laz")
    check_scale(CRS.from_epsg(28992), check_location(CRS.from_epsg(28992), DELFT, False, "a"), "a")


@pytest.mark.parametrize(
    ("lon", "lat", "code"),
    [
        (4.4, 52.0, "EPSG:32631"), (-78.7, 35.7, "EPSG:32617"), (174.8, -41.3, "EPSG:32760"),
        (180.0, 10.0, "EPSG:32601"), (-180.0, 10.0, "EPSG:32601"), (6.0, 0.0, "EPSG:32632"),
    ],
)  # fmt: skip
def test_utm_zone(lon, lat, code):
    assert utm_code(lon, lat) == code


def test_degrees_under_a_projected_crs_are_refused():
    degrees = [4.36, 52.01, -1.0, 4.363, 52.013, 19.0]
    with pytest.raises(InputError, match="degrees"):
        check_extent(degrees, 1.0, 1.0, "a.laz")
    # A pole scanned in a local frame is small and high too, but not by that much.
    check_extent([0.0, 0.0, 0.0, 0.4, 0.4, 12.0], 1.0, 1.0, "a.laz")
    check_extent([0.0, 0.0, 0.0, 0.0, 0.0, 0.0], 1.0, 1.0, "one_point.laz")


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_absurd_extent_is_refused_in_metres(axis):
    upper = np.full(3, 1000.0)
    upper[axis] = 200_000.0
    with pytest.raises(InputError, match="too large"):
        check_extent([0, 0, 0, *upper], 1.0, 1.0, "a.laz")
    check_extent([0, 0, 0, *upper], 0.3048, 0.3048, "a.laz")
    upper[axis] = np.nan
    with pytest.raises(InputError, match="too large"):
        check_extent([0, 0, 0, *upper], 1.0, 1.0, "a.laz")


# --- site frame ---


def test_site_frame_has_its_origin_at_the_least_corner():
    found = reference("EPSG:28992", centre=DELFT)
    site = site_frame(found, (84800.5, 447400.25, -1.0), (85000.0, 447600.0, 20.0), "a.laz")
    assert site.frame.origin == (84800.5, 447400.25, -1.0)
    assert CRS.from_wkt(site.frame.crs_wkt).to_epsg() == 28992
    assert site.location.lat_deg == pytest.approx(52.011, abs=1e-2)


def test_geographic_crs_is_refused_with_the_utm_zone():
    found = reference("EPSG:4326", vertical="metre", centre=(4.36, 52.01))
    with pytest.raises(InputError, match=r"degrees.*target_crs: EPSG:32631"):
        site_frame(found, (4.36, 52.01, 0.0), (4.37, 52.02, 20.0), "a.laz")


def test_reprojection_moves_the_plan_and_keeps_z():
    found = reference("EPSG:4326", vertical="foot", centre=(9.0, 50.0))
    moved, move = reprojection(found, "EPSG:32632", (9.0, 50.0), False)
    assert (moved.crs.to_epsg(), moved.unit_m, moved.vertical_unit_m) == (32632, 1.0, 0.3048)
    assert any("reprojected" in note for note in moved.notes)
    places = np.array([[9.0, 50.0, 7.0], [9.001, 50.001, 8.0]])
    expected = Transformer.from_crs(4326, 32632, always_xy=True).transform(*places.T[:2])
    np.testing.assert_allclose(move(places)[:, :2], np.transpose(expected))
    np.testing.assert_array_equal(move(places)[:, 2], places[:, 2])


@pytest.mark.parametrize("target", ["EPSG:4326", "EPSG:7415", "EPSG:4978", "nonsense"])
def test_reprojection_targets_must_be_projected_and_flat(target):
    found = reference("EPSG:4326", vertical="metre", centre=(4.36, 52.01))
    with pytest.raises(InputError, match="target_crs"):
        reprojection(found, target, (4.36, 52.01), False)


def test_reprojection_needs_a_source_that_can_be_right():
    with pytest.raises(InputError, match="local"):
        reprojection(reference("local"), "EPSG:32632", (0.0, 0.0), False)
    found = reference("EPSG:4326", vertical="metre", centre=RALEIGH_M)
    with pytest.raises(InputError, match=r"cannot be.*degrees"):
        reprojection(found, "EPSG:32632", RALEIGH_M, False)


def test_what_coordinates_are_counted_in_is_said_in_words():
    foot = 1200 / 3937
    compound = Frame((0, 0, 0), foot, foot, CRS("EPSG:6543+6360").to_wkt())
    assert counted_in(compound) == {
        "crs": "NAD83(2011) / North Carolina (ftUS) (EPSG:6543)",
        "vertical": "NAVD88 height (ftUS) (EPSG:6360)",
        "unit": "us-survey-foot",
        "vertical_unit": "us-survey-foot",
    }
    assert counted_in(Frame((0, 0, 0), 1.0, 0.3048)) == {
        "crs": "local",
        "vertical": "as in the cloud",
        "unit": "metre",
        "vertical_unit": "foot",
    }
