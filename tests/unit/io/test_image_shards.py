from pathlib import Path

import numpy as np
import pytest

from roadsight.base.errors import InputError
from roadsight.io.images.image_shards import ImageShard, ImageShardWriter

RNG = np.random.default_rng(5)
IMAGES = {
    "a": RNG.integers(0, 13, (20, 30)).astype(np.uint8),
    "b.left": RNG.integers(0, 65536, (7, 9)).astype(np.uint16),
    "c": RNG.integers(0, 256, (5, 6, 3)).astype(np.uint8),
}


def write(path: Path) -> None:
    with ImageShardWriter(path, {"scale": 0.5}) as shard:
        for name, image in IMAGES.items():
            shard.write(name, image)


def test_what_is_written_is_read(tmp_path: Path) -> None:
    write(tmp_path / "0.zip")
    shard = ImageShard(tmp_path / "0.zip")
    assert shard.about == {"scale": 0.5}
    assert shard.names == list(IMAGES)
    for name, image in IMAGES.items():
        assert shard.read(name).dtype == image.dtype
        np.testing.assert_array_equal(shard.read(name), image)


def test_same_images_same_bytes(tmp_path: Path) -> None:
    write(tmp_path / "0.zip")
    write(tmp_path / "1.zip")
    assert (tmp_path / "0.zip").read_bytes() == (tmp_path / "1.zip").read_bytes()


def test_a_failure_leaves_nothing_behind(tmp_path: Path) -> None:
    with pytest.raises(RuntimeError), ImageShardWriter(tmp_path / "0.zip") as shard:
        shard.write("a", IMAGES["a"])
        raise RuntimeError
    assert list(tmp_path.iterdir()) == []


def test_missing_truncated_and_unknown(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="cannot be read"):
        ImageShard(tmp_path / "none.zip")
    write(tmp_path / "0.zip")
    with pytest.raises(InputError, match="cannot be read"):
        ImageShard(tmp_path / "0.zip").read("d")
    content = (tmp_path / "0.zip").read_bytes()
    (tmp_path / "0.zip").write_bytes(content[: len(content) // 2])
    with pytest.raises(InputError, match="cannot be read"):
        ImageShard(tmp_path / "0.zip")
