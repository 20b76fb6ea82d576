"""Poses that a person set: only their shard hears of them."""

from __future__ import annotations

import pandas as pd
import pytest

from roadsight.base.errors import InputError
from roadsight.base.shards import shard_of
from roadsight.io.images.camera_tables import corrections_of_shard

NAMES = [f"drive/{n:04d}.jpg" for n in range(40)]


@pytest.fixture
def table(tmp_path):
    path = tmp_path / "corrections.csv"
    pd.DataFrame({"image": NAMES, "easting_native": range(40)}).to_csv(path, index=False)
    return path


def test_every_row_is_in_its_shard_alone(table):
    found = [corrections_of_shard(table, shard, 3) for shard in range(3)]
    for shard, rows in enumerate(found):
        assert [row.split(",")[0] for row in rows] == [n for n in NAMES if shard_of(n, 3) == shard]
    assert sum(map(len, found)) == 40


def test_a_change_shows_in_one_shard_only(table):
    before = [corrections_of_shard(table, shard, 3) for shard in range(3)]
    table.write_text(table.read_text().replace(f"{NAMES[7]},7", f"{NAMES[7]},8"))
    after = [corrections_of_shard(table, shard, 3) for shard in range(3)]
    assert [a != b for a, b in zip(before, after, strict=True)] == [
        shard_of(NAMES[7], 3) == shard for shard in range(3)
    ]


def test_a_table_without_images_is_told(tmp_path):
    (tmp_path / "c.csv").write_text("name,x\na,1\n")
    with pytest.raises(InputError, match="lacks a column"):
        corrections_of_shard(tmp_path / "c.csv", 0, 1)
