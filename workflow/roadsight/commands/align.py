"""``roadsight align``: where each camera of a videolog stood and looked."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from roadsight.api.drive import Drive
from roadsight.base.errors import InputError
from roadsight.commands.verb import Verb
from roadsight.io.records.text_tables import write_csv


def run(
    videolog: Annotated[str, "CSV: image, latitude, longitude (x, y with --crs local)"],
    /,
    drive: Drive,
    *,
    out: Annotated[Path, "CSV to write; places in the cloud's CRS and units"],
) -> None:
    """Write one row for each usable image.

    Raises
    ------
    InputError : the output's name is not usable.
    """
    if out.suffix.lower() != ".csv":
        raise InputError("is no name for a table", where=f"--out {out}", allowed=".csv")
    from roadsight.api.alignment import cameras_of  # noqa: PLC0415  # slow to load

    cameras = cameras_of(videolog, drive)
    write_csv(out, cameras)
    print(f"{cameras['accepted'].sum()} of {len(cameras)} cameras: {out}")


VERB = Verb("align", "find the pose of every camera of a videolog", run)
