"""Cameras of a videolog."""

from __future__ import annotations

import os
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal, TypedDict, Unpack, get_args

import pandas as pd

from roadsight.api.clouds import Cloud
from roadsight.base.engines import OWN, Engine
from roadsight.base.errors import InputError
from roadsight.base.section import validated
from roadsight.base.sections.poles import Alignment, AlignmentLimits, Calibration
from roadsight.base.sections.scene import Overlap
from roadsight.geometry.crs import Unit, counted_in
from roadsight.geometry.frames import Frame
from roadsight.io.cloud.cloud_scan import OVERLAP
from roadsight.io.records.atomic import read_json
from roadsight.io.records.tables import read_table

_ALIGNMENT, _CALIBRATION = Alignment(), Calibration()
MANIFESTS = Path(__file__).resolve().parents[3] / "resources" / "manifests"
Method = Literal["auto", "road", "dense", "published", "none"]
# Columns that are named otherwise than in the workflow.
_COLUMNS = {"heading_deg": "heading_grid_deg", "focal_px": "fx_px"}
# Columns of the table of cameras, before what its places are counted in.
_RETURNED = (
    *("image", "x", "y", "z", "heading_grid_deg", "pitch_deg", "roll_deg"),
    *("fx_px", "cx_px", "cy_px", "sigma_heading_deg", "sigma_lateral_m", "residual_px"),
    *("accepted", "reason"),
)


@dataclass(frozen=True)
class DriveFiles:
    """What a verb that starts from a cloud and a videolog's images takes."""

    cloud: Annotated[Path, "LAS or LAZ file"]
    images: Annotated[str, "folder or ZIP of the images"]
    crs: Annotated[str, "EPSG:nnnn, or auto: the cloud's own"] = "auto"
    units: Annotated[Unit, "unit of x and y"] = "auto"
    vertical_units: Annotated[Unit, "unit of z"] = "auto"
    overlap: Annotated[Overlap, "points of overlapping flight lines"] = OVERLAP
    engine: Annotated[Engine, "who computes normals, FPFH and clusters of a pavement"] = OWN
    street: Annotated[
        bool,
        "a street mapped from a vehicle: edges are curbs, masks count to the first border, "
        "poles say first where the camera looks; needs --hfov-deg",
    ] = False

    def __post_init__(self) -> None:
        """Refuse words that stages do not know.

        Raises
        ------
        InputError : one of them is unknown.
        """
        named = {"units": Unit, "vertical_units": Unit, "overlap": Overlap, "engine": Engine}
        for name, words in named.items():
            check_word(name, getattr(self, name), get_args(words))


@dataclass(frozen=True)
class Drive(DriveFiles):
    """A videolog and the cloud that it is aligned with; fields as the verb's options."""

    masks: Annotated[str | None, "folder of label images; a small network if absent"] = None
    map: Annotated[str, "what the labels show; the project's own classes if absent"] = str(
        MANIFESTS / "labels_project.yaml"
    )
    hfov_deg: Annotated[float, Calibration] = _CALIBRATION.hfov_deg
    baseline: Annotated[str | None, "registered cameras, JSON"] = None
    intrinsics: Annotated[
        str | None,
        "known lens, CSV: fx_px, cx_px, cy_px, one row for all images or one for each image",
    ] = None
    method: Annotated[
        Method,
        "dense: all that photograph and cloud share, needs --intrinsics, auto takes it then; "
        "road: road edges and poles; published: Nelder-Mead from --baseline; none: the track alone",
    ] = _ALIGNMENT.method
    max_sigma_heading_deg: Annotated[
        float, "cameras with a less certain heading are rejected; more for a rough map"
    ] = _ALIGNMENT.max_sigma_heading_deg

    def __post_init__(self) -> None:
        """Refuse what the settings of calibration and alignment refuse, before any work.

        Raises
        ------
        InputError : an unknown word, or a number out of its range.
        """
        super().__post_init__()
        check_word("method", self.method, get_args(Method))
        if self.method == "published":
            self._check_published()
        validated(Calibration, {"hfov_deg": self.hfov_deg}, "options")
        limit = {"max_sigma_heading_deg": self.max_sigma_heading_deg}
        validated(AlignmentLimits, limit, "options")

    def _check_published(self) -> None:
        """Refuse a published alignment without a registered camera, or with a known lens."""
        wrong = "the published alignment starts from a registered camera of each image size"
        if self.baseline is None:
            hint = "make it with `roadsight register`"
            raise InputError(wrong, where="options: baseline", found="none", hint=hint)
        if self.intrinsics is not None:
            raise InputError(
                f"{wrong}, and keeps its lens", where="options: intrinsics", found=self.intrinsics
            )


def check_word(name: str, value: object, words: tuple[str, ...]) -> None:
    """Refuse a value that is none of some words.

    Raises
    ------
    InputError : it is none.
    """
    if value not in words:
        allowed = ", ".join(words)
        raise InputError(f"unknown {name}", where="options", found=repr(value), allowed=allowed)


class DriveOptions(TypedDict, total=False):
    """What a drive may be told; fields of `Drive`, which holds what they are without a word."""

    crs: str
    units: Unit
    vertical_units: Unit
    overlap: Overlap
    engine: Engine
    street: bool
    masks: str | None
    map: str
    hfov_deg: float
    baseline: str | None
    intrinsics: str | None
    method: Method
    max_sigma_heading_deg: float


def align(
    videolog: pd.DataFrame | str | os.PathLike[str],
    cloud: Cloud | str | os.PathLike[str],
    images: str | os.PathLike[str],
    **options: Unpack[DriveOptions],
) -> pd.DataFrame:
    """Where each camera of a videolog stood and looked (paper 2, sections 3.1 and 3.2).

    Parameters
    ----------
    videolog : columns image, latitude, longitude (WGS 84, degrees; x, y with ``crs="local"``), or
        the path of such a CSV.
    cloud : LAS or LAZ file, or what `read_cloud` made of one; its file is read again.
    images : folder or ZIP.
    options : crs, units, vertical_units, overlap : of the cloud, as `read_cloud` takes them.
        masks : folder of label images; None: a small network labels them. map : what labels mean.
        hfov_deg : field of view, 0: unknown. intrinsics : CSV of a known lens. baseline : JSON of
        registered cameras. street : a street mapped from a vehicle, whose edges are curbs.
        method : auto, road, dense, published or none. max_sigma_heading_deg : cameras whose heading
        is less certain are not accepted. engine : own or open3d, for the pavement.

    Returns
    -------
    one row for each usable image: x, y, z in the cloud's CRS and units, heading_grid_deg clockwise
    from grid north, pitch_deg, roll_deg, fx_px, cx_px, cy_px, sigma_heading_deg, sigma_lateral_m,
    residual_px, accepted and the reason where it was not

    Raises
    ------
    InputError : a file or a value that cannot be used.

    Examples
    --------
    A straight road of 8 m to the north, driven 1 m right of its middle; the images show it as
    labels alone, and its edges correct what GPS says.

    >>> import os, cv2, laspy, numpy as np, pandas as pd, roadsight
    >>> rng = np.random.default_rng(1)
    >>> x, y = rng.uniform([-20, -20], [20, 150], (40_000, 2)).T
    >>> cloud = laspy.create(point_format=6, file_version="1.4")
    >>> cloud.x, cloud.y, cloud.z = x, y, rng.normal(0, 0.01, x.size)
    >>> cloud.classification = np.where(np.abs(x) < 4, 11, 2)
    >>> cloud.write("road.las")
    >>> right_m, ahead_m = np.array([[-5, -5, 3, 3], [3, 300, 300, 3]])
    >>> u, v = 320 + 500 * right_m / ahead_m, 240 + 500 * 2 / ahead_m  # from 2 m above the road
    >>> corners = np.column_stack([u, v]).round().astype(np.int32)
    >>> label = cv2.fillPoly(np.zeros((480, 640), np.uint8), [corners], 1)
    >>> drive = pd.DataFrame({"image": [f"{n}.png" for n in range(5)], "y": 10.0 * np.arange(5)})
    >>> drive["x"] = 1 + rng.normal(0, 0.3, 5)
    >>> os.makedirs("labels", exist_ok=True)
    >>> all(cv2.imwrite(f"labels/{image}", label) for image in drive["image"])
    True
    >>> cameras = roadsight.align(drive, "road.las", "labels", masks="labels", crs="local",
    ...                           hfov_deg=65, max_sigma_heading_deg=0.5)
    >>> bool(cameras["accepted"].all()), bool((np.abs(cameras["x"] - 1) < 0.2).all())
    (True, True)
    >>> bool((np.abs((cameras["heading_grid_deg"] + 180) % 360 - 180) < 0.5).all())
    True
    """
    if isinstance(cloud, Cloud):
        read: DriveOptions = {
            "crs": cloud.choice.crs,
            "units": cloud.choice.units,
            "vertical_units": cloud.choice.vertical_units,
            "overlap": cloud.overlap,
        }
        path, options = cloud.native.header.path, {**read, **options}
    else:
        path = Path(cloud)
    drive = Drive(path, str(images), **options)
    if not isinstance(videolog, pd.DataFrame):
        return cameras_of(str(videolog), drive)
    with tempfile.TemporaryDirectory(prefix="roadsight-") as folder:
        table = Path(folder) / "videolog.csv"
        videolog.to_csv(table, index=False)
        return cameras_of(str(table), drive)


def cameras_of(videolog: str, drive: Drive) -> pd.DataFrame:
    """Table of cameras.

    Raises
    ------
    InputError : as `align`.
    """
    from roadsight.api.chain import Chain  # noqa: PLC0415  # slow to load
    from roadsight.stages.command import told_clearly  # noqa: PLC0415  # of the same

    with told_clearly("align"), tempfile.TemporaryDirectory(prefix="roadsight-") as folder:
        chain = Chain(Path(folder), videolog, drive)
        chain.scene()
        chain.track()
        chain.road()
        chain.images(drive)
        cameras = read_table(chain.cameras(drive)).rename(columns=_COLUMNS)
        frame = Frame.from_dict(read_json(chain.frame))
    cameras[["x", "y", "z"]] = frame.to_native(cameras[["x", "y", "z"]].to_numpy(float))
    return cameras[list(_RETURNED)].assign(**counted_in(frame))
