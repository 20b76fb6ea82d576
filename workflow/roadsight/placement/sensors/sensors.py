"""Kinds of sensors, and the sensors file that defines them.

Spinning LiDARs (paper 1, section 2.4, Fig. 6a and Table 5): in the sensor frame x points to the
road, y to its left, z up. Columns of a depth map go counter-clockwise from the lower azimuth limit,
rows go up from the lowest channel. A beam runs through the centre of its cell; a cell ends half-way
to the next beam.

Sensors with a limited field of view (solid-state LiDARs, cameras, radars) look along the sensor's x
axis. They are aimed by the poses that a site tries (`roadsight.placement.sensors.poses`).
"""

from __future__ import annotations

import re
from abc import ABC, abstractmethod
from itertools import pairwise
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, model_validator

from roadsight.base.arrays import AnyPath, Floats
from roadsight.base.errors import InputError, nearest
from roadsight.base.section import Section, validated
from roadsight.base.texts import read_yaml

_MAX_BEAMS = 20_000_000  # more is a slip of a step, and depth maps would not fit into memory
_POINTS_ROUNDING = 1e-3  # share beyond points_per_s that is allowed: steps have three digits
Elevation = Annotated[float, Field(ge=-90, le=90, allow_inf_nan=False)]
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
Share = Annotated[float, Field(gt=0, le=1, allow_inf_nan=False)]


class Sensor(BaseModel):
    """A spinning LiDAR: the same channels at every azimuth step.

    Channels are either ``elevations_deg``, or ``channels`` evenly spread from ``elevation_min_deg``
    to ``elevation_max_deg``, both limits included (so Table 5's 1.29 degrees are 40 / 31).
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    kind: Literal["spinning"] = Field("spinning", description="pattern of the beams")
    azimuth_min_deg: float = Field(-180.0, ge=-360, le=360, description="right limit, deg")
    azimuth_max_deg: float = Field(180.0, ge=-360, le=360, description="left limit, deg")
    azimuth_step_deg: Positive = Field(0.1, description="horizontal angular resolution, deg")
    columns_per_turn: int | None = Field(
        None, ge=1, description="measurements of a channel in a turn, instead of azimuth_step_deg"
    )
    rotation_hz: Positive | None = Field(None, description="turns a second")
    points_per_s: Positive | None = Field(None, description="most points a second of the product")
    elevation_min_deg: Elevation | None = Field(None, description="lowest channel, deg")
    elevation_max_deg: Elevation | None = Field(None, description="highest channel, deg")
    channels: int | None = Field(None, ge=1, description="number of evenly spread channels")
    elevations_deg: tuple[Elevation, ...] | None = Field(None, description="channel table, deg")
    range_m: float = Field(gt=0, le=5000, description="detection range, m")
    range_min_m: float = Field(0.0, ge=0, le=5000, description="least range that is measured, m")
    range_reflectivity: Share = Field(0.8, description="target reflectivity at that range, 0 to 1")
    range_10_m: Positive | None = Field(None, description="range at 10 % target reflectivity, m")
    divergence_mrad: tuple[Positive, Positive] | None = Field(
        None, description="beam divergence across and upright, full angle, mrad"
    )
    aperture_mm: float = Field(
        0.0, ge=0, le=1000, description="width of the beam at the sensor, mm"
    )
    wavelength_nm: float = Field(905.0, ge=300, le=2000, description="wavelength, nm")
    cost: float = Field(1.0, ge=0, le=1e9, description="cost of placing one (paper: 1)")
    price: float | None = Field(None, ge=0, description="list price, any currency, for the report")
    source: str = Field("", description="data sheet or manual of the figures, with its revision")

    @model_validator(mode="before")
    @classmethod
    def _step_of_columns(cls, given: Any) -> Any:
        """The step that so many columns a turn make."""
        if not isinstance(given, dict) or given.get("columns_per_turn") is None:
            return given
        columns = given["columns_per_turn"]
        step = given.get("azimuth_step_deg")
        if not isinstance(columns, int) or columns < 1:
            return given
        if step is not None and step != 360 / columns:
            raise ValueError("give either azimuth_step_deg or columns_per_turn, not both")
        return given | {"azimuth_step_deg": 360 / columns}

    @model_validator(mode="after")
    def _consistent(self) -> Sensor:
        self._check_azimuths()
        self._check_elevations()
        if self.points_per_s is not None and self.rotation_hz is not None:
            points = self.rows * self.columns * self.rotation_hz
            if points > self.points_per_s * (1 + _POINTS_ROUNDING):
                raise ValueError(
                    f"{self.rows} channels x {self.columns} columns x {self.rotation_hz:g} turns"
                    f" are {points:,.0f} points a second, more than the {self.points_per_s:,.0f}"
                    " of points_per_s: fewer columns_per_turn (a larger azimuth_step_deg) or a"
                    " lower rotation_hz"
                )
        if self.range_min_m >= self.range_m:
            raise ValueError(
                f"range_min_m ({self.range_min_m:g}) must be below range_m ({self.range_m:g})"
            )
        if self.rows * self.columns > _MAX_BEAMS:
            raise ValueError(f"{self.rows * self.columns} beams are more than {_MAX_BEAMS}")
        return self

    def _check_azimuths(self) -> None:
        span = self.azimuth_max_deg - self.azimuth_min_deg
        if not 0 < span <= 360:
            raise ValueError(
                "azimuth_min_deg must be below azimuth_max_deg and both at most 360 deg apart,"
                f" found {self.azimuth_min_deg:g} and {self.azimuth_max_deg:g}"
            )
        cells = span / self.azimuth_step_deg
        if round(cells) < 1 or abs(cells - round(cells)) > 1e-3:
            raise ValueError(
                f"azimuth_step_deg ({self.azimuth_step_deg:g}) must divide the field of view"
                f" ({span:g} deg) into whole cells"
            )

    def _check_elevations(self) -> None:
        even = (self.elevation_min_deg, self.elevation_max_deg, self.channels)
        if self.elevations_deg is None:
            if None in even:
                raise ValueError(
                    "channels need elevations_deg, or elevation_min_deg, elevation_max_deg"
                    " and channels"
                )
        elif even != (None, None, None):
            raise ValueError("elevations_deg excludes elevation_min_deg, _max_deg and channels")
        elevations = self.elevation_deg
        if not len(elevations) or any(low >= high for low, high in pairwise(elevations)):
            raise ValueError(
                "channel elevations must increase (elevation_min_deg below elevation_max_deg)"
            )

    @property
    def elevation_deg(self) -> Floats:
        """Elevation of each row's beams, increasing; shape (rows,)."""
        if self.elevations_deg is not None:
            return np.array(self.elevations_deg, np.float64)
        low, high, channels = self.elevation_min_deg, self.elevation_max_deg, self.channels
        if low is None or high is None or channels is None:
            raise ValueError("channels are not defined")
        if channels == 1:
            return np.array([(low + high) / 2])
        return np.asarray(np.linspace(low, high, channels), np.float64)

    @property
    def elevation_edges_deg(self) -> Floats:
        """Borders of the rows' cells; shape (rows + 1,).

        Half-way between beams; the outer cells are symmetric about their beam. The cell of a single
        channel is as high as it is wide.
        """
        beams = self.elevation_deg
        if len(beams) == 1:
            half = self.azimuth_cell_deg / 2
            return np.array([beams[0] - half, beams[0] + half])
        middle = (beams[:-1] + beams[1:]) / 2
        return np.concatenate([[2 * beams[0] - middle[0]], middle, [2 * beams[-1] - middle[-1]]])

    @property
    def azimuth_cell_deg(self) -> float:
        """Width of a cell: the step that divides the field of view exactly."""
        return (self.azimuth_max_deg - self.azimuth_min_deg) / self.columns

    @property
    def azimuth_deg(self) -> Floats:
        """Azimuth of each column's beams, counter-clockwise from sensor x; shape (columns,)."""
        cells = np.arange(self.columns, dtype=np.float64) + 0.5
        return self.azimuth_min_deg + cells * self.azimuth_cell_deg

    @property
    def columns(self) -> int:
        """Number of azimuth cells."""
        return round((self.azimuth_max_deg - self.azimuth_min_deg) / self.azimuth_step_deg)

    @property
    def rows(self) -> int:
        """Number of channels."""
        return len(self.elevation_deg)

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of a depth map."""
        return self.rows, self.columns

    def thinned(self, stride: int) -> Sensor:
        """Sensor of which only every ``stride``-th azimuth is simulated.

        Raises
        ------
        InputError : the columns are no multiple of it.
        """
        if self.columns % stride:
            raise InputError(
                "does not divide the sensor's azimuths",
                where="lidar.azimuth_stride",
                found=stride,
                allowed=f"a divisor of {self.columns}",
            )
        step = {"azimuth_step_deg": self.azimuth_cell_deg * stride, "columns_per_turn": None}
        return self.model_copy(update=step)

    def to_dict(self) -> dict[str, Any]:
        """Definition as plain values; equal definitions give equal depth maps."""
        return self.model_dump(mode="json")


_MAX_PIXELS = 200_000_000  # pixels of a camera; more is a slip


class AimedSensor(Section, ABC):
    """What all aimed sensors have."""

    range_m: float = Field(gt=0, le=5000, description="detection range, m")
    cost: float = Field(1.0, ge=0, le=1e9, description="cost of placing one (paper: 1)")
    price: float | None = Field(None, ge=0, description="list price, any currency, for the report")

    @property
    @abstractmethod
    def half_view_deg(self) -> tuple[float, float]:
        """Half the field of view, across and upright."""

    def to_dict(self) -> dict[str, Any]:
        """Definition as plain values; equal definitions give equal detections."""
        return self.model_dump(mode="json")


class Rosette(AimedSensor):
    """A non-repetitive solid-state LiDAR: two prisms that turn at different speeds.

    The beam is bent by either prism by a quarter of the field of view, so that its direction is the
    sum of two arrows of that length, as angles from the axis: a rosette that never closes. Several
    lasers are stacked upright, evenly over ``lasers_span_deg``.
    """

    kind: Literal["rosette"] = Field(description="non-repetitive pattern of two prisms")
    field_deg: float = Field(gt=0, le=120, description="diameter of the rosette, deg")
    lasers: int = Field(1, ge=1, le=64, description="lasers, stacked upright")
    lasers_span_deg: float = Field(0.0, ge=0, le=90, description="from lowest to highest, deg")
    points_per_s: float = Field(gt=0, le=1e8, description="points per second, of all lasers")
    frame_s: float = Field(0.1, gt=0, le=60, description="time over which points are gathered, s")
    rotors_hz: tuple[float, float] = Field(
        (121.567, -77.733), description="turns of the prisms per second; only scans depend on them"
    )
    range_reflectivity: Share = Field(0.8, description="target reflectivity at that range, 0 to 1")
    range_10_m: Positive | None = Field(None, description="range at 10 % target reflectivity, m")
    divergence_mrad: tuple[Positive, Positive] | None = Field(
        None, description="beam divergence across and upright, full angle, mrad"
    )
    aperture_mm: float = Field(
        0.0, ge=0, le=1000, description="width of the beam at the sensor, mm"
    )
    wavelength_nm: float = Field(905.0, ge=300, le=2000, description="wavelength, nm")

    @property
    def points(self) -> float:
        """Points of one frame."""
        return self.points_per_s * self.frame_s

    @property
    def laser_offsets_deg(self) -> np.ndarray:
        """Elevation of each laser against the axis, (lasers,), increasing."""
        half = self.lasers_span_deg / 2
        return np.linspace(-half, half, self.lasers) if self.lasers > 1 else np.zeros(1)

    @property
    def half_view_deg(self) -> tuple[float, float]:
        """Half the field of view, across and upright."""
        return self.field_deg / 2, (self.field_deg + self.lasers_span_deg) / 2


class Camera(AimedSensor):
    """A pinhole camera with square pixels and the axis through the middle of its image."""

    kind: Literal["camera"] = Field(description="pixels of a pinhole camera")
    columns_px: int = Field(ge=8, le=50_000, description="width of the image, px")
    rows_px: int = Field(ge=8, le=50_000, description="height of the image, px")
    hfov_deg: float = Field(gt=0, le=150, description="horizontal field of view, deg")
    min_pixels: int = Field(ge=1, description="seen when at least so many pixels show the target")

    @model_validator(mode="after")
    def _few_enough(self) -> Camera:
        if self.columns_px * self.rows_px > _MAX_PIXELS:
            raise ValueError(f"{self.columns_px * self.rows_px} pixels exceed {_MAX_PIXELS}")
        return self

    @property
    def focal_px(self) -> float:
        """Focal length in pixels."""
        return float(self.columns_px / 2 / np.tan(np.radians(self.hfov_deg / 2)))

    @property
    def half_view_deg(self) -> tuple[float, float]:
        """Half the field of view, across and upright."""
        upright = np.degrees(np.arctan(self.rows_px / 2 / self.focal_px))
        return self.hfov_deg / 2, float(upright)


class Zone(Section):
    """A part of a radar's field of view about its axis."""

    half_angle_deg: float = Field(gt=0, le=180, description="to either side of the axis, deg")
    range_m: float = Field(gt=0, le=5000, description="detection range at range_rcs_m2, m")
    resolution_deg: Annotated[float, Field(gt=0, le=90)] = Field(
        description="azimuths that it tells apart, deg"
    )


class Radar(AimedSensor):
    """A radar: zones of range and resolution, within limits of elevation.

    ``range_m`` is that of the farthest zone.
    """

    kind: Literal["radar"] = Field(description="echo by the radar equation")
    range_m: float = Field(1.0, gt=0, le=5000, description="that of the farthest zone, m")
    zones: tuple[Zone, ...] = Field(min_length=1, description="narrowest first")
    elevation_min_deg: Elevation = Field(-10.0, description="lower limit of its beam, deg")
    elevation_max_deg: Elevation = Field(10.0, description="upper limit of its beam, deg")
    range_rcs_m2: Positive = Field(10.0, description="radar cross-section at those ranges, m2")
    widest_cell_m: Positive = Field(
        3.5, description="targets count where its resolution is no wider than this, m"
    )

    @model_validator(mode="before")
    @classmethod
    def _farthest(cls, content: Any) -> Any:
        zones = content.get("zones") if isinstance(content, dict) else None
        if isinstance(zones, list | tuple) and zones and "range_m" not in content:
            ranges = [z.get("range_m") for z in zones if isinstance(z, dict)]
            numbers = [r for r in ranges if isinstance(r, int | float)]
            if numbers:
                return {**content, "range_m": max(numbers)}
        return content

    @model_validator(mode="after")
    def _consistent(self) -> Radar:
        if self.elevation_min_deg >= self.elevation_max_deg:
            raise ValueError(
                f"elevation_min_deg ({self.elevation_min_deg:g}) must be below"
                f" elevation_max_deg ({self.elevation_max_deg:g})"
            )
        angles = [zone.half_angle_deg for zone in self.zones]
        if any(inner >= outer for inner, outer in pairwise(angles)):
            raise ValueError("half_angle_deg of the zones must increase")
        farthest = max(zone.range_m for zone in self.zones)
        if self.range_m != farthest:
            raise ValueError(
                f"range_m ({self.range_m:g}) is that of the farthest zone ({farthest:g}):"
                " leave it out"
            )
        return self

    @property
    def half_view_deg(self) -> tuple[float, float]:
        """Half the field of view, across and upright (about the horizon)."""
        return self.zones[-1].half_angle_deg, max(
            abs(self.elevation_min_deg), abs(self.elevation_max_deg)
        )


AnySensor = Sensor | AimedSensor  # a sensor of any kind
# Schema of each kind of sensor.
KINDS: dict[str, type[Sensor] | type[AimedSensor]] = {
    "spinning": Sensor,
    "rosette": Rosette,
    "camera": Camera,
    "radar": Radar,
}
_PANORAMA = re.compile(r"panorama-(\d*\.?\d+)deg-(\d+)m")  # step and range, see `panorama_name`
_PANORAMA_TOP_DEG = 20.0  # highest elevation: targets are hardly ever above their sensor


# Keys of a spinning LiDAR, of which the first go where one of the second is given: each pair says
# the step, or the channels, in two ways.
_STEP, _TURN = {"azimuth_step_deg"}, {"columns_per_turn"}
_TABLE, _EVEN = {"elevations_deg"}, {"elevation_min_deg", "elevation_max_deg", "channels"}
_INSTEAD = ((_STEP, _TURN), (_TURN, _STEP), (_TABLE, _EVEN), (_EVEN, _TABLE))


def load_sensors(path: AnyPath) -> dict[str, AnySensor]:
    """Read the sensors file.

    Parameters
    ----------
    path : YAML file with one mapping ``sensors`` of names to definitions, each of a ``kind``.

    Raises
    ------
    InputError : malformed file, unknown kind or key, reversed limits, a resolution that is not
        positive.
    """
    content = read_yaml(path)
    if not isinstance(content, dict) or not isinstance(content.get("sensors"), dict):
        raise InputError("needs a mapping 'sensors' of names to definitions", where=str(path))
    if others := sorted(str(key) for key in content if key != "sensors"):
        raise InputError(
            f"unknown key {others[0]!r}", where=str(path), hint=nearest(others[0], ["sensors"])
        )
    if not content["sensors"]:
        raise InputError("defines no sensor", where=str(path))
    given = content["sensors"]
    return {
        _checked_name(name, path): define_sensor(
            _resolved(name, given, str(path)), f"{path}, sensor {name}"
        )
        for name in given
    }


def _resolved(name: object, given: dict[Any, Any], path: str) -> Any:
    """Definition of a sensor with the keys of the one that it is like.

    Raises
    ------
    InputError : it is like a sensor that is not there, or in a circle like itself.
    """
    chain, keys = [name], given[name]
    while isinstance(keys, dict) and "like" in keys:
        like = keys["like"]
        if like not in given or like in chain:
            raise InputError(
                "like: a circle of sensors" if like in given else "like: no such sensor",
                where=f"{path}, sensor {name}",
                found=repr(like),
                hint=nearest(str(like), [str(known) for known in given if known != name]),
            )
        chain.append(like)
        own = {key: value for key, value in keys.items() if key != "like"}
        base = given[like]
        if not isinstance(base, dict):
            return own
        gone = {key for one, other in _INSTEAD if other & own.keys() for key in one}
        keys = {key: value for key, value in base.items() if key not in gone} | own
    return keys


def load_sensor(path: AnyPath, name: str) -> Sensor:
    """One spinning LiDAR of the sensors file, or the panorama of a name that `panorama_name` gave.

    Raises
    ------
    InputError : as `load_sensors`, no sensor of that name, or it is of another kind.
    """
    if matched := _PANORAMA.fullmatch(name):
        return _panorama(float(matched[1]), float(matched[2]))
    sensors = load_sensors(path)
    if name not in sensors:
        raise InputError(f"no sensor {name!r}", where=str(path), hint=nearest(name, sensors))
    sensor = sensors[name]
    if not isinstance(sensor, Sensor):
        raise InputError(
            f"sensor {name!r} has no depth map of its own",
            where=str(path),
            found=f"kind {sensor.to_dict()['kind']}",
            allowed="a sensor of kind spinning",
        )
    return sensor


# Keys of a definition that no depth map and no detection depends on.
_NOT_SEEN = frozenset({"cost", "price", "source", "points_per_s", "rotation_hz"})


def what_it_sees(sensor: AnySensor) -> dict[str, Any]:
    """Definition of a sensor without its cost and what else does not change what it sees.

    The points a second of a solid-state LiDAR do.
    """
    dropped = _NOT_SEEN - ({"points_per_s"} if isinstance(sensor, Rosette) else set())
    return {key: value for key, value in sensor.to_dict().items() if key not in dropped}


def panorama_name(step_deg: float, range_m: float) -> str:
    """Name of the depth map from which poses at a position are judged; it says all about it."""
    return f"panorama-{step_deg:g}deg-{np.ceil(range_m):.0f}m"


def _panorama(step_deg: float, range_m: float) -> Sensor:
    """All directions from straight down to 20 degrees above the horizon, the whole way around.

    Rows are twice as coarse below -20 and again below -45 degrees, where all that is seen is near.
    """
    columns = max(round(360 / step_deg), 4)
    step = 360 / columns
    bands = ((-90.0, -45.0, 4 * step), (-45.0, -20.0, 2 * step), (-20.0, _PANORAMA_TOP_DEG, step))
    rows: list[float] = []
    for low, high, height in bands:
        count = max(round((high - low) / height), 1)
        rows += (low + (np.arange(count) + 0.5) * (high - low) / count).tolist()
    beams = {"azimuth_step_deg": step, "elevations_deg": rows, "range_m": range_m}
    return Sensor.model_validate(beams)


def define_sensor(definition: Any, where: str) -> AnySensor:
    """A sensor by its definition, checked against the schema of its kind.

    Raises
    ------
    InputError : as `load_sensors`; ``where`` is told.
    """
    kind = definition.get("kind", "spinning") if isinstance(definition, dict) else "spinning"
    if not isinstance(kind, str) or kind not in KINDS:
        raise InputError(
            "kind: unknown",
            where=where,
            found=repr(kind),
            allowed=", ".join(KINDS),
            hint=nearest(str(kind), KINDS),
        )
    return validated(KINDS[kind], definition, where)


def _checked_name(name: object, path: AnyPath) -> str:
    """Names appear in file names."""
    text = str(name)
    if not text.replace("_", "a").replace(".", "a").replace("-", "a").isalnum() or text[0] in ".-":
        raise InputError(
            "a sensor's name appears in file names",
            where=str(path),
            found=repr(text),
            allowed="letters, digits, '-', '_' and '.', first a letter, digit or '_'",
        )
    if _PANORAMA.fullmatch(text):
        raise InputError("a sensor's name that is in use", where=str(path), found=repr(text))
    return text
