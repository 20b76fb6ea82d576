"""Settings of a run as a whole."""

from __future__ import annotations

from typing import Literal

from pydantic import Field, model_validator

from roadsight.base import SEED
from roadsight.base.section import Count, Section


class Run(Section):
    """What all steps share."""

    seed: int = Field(default=SEED, ge=0, description="seed of everything random")
    shards: Count = Field(default=4, description="shards of depth maps, detections and images")


class HighwayScene(Section):
    """A highway with exactly known surfaces."""

    scanned_from: Literal["vehicle", "air"] = Field(
        default="vehicle", description="highway: scanned from a vehicle or from the air"
    )
    points: Count = Field(default=3_500_000, description="highway: points to scan")
    radius_m: float = Field(
        default=600.0, ge=100, le=1e6, description="highway: radius of its curve, m; 1e6: straight"
    )
    grade: float = Field(default=0.018, ge=-0.12, le=0.12, description="highway: rise over run")
    tunnel: bool = Field(default=True, description="highway: whether it ends in a tunnel")
    overhead: bool = Field(
        default=False, description="highway: wires, a canopy and a gantry hang over its edges"
    )


class RuralScene(Section):
    """A rural road, and the cameras that are driven along it."""

    relief: float = Field(
        default=1.0, ge=0, le=2, description="rural: heights against the usual; 0 is level"
    )
    lanes: int = Field(
        default=1,
        ge=1,
        le=3,
        description="rural: lanes each way; several have dashed lines, arrows and hatching",
    )
    worn_markings: float = Field(
        default=0.0, ge=0, le=1, description="rural: share of the road's paint that is worn off"
    )
    flush_verges: bool = Field(
        default=False, description="rural: verges without ditches, level with the shoulders"
    )
    car_parks: bool = Field(
        default=False, description="rural: two car parks open onto the road, one on each side"
    )
    side_views: bool = Field(default=True, description="rural: first drive has side images")
    hfov_deg: float = Field(
        default=0.0, ge=0, le=110, description="rural: first camera, degrees; 0: about 20"
    )
    principal_point_px: float = Field(
        default=0.0,
        ge=-60,
        le=60,
        description="rural: optical axis right of and below the images' middle, px",
    )


class RuralSurvey(Section):
    """An airborne scan of it, and the receiver of the cameras' places."""

    pulses_per_m2: float = Field(
        default=24.0, gt=0, le=200, description="rural: density of the airborne scan, 1/m2"
    )
    gps_drift_m: float = Field(
        default=0.0, ge=0, le=20, description="rural: slow error of positions, m; 0: about 1.4"
    )
    pole_returns: bool = Field(default=True, description="rural: whether the laser hits poles")


class RuralLenses(Section):
    """The lenses of its cameras."""

    k1: float = Field(default=0.0, ge=-1, le=1, description="rural: radial distortion of lenses")
    k2: float = Field(default=0.0, ge=-1, le=1, description="rural: the same, second coefficient")


class Sample(RuralLenses, RuralSurvey, RuralScene, HighwayScene):
    """A site that the workflow generates itself, with known truth."""

    scene: Literal["highway", "rural"] = Field(
        default="highway",
        description="highway (mobile LiDAR, for placement) or rural (airborne, with a videolog)",
    )
    length_m: float = Field(default=250.0, gt=0, le=3000, description="length of road, m")
    class_scheme: Literal["usual", "none", "unclassified", "lines", "plants"] = Field(
        default="usual",
        description="rural: usual, all 0 (none), all 1, or wires 14, poles 15 and other things 64;"
        " highway: usual is all 0, plants tells vegetation (3 and 5)",
    )

    @model_validator(mode="after")
    def _known_scheme(self) -> Sample:
        own = {"highway": ("usual", "plants"), "rural": ("usual", "none", "unclassified", "lines")}
        if self.class_scheme not in own[self.scene]:
            allowed = ", ".join(own[self.scene])
            raise ValueError(f"class_scheme of a {self.scene} scene is one of {allowed}")
        return self

    @model_validator(mode="after")
    def _of_its_scene(self) -> Sample:
        rural = {*RuralScene.model_fields, *RuralSurvey.model_fields, *RuralLenses.model_fields}
        others = {"highway": rural, "rural": {*HighwayScene.model_fields}}[self.scene]
        if given := sorted(others & self.model_fields_set):
            raise ValueError(f"a {self.scene} scene has no {', '.join(given)}")
        return self
