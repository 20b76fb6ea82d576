"""Which files of a videolog each shard reads, known before anything runs."""

from __future__ import annotations

import logging
from collections.abc import Collection
from pathlib import Path

from roadsight.base.arrays import AnyPath
from roadsight.base.doubts import tell_named
from roadsight.base.shards import deal
from roadsight.io.images.camera_tables import posed_images
from roadsight.io.images.videologs import ImageSource, every_nth, read_videolog_table, recorded_path

log = logging.getLogger(__name__)


def dealt_images(table: AnyPath, images: str, shards: int, every: int) -> dict[str, int]:
    """Shard of each image of a videolog, of which every ``every``-th image is used.

    Raises
    ------
    InputError : the table cannot be read.
    """
    return deal(every_nth(read_videolog_table(table, ImageSource(images)), every)["image"], shards)


def files_by_shard(table: AnyPath, folders: list[str], shards: int, every: int) -> list[list[Path]]:
    """Files that belong to the images of each shard, by the names in the videolog's table.

    Parameters
    ----------
    table : the videolog, of which every ``every``-th image is used. folders : where images, or what
        was made from them, lie under the images' names with any suffix; a single file belongs to
        every shard.

    Returns
    -------
    one sorted list for each shard

    Raises
    ------
    InputError : the table cannot be read.
    """
    source = ImageSource(folders[0])
    owner: dict[str, set[int]] = {}
    rows = every_nth(read_videolog_table(table, source), every)
    dealt = deal(rows["image"], shards)
    for row in rows.to_dict("records"):
        shard = dealt[row["image"]]
        for name in (row["image"], row["left_image"], row["right_image"]):
            owner.setdefault(recorded_path(name).stem, set()).add(shard)
    found: list[set[Path]] = [set() for _ in range(shards)]
    for folder in map(Path, folders):
        files = (
            [folder] if folder.is_file() else sorted(p for p in folder.rglob("*") if p.is_file())
        )
        for file in files:
            shared = folder.is_file() or file.suffix.lower() == ".zip"
            for shard in range(shards) if shared else owner.get(file.stem, ()):
                found[shard].add(file)
    return [sorted(files) for files in found]


def videolog_images(table: AnyPath, images: str) -> set[str]:
    """Names of all images of a videolog.

    Raises
    ------
    InputError : the table cannot be read.
    """
    return set(read_videolog_table(table, ImageSource(images))["image"])


def check_corrections(known: Collection[str], corrections: str) -> None:
    """Say how many corrections are about an image of the videolog.

    Parameters
    ----------
    known : names of its images.

    Raises
    ------
    InputError : none is, or the table of corrections cannot be read.
    """
    what = "corrections are about an image of the videolog"
    tell_named(log, what, posed_images(corrections), set(known), corrections)


def posed_share(table: AnyPath, images: str, cameras: str) -> float:
    """Share of a videolog's images that a table of cameras names.

    Raises
    ------
    InputError : one of the tables cannot be read.
    """
    rows = read_videolog_table(table, ImageSource(images))
    named = posed_images(cameras)
    return float(rows["image"].isin(named).mean()) if len(rows) else 0.0
