from pathlib import Path

import pytest

from roadsight.base.errors import InputError
from roadsight.base.shards import deal
from roadsight.io.images.videolog_files import dealt_images, files_by_shard, posed_share
from roadsight.io.records.sources import CachedChecksums

NAMES = [f"r_{n:03d}.jpg" for n in range(20)]


@pytest.fixture
def videolog(tmp_path: Path) -> Path:
    (tmp_path / "images").mkdir()
    (tmp_path / "masks").mkdir()
    rows = ["image,left_image,latitude,longitude"]
    for name in NAMES:
        (tmp_path / "images" / name).write_bytes(name.encode())
        (tmp_path / "images" / name.replace("r_", "l_")).write_bytes(b"left")
        (tmp_path / "masks" / name.replace(".jpg", ".png")).write_bytes(b"mask")
        rows.append(f"{name},{name.replace('r_', 'l_')},50.0,8.0")
    (tmp_path / "images" / "stranger.jpg").write_bytes(b"not in the table")
    (tmp_path / "videolog.csv").write_text("\n".join(rows))
    return tmp_path


def test_each_file_goes_with_the_image_of_its_row(videolog: Path) -> None:
    folders = [str(videolog / "images"), str(videolog / "masks")]
    found = files_by_shard(videolog / "videolog.csv", folders, 3, every=1)
    dealt = deal(NAMES, 3)
    assert dealt_images(videolog / "videolog.csv", folders[0], 3, every=1) == dealt
    for name in NAMES:
        own = found[dealt[name]]
        for file in (
            videolog / "images" / name,
            videolog / "images" / name.replace("r_", "l_"),
            videolog / "masks" / name.replace(".jpg", ".png"),
        ):
            assert file in own
    assert sum(map(len, found)) == 3 * len(NAMES)


def test_images_that_are_not_used_are_not_dealt(videolog: Path) -> None:
    table, images = videolog / "videolog.csv", videolog / "images"
    used = NAMES[::3]
    assert dealt_images(table, str(images), 3, every=3) == deal(used, 3)
    found = files_by_shard(table, [str(videolog / "masks")], 3, every=3)
    assert sum(map(len, found)) == len(used)


def test_archives_belong_to_every_shard(videolog: Path) -> None:
    archive = videolog / "images" / "more.zip"
    archive.write_bytes(b"PK\x05\x06" + bytes(18))
    found = files_by_shard(videolog / "videolog.csv", [str(videolog / "images")], 3, every=1)
    assert all(archive in files for files in found)


def test_no_table_is_told(videolog: Path) -> None:
    with pytest.raises(InputError, match="cannot be read"):
        files_by_shard(videolog / "none.csv", [str(videolog / "images")], 2, every=1)


def test_one_checksum_for_many_files(videolog: Path) -> None:
    files = [videolog / "images" / name for name in NAMES]
    cache = videolog / "known.json"
    first = CachedChecksums(cache).of_all(files)
    assert CachedChecksums(cache).of_all(reversed(files)) == first
    assert CachedChecksums(cache).of_all(files[1:]) != first
    files[3].write_bytes(b"changed")
    assert CachedChecksums(cache).of_all(files) != first


def test_share_of_images_whose_camera_is_given(videolog: Path) -> None:
    table, images, cameras = (videolog / n for n in ("videolog.csv", "images", "cameras.csv"))
    cameras.write_text("image,x\n" + "".join(f"{name},1\n" for name in [*NAMES[:15], "other.jpg"]))
    assert posed_share(table, str(images), str(cameras)) == 0.75
    cameras.write_text("picture,x\na.jpg,1\n")
    with pytest.raises(InputError, match="lacks a column"):
        posed_share(table, str(images), str(cameras))
