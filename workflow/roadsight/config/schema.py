"""Schema of ``config/config.yaml``: type, default, range, unit and meaning of each setting."""

from __future__ import annotations

from typing import Any, Literal

from pydantic import Field, field_validator, model_validator

from roadsight.base.engines import Engine
from roadsight.base.section import Count, Metres, Name, Section, Share
from roadsight.config.conditions import Conditions
from roadsight.config.poles_schema import (
    Alignment,
    Calibration,
    Hazard,
    ImageEdges,
    Networks,
    RoadEdges,
    Sightings,
    TerrainMesh,
    Triangulation,
    Validation,
    Videolog,
    Voxels,
)
from roadsight.config.poses import Poses
from roadsight.config.sensing import Lidar, Targets, Tolerance
from roadsight.placement.candidates.mounting import Mounting


class Scene(Section):
    """Reading the cloud."""

    tile_size_m: Metres = Field(
        default=50.0, description="side of a storage tile; bounds the memory, m"
    )
    overlap: Literal["use", "leave_out"] = Field(
        default="use", description="points that are flagged as overlap of flight lines"
    )
    pulse_share: float = Field(
        default=1.0,
        gt=0,
        le=1,
        description="pulses that take part, as a share: what a sparser survey would have given",
    )


class Ground(Section):
    """Robust pillar ground filter and terrain model."""

    pillar_width_m: Metres = Field(
        default=0.2,
        description="width of the finest pillar, m; doubled where points are sparse",
    )
    height_threshold_m: Metres = Field(
        default=0.1,
        description="points higher than this above their pillar's ground are off-ground, m",
    )
    coarse_cell_m: Metres = Field(default=1.0, description="cell of the coarse ground surface, m")
    max_object_width_m: Metres = Field(
        default=40.0, description="widest object that is not ground (a building), m"
    )
    slope: float = Field(
        default=0.12,
        gt=0,
        le=2,
        description="slope, rise over run, kept without help from the ground beside it",
    )
    coarse_tolerance_m: Metres = Field(
        default=0.2, description="how far from the coarse surface a pillar's ground may lie, m"
    )
    dem_cell_m: Metres = Field(default=0.5, description="cell of the terrain model, m")
    dem_fill_m: Metres = Field(default=20.0, description="gaps are filled up to this distance, m")


class Pavement(Section):
    """Pavement as one surface, or by FPFH and k-means (all other settings but intensity)."""

    method: Literal["auto", "surface", "published"] = Field(
        default="auto",
        description="published: FPFH, k-means; auto: surface if scans tell or with seeds",
    )
    seeds: list[tuple[float, float]] = Field(
        default=[],
        description="surface: places on the road from which it grows, x and y as in the cloud",
    )
    voxel_size_m: Metres = Field(
        default=0.1,
        description="ground points are thinned to one per column this wide, m; at least spacing",
    )
    neighbours: int = Field(
        default=10, ge=3, le=100, description="K1, neighbours of a point for its FPFH"
    )
    fpfh_engine: Engine = Field(
        default="own", description="who computes normals and FPFH (docs/howto/engines.md)"
    )
    cluster_engine: Engine = Field(
        default="own", description="who tells which smooth points are connected"
    )
    intensity: Literal["auto", "use", "ignore"] = Field(
        default="auto",
        description="second cue; auto: as a surface, or where spacing exceeds 0.15 m",
    )
    intensity_weight: float = Field(
        default=1.5, gt=0, le=10, description="weight of intensity against the whole histogram"
    )
    sample: Count = Field(default=100_000, description="points on which k-means is fitted")
    cluster_distance_m: Metres = Field(
        default=0.2,
        description="points closer than this are connected, m; at least 2.5 thinned spacings",
    )
    vote_radius_m: Metres = Field(default=0.5, description="radius in which neighbours vote, m")
    outline_cell_m: Metres = Field(default=0.25, description="cell of the raster that is traced, m")
    closing_m: Metres = Field(default=1.0, description="gaps narrower than this are closed, m")
    smallest_hole_m2: float = Field(default=20.0, ge=0, description="smaller holes are filled, m2")
    smallest_part_share: Share = Field(
        default=0.2, description="separate surfaces are kept above this share of the largest one"
    )


class Edges(Section):
    """Road edges that carry candidates."""

    offset_m: float = Field(
        default=0.5,
        ge=0,
        le=20,
        description="automatic edges are moved this far off the pavement, m",
    )
    knot_spacing_m: Metres = Field(default=6.0, description="spline knots on an automatic edge, m")
    shortest_m: Metres = Field(default=12.0, description="shorter automatic edges are dropped, m")


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


class Settings(Section):
    """All settings that a site may override."""

    seed: int = Field(default=1, ge=0, description="seed of everything random")
    shards: Count = Field(default=4, description="shards of depth maps and detections")
    scene: Scene = Scene()
    ground: Ground = Ground()
    pavement: Pavement = Pavement()
    edges: Edges = Edges()
    candidates: Candidates = Candidates()
    mounting: Mounting = Mounting()
    poses: Poses = Poses()
    targets: Targets = Targets()
    lidar: Lidar = Lidar()
    conditions: Conditions = Conditions()
    effects: dict[str, str] | str = Field(
        default={},
        description="{effect: simulate | skip | auto} where not as in effects_file; or audit",
    )
    coverage: Coverage = Coverage()
    cover: Cover = Cover()
    tolerance: Tolerance = Tolerance()
    voxels: Voxels = Voxels()
    road_edges: RoadEdges = RoadEdges()
    terrain_mesh: TerrainMesh = TerrainMesh()
    videolog: Videolog = Videolog()
    networks: Networks = Networks()
    image_edges: ImageEdges = ImageEdges()
    calibration: Calibration = Calibration()
    alignment: Alignment = Alignment()
    sightings: Sightings = Sightings()
    triangulation: Triangulation = Triangulation()
    hazard: Hazard = Hazard()
    validation: Validation = Validation()

    @field_validator("effects")
    @classmethod
    def _known_modes(cls, value: dict[str, str] | str) -> dict[str, str] | str:
        modes = ("auto", "simulate", "skip")
        if isinstance(value, str) and value != "audit":
            raise ValueError("must be audit, or a mapping of effects to auto, simulate or skip")
        for name, mode in value.items() if isinstance(value, dict) else ():
            if mode not in modes:
                raise ValueError(f"{name}: {mode!r} is none of {', '.join(modes)}")
        return value

    @property
    def effect_modes(self) -> dict[str, str]:
        """Modes of the effects that the site decides itself; an audit decides as usual."""
        return self.effects if isinstance(self.effects, dict) else {}


class Config(Settings):
    """The whole of ``config/config.yaml``."""

    sites: list[str] = Field(
        default=["sample", "sample_rural"],
        min_length=1,
        description="sites to run: names of files in config/sites, or paths of site files",
    )
    sensors_file: str = Field(
        default="config/sensors.yaml", description="sensors that plans may use"
    )
    plans_file: str = Field(default="config/plans.yaml", description="deployment plans to compare")
    effects_file: str = Field(
        default="config/effects.yaml", description="physical effects and what calls for them"
    )
    tradeoffs_file: str = Field(
        default="config/tradeoffs.yaml", description="what the target tradeoffs varies and measures"
    )
    plans: list[Name] = Field(
        default=[], description="plans to solve at every site; empty: those that the site asks for"
    )
    overrides: dict[str, Any] = Field(
        default={}, description="settings that beat those of the site files, by section"
    )
