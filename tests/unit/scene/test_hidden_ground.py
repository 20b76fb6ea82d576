import numpy as np
import pytest
import shapely
from shapely import MultiPolygon, box

from roadsight.scene.pavement.hidden_ground import REACH_M, to_what_stands

SPACING_M = 0.25
STREET = MultiPolygon([box(0, -4, 60, 4)])
"""The pavement that was found; its true edge lies at y = 5."""


def layer(rng, area, z_m, spacing_m=SPACING_M):
    """Points (n, 3) evenly over an area."""
    west, south, east, north = area.bounds
    count = round((east - west) * (north - south) / spacing_m**2)
    x, y = rng.uniform([west, south], [east, north], (count, 2)).T
    return np.column_stack([x, y, np.full(count, z_m)])


def stray(area):
    """One return far above."""
    return np.array([[area.centroid.x, area.centroid.y, 60.0]])


def grown(parts, outline=STREET, spacing_m=SPACING_M):
    """What the pavement becomes, by parts: points and whether they are ground."""
    xyz = np.concatenate([points for points, _ in parts])
    ground = np.concatenate([np.full(len(points), label) for points, label in parts])

    def around(bounds):
        west, south, east, north = bounds
        near = (xyz[:, 0] >= west) & (xyz[:, 0] < east) & (xyz[:, 1] >= south) & (xyz[:, 1] < north)
        return xyz[near], ground[near]

    return to_what_stands(outline, around, spacing_m, 20.0)


def street(rng, wall_y=4.7, height_m=6.0):
    """A street, a roof from `wall_y` on, and a verge that was seen on the other side."""
    return [
        (layer(rng, box(0, -4, 60, 4), 0.0), True),
        (layer(rng, box(0, -12, 60, -4), 0.05), True),
        (layer(rng, box(0, wall_y, 60, 14), height_m), False),
    ]


def edge_at(outline, x=30.0):
    """Southern and northern end of the pavement at x."""
    across = shapely.intersection(outline, shapely.LineString([(x, -30), (x, 30)]))
    return across.bounds[1], across.bounds[3]


class TestToWhatStands:
    def test_a_street_runs_under_the_eaves_and_stops_at_ground_that_was_seen(self, rng):
        outline, share = grown(street(rng))
        south, north = edge_at(outline)
        assert north == pytest.approx(5.0, abs=0.25)
        assert south == pytest.approx(-4.0, abs=0.15)
        assert share == pytest.approx(60 / 138, abs=0.06)

    def test_what_lies_low_or_far_away_hides_nothing(self, rng):
        for parts in (street(rng, height_m=0.4), street(rng, wall_y=4 + 2 * REACH_M + 0.5)):
            outline, share = grown(parts)
            assert outline.symmetric_difference(STREET).area < 0.02 * STREET.area
            assert share < 0.05

    @pytest.mark.parametrize(
        "standing",
        [
            [box(0, 1, 60, 3.9)],
            [box(20, 2, 24.5, 3.8)],
            [box(0, 3.4, 60, 3.5)],
            [box(x, 4.1, x + 0.05, 4.15) for x in range(2, 60, 3)],
            [],
        ],
        ids=["crowns over the quay", "a car on it", "a wire over it", "stray returns", "nothing"],
    )
    def test_water_gives_no_returns_and_is_no_pavement(self, rng, standing):
        """A canal begins at y = 4, whatever stands on the quay or hangs over it."""
        high = [
            (layer(rng, area, 5.0) if area.area > 1 else stray(area), False) for area in standing
        ]
        outline, _ = grown([street(rng)[0], *high])
        assert outline.difference(STREET.buffer(0.15)).area < 1.0

    def test_what_was_measured_low_is_seen_whether_ground_or_not(self, rng):
        """Planting of 0.4 m before a wall."""
        plants = (layer(rng, box(0, 4, 60, 5), 0.4), False)
        wall = (layer(rng, box(0, 5, 60, 12), 6.0), False)
        outline, _ = grown([street(rng)[0], plants, wall])
        assert outline.difference(STREET.buffer(0.4)).area < 1.0

    @pytest.mark.parametrize("spacing_m", [0.03, 0.1, 0.5])
    def test_no_spacing_undoes_it(self, rng, spacing_m):
        paved = (layer(rng, box(0, 0, 12, 4), 0.0, spacing_m), True)
        roof = (layer(rng, box(0, 4.7, 12, 8), 6.0, spacing_m), False)
        outline, _ = grown([paved, roof], MultiPolygon([box(0, 0, 12, 4)]), spacing_m)
        assert edge_at(outline, 6.0)[1] == pytest.approx(5.0, abs=max(0.2, spacing_m))

    def test_lone_returns_below_the_eaves_leave_no_holes(self, rng):
        lone = np.array([[x, 4.5, 0.0] for x in range(5, 60, 5)])
        outline, _ = grown([*street(rng, wall_y=5.2), (lone, True)])
        assert all(len(part.interiors) == 0 for part in outline.geoms)

    def test_it_goes_no_farther_than_its_reach(self, rng):
        parts = [street(rng)[0], (layer(rng, box(0, 4, 60, 14), 6.0), False)]
        outline, _ = grown(parts)
        assert edge_at(outline)[1] == pytest.approx(4.3, abs=0.25)  # one overhang below the roof
        gone = outline.difference(STREET.buffer(REACH_M + 0.15))
        assert gone.area < 1e-6

    @pytest.mark.parametrize(
        ("deep_m", "height_m", "edge_m"),
        [(1.8, 1.4, 5.9), (0.6, 1.4, 4.4), (6.0, 1.4, 4.4), (1.8, 3.5, 4.4)],
        ids=["cars", "a hedge", "a shed", "a low roof"],
    )
    def test_a_row_of_cars_stands_on_the_pavement(self, rng, deep_m, height_m, edge_m):
        """Behind it lies a walk that was seen; what else stands there hides one overhang."""
        row = (layer(rng, box(10, 4.1, 50, 4.1 + deep_m), height_m), False)
        walk = (layer(rng, box(0, 4.1 + deep_m, 60, 12), 0.1), True)
        outline, _ = grown([street(rng)[0], row, walk])
        assert edge_at(outline)[1] == pytest.approx(edge_m, abs=0.4)

    @pytest.mark.parametrize(("verge_m", "one"), [(0.4, True), (1.5, False)])
    def test_a_vehicle_far_away_decides_nothing(self, rng, verge_m, one):
        """Kerbs between pavements are paved, wider verges are not, whatever is parked elsewhere."""
        roads = MultiPolygon([box(0, -4, 60, 0), box(0, verge_m, 60, 4)])
        ground = [(layer(rng, box(0, -10, 60, 10), 0.0), True)]
        car = [(layer(rng, box(40, -5.8, 44.5, -4.1), 1.2, 0.1), False)]
        low = ground[0][0]
        below = (low[:, 0] > 39.8) & (low[:, 0] < 44.7) & (low[:, 1] > -6) & (low[:, 1] < -3.9)
        hidden = [(low[~below], True), *car]
        for parts in (ground, hidden):
            outline, _ = grown([*parts, (stray(roads), False)], roads)
            assert outline.covers(shapely.Point(10, verge_m / 2)) == one

    def test_a_low_thing_hides_less_than_a_high_one(self, rng):
        """A wall of 1 m, 2 m beyond the pavement, casts no shadow that reaches it."""
        low, high = (
            edge_at(grown(street(rng, wall_y=6.0, height_m=height_m))[0])[1]
            for height_m in (1.0, 6.0)
        )
        assert high == pytest.approx(6.3, abs=0.3)
        assert low < 4.4

    @pytest.mark.parametrize("shift", [0.0, 44.0, 48.0, 70.0])
    def test_where_squares_end_does_not_show(self, rng, shift):
        """Squares lie on multiples of 100 m, so that a moved street meets other borders."""
        parts = street(rng)
        whole, _ = grown(parts)
        moved = [(points + np.array([shift, shift, 0.0]), label) for points, label in parts]
        there, _ = grown(moved, MultiPolygon(shapely.transform(STREET, lambda xy: xy + shift)))
        back = shapely.transform(there, lambda xy: xy - shift)
        assert whole.symmetric_difference(back).area < 0.02 * whole.difference(STREET).area

    def test_without_ground_or_pavement_nothing_changes(self, rng):
        outline, _ = grown([(layer(rng, box(0, -10, 60, 10), 3.0), False)])
        assert outline.symmetric_difference(STREET).area < 0.01
        empty, share = grown(street(rng), outline=MultiPolygon())
        assert empty.is_empty
        assert share == 0
