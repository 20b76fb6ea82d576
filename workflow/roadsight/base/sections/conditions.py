"""Schema of the weather and the traffic in which sensors work."""

from __future__ import annotations

from pydantic import Field

from roadsight.base.section import Section, Share


class Traffic(Section):
    """Vehicles on the road."""

    aadt: float = Field(default=0.0, ge=0, le=1e6, description="vehicles a day, all lanes; 0: none")
    truck_share: Share = Field(default=0.1, description="share of trucks among the vehicles")
    peak_share: Share = Field(default=0.1, description="share of a day's vehicles in its peak hour")
    speed_kmh: float = Field(default=80.0, gt=0, le=300, description="speed of vehicles, km/h")
    lane_width_m: float = Field(default=3.5, gt=1, le=10, description="width of a lane, m")
    availability: float = Field(
        default=0.9, gt=0, lt=1, description="targets are seen if free of traffic so often, share"
    )


class Weather(Section):
    """What is in the air, and how targets reflect."""

    rain_mm_h: float = Field(default=0.0, ge=0, le=300, description="rain, mm/h")
    visibility_m: float = Field(
        default=20000.0, gt=0, le=1e6, description="visibility in fog or haze, m; 20000: clear"
    )
    target_reflectivity: float = Field(
        default=0.0,
        ge=0,
        le=1,
        description="reflectivity of targets; 0: that at which sensors' ranges are stated",
    )


class Conditions(Traffic, Weather):
    """Conditions in which sensors work."""
