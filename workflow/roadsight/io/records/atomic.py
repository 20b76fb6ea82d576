"""Outputs appear whole or not at all."""

from __future__ import annotations

import glob
import json
import os
import socket
import sqlite3
from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, closing, contextmanager, suppress
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any, Self

from roadsight.base.arrays import AnyPath
from roadsight.base.errors import InputError

if TYPE_CHECKING:
    from rasterio.io import DatasetReader

# Part of a temporary's name, because the processes of other hosts cannot be looked up here.
_HOST = socket.gethostname().partition(".")[0]
# Written after a failure to learn whether the disk is full, because libraries say everything but
# that. Less might still fit where a library's block did not.
_PROBE_BYTES = 1 << 20
written: set[Path] = set()  # files that this process wrote, by absolute path


@contextmanager
def atomic_path(path: AnyPath) -> Iterator[Path]:
    """Yield a temporary sibling of ``path``; rename it onto ``path`` if the block succeeds.

    The temporary name keeps the suffix, because some writers choose their format by it. What a
    killed process of this host left behind of the same file is removed first.

    Raises
    ------
    InputError : the disk is full, whatever the library in the block says of it.
    """
    target = Path(path)
    target.parent.mkdir(parents=True, exist_ok=True)
    before, after = f".{target.stem}.{_HOST}-", f".tmp{target.suffix}"
    for file in target.parent.glob(f"{glob.escape(before)}*{glob.escape(after)}*"):
        process = file.name.removeprefix(before).partition(".")[0]
        if process.isdecimal() and not Path(f"/proc/{process}").exists():
            file.unlink(missing_ok=True)
    temporary = target.with_name(f"{before}{os.getpid()}{after}")
    try:
        yield temporary
        os.replace(temporary, target)
        written.add(target.absolute())
    except Exception as error:
        if isinstance(error, InputError) or _has_room(temporary):
            raise
        raise no_room(target) from error
    finally:
        beside = sorted(target.parent.glob(f"{glob.escape(temporary.name)}-*"))  # as a journal
        for file in [temporary, *beside]:
            file.unlink(missing_ok=True)


def no_room(path: Path) -> InputError:
    """Message that the disk is full."""
    return InputError(
        "there is no room to write it",
        where=str(path),
        hint="free some and run again; what was finished is kept",
    )


class Incomplete(BaseException):
    """Raised by a `WholeFile` whose file must not appear though its block ended well."""


class WholeFile(ABC):
    """Base of writers that write one file piece by piece: it appears whole or not at all.

    The file appears under its name if the writer's block ends well, and is removed otherwise. It
    is written to the temporary of `atomic_path`, which also tells a full disk from other errors.

    Parameters
    ----------
    path : the file to write.
    """

    def __init__(self, path: AnyPath) -> None:
        self._path = path
        self._whole = ExitStack()

    @abstractmethod
    def _open(self, temporary: Path) -> None:
        """Open the file under its temporary name."""

    def _complete(self) -> None:  # noqa: B027  # most writers hold nothing back
        """Write what is still held back: the block ended well. `Incomplete` drops the file."""

    @abstractmethod
    def _close(self) -> None:
        """Close the file, after `_complete` or after an error."""

    def _check(self) -> None:  # noqa: B027  # most libraries raise by themselves
        """Raise if the file, now closed, is not whole."""

    @contextmanager
    def _being_written(self) -> Iterator[None]:
        with atomic_path(self._path) as temporary:
            self._open(temporary)
            try:
                yield
                self._complete()
            except BaseException:
                with suppress(Exception):  # the first error is the one that tells why
                    self._close()
                raise
            self._close()
            self._check()

    def __enter__(self) -> Self:
        self._whole.enter_context(self._being_written())
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        with suppress(Incomplete):
            self._whole.__exit__(kind, error, trace)

    def keep(self) -> None:
        """Let the file appear before the block ends; nothing can be added after that.

        Raises
        ------
        InputError : the disk is full.
        """
        self._whole.close()


def _has_room(temporary: Path) -> bool:
    """Whether the file that could not be written could still grow."""
    try:
        with temporary.open("ab") as stream:
            stream.write(bytes(_PROBE_BYTES))
            stream.flush()
    except OSError:
        return False
    return True


def write_text(path: AnyPath, text: str) -> None:
    """Write ``text`` in UTF-8."""
    with atomic_path(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def write_json(path: AnyPath, content: Any) -> None:
    """Write ``content`` as sorted, indented JSON; NaN and infinity are refused."""
    text = json.dumps(content, indent=2, sort_keys=True, allow_nan=False, ensure_ascii=False)
    write_text(path, text + "\n")


def read_json(path: AnyPath) -> Any:
    """Read a JSON file.

    Raises
    ------
    InputError : the file is missing, cut off or otherwise no JSON.
    """
    try:
        return json.loads(Path(path).read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError) as error:
        raise InputError(
            f"cannot be read as JSON ({error})",
            where=str(path),
            hint="if the workflow wrote it, delete it and run again",
        ) from error


# Whether a file that GDAL wrote is whole: on a full disk it may close a cut-off one in silence.


def check_raster(path: Path, blocks: int | None = None) -> None:
    """Check that all blocks of a GeoTIFF lie inside the file.

    Parameters
    ----------
    blocks : how many were written over all bands; all of them if None.

    Raises
    ------
    OSError : it is cut off, or blocks are missing. RasterioError : it cannot be opened.
    """
    import rasterio  # noqa: PLC0415  # slow to load, and most files are none

    size = path.stat().st_size
    with rasterio.open(path) as raster:
        ends = _block_ends(raster)
        expected = blocks if blocks is not None else len(ends)
    if max(ends, default=0) > size or sum(end > 0 for end in ends) != expected:
        raise OSError(f"{path} is cut off")


def _block_ends(raster: DatasetReader) -> list[int]:
    """Where the bytes of each block end, 0 for a block that is not in the file."""
    places = [
        (f"{column}_{row}", band)
        for band, (height, width) in zip(raster.indexes, raster.block_shapes, strict=True)
        for row in range(-(-raster.height // height))
        for column in range(-(-raster.width // width))
    ]

    def number(name: str, place: str, band: int) -> int:
        return int(raster.get_tag_item(f"BLOCK_{name}_{place}", "TIFF", bidx=band) or 0)

    return [number("OFFSET", *place) + number("SIZE", *place) for place in places]


def check_geopackage(path: Path, layers: Mapping[str, int]) -> None:
    """Check the database's pages, and each layer's number of features, extent and spatial index.

    Raises
    ------
    OSError : something of it is missing. sqlite3.DatabaseError : it is no database.
    """
    with closing(sqlite3.connect(f"{path.absolute().as_uri()}?mode=ro", uri=True)) as database:
        if database.execute("PRAGMA quick_check(1)").fetchone() != ("ok",):
            raise OSError(f"{path} is damaged")
        for layer, features in layers.items():
            table = layer.replace('"', '""')
            column = _one(
                database,
                "SELECT column_name FROM gpkg_geometry_columns WHERE table_name = ?",
                layer,
            )
            indexed = f'SELECT count(*) FROM "rtree_{table}_{column}"'
            found = [_one(database, f'SELECT count(*) FROM "{table}"'), _one(database, indexed)]
            extent = _one(database, "SELECT min_x FROM gpkg_contents WHERE table_name = ?", layer)
            if found != [features, features] or (features and extent is None):
                raise OSError(f"{path} lacks a part of {layer}")


def _one(database: sqlite3.Connection, query: str, *values: str) -> object:
    """First value of a query's only row, None without one."""
    row = database.execute(query, values).fetchone()
    return row[0] if row else None


def check_geojson(path: Path, features: int) -> None:
    """Check the number of features.

    Raises
    ------
    OSError : some are missing. ValueError : it is no JSON.
    """
    if len(json.loads(path.read_text(encoding="utf-8"))["features"]) != features:
        raise OSError(f"{path} is cut off")
