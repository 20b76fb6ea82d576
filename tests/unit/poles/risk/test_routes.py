import numpy as np
import pytest

from roadsight.base.errors import InputError
from roadsight.poles.risk.roads import Road, Roads
from roadsight.poles.risk.routes import Route, check_routes, with_routes

X = np.arange(0.0, 401.0)


def road(name="drive-e", flip=False):
    line = np.column_stack([X, 0 * X])
    line = line[::-1] if flip else line
    return Road(name, (name,), "", line, X.copy(), np.full(401, 3.0), np.full(401, 4.0))


def route(name="SR 7", start=1200.0, low=-100.0, high=500.0, step=25.0, y=1.0, where="a.gpkg"):
    x = np.arange(low, high + 1, step)
    return Route(name, np.column_stack([x, y + 0 * x]), start + x - low, where)


@pytest.mark.parametrize("flip", [False, True])
def test_the_measure_is_the_routes_whichever_way_the_drive_went(flip):
    roads, told = with_routes(Roads([road(flip=flip)]), [route()])
    assert not told
    own = roads.roads[0]
    assert own.name == "SR 7"
    assert own.drives == ("drive-e",)
    assert own.travel == (-1 if flip else 1)
    assert (np.diff(own.station_m) > 0).all()
    located = roads.locate(np.array([[100.0, -5.0], [300.0, 6.0]]))
    assert located.station_m == pytest.approx([1400, 1600], abs=0.01)
    assert located.side.tolist() == [1, -1]
    # The wider side of the road stays where it was.
    assert own.edge_m(located.station_m, located.side) == pytest.approx(
        [3.0, 4.0] if flip else [4.0, 3.0]
    )


def test_measures_of_other_scale_and_beyond_the_routes_ends():
    shorter = route(low=50.0, high=350.0)
    stretched = Route("r", shorter.xy_m, 100 + 1.01 * (shorter.xy_m[:, 0] - 50))
    roads, _ = with_routes(Roads([road()]), [stretched])
    at = roads.locate(np.column_stack([[50.0, 200, 350, 0, 400], np.zeros(5)])).station_m
    assert at == pytest.approx([100, 251.5, 403, 50, 453], abs=0.2)


def test_segments_of_one_route_are_one_measure():
    first, second = route(high=200.0), route(start=1500.0, low=200.0)
    roads, told = with_routes(Roads([road()]), [second, first])
    assert not told
    assert roads.locate(np.array([[250.0, 2.0]])).station_m == pytest.approx([1550])


def test_two_routes_on_one_road_are_refused():
    with pytest.raises(InputError, match=r"two routes run along road drive-e.*SR 7 and US 1"):
        with_routes(Roads([road()]), [route(), route("US 1", where="a.gpkg, feature 2")])


def test_routes_that_follow_each_other_are_told():
    roads, told = with_routes(Roads([road()]), [route(high=250.0), route("US 1", low=250.0)])
    assert roads.roads[0].name == "SR 7"
    (doubt,) = told
    assert doubt.code == "routes_follow"
    assert "follow each other" in doubt.message
    assert doubt.measured == pytest.approx(0.4, abs=0.05)
    assert doubt.limit < 0.3


def test_roads_off_all_routes_keep_their_own_measure():
    roads, told = with_routes(Roads([road()]), [route(y=80.0)])
    assert roads.roads[0].name == "drive-e"
    (doubt,) = told
    assert doubt.code == "road_without_route"
    assert "road drive-e: its measure stays its own" in doubt.message
    assert (doubt.measured, doubt.limit) == (pytest.approx(80), 12)
    # Vertices of the line are elsewhere: its own distance counts.
    (doubt,) = with_routes(Roads([road()]), [route(low=-305.0, high=505.0, step=810.0, y=13.0)])[1]
    assert doubt.measured == 13
    crossing = Route("c", np.array([[200.0, -200.0], [200.0, 200.0]]), np.array([0.0, 400.0]))
    assert [doubt.code for doubt in with_routes(Roads([road()]), [crossing])[1]] == [doubt.code]


def test_falling_measures_and_turned_segments_are_refused():
    one = route()
    with pytest.raises(InputError, match=r"do not rise along its line.*turn the line"):
        check_routes([Route("r", one.xy_m, one.measure_m[::-1], "r.gpkg, feature 1")])
    dented = one.measure_m.copy()
    dented[7] = dented[5]
    with pytest.raises(InputError, match=r"found 1350 m, then 1325 m at vertex 8 of 25"):
        check_routes([Route("r", one.xy_m, dented, "r.gpkg, feature 1")])
    for row in (0, 7, 24):
        endless = one.measure_m.copy()
        endless[row] = np.inf if row else -np.inf
        pair = " m, then ".join(f"{value:g}" for value in endless[max(row - 1, 0) :][:2])
        with pytest.raises(InputError, match=f"found {pair} m at vertex {max(row, 1) + 1} of 25"):
            check_routes([Route("r", one.xy_m, endless, "r.gpkg, feature 1")])
    first, second = route(high=200.0), route(start=1500.0, low=200.0)
    turned = Route(second.name, second.xy_m[::-1], second.measure_m, "feature 2")
    with pytest.raises(InputError, match="digitised against its measures"):
        check_routes([first, turned])
    check_routes([first, second])


def test_routes_of_another_place_are_refused():
    far = route(y=3e6, where="lrs.gpkg, feature 1")
    with pytest.raises(
        InputError, match=r"lrs.gpkg.*near road drive-e.*3000 km.*routes_crs.*roads\.inventory_crs"
    ):
        with_routes(Roads([road()]), [far])
    # A state's routes are mostly elsewhere; one behind the end of the road is told with its way.
    behind = route(low=900.0, high=1200.0)
    (doubt,) = with_routes(Roads([road()]), [far, behind])[1]
    assert (doubt.code, doubt.measured) == ("road_without_route", pytest.approx(700, abs=6))


@pytest.mark.parametrize(
    ("metres", "message"),
    [
        (1 / 1609.344, "what is read as m were mi"),
        (1 / 1000, "what is read as m were km"),
        (1 / 0.3048, "what is read as m were ft"),
        (0.3048, "what is read as ft were m"),
        (1.1, "check the measures and their unit"),
    ],
)
def test_measures_in_another_unit_are_refused_with_the_one_that_fits(metres, message):
    one = route()
    wrong = Route(one.name, one.xy_m, one.measure_m * metres, "lrs.gpkg, feature 1")
    with pytest.raises(InputError, match=f"do not go with the length.*{message}"):
        with_routes(Roads([road()]), [wrong])
    # Of a route elsewhere nobody asks.
    with_routes(Roads([road()]), [route("US 1"), Route("b", wrong.xy_m + 500, wrong.measure_m)])


def test_measures_in_hundredths_of_a_mile_are_as_good_as_they_can_be():
    short = route(low=100.0, high=150.0, start=1207.0)
    rounded = Route("r", short.xy_m[[0, -1]], np.array([0.75, 0.79]) * 1609.344)
    roads, told = with_routes(Roads([road()]), [rounded])
    assert not told
    assert roads.roads[0].name == "r"


@pytest.mark.parametrize("flip", [False, True])
@pytest.mark.parametrize(("low", "high"), [(101.0, 109.0), (98.0, 102.0), (0.0, 5.0)])
def test_a_route_shorter_than_the_spacing_of_knots(low, high, flip):
    x = np.array([low, high])
    short = Route("s", np.column_stack([x, 1 + 0 * x]), 700 + x - low)
    roads, told = with_routes(Roads([road(flip=flip)]), [short])
    assert not told
    at = roads.locate(np.array([[low, -5.0], [high, 5.0], [300.0, 5.0]]))
    assert at.station_m == pytest.approx([700, 700 + high - low, 1000 - low], abs=0.5)
    assert at.side.tolist() == [1, -1, -1]


def test_a_route_that_only_touches_a_road_measures_nothing():
    # It ends beside the road's first metre and goes on away from it.
    x = np.array([-7.0, -1.0])
    roads, told = with_routes(Roads([road()]), [Route("s", np.column_stack([x, 0 * x]), x + 7)])
    assert roads.roads[0].name == "drive-e"
    (doubt,) = told
    assert doubt.code == "route_too_short"
    assert "route s runs along too little of road drive-e" in doubt.message
    assert doubt.measured < doubt.limit
