from itertools import pairwise

import numpy as np
import pytest
import shapely
from scipy.integrate import quad
from scipy.interpolate import CubicSpline
from shapely import LineString, MultiPolygon, box

from roadsight.base.errors import InputError
from roadsight.base.sections.scene import Edges
from roadsight.scene.splines import natural_spline, outline_edges, spline_line

SETTINGS = Edges()


def literal_spline(points, parameter):
    """Natural cubic spline from the textbook's tridiagonal system, one coordinate at a time."""
    points = np.asarray(points, float)
    chord = np.append(0, np.cumsum(np.hypot(*np.diff(points, axis=0).T)))
    n, h = len(points), np.diff(chord)
    matrix, right = np.eye(n), np.zeros((n, 2))
    for i in range(1, n - 1):
        matrix[i, i - 1 : i + 2] = h[i - 1], 2 * (h[i - 1] + h[i]), h[i]
        slopes = (points[i + 1] - points[i]) / h[i], (points[i] - points[i - 1]) / h[i - 1]
        right[i] = 6 * (slopes[0] - slopes[1])
    second = np.linalg.solve(matrix, right)
    out = []
    for t in parameter:
        i = min(np.searchsorted(chord, t, side="right") - 1, n - 2)
        a, b = chord[i + 1] - t, t - chord[i]
        out.append(
            (second[i] * a**3 + second[i + 1] * b**3) / (6 * h[i])
            + (points[i] / h[i] - second[i] * h[i] / 6) * a
            + (points[i + 1] / h[i] - second[i + 1] * h[i] / 6) * b
        )
    return np.array(out)


@pytest.fixture
def bend(rng):
    """A digitised edge: points about 12 m apart on a bend of 80 m radius, 0.2 m off."""
    angle = np.linspace(0, 1.4, 10)
    return 80 * np.column_stack([np.sin(angle), 1 - np.cos(angle)]) + rng.normal(0, 0.2, (10, 2))


class TestNaturalSpline:
    def test_lies_on_the_textbook_spline(self, bend):
        chord = np.cumsum(np.hypot(*np.diff(bend, axis=0).T))[-1]
        curve = LineString(literal_spline(bend, np.linspace(0, chord, 20_000)))
        _, xy, _ = natural_spline(bend, 4.0)
        assert shapely.distance(shapely.points(xy), curve).max() < 1e-6

    def test_passes_through_every_knot(self, bend):
        _, xy, _ = natural_spline(bend, 0.05)
        nearest = np.hypot(*(bend[:, None] - xy[None]).transpose(2, 0, 1)).min(axis=1)
        assert nearest[:-1].max() < 0.026
        assert nearest[-1] < 0.05  # the last sample may be a step short of the end
        assert (xy[0] == bend[0]).all()

    def test_does_not_curve_at_its_ends(self, bend):
        _, _, direction = natural_spline(bend, 0.01)
        turn = np.hypot(*np.diff(direction, axis=0).T) / 0.01  # curvature, 1/m
        assert turn[:3].max() < 1e-3
        assert turn[-3:].max() < 2e-3
        assert turn.max() > 5e-3

    def test_steps_of_arc_length_are_equal_to_the_millimetre(self, bend):
        chord = np.append(0, np.cumsum(np.hypot(*np.diff(bend, axis=0).T)))
        curve = CubicSpline(chord, bend, bc_type="natural")

        def speed(t):
            return np.hypot(*curve(t, 1))

        station, xy, _ = natural_spline(bend, 4.0)
        fine = np.linspace(0, chord[-1], 200_001)
        parameter = [fine[np.hypot(*(curve(fine) - point).T).argmin()] for point in xy]
        for low, high in pairwise(parameter):
            length, _ = quad(speed, low, high)
            assert length == pytest.approx(4.0, abs=2e-3)
        whole, _ = quad(speed, 0, parameter[-1], limit=200)
        assert whole == pytest.approx(station[-1], abs=1e-3)
        assert station.tolist() == [4.0 * k for k in range(len(station))]
        total, _ = quad(speed, 0, chord[-1], limit=200)
        assert 0 <= total - station[-1] < 4.0

    def test_directions_are_unit_tangents(self, bend):
        _, xy, direction = natural_spline(bend, 0.1)
        np.testing.assert_allclose(np.hypot(*direction.T), 1.0, rtol=1e-12)
        secant = xy[2:] - xy[:-2]
        secant /= np.hypot(*secant.T)[:, None]
        assert (secant * direction[1:-1]).sum(axis=1).min() > 1 - 1e-5

    def test_reversed_points_give_the_same_curve_run_backwards(self, bend):
        _, forward, along = natural_spline(bend, 0.5)
        _, backward, against = natural_spline(bend[::-1], 0.5)
        line = LineString(natural_spline(bend, 0.01)[1])
        assert shapely.distance(shapely.points(backward), line).max() < 0.01
        assert np.hypot(*(backward[0] - bend[-1])) < 1e-12
        i = np.hypot(*(forward[:, None] - backward[None]).transpose(2, 0, 1)).argmin(axis=1)
        assert ((along * against[i]).sum(axis=1) < -0.99).all()

    def test_two_points_make_a_straight_line(self):
        station, xy, direction = natural_spline([[0, 0], [6, 8]], 2.5)
        assert station.tolist() == [0, 2.5, 5, 7.5, 10]
        np.testing.assert_allclose(xy, np.outer(station / 10, [6, 8]), atol=1e-9)
        np.testing.assert_allclose(direction, [[0.6, 0.8]] * 5, atol=1e-12)

    def test_points_on_a_line_make_a_straight_line_however_uneven(self):
        x = np.array([0, 0.5, 9, 10, 50.0])
        _, xy, _ = natural_spline(np.column_stack([x, 2 * x]), 3.0)
        assert np.abs(xy[:, 1] - 2 * xy[:, 0]).max() < 1e-9
        assert (np.diff(xy[:, 0]) > 0).all()

    def test_an_edge_shorter_than_the_spacing_has_its_first_point(self):
        station, xy, _ = natural_spline([[1, 1], [2, 1]], 4.0)
        assert station.tolist() == [0]
        assert xy.tolist() == [[1, 1]]

    def test_repeated_points_and_heights_are_dropped(self, bend):
        repeated = np.column_stack([np.repeat(bend, 3, axis=0), np.zeros(30)])
        for plain, other in zip(
            natural_spline(bend, 4.0), natural_spline(repeated, 4.0), strict=True
        ):
            np.testing.assert_allclose(plain, other, atol=1e-9)

    @pytest.mark.parametrize("points", [[], [[1, 2]], [[1, 2], [1, 2], [1, 2 + 1e-9]]])
    def test_fewer_than_two_distinct_points_are_refused(self, points):
        with pytest.raises(InputError, match=r"at least 2 distinct points; found [01]"):
            natural_spline(np.array(points, float).reshape(-1, 2), 4.0)


class TestSplineLine:
    def test_keeps_both_ends(self, bend):
        coordinates = shapely.get_coordinates(spline_line(LineString(bend)))
        assert (coordinates[[0, -1]] == bend[[0, -1]]).all()
        assert len(np.unique(coordinates, axis=0)) == len(coordinates)

    def test_a_length_of_whole_steps_has_no_double_end(self):
        coordinates = shapely.get_coordinates(spline_line(LineString([(0, 0), (5, 0)])))
        np.testing.assert_allclose(coordinates, [[x, 0] for x in range(6)], atol=1e-9)

    def test_a_bend_of_25_m_radius_is_met_to_half_a_centimetre(self):
        angle = np.linspace(0, 2, 30)
        knots = 25 * np.column_stack([np.cos(angle), np.sin(angle)])
        fine = shapely.points(natural_spline(knots, 0.01)[1])
        assert (
            shapely.distance(fine, spline_line(LineString(knots))).max() < 0.006
        )  # 5 mm; natural ends curve a little more


def ground_on(shape, spacing_m=0.5, height=lambda x, y: 0 * x):
    """Ground points on a raster inside a shape."""
    west, south, east, north = shape.bounds
    x, y = np.meshgrid(np.arange(west, east, spacing_m), np.arange(south, north, spacing_m))
    xy = np.column_stack([x.ravel(), y.ravel()]) + spacing_m / 2
    xy = xy[shapely.contains_xy(shape, *xy.T)]
    return np.column_stack([xy, height(*xy.T)])


class TestOutlineEdges:
    @pytest.mark.parametrize("width", [8, 14, 22])
    @pytest.mark.parametrize("angle_deg", [0, 33])
    def test_no_edge_runs_along_the_cut_where_the_data_end(self, width, angle_deg):
        road, data = box(0, -width / 2, 120, width / 2), box(0, -20, 120, 20)
        road, data = (shapely.affinity.rotate(s, angle_deg, (0, 0)) for s in (road, data))
        edges = outline_edges(MultiPolygon([road]), ground_on(data), SETTINGS)
        assert [kind for kind, _ in edges] == ["edge", "edge"]
        for _, line in edges:
            back = shapely.affinity.rotate(line, -angle_deg, (0, 0))
            x, y = shapely.get_coordinates(back).T
            assert np.ptp(x) > 100
            assert np.ptp(y) < 3.1  # the last knot may cut the corner
            assert line.length < 125

    def test_an_edge_at_the_end_of_a_car_park_is_real_when_ground_lies_behind(self):
        park, data = box(0, -15, 60, 15), box(-20, -35, 80, 35)
        edges = outline_edges(MultiPolygon([park]), ground_on(data), SETTINGS)
        length = sum(line.length for _, line in edges)
        assert length == pytest.approx(park.length, rel=0.05)

    def test_medians_are_holes_marked_as_such(self):
        hole = box(30, -1.5, 90, 1.5)
        road, data = box(0, -12, 120, 12).difference(hole), box(0, -20, 120, 20)
        edges = outline_edges(MultiPolygon([road]), ground_on(data), SETTINGS)
        medians = [line for kind, line in edges if kind == "median"]
        assert len([kind for kind, _ in edges if kind == "edge"]) == 2
        assert medians
        for line in medians:
            assert line.hausdorff_distance(hole.boundary) < 65
            assert shapely.distance(shapely.points(line.coords), hole.boundary).max() < 1e-6
        assert sum(line.length for line in medians) > 100

    def test_outer_edges_run_with_the_pavement_on_their_left(self):
        road, data = box(0, -6, 120, 6), box(0, -20, 120, 20)
        for ring in (road, shapely.reverse(road)):
            for _, line in outline_edges(MultiPolygon([ring]), ground_on(data), SETTINGS):
                middle = line.interpolate(0.5, normalized=True)
                ahead = line.interpolate(0.5 + 1 / line.length, normalized=True)
                left = middle.x - (ahead.y - middle.y), middle.y + (ahead.x - middle.x)
                assert road.contains(shapely.Point(left))

    def test_a_round_place_is_one_closed_edge(self):
        place = shapely.Point(0, 0).buffer(30, quad_segs=32)
        edges = outline_edges(MultiPolygon([place]), ground_on(place.buffer(15)), SETTINGS)
        assert [kind for kind, _ in edges] == ["edge"]
        assert edges[0][1].is_ring
        assert edges[0][1].length == pytest.approx(place.length, rel=0.02)

    def test_corners_at_a_knot_split_edges(self):
        park, data = box(0, 0, 60, 42), box(-20, -20, 80, 62)  # sides are whole steps
        edges = outline_edges(MultiPolygon([park]), ground_on(data), SETTINGS)
        assert sorted(round(line.length) for _, line in edges) == [42, 42, 60, 60]

    def test_corners_between_two_knots_are_cut_by_half_a_step_at_most(self):
        park, data = box(0, 0, 61, 40), box(-20, -20, 80, 60)
        for _, line in outline_edges(MultiPolygon([park]), ground_on(data), SETTINGS):
            assert line.hausdorff_distance(line.intersection(park.boundary.buffer(2.2))) == 0

    @pytest.mark.parametrize(("kerb_m", "ends"), [(0.0, 0), (0.12, 1)])
    def test_the_end_of_a_road_is_an_edge_where_a_kerb_shows_it(self, kerb_m, ends):
        """Ground goes on behind x = 0: with a kerb the road ends there, without it runs on."""
        road, data = box(0, -12, 120, 12), box(-15, -30, 120, 30)

        def height(x, y):
            return 0.02 * x + kerb_m * ~shapely.contains_xy(road, x, y)

        edges = outline_edges(MultiPolygon([road]), ground_on(data, height=height), SETTINGS)
        middle = shapely.Point(0, 0).buffer(6)
        assert sum(line.intersects(middle) for _, line in edges) == ends

    def test_both_sides_of_a_place_much_wider_than_the_streets_are_edges(self):
        """The way across the place is long, but the way along its sides is longer."""
        street, place = box(0, -3, 200, 3), box(200, -25, 320, 25)
        outline = street.union(place)
        edges = outline_edges(MultiPolygon([outline]), ground_on(outline), SETTINGS)
        drawn = shapely.union_all([line for _, line in edges])
        for side in (-25, 25):
            along = shapely.points(np.arange(210, 311), np.full(101, side))
            assert shapely.distance(along, drawn).max() < 0.1
        assert drawn.distance(shapely.Point(0, 0)) > 2.9  # the street's cut is no edge

    def test_short_outlines_are_dropped(self):
        islet = box(0, 0, 2, 2)
        assert outline_edges(MultiPolygon([islet]), ground_on(islet), SETTINGS) == []

    def test_no_pavement_and_no_ground_are_decided(self):
        assert outline_edges(MultiPolygon(), np.empty((0, 3)), SETTINGS) == []
        road = box(0, -6, 120, 6)
        edges = outline_edges(MultiPolygon([road]), np.empty((0, 3)), SETTINGS)
        assert edges  # without any ground points nothing shows that the road is cut

    def test_two_carriageways_have_four_edges(self):
        roads = [box(0, 2, 150, 12), box(0, -12, 150, -2)]
        edges = outline_edges(MultiPolygon(roads), ground_on(box(0, -25, 150, 25)), SETTINGS)
        assert len(edges) == 4
        assert all(line.length > 120 for _, line in edges)
