"""What is said of a drive whose cameras are aligned: files and options of a verb or a call."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal, TypedDict, get_args

from roadsight.base.engines import OWN, Engine
from roadsight.base.errors import InputError
from roadsight.base.section import validated
from roadsight.base.sections.poles import Alignment, AlignmentLimits, Calibration
from roadsight.base.sections.scene import Overlap
from roadsight.geometry.crs import Unit
from roadsight.io.cloud.cloud_scan import OVERLAP

_ALIGNMENT, _CALIBRATION = Alignment(), Calibration()
MANIFESTS = Path(__file__).resolve().parents[3] / "resources" / "manifests"
Method = Literal["auto", "road", "dense", "published", "none"]


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
            _check_word(name, getattr(self, name), get_args(words))


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
        _check_word("method", self.method, get_args(Method))
        if self.method == "published":
            wrong = "the published alignment starts from a registered camera of each image size"
            if self.baseline is None:
                hint = "make it with `roadsight register`"
                raise InputError(wrong, where="options: baseline", found="none", hint=hint)
            if self.intrinsics is not None:
                where = "options: intrinsics"
                raise InputError(f"{wrong}, and keeps its lens", where=where, found=self.intrinsics)
        validated(Calibration, {"hfov_deg": self.hfov_deg}, "options")
        limit = {"max_sigma_heading_deg": self.max_sigma_heading_deg}
        validated(AlignmentLimits, limit, "options")


def _check_word(name: str, value: object, words: tuple[str, ...]) -> None:
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
