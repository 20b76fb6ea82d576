import hashlib
import os

import pytest

from roadsight.io.records import sources as checksums
from roadsight.io.records.atomic import read_json
from roadsight.io.records.sources import CachedChecksums, sha256


@pytest.fixture
def cloud(tmp_path):
    path = tmp_path / "cloud.laz"
    path.write_bytes(b"points")
    return path


@pytest.fixture
def reads(monkeypatch):
    """Paths of the files whose content was read."""
    read = []
    monkeypatch.setattr(checksums, "sha256", lambda path: (read.append(path), sha256(path))[1])
    return read


def test_an_unchanged_file_is_read_once_also_by_the_next_run(tmp_path, cloud, reads):
    first = CachedChecksums(tmp_path / "sub" / "sums.json")
    assert first.of(cloud) == first.of(cloud) == sha256(cloud)
    assert CachedChecksums(tmp_path / "sub" / "sums.json").of(cloud) == sha256(cloud)
    assert reads == [cloud]


def test_touching_does_not_change_the_sum(tmp_path, cloud, reads):
    sums = CachedChecksums(tmp_path / "sums.json")
    before = sums.of(cloud)
    os.utime(cloud, ns=(1, 1))
    assert sums.of(cloud) == before
    assert len(reads) == 2
    # Only the newest state of a file is remembered.
    assert len(read_json(tmp_path / "sums.json")) == 1


def test_new_content_changes_the_sum_even_at_equal_size(tmp_path, cloud):
    sums = CachedChecksums(tmp_path / "sums.json")
    before = sums.of(cloud)
    cloud.write_bytes(b"POINTS")
    os.utime(cloud, ns=(7, 7))
    assert sums.of(cloud) == hashlib.sha256(b"POINTS").hexdigest() != before


@pytest.mark.parametrize("damage", [b"{", b"[]", b"null", b"\xff\xfe", b'{"a": 1}', b'{"a": {}}'])
def test_a_damaged_memory_is_rebuilt(tmp_path, cloud, damage):
    memory = tmp_path / "sums.json"
    memory.write_bytes(damage)
    assert CachedChecksums(memory).of(cloud) == sha256(cloud)
    assert sha256(cloud) in memory.read_text()


def test_what_is_no_file_is_missing_and_not_remembered(tmp_path):
    sums = CachedChecksums(tmp_path / "sums.json")
    assert sums.of(tmp_path / "nope.laz") == "missing"
    assert sums.of(tmp_path) == "missing"
    assert not (tmp_path / "sums.json").exists()
