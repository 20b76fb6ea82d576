from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from roadsight.base.errors import InputError
from roadsight.io.cloud.tile_writer import TileWriter
from roadsight.io.cloud.tiles import COLUMN_TYPES, CloudTiles, StandingCloud
from roadsight.io.records.tables import write_table
from roadsight.scene.grids import Grid
from roadsight.scene.traffic import Columns, is_traffic


def columns_of(xy: np.ndarray, height: np.ndarray) -> Columns:
    columns = Columns(Grid.around(xy[:, 0], xy[:, 1], 0.5))
    for part in np.array_split(np.arange(len(xy)), 3):
        columns.add(xy[part], height[part])
    return columns


def test_tops_equal_a_slow_search(rng: np.random.Generator) -> None:
    xy, height = rng.uniform(-4, 6, (500, 2)), rng.uniform(-1, 8, 500)
    cell = np.floor(xy / 0.5)
    expected = [height[(cell == c).all(axis=1)].max() for c in cell]
    np.testing.assert_array_equal(columns_of(xy, height).top_m(xy), expected)


def test_a_van_goes_and_a_mast_stays_to_its_foot(rng: np.random.Generator) -> None:
    van = np.column_stack([rng.uniform(0, 4, 300), rng.uniform(0, 2, 300)])
    mast = np.tile([10.25, 0.25], (80, 1))
    xy = np.concatenate([van, mast])
    height = np.concatenate([rng.uniform(0.3, 2.4, 300), np.linspace(0.0, 8.0, 80)])
    found = is_traffic(height, columns_of(xy, height).top_m(xy), np.full(380, True), 0.2, 4.5)
    assert found[:300].all()
    assert not found[300:].any()


def test_pavement_verge_and_unknown_ground_stay() -> None:
    height = np.array([0.1, 1.0, np.nan, 1.0])
    on_pavement = np.array([True, False, True, True])
    found = is_traffic(height, np.array([1.0, 1.0, 1.0, 1.0]), on_pavement, 0.2, 4.5)
    assert found.tolist() == [False, False, False, True]


def write_cloud(
    folder: Path, xyz: np.ndarray, traffic: np.ndarray, classes: np.ndarray | None = None
) -> tuple[str, str]:
    columns = {axis: xyz[:, k] for k, axis in enumerate("xyz")}
    columns |= {name: np.zeros(400) for name in COLUMN_TYPES if name not in "xyz"}
    columns |= {} if classes is None else {"classification": classes}
    with TileWriter(folder / "cloud.parquet", 50.0, coloured=True) as writer:
        writer.append(columns)
        writer.finish()
    write_table(folder / "traffic.parquet", pd.DataFrame({"traffic": traffic}))
    return str(folder / "cloud.parquet"), str(folder / "traffic.parquet")


def test_standing_cloud_leaves_out_what_the_mask_says(
    tmp_path: Path, rng: np.random.Generator
) -> None:
    xyz = rng.uniform([0, 0, 0], [90, 60, 5], (400, 3)).astype(np.float32)
    traffic = rng.random(400) < 0.3
    cloud, mask = write_cloud(tmp_path, xyz, traffic)
    whole, standing = StandingCloud(cloud, None), StandingCloud(cloud, mask)
    everything = np.concatenate([whole.xyz(k) for k in range(len(whole.tiles))])
    kept = np.concatenate([standing.xyz(k) for k in range(len(standing.tiles))])
    np.testing.assert_array_equal(kept, everything[~traffic])
    assert standing.points == len(kept)
    box = (20.0, 10.0, 70.0, 55.0)
    inside = (kept[:, :2] >= box[:2]).all(axis=1) & (kept[:, :2] < box[2:]).all(axis=1)
    np.testing.assert_array_equal(standing.xyz_within(box), kept[inside])
    assert standing.xyz_within((500.0, 0.0, 600.0, 10.0)).shape == (0, 3)


def test_classes_are_left_out_and_have_to_be_there(
    tmp_path: Path, rng: np.random.Generator
) -> None:
    xyz = rng.uniform([0, 0, 0], [90, 60, 5], (400, 3)).astype(np.float32)
    traffic, classes = rng.random(400) < 0.3, rng.integers(0, 7, 400)
    cloud, mask = write_cloud(tmp_path, xyz, traffic, classes)
    found = StandingCloud(cloud, mask, (3, 4, 5))
    own = CloudTiles(cloud).read(["classification"])["classification"]
    assert found.points == (~traffic & ~np.isin(own, (3, 4, 5))).sum()
    with pytest.raises(InputError, match="classes 64, 65"):
        StandingCloud(cloud, mask, (64, 65))


def test_a_mask_of_another_cloud_is_refused(tmp_path: Path) -> None:
    cloud, mask = write_cloud(tmp_path, np.zeros((400, 3), np.float32), np.zeros(399, bool))
    with pytest.raises(InputError, match="not the mask of this cloud"):
        StandingCloud(cloud, mask)
