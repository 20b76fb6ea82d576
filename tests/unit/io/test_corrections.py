import pandas as pd
import pytest

from roadsight.base.errors import InputError
from roadsight.base.shards import Shard
from roadsight.io.images.camera_tables import corrections_of

NAMES = [f"drive/{n:04d}.jpg" for n in range(40)]
OWN = [Shard(shard, 3).dealt(NAMES) for shard in range(3)]


@pytest.fixture
def table(tmp_path):
    path = tmp_path / "corrections.csv"
    pd.DataFrame({"image": NAMES, "easting_native": range(40)}).to_csv(path, index=False)
    return path


def test_every_row_is_in_its_shard_alone(table):
    found = [corrections_of(table, own) for own in OWN]
    for own, rows in zip(OWN, found, strict=True):
        assert [row.split(",")[0] for row in rows] == [n for n in NAMES if n in own]
    assert sum(map(len, found)) == 40


def test_a_change_shows_in_one_shard_only(table):
    before = [corrections_of(table, own) for own in OWN]
    table.write_text(table.read_text().replace(f"{NAMES[7]},7", f"{NAMES[7]},8"))
    after = [corrections_of(table, own) for own in OWN]
    assert [a != b for a, b in zip(before, after, strict=True)] == [NAMES[7] in own for own in OWN]


def test_a_table_without_images_is_told(tmp_path):
    (tmp_path / "c.csv").write_text("name,x\na,1\n")
    with pytest.raises(InputError, match="lacks a column"):
        corrections_of(tmp_path / "c.csv", NAMES)
