"""Schema of a site file: where its cloud is, in which CRS and units, and which jobs it asks for."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import AfterValidator, Field, model_validator
from pyproj import CRS
from pyproj.exceptions import CRSError

from roadsight.base.section import Name, Section
from roadsight.base.sections.run import Sample
from roadsight.config.plans import Plan
from roadsight.geometry.crs import Unit

# Kind and place of an object in the way, such as tree+115+140 (`placement/sight/objects.py`).
ObjectName = Annotated[str, Field(pattern=r"^[a-z]+[+-]\d+[+-]\d+(-\d+)?$")]


def _known(text: str) -> str:
    """A CRS that PROJ knows, before a cloud is read for hours in one that it does not."""
    try:
        CRS.from_user_input(text)
    except CRSError as error:
        raise ValueError(
            f"{text[:60]!r} is no CRS that PROJ knows; give an EPSG code such as EPSG:25832, or WKT"
        ) from error
    return text


CrsText = Annotated[str, AfterValidator(_known)]  # EPSG code, WKT, or whatever else PROJ reads
# The same; or auto, the file's own, or local.
CloudCrs = Annotated[
    str, AfterValidator(lambda text: text if text in ("auto", "local") else _known(text))
]


class Extent(Section):
    """Part of the clouds that a site is about; one of these."""

    box: list[float] | None = Field(
        default=None,
        min_length=4,
        max_length=4,
        description="west, south, east, north in the clouds' coordinates",
    )
    polygon: str | None = Field(default=None, description="polygon file, e.g. GeoJSON")
    polygon_crs: CrsText | None = Field(default=None, description="its CRS if the file names none")
    edges_m: float | None = Field(
        default=None, gt=0, le=10_000, description="distance from placement.edges, m"
    )
    track_m: float | None = Field(
        default=None, gt=0, le=10_000, description="distance from the videolog's positions, m"
    )

    @model_validator(mode="after")
    def _one(self) -> Extent:
        if sum(value is not None for value in self._kinds().values()) != 1:
            raise ValueError("give one of box, polygon, edges_m, track_m")
        return self

    def _kinds(self) -> dict[str, Any]:
        names = ("box", "polygon", "edges_m", "track_m")
        return {name: getattr(self, name) for name in names}

    @property
    def stated(self) -> str:
        """As the stage takes it: ``kind=value``."""
        kind, value = next((k, v) for k, v in self._kinds().items() if v is not None)
        shown = ",".join(f"{part!r}" for part in value) if kind == "box" else f"{value}"
        return f"{kind}={shown}"


class PlacementInputs(Section):
    """What a user may give the placement job instead of having it found."""

    edges: str | None = Field(
        default=None, description="digitised edges: GeoJSON, GeoPackage or CSV; automatic if absent"
    )
    edges_crs: CrsText | None = Field(
        default=None, description="CRS of the edges if their file names none"
    )
    tma: str | None = Field(
        default=None, description="polygon of the monitored area; found if absent"
    )
    track: str | None = Field(
        default=None,
        description="line that a vehicle drove, GeoJSON, GeoPackage or CSV: the road as a surface"
        " grows from it",
    )
    track_crs: CrsText | None = Field(
        default=None, description="CRS of the track if its file names none"
    )
    zones: str | None = Field(
        default=None, description="polygons in which no sensor may stand, e.g. GeoJSON"
    )
    mounts: str | None = Field(
        default=None, description="existing poles that may carry sensors: points, height_m"
    )
    remove: list[ObjectName] = Field(
        default=[], description="objects that are taken away first, by their names in objects.gpkg"
    )
    cabinets: str | None = Field(
        default=None, description="cabinets with power and fibre: points, for the cost of cables"
    )
    plans: list[str] | None = Field(
        default=None, description="plans to solve; all of them if absent"
    )
    own_plans: dict[Name, Plan] = Field(
        default={},
        description="plans of this site alone, solved besides; one of a known name replaces it",
    )


class Masks(Section):
    """Where the classes of pixels come from: a network, or label images made elsewhere."""

    model: str | None = Field(
        default=None, description="manifest of an ONNX model, docs/poles/models.md"
    )
    labels: str | None = Field(default=None, description="folder of label images")
    map: str | None = Field(default=None, description="label map of the label images")

    @model_validator(mode="after")
    def _one_way(self) -> Masks:
        if (self.model is None) == (self.labels is None) or (self.labels is None) != (
            self.map is None
        ):
            raise ValueError("give either model, or labels with their map")
        return self

    @property
    def files(self) -> list[str]:
        """The files that it names."""
        return [path for path in (self.model, self.labels, self.map) if path]


class Depth(Section):
    """Where the relative depth of pixels comes from."""

    model: str | None = Field(
        default=None, description="manifest of an ONNX model, docs/poles/models.md"
    )
    images: str | None = Field(default=None, description="folder of 16-bit images, 0 = unknown")
    kind: Literal["inverse_depth", "depth"] = Field(
        default="inverse_depth", description="what the images hold; larger inverse depth is nearer"
    )

    @model_validator(mode="after")
    def _one_way(self) -> Depth:
        if (self.model is None) == (self.images is None):
            raise ValueError("give either model or images, not both or neither")
        return self


class Lens(Section):
    """Radial distortion (Brown's model, as OpenCV gives it) of the cameras of a route."""

    route: str | None = Field(default=None, description="route; all of them if absent")
    k1: float = Field(description="first coefficient")
    k2: float = Field(default=0.0, description="second coefficient")
    focal_px: float = Field(gt=0, description="focal length that they belong to, px")


class KnownLens(Section):
    """Lens of all images of a videolog, px; without distortion unless poles.lenses states it."""

    fx_px: float = Field(gt=0, description="focal length")
    fy_px: float | None = Field(default=None, gt=0, description="the same down the image")
    cx_px: float = Field(description="principal point, column; pixel centres are whole numbers")
    cy_px: float = Field(description="principal point, row")
    width_px: int | None = Field(default=None, gt=0, description="size of the images, if stated")
    height_px: int | None = Field(default=None, gt=0, description="the same")
    sigma_fx_px: float = Field(default=0.0, ge=0, description="one standard deviation of fx_px")
    sigma_cx_px: float = Field(default=0.0, ge=0, description="one standard deviation of cx_px")
    sigma_cy_px: float = Field(default=0.0, ge=0, description="one standard deviation of cy_px")


class PolesInputs(Section):
    """The videolog of the pole job."""

    videolog: str | None = Field(
        default=None, description="CSV of images and positions; absent: positions in the images"
    )
    images: str | None = Field(default=None, description="folder of the images, or ZIP files")
    masks: list[Masks] = Field(
        default=[], description="sources of pixel classes, later ones replace what earlier ones say"
    )
    depth: Depth | None = Field(default=None, description="source of relative depth")
    road: Literal["classes", "pavement"] = Field(
        default="classes", description="the cloud's road: by its classes, or found as pavement"
    )
    baseline: str | None = Field(default=None, description="registered cameras, JSON")
    corrections: str | None = Field(
        default=None, description="poses of single images that a person set, CSV"
    )
    decisions: str | None = Field(
        default=None, description="poles that a person accepted, rejected or moved, CSV"
    )
    cameras: str | None = Field(
        default=None, description="camera poses that come with the videolog, CSV"
    )
    intrinsics: str | KnownLens | None = Field(
        default=None, description="known lens: fx_px, cx_px, cy_px, or a CSV of them; it then holds"
    )
    lenses: list[Lens] = Field(default=[], description="radial distortion; measured if absent")


class RoadsInputs(Section):
    """What a user knows about the roads; the pole job's hazard file uses it."""

    inventory: str | None = Field(
        default=None,
        description="speed, AADT, lanes by measures: CSV or line layer, docs/poles/hazard.md",
    )
    inventory_crs: CrsText | None = Field(
        default=None, description="CRS of the inventory if its file names none"
    )
    routes: str | None = Field(
        default=None, description="routes with measures (LRS), CSV of vertices, or GPX track"
    )
    routes_crs: CrsText | None = Field(
        default=None, description="CRS of the routes if their file names none"
    )
    barriers: str | None = Field(default=None, description="guardrails and barriers as lines")
    barriers_crs: CrsText | None = Field(
        default=None, description="CRS of the barriers if their file names none"
    )
    measure_unit: Literal["m", "km", "ft", "usft", "mi", "usmi"] = Field(
        default="m", description="of measures in the routes' vertices, and of the milepost column"
    )
    traffic: Literal["right", "left"] = Field(
        default="right", description="side of the road on which vehicles drive"
    )
    carriageway: Literal["two-way", "divided", "one-way"] = Field(
        default="two-way",
        description="where the inventory states none; one-way: AADT is of that one direction",
    )


class Truth(Section):
    """Reference data for scoring only."""

    cameras: str | None = Field(default=None, description="known camera poses, CSV")
    intrinsics: str | None = Field(default=None, description="their lens, CSV, if not with them")
    poles: str | None = Field(default=None, description="surveyed poles: CSV or vector file")
    poles_kind: str | None = Field(default=None, description="only those whose `kind` is this")
    poles_crs: CrsText | None = Field(default=None, description="their CRS if the file names none")

    pavement: str | None = Field(default=None, description="surveyed road polygons")
    pavement_crs: CrsText | None = Field(
        default=None, description="their CRS if the file names none"
    )
    reach_m: float = Field(
        default=float("inf"), gt=0, description="what lies further from the truth is unknown, m"
    )


class Site(Section):
    """One site."""

    site: Name = Field(description="name; results go to results/<site>")
    title: str = Field(default="", description="name for people")
    clouds: list[str] = Field(default=[], description="LAS or LAZ files; ${VARIABLE} is replaced")
    sample: Sample | None = Field(default=None, description="generate the cloud instead")
    crs: CloudCrs | None = Field(
        default=None, description="auto (the file's own), local, EPSG:nnnn or WKT"
    )
    units: Unit = Field(default="auto", description="horizontal unit of the coordinates")
    vertical_units: Unit = Field(default="auto", description="vertical unit of the coordinates")
    target_crs: CrsText | None = Field(default=None, description="reproject to this CRS on reading")
    orthophoto: str | None = Field(
        default=None, description="picture below the report's map, e.g. GeoTIFF; 8 bits, with CRS"
    )
    extent: Extent | None = Field(
        default=None, description="part of the clouds that counts; all of them if absent"
    )
    jobs: list[Literal["scene", "placement", "poles"]] = Field(
        default=["placement"],
        min_length=1,
        description="scene: ground, pavement, edges; placement: sensors; poles: utility poles",
    )
    placement: PlacementInputs = PlacementInputs()
    poles: PolesInputs = PolesInputs()
    roads: RoadsInputs = RoadsInputs()
    truth: Truth = Truth()
    settings: dict[str, Any] = Field(
        default={}, description="settings of config.yaml that differ at this site"
    )

    @model_validator(mode="after")
    def _one_source(self) -> Site:
        if bool(self.clouds) == bool(self.sample):
            raise ValueError("give either clouds (a list of files) or sample, not both or neither")
        return self

    @model_validator(mode="after")
    def _videolog(self) -> Site:
        if "poles" not in self.jobs or self.sample:
            return self
        missing = [name for name in ("images", "masks") if not getattr(self.poles, name)]
        if missing:
            raise ValueError(f"the job poles needs poles.{missing[0]}")
        return self
