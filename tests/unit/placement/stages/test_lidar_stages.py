import json

import geopandas as gpd
import numpy as np
import pandas as pd
import pytest
from shapely import box

from roadsight.geometry.frames import Frame
from roadsight.io.cloud.tile_writer import TileWriter
from roadsight.io.cloud.tiles import StandingCloud
from roadsight.io.images.models import network_for
from roadsight.io.records.atomic import write_json
from roadsight.io.records.depth_maps import DepthMaps
from roadsight.io.records.placement_tables import read_detections
from roadsight.io.records.scene_tables import read_surfels
from roadsight.io.records.tables import read_table, write_table
from roadsight.io.vector.vectors import write_layers
from roadsight.placement.depth.unet import model_of_points
from roadsight.placement.sensors.rays import NOT_CAST_M
from roadsight.placement.sensors.sensors import load_sensor
from roadsight.placement.sight.detection import count_hits
from roadsight.stages.placement import build_detection_shard, place_targets, render_depth_maps
from roadsight.stages.scene import build_surfels
from tests.conftest import PROJECT

NETWORK = str(PROJECT / "resources/models/depth_unet.onnx")
SENSORS = """
sensors:
  tiny:
    {azimuth_step_deg: 1, elevation_min_deg: -30, elevation_max_deg: 5, channels: 36, range_m: 60}
  other:
    {azimuth_step_deg: 2, elevations_deg: [-10, 0], range_m: 60}
"""


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """A road of 20 m x 8 m with a wall across it, scanned at 150 points per square metre."""
    folder = tmp_path_factory.mktemp("site")
    rng = np.random.default_rng(4)
    road = rng.uniform([0, 0, 10], [20, 8, 10.01], (24_000, 3))
    wall = rng.uniform([12, 0, 10], [12.02, 8, 14], (5_000, 3))
    points = np.concatenate([road, wall])
    ones = np.ones(len(points), np.uint8)
    with TileWriter(folder / "cloud.parquet", 8.0, coloured=False) as writer:
        columns = dict(zip("xyz", points.T, strict=True))
        counts = dict.fromkeys(("classification", "return_number", "number_of_returns"), ones)
        writer.append(columns | {"intensity": ones} | counts)
        writer.finish()
    write_table(folder / "pavement.parquet", pd.DataFrame(road, columns=list("xyz")))
    (folder / "profile.json").write_text(json.dumps({"density_per_m2": {"median": 150.0}}))
    (folder / "sensors.yaml").write_text(SENSORS)
    candidates = pd.DataFrame(
        {
            "candidate": [f"e-s{i}" for i in range(8)], "x": np.linspace(1, 19, 8), "y": -0.5,
            "z": 14.0, "yaw_deg": 90.0,
        }
    )  # fmt: skip
    write_table(folder / "candidates.parquet", candidates)
    write_table(folder / "none.parquet", candidates.iloc[:0])
    paths = {name: str(folder / f"{name}.parquet") for name in ("cloud", "pavement", "surfels")}
    surfels = ["--cloud", paths["cloud"]]
    assert build_surfels.main([*surfels, "--out", paths["surfels"]]) == 0
    targets = str(folder / "targets.parquet")
    frame = Frame((0.0, 0.0, 0.0))
    write_json(folder / "frame.json", frame.to_dict())
    outline = gpd.GeoDataFrame({"part": [0]}, geometry=[box(-1, -1, 21, 21)])
    write_layers(folder / "outline.gpkg", {"pavement": outline}, frame)
    ground = ["--outline", str(folder / "outline.gpkg"), "--frame", str(folder / "frame.json")]
    ground += ["--width-m", "0.5"]
    assert place_targets.main(["--pavement", paths["pavement"], *ground, "--out", targets]) == 0
    return folder


def render(site, out, *extra, candidates="candidates", sensor="tiny"):
    scene = ["--surfels", str(site / "surfels.parquet"), "--cloud", str(site / "cloud.parquet")]
    return render_depth_maps.main(
        [
            *("--candidates", str(site / f"{candidates}.parquet"), "--sensor", sensor, *scene),
            *("--sensors", str(site / "sensors.yaml"), "--out", str(site / out), *extra),
        ]
    )


def detect(site, depth, out, *extra, sensor="tiny", candidates="candidates"):
    tables = {name: str(site / f"{name}.parquet") for name in ("targets",)}
    return build_detection_shard.main(
        [
            *("--depth", str(site / depth), "--candidates", str(site / f"{candidates}.parquet")),
            *("--targets", tables["targets"], "--sensor", sensor),
            *("--sensors", str(site / "sensors.yaml"), "--out", str(site / out), *extra),
        ]
    )


def test_every_cell_of_the_road_carries_a_target(site):
    assert len(read_table(site / "targets.parquet")) == 20 * 8
    assert len(read_surfels(site / "surfels.parquet")) > 50


@pytest.mark.parametrize("model", ["surfel", "hybrid", "preliminary"])
def test_shards_hold_each_candidate_once_and_see_what_the_maps_show(site, model):
    shards = [f"{model}-{shard}.parquet" for shard in range(3)]
    for shard, name in enumerate(shards):
        which = ("--shard", str(shard), "--shards", "3", "--model", model)
        assert render(site, name, *which) == 0
        assert detect(site, name, f"seen-{name}") == 0
    maps = {name: depth for path in shards for name, depth in DepthMaps(site / path)}
    candidates = read_table(site / "candidates.parquet").set_index("candidate")
    targets = read_table(site / "targets.parquet")
    assert sorted(maps) == sorted(candidates.index)
    seen = read_detections([site / f"seen-{name}" for name in shards])
    assert set(seen["sensor"]) == {"tiny"}
    sensor = load_sensor(site / "sensors.yaml", "tiny")
    for name, depth in maps.items():
        x, y, z, yaw_deg = candidates.loc[name]
        hits = count_hits(depth, sensor, (x, y, z), yaw_deg, targets[["x", "y", "z"]].to_numpy())
        own = seen[seen["candidate"] == name]
        assert own["target"].tolist() == targets["target"][hits > 8].tolist()
        assert own["hits"].tolist() == hits[hits > 8].tolist()


@pytest.mark.parametrize("model", ["unet", "unet_mask"])
def test_networks_render_what_their_function_gives(site, model, capsys):
    candidates = read_table(site / "candidates.parquet").iloc[2:3]
    write_table(site / "one.parquet", candidates)
    chosen = ("--model", model)
    assert render(site, "no.parquet", *chosen, candidates="one") == 2
    assert f"{model}: needs a network" in capsys.readouterr().err
    assert render(site, "u.parquet", *chosen, "--network", NETWORK, candidates="one") == 0
    ((_, found),) = DepthMaps(site / "u.parquet")
    sensor = load_sensor(site / "sensors.yaml", "tiny")
    xyz_m = StandingCloud(str(site / "cloud.parquet"), None).xyz_within((-99, -99, 99, 99))
    x, y, z, yaw_deg = candidates[["x", "y", "z", "yaw_deg"]].to_numpy(float)[0]
    expected = model_of_points(model, network_for(model, NETWORK))(
        xyz_m, sensor, (x, y, z), yaw_deg
    )
    assert (expected > 0).mean() > 0.02
    np.testing.assert_allclose(found, expected, atol=0.002)


def test_only_beams_towards_targets_are_cast_and_detection_is_the_same(site):
    towards = ("--targets", str(site / "targets.parquet"))
    for name, extra in (("whole", ()), ("part", towards)):
        assert render(site, f"{name}.parquet", *extra) == 0
        assert detect(site, f"{name}.parquet", f"seen-{name}.parquet") == 0
    whole, part = (dict(DepthMaps(site / f"{name}.parquet")) for name in ("whole", "part"))
    for name, depth in part.items():
        cast = depth != NOT_CAST_M
        assert 0.1 < cast.mean() < 0.9
        np.testing.assert_array_equal(depth[cast], whole[name][cast])
    seen = [(site / f"seen-{name}.parquet").read_bytes() for name in ("whole", "part")]
    assert seen[0] == seen[1]


def test_the_wall_hides_what_is_behind_it(site):
    assert render(site, "all.parquet") == 0
    assert detect(site, "all.parquet", "seen.parquet") == 0
    seen = read_detections([site / "seen.parquet"])
    targets = read_table(site / "targets.parquet").set_index("target")
    x = targets["x"].loc[seen["target"].astype(str)].to_numpy()
    left = (seen["candidate"] == "e-s0").to_numpy()
    right = (seen["candidate"] == "e-s7").to_numpy()
    assert left.sum() > 40
    assert x[left].max() < 12
    assert x[right].min() > 12


def test_each_of_fewer_azimuths_stands_for_several_beams(site, capsys):
    thin = ("--azimuth-stride", "2")
    assert render(site, "half.parquet", *thin) == 0
    assert detect(site, "half.parquet", "seen-half.parquet", *thin) == 0
    assert render(site, "full.parquet") == 0
    assert detect(site, "full.parquet", "seen-full.parquet") == 0
    half, full = (read_detections([site / f"seen-{name}.parquet"]) for name in ("half", "full"))
    assert (half["hits"] % 2 == 0).all()
    both = half.merge(full, on=["candidate", "target"], how="outer", suffixes=("", "_full"))
    assert both["hits"].notna().mean() > 0.75
    assert both["hits"].sum() == pytest.approx(both["hits_full"].sum(), rel=0.05)
    assert detect(site, "half.parquet", "wrong.parquet") == 2
    assert "is of another sensor" in capsys.readouterr().err


def test_a_round_without_candidates_gives_valid_empty_tables(site):
    assert render(site, "nothing.parquet", candidates="none") == 0
    assert detect(site, "nothing.parquet", "seen-nothing.parquet", candidates="none") == 0
    assert len(DepthMaps(site / "nothing.parquet")) == 0
    assert len(read_detections([site / "seen-nothing.parquet"])) == 0


def test_tables_that_do_not_belong_together_are_refused(site, capsys):
    assert render(site, "one.parquet") == 0
    assert detect(site, "one.parquet", "bad.parquet", sensor="other") == 2
    assert "is of another sensor" in capsys.readouterr().err
    assert detect(site, "one.parquet", "bad.parquet", candidates="none") == 2
    assert "unknown candidate 'e-s0'" in capsys.readouterr().err
    assert render(site, "bad.parquet", sensor="tinny") == 2
    assert "did you mean 'tiny'" in capsys.readouterr().err
    assert not (site / "bad.parquet").exists()


def test_same_inputs_same_bytes(site):
    for name in ("first.parquet", "second.parquet"):
        assert render(site, name) == 0
        assert detect(site, name, f"seen-{name}") == 0
    for prefix in ("", "seen-"):
        first, second = ((site / f"{prefix}{n}.parquet").read_bytes() for n in ("first", "second"))
        assert first == second


class TestSmallChanges:
    """A candidate that did not change is taken over, with the bytes that it would have anyhow."""

    def run(self, site, capsys, caplog, kept=True, **candidates):
        caplog.clear()
        caplog.set_level("INFO")
        depth = ("--kept", str(site / "kept/depth.parquet")) if kept else ()
        seen = ("--kept", str(site / "kept/seen.parquet")) if kept else ()
        assert render(site, "now.parquet", *depth, **candidates) == 0
        assert detect(site, "now.parquet", "seen-now.parquet", *seen, **candidates) == 0
        found = [record.getMessage() for record in caplog.records]
        counts = [text.split(" ")[0] for text in found if "those of an earlier run" in text]
        both = tuple((site / name).read_bytes() for name in ("now.parquet", "seen-now.parquet"))
        return [int(count) for count in counts], both

    def test_one_candidate_moved_renders_one(self, site, capsys, caplog):
        table = read_table(site / "candidates.parquet")
        assert self.run(site, capsys, caplog)[0] == [0, 0]
        again, same = self.run(site, capsys, caplog)
        assert again == [8, 8]
        moved = table.copy()
        moved.loc[3, "x"] += 0.5
        write_table(site / "moved.parquet", moved)
        counts, found = self.run(site, capsys, caplog, candidates="moved")
        assert counts == [7, 7]
        _, fresh = self.run(site, capsys, caplog, kept=False, candidates="moved")
        assert found == fresh
        assert found != same

    def test_fewer_targets_take_over_all_and_more_targets_what_they_can(self, site, caplog):
        caplog.set_level("INFO")
        targets = read_table(site / "targets.parquet")
        write_table(site / "near.parquet", targets[targets["x"] < 6].reset_index(drop=True))
        kept = ("--kept", str(site / "kept/window.parquet"))
        made = {}
        for name, taken in (("targets", 0), ("near", 8), ("targets", 0)):
            caplog.clear()
            towards = ("--targets", str(site / f"{name}.parquet"))
            assert render(site, "now.parquet", *towards, *kept) == 0
            assert render(site, "fresh.parquet", *towards) == 0
            made[name] = (site / "now.parquet").read_bytes()
            assert made[name] == (site / "fresh.parquet").read_bytes()
            assert f"{taken} of 8 maps are those of an earlier run" in caplog.text
        assert made["targets"] != made["near"]

    def test_another_cloud_or_setting_takes_over_nothing(self, site, capsys, caplog):
        depth = ("--kept", str(site / "kept/other.parquet"))
        assert render(site, "now.parquet", *depth) == 0
        caplog.clear()
        caplog.set_level("INFO")
        assert render(site, "now.parquet", *depth, "--curvature", "simulate") == 0
        assert "0 of 8 maps are those of an earlier run" in caplog.text

    def test_a_damaged_file_is_not_taken_over(self, site, capsys, caplog):
        depth = ("--kept", str(site / "kept/bad.parquet"))
        assert render(site, "now.parquet", *depth) == 0
        whole = (site / "now.parquet").read_bytes()
        kept = site / "kept/bad.parquet"
        kept.unlink()
        kept.write_bytes(whole[:300] + b"x" * 60 + whole[360:])
        caplog.clear()
        caplog.set_level("INFO")
        assert render(site, "now.parquet", *depth) == 0
        assert "0 of 8 maps" in caplog.text
        assert (site / "now.parquet").read_bytes() == whole

    def test_denser_candidates_are_rendered_for_the_sensors_with_the_gap(self, site):
        table = read_table(site / "candidates.parquet")
        table["for_sensors"] = ["tiny", "", "other", "tiny other", "", "", "other", ""]
        write_table(site / "meant.parquet", table)
        assert render(site, "meant-maps.parquet", candidates="meant") == 0
        assert [name for name, _ in DepthMaps(site / "meant-maps.parquet")] == ["e-s0", "e-s3"]
        assert detect(site, "meant-maps.parquet", "m.parquet", candidates="meant") == 0
        assert set(read_detections([site / "m.parquet"])["candidate"]) <= {"e-s0", "e-s3"}
        everything = ("--panorama",)
        assert render(site, "meant-all.parquet", *everything, candidates="meant") == 0
        assert len(DepthMaps(site / "meant-all.parquet")) == 8
