"""Sensors with a limited field of view: solid-state LiDARs, cameras, radars.

All of them look along the sensor's x axis; y points to its left, z up. They are aimed by the poses
that a site tries (`roadsight.placement.sensors.poses`).
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from itertools import pairwise
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, model_validator

from roadsight.placement.sensors.spinning import Elevation, Positive, Share

_MAX_PIXELS = 200_000_000  # pixels of a camera; more is a slip


class AimedSensor(BaseModel, ABC):
    """What all aimed sensors have."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

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


class Zone(BaseModel):
    """A part of a radar's field of view about its axis."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

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
