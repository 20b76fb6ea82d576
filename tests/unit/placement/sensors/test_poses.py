import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from roadsight.geometry.cameras import attitude_deg, cam_from_world
from roadsight.placement.sensors.poses import (
    AS_MOUNTED,
    Turn,
    local_from_sensor,
    not_dominated,
    pose_name,
    split_pose,
    tilt_rotation,
    turns_of,
)
from roadsight.placement.sensors.rays import beam_directions
from roadsight.placement.sensors.sensors import Sensor
from roadsight.setcover import CoverProblem, solve_cover_problem

ANGLE = st.floats(-179, 179).map(lambda value: round(value, 3))
TURN = st.builds(Turn, ANGLE, st.floats(-89, 89).map(lambda value: round(value, 3)), ANGLE)


class TestConvention:
    def test_yaw_turns_left_pitch_up_and_roll_lifts_the_right_side(self):
        left = local_from_sensor(0.0, Turn(90, 0, 0))
        np.testing.assert_allclose(left[:, 0], [0, 1, 0], atol=1e-12)
        up = local_from_sensor(0.0, Turn(0, 30, 0))
        assert up[2, 0] == pytest.approx(0.5)
        rolled = local_from_sensor(0.0, Turn(0, 0, 30))
        assert -rolled[2, 1] == pytest.approx(0.5)  # the right side is minus y

    @given(st.floats(-180, 180), TURN)
    def test_pitch_and_roll_are_those_of_the_pole_jobs_cameras(self, facing_deg, turn):
        axes = local_from_sensor(facing_deg, turn)
        forward, left, up = axes.T
        cam = cam_from_world(90 - facing_deg - turn.yaw_deg, turn.pitch_deg, turn.roll_deg)
        np.testing.assert_allclose(cam, [-left, -up, forward], atol=1e-9)
        heading, pitch, _ = attitude_deg(cam)
        assert pitch == pytest.approx(turn.pitch_deg, abs=1e-6)
        turned = heading - (90 - facing_deg - turn.yaw_deg)
        assert (turned + 180) % 360 == pytest.approx(180, abs=1e-5)

    @given(st.floats(-180, 180))
    def test_a_leaning_mount_turns_all_of_it_as_depth_maps_do(self, facing_deg):
        tilt = tilt_rotation(np.array([0.05, -0.03, 1]) / np.linalg.norm([0.05, -0.03, 1]))
        sensor = Sensor(azimuth_step_deg=90, elevations_deg=(-20.0, 0.0), range_m=50)
        beams = beam_directions(sensor, 0.0).reshape(-1, 3)
        turned = beams @ local_from_sensor(facing_deg, AS_MOUNTED, tilt).T
        expected = beam_directions(sensor, facing_deg, tilt).reshape(-1, 3)
        np.testing.assert_allclose(turned, expected, atol=1e-6)


class TestNames:
    @given(TURN)
    def test_a_pose_is_read_from_its_name(self, turn):
        name, found = split_pose(pose_name("edge@y1-s0004.00-h04.50", turn))
        assert name == "edge@y1-s0004.00-h04.50"
        assert found == pytest.approx(turn, abs=1e-9)

    def test_a_candidate_without_a_pose_is_as_mounted(self):
        assert split_pose("right-s0004.00-h04.50") == ("right-s0004.00-h04.50", AS_MOUNTED)

    def test_different_poses_have_different_names_and_the_least_turned_comes_first(self):
        turns = turns_of([0, -30, 30, 30], [-10, 0], [0])
        assert turns[0] == AS_MOUNTED
        assert len({pose_name("a", turn) for turn in turns}) == len(turns) == 6


def seen_by_poses():
    shape = st.tuples(st.integers(1, 9), st.integers(1, 12))
    return shape.flatmap(lambda size: arrays(bool, size))


class TestDominance:
    @given(seen_by_poses())
    def test_every_dropped_pose_is_part_of_a_kept_one_and_no_kept_one_of_another(self, seen):
        kept = not_dominated(seen)
        for row in range(len(seen)):
            within = [(seen[row] <= seen[other]).all() for other in kept]
            assert any(within) or not seen[row].any()
        for row in kept:
            others = kept[kept != row]
            assert not any((seen[row] <= seen[other]).all() for other in others)
        # Of equal poses the first is kept.
        for row in kept:
            assert not any((seen[row] == seen[other]).all() for other in range(row))

    @settings(deadline=None, max_examples=50)
    @given(st.lists(seen_by_poses(), min_size=1, max_size=3), st.integers(0, 99))
    def test_the_best_cover_costs_the_same_without_the_dropped_poses(self, positions, seed):
        targets = min(seen.shape[1] for seen in positions)
        positions = [seen[:, :targets] for seen in positions]
        everything = np.concatenate(positions)
        covered = everything.any(axis=0)
        if not covered.any():
            return
        full = [(rows[:, covered], number) for number, rows in enumerate(positions)]
        few = [(rows[not_dominated(rows)], number) for rows, number in full]
        costs = np.random.default_rng(seed).integers(1, 4, len(positions)).astype(float)

        def best(parts):
            matrix = np.concatenate([rows for rows, _ in parts])
            group = np.repeat([number for _, number in parts], [len(rows) for rows, _ in parts])
            cover = solve_cover_problem(CoverProblem(matrix, costs[group], groups=group))
            return cover.status, cover.objective

        assert best(few) == best(full)


def test_angles_are_those_that_names_state():
    turns = turns_of([10.0001, 10.0002, -0.0001], [0.0], [0.0])
    assert [turn.yaw_deg for turn in turns] == [0.0, 10.0]
    assert all(split_pose(pose_name("c", turn))[1] == turn for turn in turns)
