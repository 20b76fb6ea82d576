"""Spinning LiDARs: field of view, channels, range (paper 1, section 2.4, Fig. 6a and Table 5).

Conventions: in the sensor frame x points to the road, y to its left, z up. Columns of a depth map
go counter-clockwise from the lower azimuth limit, rows go up from the lowest channel. A beam runs
through the centre of its cell; a cell ends half-way to the next beam.
"""

from __future__ import annotations

from itertools import pairwise
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, model_validator

from roadsight.base.arrays import Floats
from roadsight.base.errors import InputError

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
