import numpy as np
import pytest

from roadsight.evidence.labelled_clouds import ground_points, read_street
from roadsight.scene.pavement.road_surface import RoadSettings, find_road, road_points
from roadsight.scene.pavement.scan_levels import close_turns, scanner_positions
from roadsight.scene.whole import near_ground

HALF_ROAD_M = 4.0
SPEED_M = 0.8
"""Way from one turn to the next."""


def drive(rng, turns=8, heading_deg=0.0, lane_m=-1.5, per_turn=40_000):
    """Points of a street as turns of a scanner see it: (n, 3), turn, azimuth, places, across."""
    heading = np.radians(heading_deg)
    ahead = np.array([np.cos(heading), np.sin(heading)])
    left = np.array([-ahead[1], ahead[0]])
    rings = np.geomspace(2.8, 28.0, 45)
    parts = []
    for turn in range(turns):
        azimuth = rng.uniform(-np.pi, np.pi, per_turn)
        away = rng.choice(rings, per_turn) * rng.normal(1, 0.004, per_turn)
        along = turn * SPEED_M + away * np.cos(azimuth)
        across = lane_m + away * np.sin(azimuth)
        z = 0.01 * along - 0.02 * np.abs(across) + rng.normal(0, 0.008, per_turn)
        z += np.where(np.abs(across) > HALF_ROAD_M, 0.12, 0.0)
        xy = along[:, None] * ahead + across[:, None] * left
        parts.append(np.column_stack([xy, z, np.full(per_turn, turn), azimuth, across]))
    points = np.concatenate(parts)
    places = np.arange(turns)[:, None] * SPEED_M * ahead + lane_m * left
    return points[:, :3], points[:, 3].astype(np.int64), points[:, 4], places, points[:, 5]


def ramp_m(azimuth, ray, step_m):
    """Error of heights between a turn's two ends, half a step at its left."""
    return step_m * (0.5 - np.mod(azimuth - ray, 2 * np.pi) / (2 * np.pi))


@pytest.mark.parametrize(
    ("ray_deg", "step_m", "heading_deg"),
    [(180, 0.16, 0), (180, -0.16, 77), (172, 0.08, -130), (0, -0.25, 15), (93, 0.12, 160)],
)
def test_a_step_that_all_turns_share_is_taken_out(rng, ray_deg, step_m, heading_deg):
    """Places are off by what blind discs tell, and every turn has a step of its own."""
    xyz, turn, azimuth, places, _ = drive(rng, heading_deg=heading_deg)
    own_step = step_m * rng.uniform(0.8, 1.2, 8)[turn]
    bent = xyz.copy()
    bent[:, 2] += ramp_m(azimuth, np.radians(ray_deg), own_step)
    seen = places + rng.uniform(-0.25, 0.25, places.shape)
    heights, found_m = close_turns(bent, turn, seen, np.ones(8, bool))
    assert found_m == pytest.approx(abs(step_m), abs=0.15 * abs(step_m) + 0.01)
    off = heights - xyz[:, 2]
    beside = np.mod(azimuth - np.radians(ray_deg) + np.pi, 2 * np.pi) - np.pi
    away = np.hypot(*(xyz[:, :2] - places[turn]).T)
    for side in (-1, 1):
        there = (np.abs(beside - side * 0.15) < 0.1) & (away < 20)
        assert abs(np.median(off[there])) < 0.03


@pytest.mark.parametrize("step_m", [0.0, 0.06, 0.15])
def test_a_step_along_the_lane_before_and_behind_stays(rng, step_m):
    xyz, turn, _, places, across = drive(rng)
    xyz[:, 2] += np.where(across > -1.5, step_m, 0.0)
    heights, found_m = close_turns(xyz, turn, places, np.ones(8, bool))
    assert found_m == 0.0 and np.array_equal(heights, xyz[:, 2])


def test_one_turn_that_does_not_close_is_left(rng):
    xyz, turn, azimuth, places, _ = drive(rng)
    xyz[:, 2] += np.where(turn == 3, ramp_m(azimuth, np.pi, 0.2), 0.0)
    heights, found_m = close_turns(xyz, turn, places, np.ones(8, bool))
    assert found_m == 0.0 and np.array_equal(heights, xyz[:, 2])


def test_turns_without_a_place_keep_their_heights(rng):
    xyz, turn, azimuth, places, _ = drive(rng)
    xyz[:, 2] += ramp_m(azimuth, np.pi, 0.2)
    places[[2, 5]] = np.nan
    heights, found_m = close_turns(xyz, turn, places, np.isfinite(places[:, 0]))
    kept = np.isin(turn, (2, 5))
    assert found_m == pytest.approx(0.2, abs=0.03)
    assert np.array_equal(heights[kept], xyz[kept, 2])
    assert not np.array_equal(heights[~kept], xyz[~kept, 2])


@pytest.mark.parametrize("step_m", [0.0, 0.16])
def test_both_lanes_are_road_whether_turns_close_or_not(rng, step_m):
    xyz, turn, azimuth, _, across = drive(rng)
    xyz[:, 2] += ramp_m(azimuth, np.pi, step_m)
    surface = find_road(xyz, None, turn)
    found = road_points(surface, xyz, RoadSettings())
    road = np.abs(across) < HALF_ROAD_M
    behind = np.abs(np.abs(azimuth) - np.pi) < 0.7
    assert surface.seeded_by == "scans"
    assert surface.seam_m == pytest.approx(step_m, abs=0.03)
    for lane in (across > -1.4, across < -1.6):
        assert found[road & lane & behind].mean() > 0.85
    assert found[~road].mean() < 0.05


@pytest.mark.real
@pytest.mark.parametrize(("name", "step_m"), [("02", 0.0), ("05", 0.0), ("08", 0.16)])
def test_of_real_streets_one_does_not_close(data, name, step_m):
    street = ground_points(read_street(data / "street_scans" / name))
    near = near_ground(street.xyz_m)
    xyz_m, scan = street.xyz_m[near], street.scan[near]
    heights, found_m = close_turns(xyz_m, scan, *scanner_positions(xyz_m, scan))
    assert found_m == pytest.approx(step_m, abs=0.02)
    assert np.abs(heights - xyz_m[:, 2]).max() < 0.2
