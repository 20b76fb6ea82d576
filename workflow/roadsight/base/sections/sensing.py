"""Settings of what is to be seen, and of how sensors see it."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, field_validator, model_validator

from roadsight.base.engines import OWN, Engine
from roadsight.base.section import Count, Metres, Section

Curve = Annotated[list[float], Field(min_length=2, max_length=2)]  # a and b of p = a ln(n) + b
# Ways to a depth map (`roadsight.placement.depth.unet`).
DepthModel = Literal["surfel", "hybrid", "preliminary", "unet", "unet_mask"]


class TargetGrid(Section):
    """Where targets stand."""

    cell_size_m: Metres = Field(default=1.0, description="grid of targets, m")
    min_points: Count | Literal["local"] = Field(
        default="local",
        description="pavement points that a cell needs to carry a target; local: by density",
    )
    inset_m: Annotated[float, Field(ge=-10, le=10)] | Literal["local"] = Field(
        default="local",
        description="targets keep this far inside the outline, m; local: a spacing of points",
    )


class Targets(TargetGrid):
    """Pole-like targets on the pavement."""

    kind: Literal["cylinder", "pedestrian", "car", "truck", "deer", "box"] = Field(
        default="cylinder", description="what a target is; box: of your size"
    )
    radius_m: Metres = Field(default=0.25, description="radius of a cylinder, m")
    height_m: Metres = Field(default=0.6, description="height of a cylinder or box, m")
    length_m: Metres = Field(default=4.5, description="length of a box, along the road, m")
    width_m: Metres = Field(default=1.8, description="width of a box, m")
    min_beams: int = Field(
        default=8, ge=0, description="seen when more beams than this return from it"
    )
    min_probability: float = Field(
        default=0.0,
        ge=0,
        le=1,
        description="instead of min_beams, min_pixels: least probability to be found; 0: off",
    )
    lidar_curve: Curve = Field(
        default=[0.152, 0.659],
        description="a and b of the probability a ln(n) + b to be found by n beams"
        " (docs/placement/targets.md)",
    )
    camera_curve: Curve = Field(
        default=[0.055, 0.155], description="the same by n pixels of a camera"
    )
    rcs_m2: float = Field(
        default=0.16, gt=0, le=1e6, description="radar cross-section of a target, m2"
    )

    @field_validator("lidar_curve", "camera_curve")
    @classmethod
    def _rises(cls, curve: list[float]) -> list[float]:
        if not 0.001 <= curve[0] <= 10 or not -10 <= curve[1] <= 10:
            raise ValueError("needs a from 0.001 to 10, and b from -10 to 10")
        return curve


class Obstacles(Section):
    """What hides targets from the chosen sensors."""

    method: Literal["sight_lines", "cells"] = Field(
        default="sight_lines",
        description="sight_lines: rays to targets; cells: points in depth maps, as published",
    )


class Tolerance(Section):
    """How far sensors may stand from their plan: each is looked at alone."""

    move_m: Metres = Field(default=0.2, description="to each side, forward, back, up, down, m")
    turn_deg: float = Field(default=1.0, gt=0, le=45, description="about each axis, degrees")
    other_height_m: Metres = Field(default=0.5, description="another mast, lower or higher, m")


class DepthMaps(Section):
    """How depth maps are made."""

    model: DepthModel = Field(default="surfel", description="way to depth maps, see docs/placement")
    network: str = Field(
        default="resources/models/depth_unet.onnx",
        min_length=1,
        description="unet, unet_mask: network that refines preliminary depth maps",
    )
    engine: Engine = Field(
        default=OWN, description="who casts rays at surfels (docs/howto/engines.md)"
    )
    mounting: Literal["levelled", "normal"] = Field(
        default="levelled", description="sensors stand upright, or normal to the road"
    )
    azimuth_stride: Count = Field(
        default=1, description="only every n-th azimuth is simulated and stands for n beams"
    )
    frames_hz: float = Field(
        default=10.0,
        gt=0,
        le=1000,
        description="turns of spinning LiDARs and frames of cameras, for data rates, per s",
    )
    clear_below_m: float = Field(
        default=0.0,
        ge=0,
        le=10,
        description="passing vehicles, lower than this, are cleared off the pavement, m; 0: no",
    )


class SurfelMaking(Section):
    """The cloud as surfels."""

    outlier_radius_m: float = Field(
        default=0.0,
        ge=0,
        le=10,
        description="points that stand alone within this are no surfels, m; 0: all points count",
    )
    outlier_neighbours: Annotated[int, Field(ge=1, le=100)] = Field(
        default=2, description="others within that radius that a point needs to stay"
    )
    outlier_engine: Engine = Field(default=OWN, description="who looks for such points")
    surfel_size_m: Metres = Field(
        default=0.1, description="finest voxel of a surfel, m; larger where points are sparse"
    )
    vegetation: Literal["keep", "leave_out"] = Field(
        default="keep", description="leave_out: no surfels of plants (classes 3 to 5), as in winter"
    )


class CellFilling(Section):
    """What the hybrid depth map does with sparse cells."""

    min_cell_points: Count = Field(
        default=5, description="hybrid: cells with fewer points are filled"
    )
    neighbours: Count = Field(default=10, description="K2, hybrid: neighbours that fill a cell")
    reach_cells: float = Field(
        default=1.5,
        gt=0,
        le=100,
        description="hybrid: farthest neighbours that fill a cell, in cells from the beam",
    )


class Lidar(CellFilling, SurfelMaking, DepthMaps):
    """Virtual LiDAR."""

    @model_validator(mode="after")
    def _surfels_without_plants(self) -> Lidar:
        if self.vegetation == "leave_out" and self.model != "surfel":
            raise ValueError(
                f"vegetation: leave_out takes plants off surfels, and model: {self.model} looks at"
                " the points themselves; use model: surfel"
            )
        return self
