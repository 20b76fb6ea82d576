import os
import subprocess
import sys

import numpy as np
import pandas as pd
import pytest

from roadsight.base.errors import InputError
from roadsight.io.records.tables import read_about, read_table, write_table


@pytest.fixture
def frame():
    return pd.DataFrame(
        {
            "target": ["t1", "t2"],
            "x": np.array([1.5, np.nan], np.float32),
            "seen": [True, False],
            "beams": np.array([3, 65_535], np.uint16),
        }
    )


def test_table_and_description_come_back(tmp_path, frame):
    path = tmp_path / "deep" / "t.parquet"
    write_table(path, frame, {"seed": 1, "unit": "m"})
    pd.testing.assert_frame_equal(read_table(path), frame)
    assert read_about(path) == {"seed": 1, "unit": "m"}


def test_only_the_asked_columns_are_read_in_the_asked_order_and_no_index(tmp_path, frame):
    write_table(tmp_path / "t.parquet", frame.set_axis([7, 9]))
    table = read_table(tmp_path / "t.parquet", ["beams", "target"])
    assert (list(table), list(table.index)) == (["beams", "target"], [0, 1])


def test_empty_table_keeps_its_types(tmp_path, frame):
    write_table(tmp_path / "t.parquet", frame.iloc[:0])
    back = read_table(tmp_path / "t.parquet")
    assert len(back) == 0
    assert back.dtypes[["x", "seen", "beams"]].tolist() == [np.float32, bool, np.uint16]
    assert read_about(tmp_path / "t.parquet") == {}


def test_same_content_gives_the_same_bytes(tmp_path, frame):
    write_table(tmp_path / "a.parquet", frame, {"b": 1, "a": 2})
    write_table(tmp_path / "b.parquet", frame, {"a": 2, "b": 1})
    assert (tmp_path / "a.parquet").read_bytes() == (tmp_path / "b.parquet").read_bytes()


@pytest.mark.parametrize("read", [read_table, read_about])
@pytest.mark.parametrize("content", [None, b"", b"PAR1 but not really PAR1"])
def test_a_missing_or_damaged_file_is_named(tmp_path, read, content):
    path = tmp_path / "t.parquet"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(InputError, match=r"t\.parquet: cannot be read as a Parquet table"):
        read(path)


def test_a_missing_column_is_an_input_error(tmp_path, frame):
    write_table(tmp_path / "t.parquet", frame)
    with pytest.raises(InputError, match="nope"):
        read_table(tmp_path / "t.parquet", ["target", "nope"])


def test_reading_starts_no_thread(tmp_path, frame):
    """Arrow waits for ever where it cannot start one, as in a process that may not grow."""
    path = tmp_path / "t.parquet"
    write_table(path, frame)
    code = """if True:
        import sys
        from pathlib import Path
        from roadsight.io.records.tables import read_table
        tasks = Path("/proc/self/task")
        before = set(tasks.iterdir())
        read_table(sys.argv[1])
        names = [(path / "comm").read_text().strip() for path in set(tasks.iterdir()) - before]
        print(*[name for name in names if "jemalloc" not in name])  # which starts one by itself
    """
    command = [sys.executable, "-c", code, str(path)]
    done = subprocess.run(command, env=os.environ, capture_output=True, text=True, check=True)
    assert done.stdout.split() == []
