"""From what images and cloud show to cameras, and to poles on the map."""

from roadsight.base.sections.poles import AlignmentLimits, Reach


# What the cloud shows beside the road: pole-like columns; trees and guardrails, where asked for.
use rule step as find_pole_columns with:
    input:
        cloud=rules.ingest_cloud.output.cloud,
        frame=rules.ingest_cloud.output.frame,
        dem=rules.build_dem.output.dem,
    output:
        out="results/{site}/poles/columns.parquet",
    resources:
        **holding_cloud(60),
    params:
        settings=told("columns"),


use rule find_pole_columns as find_roadside_objects with:
    output:
        out="results/{site}/poles/objects.parquet",
    params:
        settings=told(flags("sightings", "kinds", "building_classes", "headwall_classes")),


# Where the camera of every image stood: aligned with the road, or given. What it is aligned with is
# the road and poles, in images and in the cloud, and all that photographs and the cloud share.
ROAD_AND_POLES = dict(
    frames=rules.read_videolog.output.out,
    image_edges=all_image_edges,
    road_edges=rules.extract_road_edges.output.edges,
    frame=rules.ingest_cloud.output.frame,
    dem=rules.build_dem.output.dem,
    terrain=only_if("terrain_occlusion", rules.build_terrain.output.out),
    decided=after_profile("sight_curvature"),
    pole_axes=if_landmarks(all_pole_axes),
    columns=if_landmarks([rules.find_pole_columns.output.out]),
)
PHOTOGRAPHS = dict(
    cloud=if_dense([rules.ingest_cloud.output.cloud]),
    photographs_files=if_dense(rendered_images),
    masks=if_dense(all_masks),
    drive=if_dense(distorting_drive),
    intrinsics_files=intrinsics_file,
)


use rule step as calibrate_drive with:
    input:
        **ROAD_AND_POLES,
        **{"matches": if_ties(all_matches), "baseline": registered_cameras},
        **PHOTOGRAPHS,
    output:
        out="results/{site}/poles/calibration.json",
        doubts="results/{site}/doubts/calibrate_drive.json",
    resources:
        mem_mb=camera_memory,
    params:
        settings=told(
            "calibration",
            flags("sightings", "left_yaw_deg", "right_yaw_deg"),
            flags("alignment", Reach),
            flags("alignment", "method"),
            dense_options,
            curvature=decision_on("sight_curvature"),
        ),
        images_sha256=if_dense(image_digest(), ""),


use rule calibrate_drive as align_cameras with:
    input:
        **ROAD_AND_POLES,
        **{"calibration": rules.calibrate_drive.output.out},
        **PHOTOGRAPHS,
    output:
        out=non_empty("results/{site}/poles/cameras/{shard}.parquet"),
    params:
        settings=told(
            dense_options,
            flags("alignment", "method", Reach, AlignmentLimits),
            corrections=corrections_file,
            curvature=decision_on("sight_curvature"),
            **ONE_SHARD,
        ),
        corrected=shard_corrections,


use rule step as use_given_cameras with:
    input:
        frames=rules.read_videolog.output.out,
        image_edges=rules.trace_image_edges.output.out,
        road_edges=rules.extract_road_edges.output.edges,
        frame=rules.ingest_cloud.output.frame,
        dem=rules.build_dem.output.dem,
        cameras=cameras_of_videolog,
        intrinsics=intrinsics_file,
    output:
        out=non_empty("results/{site}/poles/given_cameras/{shard}.parquet"),
    params:
        settings=told(flags("alignment", Reach), **ONE_SHARD),


use rule step as score_cameras with:
    input:
        cameras=all_cameras,
        truth=known_cameras,
        intrinsics=beside_site("truth.intrinsics"),
        frame=rules.ingest_cloud.output.frame,
        road_edges=rules.extract_road_edges.output.edges,
    output:
        errors="results/{site}/poles/camera_errors.parquet",
        out="results/{site}/poles/camera_scores.json",


# From cameras and what their images show to poles on the map.
use rule step as turn_side_views with:
    input:
        frames=rules.read_videolog.output.out,
        calibration=rules.calibrate_drive.output.out,
        cameras=all_cameras,
        images_files=rendered_images,
        drive=distorting_drive,
    output:
        out="results/{site}/poles/side_turns.json",
    params:
        settings=told(images=images_path, lenses=given_lenses),
        images_sha256=image_digest(),


use rule step as measure_poles with:
    input:
        frames=rules.read_videolog.output.out,
        calibration=if_aligned([rules.calibrate_drive.output.out]),
        turns=side_turns_if_used,
        cameras=pole_shard(camera_folder, "parquet"),
        masks=pole_shard(straight("masks"), "zip"),
        depth=pole_shard(straight("depth"), "zip"),
        dem=rules.build_dem.output.dem,
        columns=rules.find_pole_columns.output.out,
        voxels=if_bearings([rules.rasterise_lidar.output.voxels]),
        objects=if_objects([rules.find_roadside_objects.output.out]),
        frame=rules.ingest_cloud.output.frame,
        decided=after_profile("side_views", "grid_convergence"),
    output:
        out=non_empty("results/{site}/poles/sightings/{shard}.parquet"),
        seen="results/{site}/poles/seen/{shard}.parquet",
        markings="results/{site}/poles/markings/{shard}.parquet",
    params:
        settings=told(
            "sightings",
            flags("image_edges", "min_marking_px"),
            views=used_views,
            grid_convergence=decision_on("grid_convergence"),
            **ONE_SHARD,
        ),


use rule step as triangulate_poles with:
    input:
        sightings=all_sightings,
        frame=rules.ingest_cloud.output.frame,
        dem=rules.build_dem.output.dem,
        voxels=rules.rasterise_lidar.output.voxels,
        objects=if_objects([rules.find_roadside_objects.output.out]),
        seen=pole_shards("seen", "parquet"),
        frames=rules.read_videolog.output.out,
        columns=rules.find_pole_columns.output.out,
        decisions=beside_site("poles.decisions"),
    output:
        poles="results/{site}/poles/poles.parquet",
        layers="results/{site}/poles/placed.gpkg",
        csv="results/{site}/poles/poles.csv",
        geojson="results/{site}/poles/poles.geojson",
        doubts="results/{site}/doubts/triangulate_poles.json",
    params:
        settings=told("triangulation", own_networks),


use rule step as rate_hazard with:
    input:
        poles=rules.triangulate_poles.output.poles,
        frame=rules.ingest_cloud.output.frame,
        frames=rules.read_videolog.output.out,
        edges=rules.extract_road_edges.output.edges,
        dem=rules.build_dem.output.dem,
        cloud=rules.ingest_cloud.output.cloud,
        ground=rules.build_dem.output.ground,
        placed=rules.triangulate_poles.output.layers,
        markings=pole_shards("markings", "parquet"),
        inventory_files=beside_site("roads.inventory"),
        routes_files=beside_site("roads.routes"),
        barriers_files=beside_site("roads.barriers"),
        decided=after_profile("scale_factor"),
    output:
        out="results/{site}/poles/hazard.parquet",
        csv="results/{site}/poles/hazard.csv",
        sections="results/{site}/poles/cross_sections.parquet",
        geometry_csv="results/{site}/poles/road_geometry.csv",
        layers="results/{site}/poles/poles.gpkg",
        doubts="results/{site}/doubts/rate_hazard.json",
    params:
        settings=told(
            "hazard",
            inventory=layered_site("roads.inventory"),
            inventory_crs=site_field("roads.inventory_crs"),
            routes=layered_site("roads.routes"),
            routes_crs=site_field("roads.routes_crs"),
            barriers=layered_site("roads.barriers"),
            barriers_crs=site_field("roads.barriers_crs"),
            measure_unit=site_field("roads.measure_unit"),
            traffic=site_field("roads.traffic"),
            carriageway=site_field("roads.carriageway"),
            scale_factor=decision_on("scale_factor"),
        ),


use rule step as validate_poles with:
    input:
        poles=rules.triangulate_poles.output.poles,
        placed=rules.triangulate_poles.output.layers,
        truth_files=known_poles,
        roadside=if_rendered(["results/{site}/sample/truth.gpkg"]),
        frame=rules.ingest_cloud.output.frame,
        frames=rules.read_videolog.output.out,
        edges=rules.extract_road_edges.output.edges,
        voxels=rules.rasterise_lidar.output.voxels,
    output:
        out="results/{site}/poles/validation.json",
    params:
        settings=told(
            flags("validation", "reach_m", "match_m"),
            flags("sightings", "kinds"),
            truth=layered_site("truth.poles", known_poles),
            truth_crs=site_field("truth.poles_crs"),
            truth_kind=known_pole_kind,
        ),
