"""Images of a videolog, in folders or ZIP files, and the table of where they were taken."""

from __future__ import annotations

import logging
import re
import zipfile
from collections.abc import Callable, Iterable
from pathlib import Path, PurePosixPath

import cv2
import numpy as np
import pandas as pd

from roadsight.base.arrays import AnyPath, Bytes, Floats
from roadsight.base.errors import InputError
from roadsight.io.images.exif import ImageFacts, decoded_image, image_facts
from roadsight.io.records.text_tables import read_cells
from roadsight.poles.drive.videolog import drive_order, seconds_of

log = logging.getLogger(__name__)
_SUFFIXES = (".jpg", ".jpeg", ".png", ".tif", ".tiff", ".webp")
# Names that a table's columns may have, the usual first.
_ALIASES = {
    "image": ("image", "image_name", "filename", "file", "name", "photo"),
    "latitude": ("latitude", "lat", "y", "y_m", "northing", "northing_m"),
    "longitude": ("longitude", "lon", "long", "lng", "x", "x_m", "easting", "easting_m"),
    "route": ("route", "route_id", "routeid", "road"),
    "sequence": ("sequence", "seq", "frame", "frame_number", "order", "number"),
    "measure": (
        *("milepost", "mile_post", "mile", "mp", "measure", "chainage", "station", "stationing"),
        *("km", "kilometre", "kilometer", "distance", "distance_m", "log_mile"),
    ),
    "time": (
        *("time", "timestamp", "time_stamp", "datetime", "date_time", "capture_time", "captured"),
        *("captured_at", "gps_time", "gpstime", "utc", "utc_time", "time_utc", "unix_time"),
        *("epoch", "time_s", "gps_seconds", "date_taken", "datetimeoriginal", "capturetime"),
    ),
    "left_image": ("left_image", "left"),
    "right_image": ("right_image", "right"),
}
_MOST_BYTES = 1 << 28  # larger images are refused: a ZIP may unpack to any size
_ONE_ROUTE = "route"  # route of images that name none


class ImageSource:
    """Images under one path: a folder (with folders and ZIP files in it) or one ZIP file.

    Parameters
    ----------
    path : the folder or ZIP file.

    Raises
    ------
    InputError : there is no such place, a ZIP file is damaged, or two of them hold one name.
    """

    def __init__(self, path: AnyPath) -> None:
        self.path = Path(path)
        self._zips: dict[str, tuple[zipfile.ZipFile, str]] = {}
        if self.path.is_dir():
            found = sorted(p for p in self.path.rglob("*") if p.is_file())
            self._files = {
                p.relative_to(self.path).as_posix(): p
                for p in found
                if p.suffix.lower() in _SUFFIXES
            }
            archives = [p for p in found if p.suffix.lower() == ".zip"]
        elif self.path.is_file():
            self._files, archives = {}, [self.path]
        else:
            raise InputError("is neither a folder nor a ZIP file", where=str(path))
        for archive_path in archives:
            try:
                archive = zipfile.ZipFile(archive_path)
            except Exception as error:  # a damaged archive raises of every kind
                problem = f"is no ZIP file of images ({error})"
                raise InputError(problem, where=str(archive_path)) from error
            for member in archive.namelist():
                if PurePosixPath(member).suffix.lower() not in _SUFFIXES or "__MACOSX" in member:
                    continue
                _check_inside(member, archive_path)
                if member in self._files or member in self._zips:
                    where = str(archive_path)
                    raise InputError("an image is there twice", where=where, found=member)
                self._zips[member] = (archive, member)
        self._names = sorted({*self._files, *self._zips}, key=natural_key)
        self._by_key = _lookup(self._names)

    def names(self) -> list[str]:
        """Names of all images, `/` between folders, numbers within names in their order."""
        return list(self._names)

    def find(self, name: str) -> str:
        """Full name of the image that a table calls ``name``: with or without folder and suffix.

        Of a path on the computer that recorded it, the last parts are enough.

        Returns
        -------
        the name, or "" if there is no such image or more than one

        Raises
        ------
        InputError : the name leads out of the folder.
        """
        plain = recorded_path(name)
        _check_inside(str(plain) if name else "", self.path)
        if str(plain) in self._files or str(plain) in self._zips:
            return str(plain)
        if not plain.name:
            return ""
        bare = plain.with_name(plain.stem)
        ways = [
            "/".join(path.parts[start:])
            for path in (plain, bare)
            for start in range(len(path.parts))
        ]
        for key in ways:
            found = self._by_key.get(key.lower(), [])
            if len(found) == 1:
                return found[0]
        return ""

    def content(self, name: str) -> bytes:
        """Bytes of an image.

        Raises
        ------
        InputError : there is no such image, it cannot be read, or its name leads out of the folder.
        """
        _check_inside(name, self.path)
        try:
            if name in self._files:
                return self._files[name].read_bytes()
            archive, member = self._zips[name]
            with archive.open(member) as stream:
                content = stream.read(_MOST_BYTES + 1)
        except KeyError as error:
            raise InputError("holds no such image", where=str(self.path), found=name) from error
        except Exception as error:  # as above
            raise InputError(f"cannot be read ({error})", where=f"{self.path}: {name}") from error
        if len(content) > _MOST_BYTES:
            raise InputError(
                "is too large for an image", where=f"{self.path}: {name}", allowed="256 MiB"
            )
        return content

    def facts(self, name: str) -> ImageFacts:
        """Size, place and completeness of an image, without decoding it.

        Raises
        ------
        InputError : as `content`, or the bytes are no image.
        """
        content = self.content(name)
        try:
            return image_facts(content)
        except ValueError as error:
            raise InputError(f"is no image: {error}", where=f"{self.path}: {name}") from error

    def size(self, name: str) -> tuple[int, int]:
        """Width and height of an image, pixels; see `facts`."""
        facts = self.facts(name)
        return facts.width_px, facts.height_px

    def read(self, name: str) -> Bytes:
        """Image (rows, columns, 3 BGR).

        Raises
        ------
        InputError : as `content`, or the image cannot be decoded.
        """
        image = decoded_image(self.content(name), cv2.IMREAD_COLOR)
        if image is None:
            raise InputError("cannot be decoded as an image", where=f"{self.path}: {name}")
        return image.astype(np.uint8, copy=False)


def natural_key(name: str) -> list[tuple[int, int | str]]:
    """Key that sorts numbers within names by value: a2 before a10."""
    parts = re.split(r"(\d+)", name)
    return [(0, int(part)) if part.isdecimal() else (1, part) for part in parts]


def read_videolog_table(path: AnyPath, source: ImageSource) -> pd.DataFrame:
    """Where the images were taken: a CSV table, or the images' own EXIF.

    Parameters
    ----------
    path : CSV file, or a folder or ZIP file of geotagged images. source : the images.

    Returns
    -------
    columns image, route, left_image, right_image (str; "" if none), latitude, longitude (float,
    NaN where missing or no number; y and x of a local system), sequence (float, the row where none
    is given)

    Raises
    ------
    InputError : the table is missing, empty or no CSV, or lacks a column.
    """
    if Path(path).is_dir() or Path(path).suffix.lower() == ".zip":
        table = _from_exif(source)
    else:
        table = _from_csv(Path(path))
    if not len(table):
        raise InputError("lists no images", where=str(path))
    return table


def every_nth(table: pd.DataFrame, every: int) -> pd.DataFrame:
    """The first row of each route in its sequence, and every ``every``-th after it."""
    order = table.sort_values(["route", "sequence"], kind="stable")
    kept = order[order.groupby("route").cumcount() % every == 0].index
    return table.loc[kept.sort_values()].reset_index(drop=True)


def _from_csv(path: Path) -> pd.DataFrame:
    """Columns under their own names, text stripped, whatever the aliases and their case."""
    table = read_cells(path)
    table.columns = table.columns.str.strip().str.lower().str.replace(" ", "_")
    found = {
        name: next((alias for alias in aliases if alias in table), None)
        for name, aliases in _ALIASES.items()
    }
    if missing := [n for n in ("image", "latitude", "longitude") if found[n] is None]:
        raise InputError(
            f"has no column {missing[0]}",
            where=str(path),
            found=", ".join(table.columns),
            allowed=" or ".join(_ALIASES[missing[0]]),
        )

    def column(name: str, default: str) -> pd.Series:
        alias = found[name]
        text = pd.Series(default, index=table.index) if alias is None else table[alias]
        return text.str.strip()

    sequence, is_measure = np.arange(len(table), dtype=float), False
    for name in ("sequence", "measure"):
        if found[name] is not None:
            numbers = pd.to_numeric(column(name, ""), errors="coerce").to_numpy(float)
            sequence, is_measure = numbers, name == "measure"
            break
    time = np.full(len(table), np.nan) if found["time"] is None else seconds_of(column("time", ""))
    route = column("route", _ONE_ROUTE).replace("", _ONE_ROUTE)
    sequence, reasons = drive_order(route, sequence, time, is_measure)
    _tell_order(reasons)
    return pd.DataFrame(
        {
            "image": column("image", ""),
            "route": route,
            "sequence": sequence,
            "latitude": pd.to_numeric(column("latitude", ""), errors="coerce").astype(float),
            "longitude": pd.to_numeric(column("longitude", ""), errors="coerce").astype(float),
            "left_image": column("left_image", ""),
            "right_image": column("right_image", ""),
        }
    )


def _tell_order(reasons: dict[str, str]) -> None:
    for reason in dict.fromkeys(reasons.values()):
        routes = [name for name, why in reasons.items() if why == reason]
        if reason == "falling measure":
            log.warning("driven against the measure, which falls: route %s", ", ".join(routes))
        else:
            log.info("ordered by %s: %d routes", reason, len(routes))


def _from_exif(source: ImageSource) -> pd.DataFrame:
    """Images by time of capture, or else of names, one route for each folder."""
    rows = []
    for number, name in enumerate(source.names()):
        try:
            facts = source.facts(name)
        except InputError:
            facts = ImageFacts(0, 0)
        folder = str(PurePosixPath(name).parent)
        rows.append(
            {
                "image": name,
                "route": _ONE_ROUTE if folder == "." else folder,
                "sequence": float(number),
                "latitude": np.nan if facts.latitude is None else facts.latitude,
                "longitude": np.nan if facts.longitude is None else facts.longitude,
                "left_image": "",
                "right_image": "",
                "time": np.nan if facts.time_s is None else facts.time_s,
            }
        )
    if not rows:
        return pd.DataFrame(rows)
    table = pd.DataFrame(rows)
    sequence, time = (table[name].to_numpy(float) for name in ("sequence", "time"))
    table["sequence"], reasons = drive_order(table["route"], sequence, time, False)
    _tell_order(reasons)
    return table.drop(columns="time")


def read_positions(path: AnyPath) -> tuple[Floats, Floats]:
    """Latitude and longitude, degrees, of the images of a videolog that have both.

    Raises
    ------
    InputError : as `read_videolog_table`, or no image has a position.
    """
    tagged = Path(path).is_dir() or Path(path).suffix.lower() == ".zip"
    table = _from_exif(ImageSource(path)) if tagged else _from_csv(Path(path))
    placed = table.dropna(subset=["latitude", "longitude"])
    if not len(placed):
        raise InputError("has no image with a position", where=str(path))
    return placed["latitude"].to_numpy(float), placed["longitude"].to_numpy(float)


def _lookup(names: Iterable[str]) -> dict[str, list[str]]:
    """Names by what a table may call them: with or without folder and suffix, in any capitals."""
    table: dict[str, list[str]] = {}
    keys: tuple[Callable[[PurePosixPath], str], ...] = (
        str,
        lambda p: str(p.with_name(p.stem)),
        lambda p: p.name,
        lambda p: p.stem,
    )
    for name in names:
        for key in dict.fromkeys(key(PurePosixPath(name)).lower() for key in keys):
            table.setdefault(key, []).append(name)
    return table


def recorded_path(name: str) -> PurePosixPath:
    r"""An image's name as a relative path: that of a recording computer without what leads there.

    ``C:\data\run 1\p.jpg``, ``\\server\run 1\p.jpg`` and ``/data/run 1/p.jpg`` become
    ``data/run 1/p.jpg`` or ``server/run 1/p.jpg``; nothing outside the folder is ever opened.
    """
    plain = re.sub(r"^[A-Za-z]:", "", name.replace("\\", "/"))
    return PurePosixPath(re.sub(r"/+", "/", plain).lstrip("/"))


def _check_inside(name: str, where: Path) -> None:
    path = PurePosixPath(name.replace("\\", "/"))
    if not name or path.is_absolute() or ".." in path.parts or re.match(r"[A-Za-z]:", name):
        raise InputError("an image's name leads out of the folder", where=str(where), found=name)
