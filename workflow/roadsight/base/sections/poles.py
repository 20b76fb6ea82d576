"""Schema of the settings of the pole job; each section is what one stage takes."""

from __future__ import annotations

from typing import Literal

from pydantic import Field, model_validator

from roadsight.base.section import Count, Degrees, LasClass, Metres, Positive, Section


class RoadClasses(Section):
    """Classes of the road."""

    road_classes: list[LasClass] = Field(default=[11], description="LAS classes that are road")
    bridge_classes: list[LasClass] = Field(default=[17], description="LAS classes that are bridge")


class Voxels(RoadClasses):
    """Poles: the cloud as classified voxels and their top view."""

    voxel_size_m: Metres = Field(default=0.3048, description="edge of a voxel, m (1 foot)")


class RoadEdges(Section):
    """Poles: road edges in the top view."""

    method: Literal["contours", "pixels", "curbs"] = Field(
        default="contours",
        description="smooth outlines, edge pixels as published, or steps beside the track",
    )
    closing_cells: int = Field(default=1, ge=0, description="gaps and spurs up to this, cells")
    smallest_hole_m2: float = Field(default=20.0, ge=0, description="smaller holes are filled, m2")
    smallest_road_m2: float = Field(default=50.0, ge=0, description="smaller roads are dropped, m2")
    spacing_m: Metres = Field(default=0.25, description="spacing of edge points, m")
    smoothing_m: Metres = Field(default=0.6, description="smoothing window, standard deviation, m")


class TerrainMesh(Section):
    """Poles: triangles that hide road from cameras."""

    terrain_cell_m: Metres = Field(default=1.0, description="one vertex per cell this wide, m")


class Videolog(Section):
    """Poles: the track of the images."""

    every: Count = Field(default=1, description="use every n-th image of a route")
    heading_images: int = Field(
        default=3, ge=0, le=50, description="headings are fitted to so many images either side"
    )


class Networks(Section):
    """Poles: networks that read the images."""

    image_height_px: int = Field(
        default=0, ge=0, le=16384, description="height that they see, px; 0: as the manifest says"
    )


class EdgeTracing(Section):
    """Poles: road edges in the images; px of an image 1200 px high."""

    min_marking_px: Positive = Field(default=60.0, description="smaller markings are dropped, px2")
    min_border_px: Positive = Field(default=40.0, description="shorter borders are dropped, px")
    gap_px: Positive = Field(default=6.0, description="runs closer than this are one marking, px")
    axis_px: Positive = Field(
        default=25.0, description="markings this near the middle line's axis are dropped, px"
    )
    borders: Literal["all", "nearest"] = Field(
        default="all", description="road borders, or only the first beside the camera's path"
    )


class AlignmentMethod(Section):
    """How cameras are aligned."""

    method: Literal["auto", "road", "dense", "published", "none"] = Field(
        default="auto", description="auto: dense with poles.intrinsics, else road"
    )
    landmarks: Literal["use", "skip"] = Field(
        default="use", description="whether poles in the cloud help to place the cameras"
    )
    ties: Literal["use", "skip"] = Field(
        default="use", description="whether what neighbouring images both show ties their cameras"
    )


class Reach(Section):
    """Which road edges are compared with an image, and how many points of both."""

    edge_points: Count = Field(default=400, description="LiDAR edge points of an image")
    pixels: Count = Field(default=400, description="edge pixels of an image")
    nearest_m: Metres = Field(default=3.0, description="nearer edges are not used, m")
    farthest_m: Metres = Field(default=240.0, description="farther edges are not used, m")


class AlignmentLimits(Section):
    """What is accepted, and how far the published method looks."""

    max_residual_px: Positive = Field(default=4.0, description="larger residuals are rejected, px")
    max_sigma_heading_deg: Positive = Field(
        default=0.15, description="less certain headings are rejected, degrees"
    )
    bound_m: Metres = Field(
        default=0.33528, description="published: how far Nelder-Mead may move a camera, m (1.1 ft)"
    )
    bound_deg: float = Field(
        default=0.11, gt=0, le=90, description="published: how far it may turn one, degrees"
    )


class Alignment(AlignmentLimits, Reach, AlignmentMethod):
    """Poles: camera poses by road alignment."""


class CameraPrior(Section):
    """What is known of a camera beforehand."""

    principal_point_px: float = Field(
        default=15.0,
        ge=0,
        le=1e4,
        description="columns of the principal point from the images' middle, 1 sigma, px; 0: in it",
    )


class Calibration(CameraPrior):
    """Poles: what the images of a drive share."""

    images: Count = Field(default=60, description="images of a drive that are used")
    hfov_deg: float = Field(
        default=0.0, ge=0, lt=180, description="field of view if known to 10 %, degrees; 0: unknown"
    )
    start: Literal["edges", "landmarks"] = Field(
        default="edges",
        description="what says first where the camera looks; landmarks need a known field of view",
    )
    gps_sigma_m: Metres = Field(default=0.8, description="slow error of the track, m")
    gps_length_m: Metres = Field(default=100.0, description="path over which it stays alike, m")
    gps_own_m: Metres = Field(default=0.2, description="error of each position by itself, m")


class BlockClasses(Section):
    """Which returns of the cloud are of buildings and of headwalls."""

    building_classes: list[LasClass] = Field(
        default=[6], description="LAS classes that are building"
    )
    headwall_classes: list[LasClass] = Field(
        default=[], description="LAS classes that are headwall: none is standard"
    )


class SightingRules(Section):
    """Which objects are looked for, and which are kept."""

    kinds: list[Literal["pole", "sign", "tree", "guardrail", "building", "headwall"]] = Field(
        default=["pole"], min_length=1, description="objects that are looked for"
    )
    bearing: Literal["fused", "image", "lidar"] = Field(
        default="fused", description="image and LiDAR, the image alone, or LiDAR as published"
    )
    distance: Literal["fused", "published"] = Field(
        default="fused",
        description="network, ground and cloud together, or the network alone as published",
    )
    height_rule: Literal["metric", "published", "none"] = Field(
        default="metric", description="what is too low for a pole: in metres, or as published"
    )
    min_height_m: Metres = Field(default=3.0, description="metric: lower poles are dropped, m")
    farthest_m: Metres = Field(default=60.0, description="farther objects are dropped, m")


class PoleMasks(Section):
    """What a pole is in a mask; px of an image 1200 px high."""

    mask_rule: Literal["axes", "published"] = Field(
        default="axes",
        description="poles in a mask: by their axes and the numbers below, or as published",
    )

    min_aspect: Positive = Field(default=5.0, description="height over width of a pole")
    min_width_px: Positive = Field(default=4.0, description="thinner objects are dropped, px")
    min_height_px: Positive = Field(default=40.0, description="lower objects are dropped, px")
    wire_px: Positive = Field(default=30.0, description="what is thinner upright is wire, px")


class SideViews(Section):
    """Where the side views look."""

    side_views: Literal["found", "given", "stitched"] = Field(
        default="found",
        description="yaw of side views: of the drive, or given; stitched: as published",
    )
    left_yaw_deg: Degrees = Field(default=-60.0, description="left view from the front, degrees")
    right_yaw_deg: Degrees = Field(default=60.0, description="right view from the front, degrees")


class Sightings(SideViews, PoleMasks, BlockClasses, SightingRules):
    """Poles: objects in the images; px of an image 1200 px high."""


class Columns(Section):
    """Poles: pole-like columns of the cloud, tall, thin and with little around them."""

    excluded_classes: list[LasClass] = Field(
        default=[2, 7, 9, 11, 17, 18],
        description="LAS classes that no pole has (of poles alone): ground, noise, water, road,"
        " bridge deck",
    )
    min_top_m: Metres = Field(default=3.0, description="lower columns are none, m")
    radius_m: float = Field(
        default=0.6, gt=0, le=2, description="returns this near are the column's, m"
    )
    around_m: float = Field(
        default=2.0, gt=0, le=20, description="returns this near are around it, m"
    )
    around_trunk: float = Field(
        default=0.5, ge=0, description="most returns around it below wires, over its own"
    )
    around_all: float = Field(
        default=3.0, ge=0, description="the same at all heights: wires and arms, but no crown"
    )

    @model_validator(mode="after")
    def _nested(self) -> Columns:
        if self.radius_m >= self.around_m:
            raise ValueError(
                f"radius_m ({self.radius_m:g}) must be below around_m ({self.around_m:g})"
            )
        return self


class Triangulation(Section):
    """Poles: places from sightings."""

    method: Literal["packing", "sweep"] = Field(
        default="packing", description="packing: by evidence; sweep: as published"
    )
    max_distance_m: Metres = Field(
        default=40.0, description="farther sightings are not used, m; not for sweep"
    )
    sigma_position_m: Metres = Field(
        default=0.7, description="error of a camera's position, one axis, m"
    )
    shared_variance: float = Field(
        default=0.04,
        gt=0,
        lt=1,
        description="share of variances of places, headings, depths that near images share",
    )
    pole_evidence: float = Field(
        default=3.0, ge=-10, le=50, description="log evidence that a pole needs beyond even odds"
    )
    min_views: int = Field(
        default=3, ge=2, description="views that a pole needs which the cloud does not show"
    )
    max_sigma_m: Metres = Field(default=5.0, description="less certain poles are withheld, m")
    sequence_m: Metres = Field(
        default=30.48,
        description="sweep: images of one pole follow each other within this, m (100 ft)",
    )
    sweep_distance_m: Metres = Field(
        default=25.0, description="sweep: farther crossings are not used, m"
    )
    cluster_m: Metres = Field(default=1.0, description="sweep: crossings this near are one pole, m")
    depth_weight: Positive = Field(
        default=0.02,
        description="sweep: weight a of depths; a ray without crossing costs 1 - a - b",
    )
    spread_weight: Positive = Field(
        default=0.2, description="sweep: weight b of the spread of a ray's crossings"
    )
    clearance_m: float = Field(
        default=1.524, ge=0, le=100, description="poles this near road or building are withheld, m"
    )

    @model_validator(mode="after")
    def _worth_a_link(self) -> Triangulation:
        both = self.depth_weight + self.spread_weight
        if both >= 1.0:
            raise ValueError(
                f"depth_weight and spread_weight sum to {both:g}: make it less than 1, or a ray"
                " without crossing costs nothing and sweep finds no pole"
            )
        return self


class Hazard(Section):
    """Poles: how dangerous they are."""

    design_speed_kmh: float | None = Field(
        default=None,
        ge=20,
        le=140,
        description="design speed where no inventory states one, km/h; null: not stated, a range",
    )
    aadt: float | None = Field(
        default=None,
        ge=0,
        le=500_000,
        description="vehicles a day where no inventory states them; null: not stated, a range",
    )
    window_m: Metres = Field(default=100.0, description="length over which objects are counted, m")
    dense_per_km: Positive = Field(
        default=40.0, description="more objects a kilometre make those in the clear zone high"
    )
    clear_zone_m: float = Field(
        default=0.0, ge=0, le=100, description="your own clear zone, m; 0: by the guide's table"
    )
    runout_length_m: float = Field(
        default=0.0, ge=0, le=500, description="your own runout length, m; 0: by the guide's table"
    )
    section_every_m: float = Field(
        default=20.0, ge=0, le=1000, description="cross-sections along roads, m; 0: at objects only"
    )
    deflection_m: Metres = Field(default=1.0, description="barriers give way so far, m")
    bend_outside: float = Field(
        default=4.0,
        ge=1,
        le=20,
        description="times more leave outside of tight bends (from memory)",
    )
    bend_inside: float = Field(default=2.0, ge=1, le=20, description="the same inside of them")
    downhill: float = Field(
        default=2.0, ge=1, le=20, description="the same on steep descents (from memory)"
    )


class Pictures(Section):
    """Poles: pictures in the report, and of each object."""

    blur: bool = Field(
        default=True,
        description="hide vehicles and people that masks show; without a mask the whole image",
    )


class Validation(Section):
    """Poles: scores against known poles."""

    reach_m: Metres = Field(default=25.0, description="known poles count this near a camera, m")
    components: Literal["skip", "compare"] = Field(
        default="skip", description="compare: run the job without each component, for the report"
    )
    match_m: Metres = Field(default=25.0, description="largest error of a match, m")
