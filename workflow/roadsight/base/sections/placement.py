"""Settings of candidates, of their coverage and of the covers."""

from __future__ import annotations

from typing import Literal

from pydantic import Field, model_validator

from roadsight.base.section import Count, Metres, Section


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
        default=0.0,
        ge=0,
        le=1000,
        description="spacings are not halved below this, m; 0: no limit",
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
