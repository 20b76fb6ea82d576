import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from shapely import MultiPolygon, box

from roadsight.base.sections.placement import Candidates
from roadsight.placement.candidates.candidates import (
    facing_deg,
    free_heights_m,
    roof_height_m,
    stack_candidates,
)

SETTINGS = Candidates()
ALL = [4.0 + 0.5 * k for k in range(13)]


def literal_heights(points, low, high, step, factor):
    """Section 2.3, step iv and cases i to iv, sentence by sentence.

    Read as: the walk starts at the lowest allowed height and ends at the highest; the first height
    stands half a step above the lower point, further ones follow at whole steps as long as they
    keep half a step from the upper point; no height is outside the allowed range.
    """

    def series(first, last):
        out, k = [], 0
        while first + k * step <= last + 1e-9:
            out.append(first + k * step)
            k += 1
        return out

    points = sorted(points)
    if not points:  # step iv
        return series(low, high)
    lowest, highest = points[0], points[-1]
    heights = []
    pairs = [(points[k], points[k + 1]) for k in range(len(points) - 1)]
    if lowest > low:  # cases iii and iv: the first pair begins at the lowest allowed height
        pairs.insert(0, (low, lowest))
    for lower, upper in pairs:  # all cases
        if upper - lower > factor * step:
            first = lower + step / 2
            if first < low:
                first = low
            heights += [h for h in series(first, upper - step / 2) if h <= high + 1e-9]
    if highest < high:  # cases ii and iii
        first = highest + step / 2
        if first < low:
            first = low
        heights += series(first, high)
    return heights


class TestFreeHeights:
    @pytest.mark.parametrize(
        ("points", "expected"),
        [
            ([], ALL),
            # ii: ground only; nothing in the way
            ([0.0, 0.02, -0.05], ALL),
            # ii: a hedge up to 3.9 m keeps half a step; one up to 5.1 m takes the lowest heights
            ([0.0, 1.3, 2.6, 3.9], [4.15 + 0.5 * k for k in range(12)]),
            ([0.0, 4.3, 5.1], [4.0] + [5.35 + 0.5 * k for k in range(10)]),
            # i: a wire at 7 m below a crown at 12 m: free above and below the wire
            ([0.0, 7.0, 12.0], [4, 4.5, 5, 5.5, 6, 6.5, 7.25, 7.75, 8.25, 8.75, 9.25, 9.75]),
            # i: gaps of exactly twice the step are not free
            ([3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0, 10.0], []),
            # iii: nothing seen below 6 m: the lowest allowed height counts as a point
            ([6.0, 6.5], [4.25, 4.75, 5.25, 5.75, 6.75, 7.25, 7.75, 8.25, 8.75, 9.25, 9.75]),
            # iv: as iii, and the points go on above the range
            ([8.0, 8.9, 9.8, 10.5], [4.25, 4.75, 5.25, 5.75, 6.25, 6.75, 7.25, 7.75]),
            # iv: all points above the range
            ([12.0], [4.25 + 0.5 * k for k in range(12)]),
            # iii: a point within reach of the lowest allowed height leaves nothing below it
            ([4.9, 11.0], [5.15 + 0.5 * k for k in range(10)]),
            # on the limits
            ([4.0], [4.25 + 0.5 * k for k in range(12)]),
            ([0.0, 10.0], [4 + 0.5 * k for k in range(12)]),
        ],
    )
    def test_hand_worked_cases(self, points, expected):
        np.testing.assert_allclose(free_heights_m(np.array(points), SETTINGS), expected, atol=1e-9)

    @settings(max_examples=300, deadline=None)
    @given(
        points=st.lists(st.floats(-1, 14), max_size=12),
        low=st.sampled_from([0.0, 2.5, 4.0]),
        span=st.sampled_from([0.3, 1.0, 6.0]),
        step=st.sampled_from([0.25, 0.5, 0.7]),
        factor=st.sampled_from([2.0, 2.5, 4.0]),
    )
    def test_equals_the_literal_transcription_and_keeps_its_promises(
        self, points, low, span, step, factor
    ):
        chosen = Candidates(
            height_min_m=low, height_max_m=low + span, height_step_m=step, gap_factor=factor
        )
        found = free_heights_m(np.array(points), chosen)
        expected = literal_heights(points, low, low + span, step, factor)
        np.testing.assert_allclose(found, expected, atol=1e-9)
        assert (found >= low).all()
        assert (found <= low + span + 1e-6).all()
        assert (np.diff(found) > step - 1e-6).all()
        if points and len(found):
            assert np.abs(np.subtract.outer(found, points)).min() >= step / 2 - 1e-6

    def test_a_wider_gap_factor_frees_less(self):
        points = np.array([0.0, 5.0, 6.3, 8.9, 12.0])
        counts = [
            len(free_heights_m(points, Candidates(gap_factor=factor))) for factor in (2, 3, 6, 12)
        ]
        assert counts == sorted(counts, reverse=True)
        assert counts[0] > counts[-1]


class TestRoof:
    def cover(self, rng, share, height, n=400):
        offsets = rng.uniform(-0.5, 0.5, (n, 2))
        offsets = offsets[np.hypot(*offsets.T) <= 0.5]
        offsets = offsets[offsets[:, 0] < -0.5 + share]
        return offsets, np.full(len(offsets), height)

    def test_a_ceiling_is_a_roof_at_its_height(self, rng):
        offsets, heights = self.cover(rng, 1.0, 6.2)
        assert roof_height_m(offsets, heights, SETTINGS) == pytest.approx(6.2)

    def test_a_curved_ceiling_is_a_roof_at_its_lower_part(self, rng):
        offsets, heights = self.cover(rng, 1.0, 6.0)
        heights = heights + 0.5 * offsets[:, 0]
        assert 5.7 < roof_height_m(offsets, heights, SETTINGS) < 5.9

    @pytest.mark.parametrize("kind", ["none", "ground", "pole", "wall", "wire", "half"])
    def test_what_does_not_cover_is_no_roof(self, rng, kind):
        z = rng.uniform(0, 12, 200)
        offsets, heights = {
            "none": (np.empty((0, 2)), np.empty(0)),
            "ground": self.cover(rng, 1.0, 0.1),
            "pole": (rng.normal(0.2, 0.05, (200, 2)), z),
            "wall": (np.column_stack([np.full(200, 0.1), rng.uniform(-0.48, 0.48, 200)]), z),
            "wire": (np.column_stack([rng.uniform(-0.5, 0.5, 200), np.zeros(200)]), z * 0 + 8),
            "half": self.cover(rng, 0.4, 7.0),
        }[kind]
        assert roof_height_m(offsets, heights, SETTINGS) == np.inf

    def test_one_low_point_does_not_lower_the_roof(self, rng):
        offsets, heights = self.cover(rng, 1.0, 6.2)
        heights[0] = 4.1
        assert roof_height_m(offsets, heights, SETTINGS) == pytest.approx(6.2)


class TestFacing:
    pavement = MultiPolygon([box(-50, 0, 50, 10)])

    @pytest.mark.parametrize(
        ("xy", "direction", "expected"),
        [
            ((0, -0.5), (1, 0), 90),  # road on the left
            ((0, -0.5), (-1, 0), 90),  # the same edge digitised the other way
            ((0, 10.5), (1, 0), -90),
            ((-50.5, 5), (0, -1), 0),
            ((50.5, 5), (0, 1), 180),
            ((50.5, 5), (0, -1), 180),
            ((0, 5), (1, 0), 90),  # road on both sides: left
            ((0, 80), (1, 0), 90),  # road on no side: left
        ],
    )
    def test_faces_the_road(self, xy, direction, expected):
        found = facing_deg(np.array([xy], float), np.array([direction], float), self.pavement)
        assert found == pytest.approx([expected])

    def test_no_positions(self):
        assert facing_deg(np.empty((0, 2)), np.empty((0, 2)), self.pavement).shape == (0,)


def positions(*rows):
    columns = ["key", "x", "y", "ground_z_m", "yaw_deg", "edge", "station_m", "mount"]
    return pd.DataFrame(rows, columns=columns)


class TestStack:
    def test_heights_stand_on_the_ground_of_their_position(self):
        table = positions(("a-s0000.00", 5.0, 5.0, 100.0, 90.0, "a", 0.0, "edge"))
        stacked = stack_candidates(table, np.empty((0, 3)), np.empty(0), SETTINGS)
        np.testing.assert_allclose(stacked["height_m"], ALL)
        np.testing.assert_allclose(stacked["z"], np.array(ALL) + 100)
        assert stacked["candidate"].iloc[0] == "a-s0000.00-h04.00"
        assert stacked["candidate"].iloc[-1] == "a-s0000.00-h10.00"
        assert stacked["candidate"].is_unique
        assert (stacked["edge"] == "a").all()

    def test_only_points_within_the_radius_obstruct(self):
        table = positions(
            ("a", 0.0, 0.0, 0.0, 0.0, "a", 0.0, "edge"), ("b", 4.0, 0.0, 0.0, 0.0, "a", 4.0, "edge")
        )
        crown = np.array([[0.49, 0, z] for z in np.arange(0, 12, 0.4)])
        stacked = stack_candidates(table, crown, crown[:, 2], SETTINGS)
        assert stacked["key"].unique().tolist() == ["b"]
        outside = crown + np.array([0.02, 0, 0])
        assert len(stack_candidates(table, outside, outside[:, 2], SETTINGS)) == 26

    def test_no_candidate_hangs_above_a_tunnel_s_ceiling(self, rng):
        table = positions(("a", 0.0, 0.0, 0.0, 0.0, "a", 0.0, "edge"))
        xy = rng.uniform(-0.5, 0.5, (300, 2))
        ceiling = np.column_stack([xy, rng.uniform(6.5, 6.6, 300)])
        ground = np.column_stack([xy, np.zeros(300)])
        points = np.concatenate([ceiling, ground])
        stacked = stack_candidates(table, points, points[:, 2], SETTINGS)
        np.testing.assert_allclose(stacked["height_m"], [4.0, 4.5, 5.0, 5.5, 6.0], atol=1e-9)

    def test_a_position_without_ground_is_dropped(self):
        table = positions(
            ("a", 0.0, 0.0, np.nan, 0.0, "a", 0.0, "edge"),
            ("b", 9.0, 0.0, 1.0, 0.0, "a", 9.0, "edge"),
        )
        stacked = stack_candidates(table, np.empty((0, 3)), np.empty(0), SETTINGS)
        assert stacked["key"].unique().tolist() == ["b"]

    @pytest.mark.parametrize("case", ["no positions", "all blocked", "no ground"])
    def test_no_candidate_is_an_empty_table_with_all_columns(self, case):
        ground = np.nan if case == "no ground" else 0.0
        table = positions(("a", 0.0, 0.0, ground, 0.0, "a", 0.0, "edge"))
        table = table.iloc[:0] if case == "no positions" else table
        points = np.array([[0, 0, z] for z in np.arange(0, 12, 0.4)])
        stacked = stack_candidates(table, points, points[:, 2], SETTINGS)
        assert len(stacked) == 0
        assert set(stacked) == {*table, "height_m", "z", "candidate", "wall_m"}
