"""Settings of the scene: cloud, ground, pavement, edges."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from roadsight.base.engines import OWN, Engine
from roadsight.base.section import Count, Metres, Section, Share

NoneOrMetres = Annotated[float, Field(ge=0, le=1000)]  # a length that 0 switches off
Thinning = Literal["columns", "voxels"]  # what ground points are thinned to
# What is done with points that are flagged as overlap of flight lines.
Overlap = Literal["use", "leave_out"]


class Scene(Section):
    """Reading the cloud."""

    tile_size_m: Metres = Field(
        default=50.0, description="side of a storage tile; bounds the memory, m"
    )
    overlap: Overlap = Field(
        default="use", description="points that are flagged as overlap of flight lines"
    )
    pulse_share: float = Field(
        default=1.0,
        gt=0,
        le=1,
        description="pulses that take part, as a share: what a sparser survey would have given",
    )


class GroundFilter(Section):
    """Ground filter."""

    method: Literal["robust", "pillars"] = Field(
        default="robust",
        description="pillars: as published, by their width and the height threshold alone",
    )
    pillar_width_m: Metres = Field(
        default=0.2, description="width of a pillar, m; robust: doubled where points are sparse"
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


class Ground(GroundFilter):
    """Ground filter and terrain model."""

    dem_cell_m: Metres = Field(default=0.5, description="cell of the terrain model, m")
    dem_fill_m: Metres = Field(default=20.0, description="gaps are filled up to this distance, m")


class PavementMethod(Section):
    """How the pavement is found."""

    method: Literal["auto", "surface", "published"] = Field(
        default="auto", description="published: FPFH, k-means; auto: surface with scans or seeds"
    )
    seeds: list[tuple[float, float]] = Field(
        default=[],
        description="surface: places on the road from which it grows, x and y as in the cloud",
    )
    cluster_engine: Engine = Field(
        default=OWN, description="who tells which smooth points are connected"
    )


class GroundClasses(Section):
    """Smooth and rough ground by FPFH and k-means."""

    thinning: Thinning = Field(
        default="columns",
        description="voxels: a ground point per cube, as published; distances stay as set",
    )
    voxel_size_m: Metres = Field(
        default=0.1,
        description="width of a column or cube, m; never below the spacing of the points",
    )
    neighbours: int = Field(
        default=10, ge=3, le=100, description="K1, neighbours of a point for its FPFH"
    )
    fpfh_engine: Engine = Field(
        default=OWN, description="who computes normals and FPFH (docs/howto/engines.md)"
    )
    intensity: Literal["auto", "use", "ignore"] = Field(
        default="auto",
        description="second cue; auto: as a surface, or where spacing exceeds 0.15 m",
    )
    intensity_weight: float = Field(
        default=1.5, gt=0, le=10, description="weight of intensity against the whole histogram"
    )
    sample: Count = Field(default=100_000, description="points on which k-means is fitted")


class PavementOutline(Section):
    """Outline of the smooth ground."""

    cluster_distance_m: Metres = Field(
        default=0.2,
        description="points closer than this are connected, m; at least 2.5 thinned spacings",
    )
    vote_radius_m: NoneOrMetres = Field(
        default=0.5, description="radius in which neighbours vote, m; 0: no vote"
    )
    outline_cell_m: Metres = Field(default=0.25, description="cell of the raster that is traced, m")
    closing_m: NoneOrMetres = Field(
        default=1.0, description="gaps narrower than this are closed, m; 0: none"
    )
    smallest_hole_m2: float = Field(default=20.0, ge=0, description="smaller holes are filled, m2")
    smallest_part_share: Share = Field(
        default=0.2, description="separate surfaces are kept above this share of the largest one"
    )


class Pavement(PavementOutline, GroundClasses, PavementMethod):
    """Pavement as one surface, or by FPFH and k-means (all other settings but intensity)."""


class Edges(Section):
    """Road edges that carry candidates."""

    offset_m: float = Field(
        default=0.5,
        ge=0,
        le=20,
        description="automatic edges are moved this far off the pavement, m",
    )
    knot_spacing_m: Metres = Field(default=3.0, description="spline knots on an automatic edge, m")
    shortest_m: Metres = Field(default=10.0, description="shorter automatic edges are dropped, m")
