"""Stages of the placement job: moving, turning, mirroring and shuffling a scene changes nothing.

Grids are anchored at the local origin, which ingest puts at the cloud's least corner: a scene that
moves in the map keeps its cells, and a scene that is turned does not. Where cells decide, the tests
move by whole cells, or state how much may change.
"""

from dataclasses import replace

import geopandas as gpd
import numpy as np
import pandas as pd
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from shapely import LineString, MultiPolygon, affinity

from roadsight.base.sections.placement import Candidates
from roadsight.placement.candidates.candidates import positions_along, stack_candidates
from roadsight.placement.candidates.targets import place_targets
from roadsight.placement.depth.hybrid import hybrid_depth, preliminary_depth
from roadsight.placement.depth.surfel_lidar import SurfelLidar
from roadsight.placement.sensors.sensors import Sensor
from roadsight.placement.sight.detection import count_hits
from roadsight.scene.surfels import build_surfels
from roadsight.scene.voxel_planes import add_moments, sum_moments

SEEDS = st.integers(0, 2**31)
ANGLES = st.floats(-180.0, 180.0)
FAR = st.tuples(*[st.integers(-5_000_000, 5_000_000)] * 2)
FEW = settings(max_examples=8, deadline=None, suppress_health_check=list(HealthCheck))
SENSOR = Sensor(
    elevation_min_deg=-20, elevation_max_deg=10, channels=31, azimuth_step_deg=1.0, range_m=60
)
AT = np.array([4.0, 3.0, 4.5])


def street(seed, points=20_000):
    """A road, a wall and a few posts, off the borders of voxels; local metres."""
    rng = np.random.default_rng(seed)
    x, y = rng.uniform(-20, 30, (2, points))
    road = np.column_stack([x, y, 0.02 * y])
    wall = np.column_stack([rng.uniform(-20, 30, points), np.full(points, 12.03), x * 0])
    wall[:, 2] = rng.uniform(0, 4, points)
    turn = rng.uniform(0, 2 * np.pi, points // 4)
    posts = rng.integers(-3, 5, points // 4)[:, None] * [5.0, 0.0, 0.0] + [0.5, -6.0, 0.0]
    posts = posts + 0.15 * np.column_stack([np.cos(turn), np.sin(turn), 0 * turn])
    posts[:, 2] = rng.uniform(0, 6, points // 4)
    return np.concatenate([road, wall, posts])


def turned(xyz, angle_deg, about=AT):
    """Points turned counter-clockwise about the vertical through a place."""
    cosine, sine = np.cos(np.radians(angle_deg)), np.sin(np.radians(angle_deg))
    turn = np.array([[cosine, sine, 0], [-sine, cosine, 0], [0, 0, 1]])
    return (xyz - about) @ turn + about


def surfel_map(xyz, yaw_deg=0.0, at=AT):
    return SurfelLidar(build_surfels(sum_moments(xyz, 0.1))).depth_map(SENSOR, at, yaw_deg)


@FEW
@given(seed=SEEDS, cells=st.tuples(*[st.integers(-60, 60)] * 2))
def test_depth_maps_move_with_the_scene(seed, cells):
    """By whole cells of the coarsest surfels, 6.4 m: all but points on a voxel's very face."""
    xyz, shift = street(seed), 6.4 * np.array([*cells, 0])
    here, there = surfel_map(xyz), surfel_map(xyz + shift, at=AT + shift)
    assert np.mean(np.abs(here - there) > 0.01) < 0.01


@FEW
@given(seed=SEEDS, shift=st.sampled_from([(0.5, 0.5, 0.0), (-0.5, 0.0, 0.0), (0.1, -0.3, 0.0)]))
def test_depth_maps_move_with_the_scene_by_half_a_metre(seed, shift):
    """Surfels merge on coarser grids, whose anchor moves: borders of things change a little."""
    xyz = street(seed)
    here, there = surfel_map(xyz), surfel_map(xyz + shift, at=AT + shift)
    both = (here > 0) & (there > 0)
    assert np.mean((here > 0) == (there > 0)) > 0.97
    assert np.mean(np.abs(here - there)[both] < 0.05) > 0.95


@FEW
@given(seed=SEEDS, far=FAR)
def test_depth_maps_of_surfels_far_away(seed, far):
    """Up to 5,000 km, all in double precision outside the ray caster."""
    surfels = build_surfels(sum_moments(street(seed), 0.1))
    shift = np.array([*far, 0.0])
    centre = surfels.centre_m.astype(np.float64)
    maps = [
        SurfelLidar(replace(surfels, centre_m=centre + by)).depth_map(SENSOR, AT + by, 10.0)
        for by in (np.zeros(3), shift)
    ]
    assert np.mean(np.abs(maps[0] - maps[1]) > 1e-3) < 1e-3


@FEW
@given(seed=SEEDS, angle=ANGLES)
def test_depth_maps_turn_with_the_scene(seed, angle):
    """The grid does not turn, and ends of sparse surfaces move with it by half their spacing."""
    xyz = street(seed)
    here, there = surfel_map(xyz), surfel_map(turned(xyz, angle), angle)
    both = (here > 0) & (there > 0)
    assert np.mean((here > 0) == (there > 0)) > 0.97
    assert np.mean(np.abs(here - there)[both] < 0.05) > 0.9


@FEW
@given(seed=SEEDS, parts=st.integers(2, 9))
def test_surfels_do_not_depend_on_order_repeats_or_tiles(seed, parts):
    rng = np.random.default_rng(seed)
    xyz = street(seed, 4000)
    order = rng.permutation(len(xyz))
    tiles = [sum_moments(part, 0.1) for part in np.array_split(xyz[order], parts)]
    here, there = build_surfels(sum_moments(xyz, 0.1)), build_surfels(add_moments(tiles))
    assert abs(len(here) - len(there)) <= 0.002 * len(here)
    maps = [SurfelLidar(one).depth_map(SENSOR, AT, 0.0) for one in (here, there)]
    assert np.mean(np.abs(maps[0] - maps[1]) > 1e-2) < 0.01


@FEW
@given(seed=SEEDS)
def test_depth_maps_from_points_do_not_depend_on_their_order(seed):
    rng = np.random.default_rng(seed)
    xyz = street(seed, 3000)
    order = rng.permutation(len(xyz))
    doubled = np.concatenate([xyz, xyz[rng.integers(0, len(xyz), 2000)]])
    least = preliminary_depth(xyz, SENSOR, AT, 0.0)
    assert (preliminary_depth(xyz[order], SENSOR, AT, 0.0) == least).all()
    assert (preliminary_depth(doubled, SENSOR, AT, 0.0) == least).all()
    maps = [hybrid_depth(part, SENSOR, AT, 0.0) for part in (xyz, xyz[order])]
    np.testing.assert_allclose(maps[0], maps[1], atol=1e-3)


def feet_around(seed, count=40):
    rng = np.random.default_rng(seed)
    away, turn = rng.uniform(1.5, 40, count), rng.uniform(0, 2 * np.pi, count)
    xy = away[:, None] * np.column_stack([np.cos(turn), np.sin(turn)]) + AT[:2]
    return np.column_stack([xy, rng.uniform(-0.3, 0.3, count)])


@FEW
@given(seed=SEEDS, angle=ANGLES, far=FAR)
def test_beams_on_targets_turn_and_move_with_the_scene(seed, angle, far):
    feet, scene = feet_around(seed), np.full(SENSOR.shape, 25.0, np.float32)
    here = count_hits(scene, SENSOR, AT, 20.0, feet)
    assert here.max() > 0
    shift = np.array([far[0] + 0.5, far[1] + 0.5, 0.0])
    there = count_hits(scene, SENSOR, AT + shift, 20.0 + angle, turned(feet, angle) + shift)
    assert np.abs(here - there).max() <= 1  # a beam that only just touches


@FEW
@given(seed=SEEDS)
def test_beams_on_targets_are_mirrored_with_the_scene(seed):
    feet = feet_around(seed)
    scene = np.random.default_rng(seed).uniform(3, 60, SENSOR.shape).astype(np.float32)
    mirrored = feet * [1, -1, 1] + [0, 2 * AT[1], 0]
    here = count_hits(scene, SENSOR, AT, 0.0, feet)
    there = count_hits(np.ascontiguousarray(scene[:, ::-1]), SENSOR, AT, 0.0, mirrored)
    assert np.abs(here - there).max() <= 1


@FEW
@given(seed=SEEDS, cells=st.tuples(*[st.integers(-500_000, 500_000)] * 2))
def test_targets_move_with_the_pavement(seed, cells):
    rng = np.random.default_rng(seed)
    xyz = np.round(rng.uniform(0, 12, (6000, 3)) * 1024) / 1024
    order, shift = rng.permutation(len(xyz)), np.array([*cells, 0.0])
    here, there = place_targets(xyz), place_targets(xyz[order] + shift)
    moved = here[["x", "y", "z"]].to_numpy() + shift
    assert (there[["x", "y", "z"]].to_numpy() == moved).all()
    assert (here["points"] == there["points"]).all()


def candidates(line, pavement, obstacles):
    edges = gpd.GeoDataFrame({"edge": ["e"], "kind": ["verge"]}, geometry=[line])
    positions = positions_along(edges, pavement, 4.0).assign(ground_z_m=0.0)
    return stack_candidates(positions, obstacles, obstacles[:, 2], Candidates())


@FEW
@given(seed=SEEDS, angle=ANGLES, mirror=st.booleans())
def test_candidates_turn_and_mirror_with_the_edge(seed, angle, mirror):
    rng = np.random.default_rng(seed)
    line = LineString([(0, 0), (18, 1), (35, 5), (50, 12)])
    # Where neither side or both are paved a position faces left, which no mirror keeps.
    # The pavement goes on beyond the edge, or the ends' probes lie on its border.
    road = LineString([(-18, -1), (18, 1), (35, 5), (65, 19)])
    pavement = MultiPolygon([road.buffer(-8, single_sided=True)])
    obstacles = np.column_stack([rng.uniform(0, 50, (60, 2)) * [1, 0.25], rng.uniform(0, 9, 60)])
    here = candidates(line, pavement, obstacles)
    sign = -1.0 if mirror else 1.0
    cosine, sine = np.cos(np.radians(angle)), np.sin(np.radians(angle))
    matrix = [cosine, -sign * sine, sine, sign * cosine, 0, 0]
    move = np.array([[cosine, -sign * sine], [sine, sign * cosine]])
    xy = obstacles[:, :2] @ move.T
    there = candidates(
        affinity.affine_transform(line, matrix),
        MultiPolygon(affinity.affine_transform(pavement, matrix).geoms),
        np.column_stack([xy, obstacles[:, 2]]),
    )
    assert here["candidate"].tolist() == there["candidate"].tolist()
    np.testing.assert_allclose(there[["x", "y"]], here[["x", "y"]].to_numpy() @ move.T, atol=1e-9)
    expected = angle + sign * here["yaw_deg"]
    gap = (there["yaw_deg"] - expected + 180.0) % 360.0 - 180.0
    assert np.abs(gap).max() < 1e-6


def test_the_same_obstacles_in_another_order_give_the_same_heights(rng):
    line, xy = LineString([(0, 0), (40, 0)]), rng.uniform([0, -1], [40, 1], (300, 2))
    obstacles = np.column_stack([xy, rng.uniform(0, 9, 300)])
    again = np.concatenate([obstacles[rng.permutation(300)], obstacles[:50]])
    here, there = (candidates(line, MultiPolygon(), part) for part in (obstacles, again))
    pd.testing.assert_frame_equal(here, there)
