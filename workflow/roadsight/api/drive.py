"""Cameras of a videolog."""

from __future__ import annotations

import contextlib
import io
import logging
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pandas as pd

from roadsight.api.chain import MANIFESTS, Chain
from roadsight.base.errors import InputError
from roadsight.geometry.frames import Frame
from roadsight.io.records.atomic import read_json
from roadsight.io.records.tables import read_table

_COLUMNS = {"heading_deg": "heading_grid_deg", "focal_px": "fx_px"}
"""Columns that are named otherwise than in the workflow."""
_RETURNED = (
    *("image", "x", "y", "z", "heading_grid_deg", "pitch_deg", "roll_deg"),
    *("fx_px", "cx_px", "cy_px", "sigma_heading_deg", "sigma_lateral_m", "residual_px"),
    *("accepted", "reason"),
)
"""Columns of the table of cameras."""


@dataclass(frozen=True)
class Drive:
    """A videolog and the cloud that it is aligned with; fields as the verb's options."""

    videolog: str
    cloud: Path
    images: str
    crs: str = "auto"
    units: str = "auto"
    vertical_units: str = "auto"
    street: bool = False
    masks: str | None = None
    map: str = str(MANIFESTS / "labels_project.yaml")
    hfov_deg: float = 0.0
    baseline: str | None = None
    intrinsics: str | None = None
    method: str = "auto"
    max_sigma_heading_deg: float = 0.12


def align(
    videolog: str | Path, cloud: str | Path, images: str | Path, **options: object
) -> pd.DataFrame:
    """Where each camera of a videolog stood and looked (paper 2, sections 3.1 and 3.2).

    Parameters
    ----------
    videolog : CSV with image, latitude, longitude. cloud : LAS or LAZ file.
    images : folder or ZIP.
    options : fields of `Drive`: crs, units, masks, map, intrinsics, hfov_deg, street, method, ...

    Returns
    -------
    one row for each usable image: x, y, z in the cloud's CRS and units, heading_grid_deg,
    pitch_deg, roll_deg, fx_px, cx_px, cy_px, sigmas, accepted and the reason where it was not

    Raises
    ------
    InputError : a file or a value that cannot be used.

    Examples
    --------
    >>> import roadsight
    >>> cameras = roadsight.align("videolog.csv", "cloud.laz", "images")  # doctest: +SKIP
    >>> usable = cameras[cameras["accepted"]]  # doctest: +SKIP
    """
    drive = Drive(str(videolog), Path(cloud), str(images), **options)  # type: ignore[arg-type]
    told = io.StringIO()
    try:
        with _own_log(), contextlib.redirect_stderr(told):
            return cameras_of(drive)
    except SystemExit as ended:
        lines = [line for line in told.getvalue().splitlines() if line.startswith("roadsight: ")]
        raise InputError(lines[-1][11:] if lines else "a step ended early") from ended


@contextlib.contextmanager
def _own_log() -> Iterator[None]:
    """Leave the caller's logging as it was: a stage sets up the log of a program of its own."""
    root = logging.getLogger()
    handlers, level = root.handlers[:], root.level
    try:
        yield
    finally:
        root.handlers[:] = handlers
        root.setLevel(level)


def cameras_of(drive: Drive) -> pd.DataFrame:
    """Table of cameras; a step that fails tells its own message and ends the program."""
    with tempfile.TemporaryDirectory(prefix="roadsight-") as folder:
        chain = Chain(Path(folder), street=drive.street)
        chain.scene(drive)
        chain.track(drive)
        chain.road()
        chain.images(drive)
        chain.cameras(drive)
        cameras = read_table(chain.path("cameras.parquet")).rename(columns=_COLUMNS)
        frame = Frame.from_dict(read_json(chain.path("frame.json")))
    cameras[["x", "y", "z"]] = frame.to_native(cameras[["x", "y", "z"]].to_numpy(float))
    return pd.DataFrame(cameras[list(_RETURNED)])
