import geopandas as gpd
import numpy as np
import pandas as pd
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st
from pyproj import CRS

from roadsight.base.errors import InputError
from roadsight.geometry.frames import Frame
from roadsight.io.raster.rasters import write_raster
from roadsight.io.records.atomic import write_json
from roadsight.io.records.placement_tables import write_detections
from roadsight.io.records.scene_tables import write_surfels
from roadsight.io.records.tables import write_table
from roadsight.placement.sight.obstacles import (
    blocked_sight_lines,
    explain_gaps,
    group_obstacles,
    pairs_in_range,
)
from roadsight.scene.surfels import Surfels
from roadsight.stages.placement import find_obstacles
from roadsight_worlds.casting.simple_scenes import cylinder_scene, plane_scene, wall_scene

HEIGHT_M = 0.6
LEVELS = np.array([0.25, 0.5, 0.75, 1.0])
PLACE = ["obstacle_x", "obstacle_y", "obstacle_z"]


def caster(scene):
    """Cast from one origin; infinity where nothing is met."""

    def cast(origin_m, directions):
        return scene.cast(np.tile(origin_m, (len(directions), 1)), directions, 1e3)[0]

    return cast


def table(name, points, first=0):
    points = np.asarray(points, float).reshape(-1, 3)
    frame = pd.DataFrame(points, columns=["x", "y", "z"])
    frame.insert(0, name, [f"{name[0]}{first + i}" for i in range(len(points))])
    return frame


def paired(sensors, targets, range_m=1e3):
    return pairs_in_range(sensors, targets, np.full(len(sensors), range_m))


def test_a_wall_between_is_found_where_it_stands():
    sensors, targets = table("candidate", [[0, 0, 6]]), table("target", [[30, 3, 0]])
    lines = blocked_sight_lines(paired(sensors, targets), HEIGHT_M, caster(wall_scene(20.0)))
    assert lines["blocked_share"].tolist() == [1.0]
    # On the lowest line, from 6 m to a quarter of the target's height, two thirds of the way.
    lowest_m = 6 + (0.25 * HEIGHT_M - 6) * 20 / 30
    assert lines[PLACE].to_numpy()[0] == pytest.approx([20, 2, lowest_m], abs=1e-9)


def test_a_low_wall_blocks_the_lower_lines_only():
    # The lines cross x = 20 at 2 m + two thirds of their height on the target.
    heights = 2.0 + LEVELS * HEIGHT_M * 20 / 30
    scene = wall_scene(20.0, height_m=float(heights[1:3].mean()))
    sensors, targets = table("candidate", [[0, 0, 6]]), table("target", [[30, 0, 0]])
    lines = blocked_sight_lines(paired(sensors, targets), HEIGHT_M, caster(scene))
    assert lines["blocked_share"].tolist() == [0.5]
    assert lines[PLACE].to_numpy()[0] == pytest.approx([20, 0, heights[0]], abs=1e-9)


@pytest.mark.parametrize(
    "scene",
    [plane_scene(), wall_scene(40.0), cylinder_scene(15.0, -5.0)],
    ids=["nothing", "beyond", "beside"],
)
def test_nothing_between_blocks_nothing(scene):
    sensors = table("candidate", [[0, 0, 6], [0, 8, 4]])
    targets = table("target", [[30, 0, 0], [12, -3, 0]])
    lines = blocked_sight_lines(paired(sensors, targets), HEIGHT_M, caster(scene))
    assert lines["blocked_share"].tolist() == [0.0] * 4
    assert lines[PLACE].isna().all(axis=None)


def test_what_touches_the_target_is_no_obstacle():
    sensors, targets = table("candidate", [[0, 0, 0.3]]), table("target", [[20.3, 0, 0]])
    pairs = paired(sensors, targets)
    near = blocked_sight_lines(pairs, HEIGHT_M, caster(wall_scene(20.0)))
    assert near["blocked_share"].tolist() == [0.0]
    before = blocked_sight_lines(pairs, HEIGHT_M, caster(wall_scene(19.8)))
    assert before["blocked_share"].tolist() == [1.0]


def test_a_ray_without_return_is_free_whether_told_by_zero_or_infinity():
    pairs = paired(table("candidate", [[0, 0, 6]]), table("target", [[30, 0, 0]]))
    for nothing in (0.0, np.inf):
        lines = blocked_sight_lines(pairs, HEIGHT_M, lambda _, d, r=nothing: np.full(len(d), r))
        assert lines["blocked_share"].tolist() == [0.0]
        assert lines[PLACE].isna().all(axis=None)


def test_a_sensor_in_its_target_is_not_blocked():
    pairs = paired(table("candidate", [[5, 0, 0.3]]), table("target", [[5, 0, 0]]))
    lines = blocked_sight_lines(pairs, HEIGHT_M, caster(plane_scene()))
    assert lines["blocked_share"].tolist() == [0.0]


@settings(max_examples=30, deadline=None)
@given(
    distance_m=st.floats(2, 27),
    wall_m=st.floats(0.5, 8),
    sensor_m=st.floats(2, 9),
    y_m=st.floats(-15, 15),
)
def test_share_is_that_of_similar_triangles(distance_m, wall_m, sensor_m, y_m):
    crossing = sensor_m + (LEVELS * HEIGHT_M - sensor_m) * distance_m / 30
    if np.abs(crossing - wall_m).min() < 1e-6:
        return
    scene = wall_scene(distance_m, wall_m, 100.0)
    pairs = paired(table("candidate", [[0, 0, sensor_m]]), table("target", [[30, y_m, 0]]))
    lines = blocked_sight_lines(pairs, HEIGHT_M, caster(scene))
    assert lines["blocked_share"].tolist() == [np.mean(crossing < wall_m)]
    if crossing[0] < wall_m:
        expected = [distance_m, y_m * distance_m / 30, crossing[0]]
        assert lines[PLACE].to_numpy()[0] == pytest.approx(expected, abs=1e-6)


def test_rows_keep_their_index_and_order():
    sensors = table("candidate", [[0, 0, 6], [40, 0, 6]])
    targets = table("target", [[30, 0, 0], [10, 0, 0]])
    pairs = paired(sensors, targets).sample(frac=1, random_state=3)
    pairs.index = [7, 3, 11, 5]
    lines = blocked_sight_lines(pairs, HEIGHT_M, caster(wall_scene(20.0)))
    assert lines.index.tolist() == [7, 3, 11, 5]
    across = (pairs["sensor_x"] < 20) != (pairs["x"] < 20)
    assert (lines["blocked_share"] == across.astype(float)).all()


def test_pairs_end_at_each_sensors_own_range():
    sensors = table("candidate", [[0, 0, 0], [0, 0, 0]])
    targets = table("target", [[10, 0, 0], [20, 0, 0], [0, 20.001, 0]])
    pairs = pairs_in_range(sensors, targets, np.array([10.0, 20.0]))
    names = list(zip(pairs["candidate"], pairs["target"], strict=True))
    assert names == [("c0", "t0"), ("c1", "t0"), ("c1", "t1")]
    assert pairs["distance_m"].tolist() == [10.0, 10.0, 20.0]
    assert pairs[["x", "y", "z"]].to_numpy().tolist() == [[10, 0, 0], [10, 0, 0], [20, 0, 0]]


@pytest.mark.parametrize(("sensors", "targets"), [(0, 0), (0, 2), (2, 0), (2, 2)])
def test_without_pairs_there_are_no_obstacles(sensors, targets):
    chosen = table("candidate", [[0, 0, 5]] * sensors)
    pairs = paired(chosen, table("target", [[50, 0, 0]] * targets), range_m=10.0)
    assert len(pairs) == 0
    lines = blocked_sight_lines(pairs, HEIGHT_M, caster(plane_scene()))
    assert (lines.dtypes == np.float64).all()
    obstacles = group_obstacles(pairs.join(lines))
    assert len(obstacles) == 0
    assert (obstacles[["x", "y", "z"]].dtypes == np.float64).all()


def lines_at(rows):
    return pd.DataFrame(
        [(t, c, share, *place) for t, c, share, place in rows],
        columns=["target", "candidate", "blocked_share", *PLACE],
    )


def test_obstacles_are_grouped_by_cubic_metre():
    lines = lines_at(
        [
            ("t0", "c0", 1.0, (0.2, 0.1, 0.5)),
            ("t1", "c0", 0.5, (0.8, 0.3, 0.7)),
            ("t1", "c1", 0.25, (0.5, 0.5, 0.9)),
            ("t2", "c1", 1.0, (-0.1, 0.1, 0.5)),
            ("t9", "c1", 0.0, (np.nan,) * 3),
        ]
    )
    obstacles = group_obstacles(lines)
    assert obstacles["sight_lines"].tolist() == [3, 1]
    assert obstacles["targets"].tolist() == [2, 1]
    assert obstacles["sensors"].tolist() == [2, 1]
    first, second = obstacles[["x", "y", "z"]].to_numpy()
    assert first == pytest.approx([0.5, 0.3, 0.7])
    assert second == pytest.approx([-0.1, 0.1, 0.5])
    assert obstacles[["target", "candidate"]].to_numpy().tolist() == [["t0", "c0"], ["t2", "c1"]]


def test_equal_obstacles_come_in_order_of_place():
    places = [(5.5, 0.5, 0.5), (-3.5, 2.5, 0.5), (-3.5, -2.5, 0.5), (-3.5, -2.5, 4.5)]
    rows = [(f"t{i}", "c0", 1.0, place) for i, place in enumerate(places)]
    expected = sorted(places)
    for order in (rows, rows[::-1]):
        found = group_obstacles(lines_at(order))
        assert found[["x", "y", "z"]].to_numpy().tolist() == [list(place) for place in expected]


def test_gaps_are_out_of_range_hidden_or_too_thinly_sampled():
    candidates = table("candidate", [[0, 0, 6], [0, 2, 6]])
    targets = table("target", [[-30, 0, 0], [30, 0, 0], [-90, 0, 0], [90, 0, 0]])
    cast = caster(wall_scene(20.0))
    gaps = explain_gaps(targets, candidates, 60.0, HEIGHT_M, cast)
    assert gaps["target"].tolist() == ["t0", "t1", "t2", "t3"]
    # Behind the wall and too far away: no sensor could reach it even without the wall.
    assert gaps["reason"].tolist() == ["too few beams", "hidden", "out of range", "out of range"]
    assert gaps["nearest_m"].tolist() == pytest.approx([np.hypot(r, 6) for r in (30, 30, 90, 90)])
    assert gaps["blocked_share"].tolist() == [0.0, 1.0, 0.0, 1.0]
    assert gaps["obstacle_x"].to_numpy() == pytest.approx([np.nan, 20, np.nan, 20], nan_ok=True)
    assert gaps["candidate"].tolist() == ["c0"] * 4


def test_only_the_eight_nearest_candidates_judge_a_gap():
    near = [[0, y, 6] for y in range(8)]
    candidates = table("candidate", [*near, [45, 0, 6]])
    targets = table("target", [[22, 3, 0]])
    gaps = explain_gaps(targets, candidates, 100.0, HEIGHT_M, caster(wall_scene(20.0)))
    assert gaps["reason"].tolist() == ["hidden"]
    assert gaps["blocked_share"].tolist() == [1.0]
    gaps = explain_gaps(targets, candidates[4:], 100.0, HEIGHT_M, caster(wall_scene(20.0)))
    assert gaps["blocked_share"].tolist() == [0.8]


def test_the_most_blocked_candidate_names_the_obstacle():
    candidates = table("candidate", [[30, 8, 6], [0, 0, 6]])
    targets = table("target", [[30, 0, 0]])
    gaps = explain_gaps(targets, candidates, 100.0, HEIGHT_M, caster(wall_scene(20.0)))
    assert gaps["candidate"].tolist() == ["c1"]
    assert gaps["nearest_m"].tolist() == [10.0]
    assert gaps["blocked_share"].tolist() == [0.5]
    assert gaps["reason"].tolist() == ["too few beams"]


@pytest.mark.parametrize("count", [1, 2])
def test_one_candidate_is_enough(count):
    targets = table("target", [[30, 0, 0], [30, 1, 0]][:count])
    targets.index = [4, 9][:count]
    one = table("candidate", [[0, 0, 6]])
    gaps = explain_gaps(targets, one, 100.0, HEIGHT_M, caster(wall_scene(20.0)))
    assert gaps["reason"].tolist() == ["hidden"] * count
    assert gaps["target"].tolist() == targets["target"].tolist()


def test_no_gap_needs_no_reason():
    targets, candidates = table("target", []), table("candidate", [[0, 0, 6]])
    gaps = explain_gaps(targets, candidates, 100.0, HEIGHT_M, caster(plane_scene()))
    assert len(gaps) == 0
    assert {"target", "x", "y", "z", "reason", "nearest_m", "blocked_share", *PLACE} <= set(gaps)


def test_gaps_cannot_be_judged_without_candidates():
    targets, none = table("target", [[30, 0, 0]]), table("candidate", [])
    with pytest.raises(InputError, match="no candidate"):
        explain_gaps(targets, none, 100.0, HEIGHT_M, caster(plane_scene()))


FRAME = Frame((458_000.0, 5_428_000.0, 100.0), crs_wkt=CRS.from_epsg(25832).to_wkt())
SENSORS = """
sensors:
  far: {azimuth_step_deg: 1, elevations_deg: [-10, 0], range_m: 60}
"""


def wall_of_surfels(x_m, height_m):
    """An upright wall across the road, of squares of 0.5 m; none where its height is 0."""
    y, z = np.meshgrid(np.arange(-10, 10, 0.5), np.arange(0.25, height_m, 0.5))
    centre = np.stack([np.full(y.size, x_m), y.ravel(), z.ravel()], axis=1).astype(np.float32)
    normal = np.tile(np.array([1, 0, 0], np.float32), (y.size, 1))
    return Surfels(centre, normal, np.full((y.size, 2), 0.25, np.float32))


def run_stage(folder, height_m, uncovered):
    """One sensor at the origin, a target before and two behind a wall at 20 m."""
    write_json(folder / "frame.json", FRAME.to_dict())
    write_surfels(folder / "surfels.parquet", wall_of_surfels(20.0, height_m))
    write_raster(folder / "dem.tif", np.zeros((40, 120)), FRAME, -20.0, 20.0, 1.0)
    write_table(folder / "targets.parquet", table("target", [[10, 0, 0], [30, 0, 0], [33, 2, 0]]))
    write_table(folder / "candidates.parquet", table("candidate", [[0, 0, 6], [-30, 0, 6]]))
    seen = pd.DataFrame({"candidate": ["c0"], "target": ["t0"], "hits": np.array([9], np.uint16)})
    write_detections(folder / "seen.parquet", seen, {"sensor": "far"})
    (folder / "sensors.yaml").write_text(SENSORS)
    write_json(folder / "coverage.json", {"plans": {"p": {"uncovered": uncovered}}})
    chosen = [{"candidate": "c0", "sensor": "far", "x": 0.0, "y": 0.0, "z": 6.0}]
    write_json(folder / "solution.json", {"sensors": chosen, "sensor_types": ["far"]})
    files = {name: f"{name}.parquet" for name in ("targets", "surfels", "candidates")}
    files |= {name: f"{name}.json" for name in ("frame", "coverage", "solution")}
    files |= {"dem": "dem.tif", "sensors": "sensors.yaml", "detections": "seen.parquet"}
    paths = [part for n, file in files.items() for part in (f"--{n}", str(folder / file))]
    out = folder / "obstacles.gpkg"
    assert find_obstacles.main([*paths, "--plan", "p", "--out", str(out)]) == 0
    return [gpd.read_file(out, layer=layer) for layer in ("obstacles", "uncovered")]


def test_stage_finds_the_wall_and_explains_the_gap(tmp_path):
    obstacles, gaps = run_stage(tmp_path, 5.0, ["t2"])
    assert obstacles.crs.to_epsg() == gaps.crs.to_epsg() == 25832
    place = shapely.get_coordinates(obstacles.geometry.to_numpy(), include_z=True)
    assert place[:, 0] == pytest.approx(458_020, abs=1e-3)
    assert obstacles["sight_lines"].sum() == 2
    heights = [6 + (0.25 * HEIGHT_M - 6) * 20 / x for x in (30, 33)]
    assert sorted(obstacles["height_m"]) == pytest.approx(sorted(heights), abs=1e-3)
    assert set(obstacles["kind"]) == {"object"}
    assert gaps[["target", "reason"]].to_numpy().tolist() == [["t2", "hidden"]]
    assert gaps["blocked_share"].tolist() == [1.0]


def test_stage_without_obstacle_or_gap_writes_empty_layers(tmp_path):
    obstacles, gaps = run_stage(tmp_path, 0.0, [])
    assert len(obstacles) == len(gaps) == 0
    assert {"targets", "sensors", "height_m", "kind"} <= set(obstacles)
    assert {"target", "reason", "nearest_m"} <= set(gaps)
