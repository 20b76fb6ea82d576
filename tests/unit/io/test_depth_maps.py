import json
import zlib

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from roadsight.base.errors import InputError
from roadsight.base.shards import shard_of
from roadsight.io.records.depth_maps import DepthMapInfo, DepthMaps, DepthMapWriter, range_step_m
from roadsight.io.records.placement_tables import read_detections, read_poses, write_detections
from roadsight.io.records.scene_tables import read_surfels, write_surfels
from roadsight.io.records.tables import write_table
from roadsight.placement.sensors.rays import NOT_CAST_M
from roadsight.scene.surfels import Surfels

INFO = DepthMapInfo("VLP-16", "surfel", rows=3, columns=40, step_m=0.002)


def write_maps(path, maps, info=INFO):
    with DepthMapWriter(path, info) as writer:
        for name, depth in maps.items():
            writer.append(name, depth)


def random_maps(rng, n):
    maps = {}
    for number in range(n):
        depth = rng.uniform(0, 130, (3, 40)).astype(np.float32)
        depth[rng.random((3, 40)) < 0.3] = 0
        maps[f"edge-1-s{number:03d}"] = depth
    return maps


def test_maps_survive_to_half_a_step_in_order(tmp_path, rng):
    maps = random_maps(rng, 21)
    write_maps(tmp_path / "d.parquet", maps)
    back = DepthMaps(tmp_path / "d.parquet")
    assert (back.info, len(back)) == (INFO, 21)
    for (name, depth), (expected_name, expected) in zip(back, maps.items(), strict=True):
        assert name == expected_name
        assert depth.dtype == np.float32
        assert ((depth == 0) == (expected == 0)).all()
        assert np.abs(depth - expected).max() <= 0.001 + 1e-5


def test_extreme_ranges_survive(tmp_path):
    depth = np.zeros((3, 40), np.float32)
    depth[0, :4] = [130.0, 0.0012, 0, 130.0]
    depth[2, -1] = NOT_CAST_M
    write_maps(tmp_path / "d.parquet", {"a": depth})
    ((_, back),) = DepthMaps(tmp_path / "d.parquet")
    assert back[0, :4] == pytest.approx([130, 0.004, 0, 130])
    assert back[2, -1] == NOT_CAST_M
    assert np.count_nonzero(back) == 4


@pytest.mark.parametrize(("range_m", "step_m"), [(100, 0.002), (200, 0.004), (5000, 0.077)])
def test_steps_are_whole_millimetres_that_fit(range_m, step_m):
    assert range_step_m(range_m) == pytest.approx(step_m)
    assert range_m / range_step_m(range_m) < 2**16 - 1


def test_same_maps_same_bytes(tmp_path, rng):
    maps = random_maps(rng, 9)
    write_maps(tmp_path / "a.parquet", maps)
    write_maps(tmp_path / "b.parquet", maps)
    assert (tmp_path / "a.parquet").read_bytes() == (tmp_path / "b.parquet").read_bytes()


def test_no_maps_is_a_valid_file(tmp_path):
    write_maps(tmp_path / "d.parquet", {})
    assert list(DepthMaps(tmp_path / "d.parquet")) == []
    assert (tmp_path / "d.parquet").stat().st_size > 0


def test_failure_leaves_nothing_behind(tmp_path):
    with pytest.raises(ValueError, match="shape"):
        write_maps(tmp_path / "d.parquet", {"a": np.zeros((2, 40), np.float32)})
    assert list(tmp_path.iterdir()) == []


def test_damaged_files_are_refused(tmp_path, rng):
    path = tmp_path / "d.parquet"
    with pytest.raises(InputError, match="cannot be read as depth maps"):
        DepthMaps(path)
    write_table(path, pd.DataFrame({"candidate": ["a"]}))
    with pytest.raises(InputError, match="cannot be read as depth maps"):
        DepthMaps(path)
    write_maps(path, random_maps(rng, 2))
    path.write_bytes(path.read_bytes()[:-200])
    with pytest.raises(InputError, match="cannot be read as depth maps"):
        DepthMaps(path)


def rewrite(path, change_about=None, steps=None):
    table = pq.read_table(path)
    about = json.loads(table.schema.metadata[b"roadsight"]) | (change_about or {})
    if steps is not None:
        table = table.set_column(1, "steps", pa.array([steps] * len(table)))
    metadata = {b"roadsight": json.dumps(about).encode()}
    pq.write_table(table.replace_schema_metadata(metadata), path)


@pytest.mark.parametrize(
    "change",
    [{"about": {"rows": 4}}, {"about": {"version": 9}}, {"about": {"extra": 1}}, {"s": b"x"}],
)
def test_content_that_does_not_fit_is_refused(tmp_path, rng, change):
    path = tmp_path / "d.parquet"
    write_maps(path, random_maps(rng, 2))
    rewrite(path, change.get("about"), change.get("s"))
    with pytest.raises(InputError, match="cannot be read as depth maps"):
        list(DepthMaps(path))


def test_shards_are_stable_and_even():
    assert shard_of("edge-1-s0004.0-h06.5", 4) == zlib.crc32(b"edge-1-s0004.0-h06.5") % 4
    counts = np.bincount([shard_of(f"e-s{i:05d}", 4) for i in range(2000)], minlength=4)
    assert counts.min() > 400
    assert {shard_of(f"é{i}", 1) for i in range(9)} == {0}


def detections(candidates, targets):
    n = len(candidates)
    return pd.DataFrame(
        {"candidate": candidates, "target": targets, "hits": np.arange(n, dtype=np.uint16) + 9}
    ).astype({"candidate": "category", "target": "category"})


def test_detections_of_several_files_come_together(tmp_path):
    write_detections(tmp_path / "a", detections(["c1", "c1"], ["t1", "t2"]), {"sensor": "VLP-16"})
    write_detections(tmp_path / "b", detections(["c0"], ["t2"]), {"sensor": "OS-32"})
    write_detections(tmp_path / "e", detections([], []), {"sensor": "OS-64"})
    table = read_detections([tmp_path / name for name in "aeb"])
    assert table.astype(str).to_numpy().tolist() == [
        ["VLP-16", "c1", "t1", "9"],
        ["VLP-16", "c1", "t2", "10"],
        ["OS-32", "c0", "t2", "9"],
    ]
    assert table["hits"].dtype == np.uint16
    assert len(read_detections([])) == 0
    assert len(read_detections([tmp_path / "e"])) == 0


def test_detections_without_sensor_are_refused(tmp_path):
    write_detections(tmp_path / "a", detections(["c1"], ["t1"]), {})
    with pytest.raises(InputError, match="of which sensor"):
        read_detections([tmp_path / "a"])
    with pytest.raises(InputError, match="cannot be read"):
        read_detections([tmp_path / "none"])


def test_surfels_survive(tmp_path, rng):
    parts = (rng.normal(size=(7, 3)), rng.normal(size=(7, 3)), rng.random((7, 2)))
    surfels = Surfels(*(part.astype(np.float32) for part in parts))
    write_surfels(tmp_path / "s.parquet", surfels)
    back = read_surfels(tmp_path / "s.parquet")
    for name in ("centre_m", "normal", "half_m"):
        assert (getattr(back, name) == getattr(surfels, name)).all()
        assert getattr(back, name).dtype == np.float32


def poses(tmp_path, **changes):
    columns = {"candidate": ["b", "a"], "x": [1.0, 2], "y": [3.0, 4], "z": [5.0, 6]}
    frame = pd.DataFrame(columns | {"yaw_deg": [7.0, 8]} | changes)
    write_table(tmp_path / "c.parquet", frame)
    return tmp_path / "c.parquet"


def test_poses_keep_their_order(tmp_path):
    back = read_poses(poses(tmp_path))
    assert [(name, pose.tolist()) for name, pose in back.items()] == [
        ("b", [1, 3, 5, 7]),
        ("a", [2, 4, 6, 8]),
    ]


def test_bad_poses_are_refused(tmp_path):
    with pytest.raises(InputError, match="not finite"):
        read_poses(poses(tmp_path, yaw_deg=[0, np.nan]))
    with pytest.raises(InputError, match="share a name"):
        read_poses(poses(tmp_path, candidate=["a", "a"]))


def test_chosen_maps_alone_are_read(tmp_path):
    rng = np.random.default_rng(4)
    info = DepthMapInfo("S", "surfel", 3, 5, 0.002)
    maps = {f"c{n}": np.round(rng.uniform(1, 9, (3, 5)), 1).astype(np.float32) for n in range(20)}
    with DepthMapWriter(tmp_path / "d.parquet", info) as writer:
        for name, depth in maps.items():
            writer.append(name, depth)
    back = DepthMaps(tmp_path / "d.parquet")
    found = dict(back.only({"c17", "c2", "elsewhere"}))
    assert list(found) == ["c2", "c17"]
    every = dict(back)
    for name, depth in found.items():
        np.testing.assert_array_equal(depth, every[name])
    assert not list(back.only([]))
