"""Schema of ``config/config.yaml``: type, default, range, unit and meaning of each setting."""

from __future__ import annotations

from typing import Any

from pydantic import Field, field_validator

from roadsight.base.section import Name
from roadsight.base.sections.placement import Candidates, Conditions, Cover, Coverage, Poses
from roadsight.base.sections.poles import (
    Alignment,
    Calibration,
    Columns,
    EdgeTracing,
    Hazard,
    Networks,
    Pictures,
    RoadEdges,
    Sightings,
    TerrainMesh,
    Triangulation,
    Validation,
    Videolog,
    Voxels,
)
from roadsight.base.sections.run import Run
from roadsight.base.sections.scene import Edges, Ground, Pavement, Scene
from roadsight.base.sections.sensing import Lidar, Obstacles, Targets, Tolerance
from roadsight.placement.candidates.mounting import Mounting


class Settings(Run):
    """All settings that a site may override."""

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
    obstacles: Obstacles = Obstacles()
    tolerance: Tolerance = Tolerance()
    voxels: Voxels = Voxels()
    road_edges: RoadEdges = RoadEdges()
    terrain_mesh: TerrainMesh = TerrainMesh()
    videolog: Videolog = Videolog()
    networks: Networks = Networks()
    image_edges: EdgeTracing = EdgeTracing()
    calibration: Calibration = Calibration()
    alignment: Alignment = Alignment()
    columns: Columns = Columns()
    sightings: Sightings = Sightings()
    triangulation: Triangulation = Triangulation()
    hazard: Hazard = Hazard()
    validation: Validation = Validation()
    pictures: Pictures = Pictures()

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
