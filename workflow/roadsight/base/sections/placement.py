"""Settings of candidates, of their coverage and of the covers."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator

from roadsight.base.section import Count, Degrees, Metres, Section, Share


class Candidates(Section):
    """Candidate sensor positions."""

    spacing_m: Metres = Field(default=4.0, description="horizontal spacing along an edge, m")
    height_min_m: float = Field(default=4.0, ge=0, le=50, description="lowest sensor height, m")
    height_max_m: float = Field(default=10.0, gt=0, le=50, description="highest sensor height, m")
    height_step_m: Metres = Field(default=0.5, description="vertical spacing, m")
    search_radius_m: Metres = Field(
        default=0.5, description="points this near obstruct a position, m"
    )
    gap_factor: float = Field(
        default=2.0,
        ge=2,
        le=20,
        description="a gap is free when wider than this many vertical spacings",
    )
    arm_m: Metres = Field(
        default=0.75, description="sensors on existing poles hang this far off them, m"
    )
    on_pavement_m: Metres = Field(
        default=1.0,
        description="positions along edges deeper in the pavement than this are in the lanes, m",
    )
    on_pavement_doubt: Share = Field(
        default=0.05, description="from this share of candidates in the lanes, a doubt is told"
    )
    on_pavement_refused: Share = Field(
        default=0.5, description="from this share of candidates in the lanes, edges are refused"
    )

    @model_validator(mode="after")
    def _ordered(self) -> Candidates:
        if self.height_min_m >= self.height_max_m:
            raise ValueError(
                f"height_min_m ({self.height_min_m:g}) must be below"
                f" height_max_m ({self.height_max_m:g})"
            )
        return self


class Coverage(Section):
    """Coverage check and densification."""

    rounds: int = Field(default=1, ge=0, le=5, description="rounds of denser candidates near gaps")
    radius_m: Metres = Field(default=30.0, description="new candidates stand this near a gap, m")
    closest_m: float = Field(
        default=0.0, ge=0, le=1000, description="spacings are not halved below this, m; 0: no limit"
    )
    felled: int = Field(
        default=1, ge=0, le=20, description="objects tried without, those that hide most; 0: none"
    )
    shards: Count = Field(default=2, description="shards of each round of denser candidates")
    uncoverable: Literal["error", "exclude"] = Field(
        default="error",
        description="targets that nothing sees: stop, or leave them out and report them",
    )


class Cover(Section):
    """Set cover."""

    time_limit_s: float = Field(
        default=300.0,
        gt=0,
        description="solver limit for each plan, s; counted in steps of work, so that runs agree",
    )
    patience: float = Field(
        default=4.0,
        ge=0,
        description="nothing moves for so many times the work up to the last move: stop; 0: never",
    )
    gap: float = Field(
        default=0.0,
        ge=0,
        lt=1,
        description="a cover proven to cost at most this share too much will do; 0: the best",
    )
    at_least: Count = Field(default=1, description="sensors that must see each target")
    second_objective: bool = Field(
        default=True,
        description="of the cheapest plans, the one that sees most targets once more than asked",
    )
    second_time_limit_s: float = Field(
        default=3.0, gt=0, description="its limit for each plan, s; counted in steps of work"
    )
    solver: Literal["own", "highs"] = Field(
        default="own",
        description="own: roadsight's branch and bound; highs: HiGHS on the whole program",
    )
    verify: Literal["none", "highs"] = Field(
        default="none", description="check the bound of each finished plan by a run of HiGHS"
    )
    verify_time_limit_s: float = Field(
        default=60.0, ge=0, description="its limit for each plan, s; counted in steps of work"
    )

    @model_validator(mode="after")
    def _time_to_verify(self) -> Cover:
        if self.verify != "none" and not self.verify_time_limit_s:
            raise ValueError(
                "verify: highs takes time: raise verify_time_limit_s (0), or leave verify out"
            )
        return self


Pitch = Annotated[float, Field(ge=-90, le=90)]
Angles = Annotated[list[Degrees], Field(min_length=1, max_length=72)]


class PoseGrid(Section):
    """Angles of one kind of sensor, degrees, of which every combination is tried."""

    yaw_deg: Angles = Field(description="from the road's normal, to the left")
    pitch_deg: list[Pitch] = Field(min_length=1, max_length=36, description="upwards")
    roll_deg: Angles = Field(description="right side up")


def _grid(yaw_deg: list[float], pitch_deg: list[float]) -> PoseGrid:
    return PoseGrid(yaw_deg=yaw_deg, pitch_deg=pitch_deg, roll_deg=[0.0])


class Poses(Section):
    """Poses tried at each candidate: yaw to the left of the road's normal, pitch up, roll."""

    spinning: PoseGrid = Field(
        default=_grid([0.0], [0.0]),
        description="spinning LiDARs; all angles 0: as mounted, with depth maps of their own",
    )
    rosette: PoseGrid = Field(
        default=_grid([-70.0, -35.0, 0.0, 35.0, 70.0], [-45.0, -25.0, -10.0]),
        description="non-repetitive solid-state LiDARs",
    )
    camera: PoseGrid = Field(
        default=_grid([-70.0, -35.0, 0.0, 35.0, 70.0], [-45.0, -25.0, -10.0]), description="cameras"
    )
    radar: PoseGrid = Field(
        default=_grid([-70.0, -35.0, 0.0, 35.0, 70.0], [-20.0, -10.0, -5.0]), description="radars"
    )
    panorama_step_deg: float = Field(
        default=0.2, ge=0.02, le=2, description="beams of the depth map that judges poses, degrees"
    )


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
