import json

import numpy as np
import pandas as pd
import pytest

from roadsight.geometry.frames import Frame
from roadsight.io.cloud.clouds import read_laz
from roadsight.io.raster.rasters import write_raster
from roadsight.io.records.atomic import write_json
from roadsight.io.records.depth_maps import DepthMapInfo, DepthMapWriter
from roadsight.io.records.placement_tables import read_detections, write_detections
from roadsight.io.records.scene_tables import write_surfels
from roadsight.io.records.tables import read_about, read_table, write_table
from roadsight.io.vector.vectors import read_layer
from roadsight.placement.plans.plan_problem import choices_of, posed_candidates
from roadsight.placement.sensors.poses import Turn, local_from_sensor, split_pose
from roadsight.placement.sensors.sensors import load_sensors
from roadsight.placement.sight.detectors import Criteria, detector_of
from roadsight.placement.sight.kinds import Box, Cylinder
from roadsight.placement.sight.sight import Sight
from roadsight.scene.surfels import Surfels
from roadsight.stages.placement import (
    check_coverage,
    detect_poses,
    find_obstacles,
    render_scans,
    solve_cover,
)
from tests.helpers.analytic_scene import panorama_of

SENSORS = """
sensors:
  eye: {kind: camera, columns_px: 800, rows_px: 600, hfov_deg: 60, min_pixels: 40, range_m: 80,
        cost: 0.4}
  brush: {kind: rosette, field_deg: 60, points_per_s: 200000, frame_s: 0.2, range_m: 90, cost: 1}
  ear: {kind: radar, zones: [{half_angle_deg: 40, range_m: 150, resolution_deg: 4}],
        elevation_min_deg: -30, cost: 1}
  ring: {kind: spinning, elevation_min_deg: -25, elevation_max_deg: 15, channels: 16, range_m: 60,
         cost: 1}
"""
FRAME = Frame((0.0, 0.0, 0.0), 1.0, 1.0, None)
YAW = ("-60", "0", "60")
PITCH = ("-30", "-10", "-8")
PLACES = {"a": (0.0, -4.0), "b": (30.0, -4.0)}
HEIGHT_M = 6.0


@pytest.fixture(scope="module")
def road(tmp_path_factory):
    """Targets on a level road, two candidates beside it, and what the stages read."""
    folder = tmp_path_factory.mktemp("road")
    (folder / "sensors.yaml").write_text(SENSORS)
    x, y = (part.ravel() for part in np.meshgrid(np.arange(-9.5, 40), np.arange(0.5, 8)))
    names = [f"t{number}" for number in range(len(x))]
    write_table(folder / "targets", pd.DataFrame({"target": names, "x": x, "y": y, "z": 0.0}))
    table = pd.DataFrame({"candidate": list(PLACES), "key": list(PLACES), "edge": "right"})
    table[["x", "y"]] = np.array(list(PLACES.values()))
    table = table.assign(mount="edge", station_m=table["x"], z=HEIGHT_M, height_m=HEIGHT_M)
    write_table(folder / "candidates", table.assign(ground_z_m=0.0, yaw_deg=90.0))
    panoramas = {
        n: panorama_of((*xy, HEIGHT_M), range_m=90, yaw_deg=90) for n, xy in PLACES.items()
    }
    shape = panoramas["a"].range_m.shape
    info = DepthMapInfo("panorama-0.2deg-90m", "surfel", *shape, 0.002)
    with DepthMapWriter(folder / "depth", info) as writer:
        for name, panorama in panoramas.items():
            writer.append(name, panorama.range_m)
    axis = np.arange(-60, 90, 0.5) + 0.25
    sx, sy = (part.ravel() for part in np.meshgrid(axis, axis))
    centre = np.column_stack([sx, sy, 0 * sx]).astype(np.float32)
    up = np.tile(np.float32([0, 0, 1]), (len(sx), 1))
    write_surfels(folder / "surfels", Surfels(centre, up, np.full((len(sx), 2), 0.25, np.float32)))
    write_json(folder / "frame.json", FRAME.to_dict())
    return folder, panoramas


def detect(folder, sensor, *options, out=None):
    out = folder / (out or f"seen-{sensor}")
    files = {
        "depth": "depth",
        "candidates": "candidates",
        "targets": "targets",
        "sensors": "sensors.yaml",
    }
    named = [part for key, name in files.items() for part in (f"--{key}", str(folder / name))]
    angles = ("--yaw-deg", *YAW, "--pitch-deg", *PITCH, "--roll-deg", "0")
    stage = [*named, "--sensor", sensor, *angles, *options, "--out", str(out)]
    assert detect_poses.main(stage) == 0
    return out


def solve(folder, costs, seen, *options):
    plan = ("--plans", "p=" + ",".join(costs), "--out", str(folder / "coverage"))
    common = ["--targets", str(folder / "targets"), "--candidates", str(folder / "candidates")]
    found = ["--detections", *map(str, seen)]
    assert check_coverage.main([*common, *found, *plan]) == 0
    outputs = {"solution": "solution", "layers": "layers.gpkg", "timing": "timing"}
    names = [part for key, file in outputs.items() for part in (f"--{key}", str(folder / file))]
    prices = ("--sensors", *(f"{name}={cost}" for name, cost in costs.items()))
    site = ("--site", "s", "--plan", "p", "--coverage", str(folder / "coverage"))
    frame = ("--frame", str(folder / "frame.json"), "--uncoverable", "exclude")
    assert solve_cover.main([*site, *common, *found, *frame, *prices, *names, *options]) == 0
    return json.loads((folder / "solution").read_text())


class TestDetections:
    @pytest.mark.parametrize("sensor", ["eye", "brush", "ear", "ring"])
    def test_kept_poses_see_what_the_detector_says(self, road, sensor):
        folder, panoramas = road
        out = detect(folder, sensor)
        found = read_detections([out])
        assert read_about(out)["sensor"] == sensor
        assert read_about(out)["poses_tried"] == len(YAW) * len(PITCH) * len(PLACES)
        targets = read_table(folder / "targets")
        feet = targets[["x", "y", "z"]].to_numpy(np.float64)
        definition = load_sensors(folder / "sensors.yaml")[sensor]
        detector = detector_of(definition, Criteria(8, 0.16))
        assert found["candidate"].nunique() == read_about(out)["poses_kept"] > 2
        for name, rows in found.groupby("candidate", observed=True):
            candidate, turn = split_pose(str(name))
            rotation = local_from_sensor(90.0, turn)
            measured = detector.measure(
                panoramas[candidate], rotation, feet, Cylinder(0.25, 0.6), Sight(definition.range_m)
            )
            expected = set(targets["target"][detector.sees(measured)])
            # Stored ranges are whole millimetres.
            assert len(expected ^ set(rows["target"].astype(str))) <= 2

    def test_fog_shortens_what_a_camera_sees_and_not_what_a_radar_does(self, road, tmp_path):
        folder, _ = road
        air = tmp_path / "fog.json"
        write_json(air, {"extinction_per_m": {"eye": 3.912 / 12}})
        clear, dim = (
            read_detections([detect(folder, "eye", *options, out="eye-air")])
            for options in ((), ("--air", str(air)))
        )
        assert 0 < dim["target"].nunique() < clear["target"].nunique()
        one, other = (
            detect(folder, "ear", *options, out=f"ear{len(options)}").read_bytes()
            for options in ((), ("--air", str(air)))
        )
        assert one == other


class TestChoice:
    def test_one_pose_a_position_and_the_solution_says_which(self, road):
        folder, _ = road
        seen = [detect(folder, "eye"), detect(folder, "brush")]
        solution = solve(folder, {"eye": 0.4, "brush": 1.0}, seen)
        sensors = solution["sensors"]
        assert len({entry["position"] for entry in sensors}) == len(sensors) <= len(PLACES)
        for entry in sensors:
            candidate, turn = split_pose(entry["candidate"])
            assert entry["position"] == candidate
            assert (entry["pitch_deg"], entry["roll_deg"]) == (turn.pitch_deg, turn.roll_deg)
            assert entry["yaw_deg"] == pytest.approx(90 + turn.yaw_deg)
        assert solution["objective"] == pytest.approx(
            sum({"eye": 0.4, "brush": 1.0}[entry["sensor"]] for entry in sensors)
        )

    def test_the_cheapest_mix_equals_trying_every_combination(self, road):
        folder, _ = road
        costs = {"eye": 0.4, "brush": 1.0}
        seen = [detect(folder, name) for name in costs]
        solution = solve(folder, costs, seen)
        detections = read_detections(seen)
        detections["position"] = [split_pose(str(n))[0] for n in detections["candidate"]]
        wanted = set(detections["target"]) - set(solution["excluded"])
        options = {
            place: [
                (0.0, set()),
                *(
                    (costs[str(sensor)], set(rows["target"]))
                    for (sensor, _), rows in part.groupby(["sensor", "candidate"], observed=True)
                ),
            ]
            for place, part in detections.groupby("position")
        }
        best = min(
            one[0] + two[0]
            for one in options["a"]
            for two in options.get("b", [(0.0, set())])
            if wanted <= one[1] | two[1]
        )
        if solution["status"] == "optimal":
            assert solution["objective"] == pytest.approx(best)

    def test_choices_are_those_poses_or_every_candidate_as_it_is(self):
        candidates = pd.DataFrame({"candidate": ["a", "b"], "yaw_deg": [170.0, -90.0]})
        seen = [
            ("eye", "b@y+0p-10r+0"), ("eye", "a@y+35p-10r+0"), ("eye", "gone@y+0p+0r+0"),
            ("ring", "a"), ("eye", "b@y+0p-10r+0"),
        ]  # fmt: skip
        detections = pd.DataFrame(seen, columns=["sensor", "candidate"])
        choices = choices_of({"ring": 1.0, "eye": 0.4, "ear": 2.0}, candidates, detections)
        assert choices["sensor"].tolist() == ["ring", "ring", "eye", "eye", "ear", "ear"]
        named = ["a", "b", "a@y+35p-10r+0", "b@y+0p-10r+0", "a", "b"]
        assert choices["candidate"].tolist() == named
        assert choices["position"].tolist() == [0, 1, 0, 1, 0, 1]
        assert choices["cost"].tolist() == [1, 1, 0.4, 0.4, 2, 2]
        turned = posed_candidates(choices.iloc[[1, 2]], candidates)
        assert turned["yaw_deg"].tolist() == [-90, -155]
        assert turned["position"].tolist() == ["b", "a"]
        assert "pitch_deg" not in posed_candidates(choices.iloc[[1]], candidates)


class TestObstacles:
    def test_only_what_stands_in_the_field_of_view_hides_targets(self, road, tmp_path):
        folder, _ = road
        # Walls on both sides of the candidate: the camera looks to the left, so along -x.
        axis, height = np.arange(0.25, 8, 0.5), np.arange(0.25, 7, 0.5)
        y, z = (part.ravel() for part in np.meshgrid(axis, height))
        walls = np.concatenate([np.column_stack([np.full(len(y), x), y, z]) for x in (-5.0, 5.0)])
        sideways = np.tile(np.float32([1, 0, 0]), (len(walls), 1))
        half = np.full((len(walls), 2), 0.25, np.float32)
        write_surfels(tmp_path / "walls", Surfels(walls.astype(np.float32), sideways, half))
        write_raster(tmp_path / "dem.tif", np.zeros((140, 140)), FRAME, -60, 80, 1.0)
        place = {"candidate": "a@y+60p-10r+0", "position": "a", "sensor": "eye"}
        place |= {"x": 0.0, "y": -4.0, "z": 6.0, "yaw_deg": 150.0, "pitch_deg": -10.0}
        place |= {"roll_deg": 0.0}
        write_json(tmp_path / "solution", {"sensors": [place], "sensor_types": ["eye"]})
        write_json(tmp_path / "coverage", {"plans": {"p": {"uncovered": ["t0"]}}})
        nothing = pd.DataFrame(
            {
                "candidate": pd.Series(dtype=str),
                "target": pd.Series(dtype=str),
                "hits": pd.Series(dtype=np.uint16),
            }
        )
        write_detections(tmp_path / "seen", nothing, {"sensor": "eye"})
        files = {
            "solution": tmp_path / "solution", "coverage": tmp_path / "coverage",
            "targets": folder / "targets", "surfels": tmp_path / "walls",
            "dem": tmp_path / "dem.tif", "frame": folder / "frame.json",
            "sensors": folder / "sensors.yaml", "candidates": folder / "candidates",
            "detections": tmp_path / "seen", "out": tmp_path / "out.gpkg",
        }  # fmt: skip
        named = [part for key, file in files.items() for part in (f"--{key}", str(file))]
        assert find_obstacles.main([*named, "--plan", "p"]) == 0
        obstacles = read_layer(tmp_path / "out.gpkg", "obstacles", FRAME)
        assert len(obstacles)
        assert (obstacles.geometry.x < 0).all()
        gaps = read_layer(tmp_path / "out.gpkg", "uncovered", FRAME)
        assert set(gaps["reason"]) <= {
            "hidden",
            "out of range",
            "out of view, or too few beams, pixels or echo",
        }


class TestScans:
    @pytest.mark.parametrize("sensor", ["eye", "brush", "ear", "ring"])
    def test_returns_lie_on_the_road_within_range_and_view(self, road, tmp_path, sensor):
        folder, _ = road
        definition = load_sensors(folder / "sensors.yaml")[sensor]
        place = {
            "candidate": "a@y+60p-20r+5", "position": "a", "sensor": sensor, "x": 0.0, "y": -4.0,
            "z": 6.0, "yaw_deg": 150.0, "pitch_deg": -20.0, "roll_deg": 5.0,
        }  # fmt: skip
        write_json(tmp_path / "solution", {"sensors": [place]})
        arguments = ["--solution", str(tmp_path / "solution"), "--out", str(tmp_path / "scan.laz")]
        for name, file in (
            ("surfels", "surfels"),
            ("frame", "frame.json"),
            ("sensors", "sensors.yaml"),
        ):
            arguments += [f"--{name}", str(folder / file)]
        assert render_scans.main(arguments) == 0
        xyz = read_laz(tmp_path / "scan.laz").xyz
        assert len(xyz) > 100
        assert np.abs(xyz[:, 2]).max() < 0.01
        offset = xyz - [0, -4, 6]
        assert np.linalg.norm(offset, axis=1).max() <= definition.range_m + 0.01
        ahead, left, up = (offset @ local_from_sensor(90.0, Turn(60, -20, 5))).T
        if sensor == "eye":
            assert np.degrees(np.arctan2(np.abs(left), ahead)).max() < 30.1
        if sensor == "brush":
            assert np.degrees(np.arctan2(np.hypot(left, up), ahead)).max() < 30.1
        if sensor == "ear":
            assert np.degrees(np.arctan2(np.abs(left), ahead)).max() < 40.1
            assert np.degrees(np.arctan2(up, np.hypot(ahead, left))).min() > -30.1
        if sensor == "ring":
            elevation = np.degrees(np.arctan2(up, np.hypot(ahead, left)))
            beams = np.linspace(-25, 15, 16)
            assert np.abs(elevation[:, None] - beams).min(axis=1).max() < 0.05


class TestBoxes:
    def test_boxes_are_measured_as_the_detector_measures_them(self, road):
        folder, panoramas = road
        targets = read_table(folder / "targets").assign(heading_rad=0.3)
        write_table(folder / "boxed", targets)
        options = ("--targets", str(folder / "boxed"), "--box", "4.5", "1.8", "1.5")
        out = detect(folder, "eye", *options, out="eye-boxes")
        sensor = load_sensors(str(folder / "sensors.yaml"))["eye"]
        detector = detector_of(sensor, Criteria(8, 0.16))
        feet = targets[["x", "y", "z", "heading_rad"]].to_numpy()
        found = read_detections([out])
        for name, part in found.groupby("candidate", observed=True):
            place, turn = split_pose(str(name))
            rotation = local_from_sensor(panoramas[place].yaw_deg, turn)
            box = Box(4.5, 1.8, 1.5)
            measured = detector.measure(
                panoramas[place], rotation, feet, box, Sight(sensor.range_m)
            )
            expected = set(targets["target"][detector.sees(measured)])
            assert set(part["target"].astype(str)) == expected
        small = read_detections([detect(folder, "eye")])
        assert len(found) > len(small) / 2
        assert read_about(out)["length_m"] == 4.5

    def test_targets_without_headings_are_refused(self, road, capsys):
        folder, _ = road
        options = [f"--{key}={folder / key}" for key in ("depth", "candidates", "targets")]
        options += [f"--sensors={folder / 'sensors.yaml'}", "--sensor=eye", "--out=x"]
        options += [f"--{angle}-deg=0" for angle in ("yaw", "pitch", "roll")]
        assert detect_poses.main([*options, "--box", "1", "1", "1"]) == 2
        assert "has no headings" in capsys.readouterr().err
