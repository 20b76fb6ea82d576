"""Where the camera of every image stood: aligned with the road, or given.

REQUIRED INPUTS  results/{site}/poles/: frames, image edges, pole axes, road edges, columns, terrain
OUTPUTS          results/{site}/poles/: calibration, cameras or given_cameras, camera scores
"""

from roadsight.base.sections.poles import AlignmentLimits, Reach


use rule step as calibrate_drive with:
    input:
        frames=rules.read_videolog.output.out,
        image_edges=all_image_edges,
        road_edges=rules.extract_road_edges.output.edges,
        frame=rules.ingest_cloud.output.frame,
        dem=rules.build_dem.output.dem,
        terrain=only_if("terrain_occlusion", rules.build_terrain.output.out),
        decided=after_profile("sight_curvature"),
        pole_axes=if_landmarks(all_pole_axes),
        columns=if_landmarks([rules.find_pole_columns.output.out]),
        matches=if_ties(all_matches),
        baseline=registered_cameras,
        cloud=if_dense([rules.ingest_cloud.output.cloud]),
        photographs_files=if_dense(rendered_images),
        masks=if_dense(all_masks),
        drive=if_dense(distorting_drive),
        intrinsics_files=intrinsics_file,
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
        images_sha256=dense_digest,


use rule step as align_cameras with:
    input:
        frames=rules.read_videolog.output.out,
        image_edges=all_image_edges,
        road_edges=rules.extract_road_edges.output.edges,
        frame=rules.ingest_cloud.output.frame,
        dem=rules.build_dem.output.dem,
        terrain=only_if("terrain_occlusion", rules.build_terrain.output.out),
        decided=after_profile("sight_curvature"),
        pole_axes=if_landmarks(all_pole_axes),
        columns=if_landmarks([rules.find_pole_columns.output.out]),
        calibration=rules.calibrate_drive.output.out,
        cloud=if_dense([rules.ingest_cloud.output.cloud]),
        photographs_files=if_dense(rendered_images),
        masks=if_dense(all_masks),
        drive=if_dense(distorting_drive),
        intrinsics_files=intrinsics_file,
    output:
        out=ensure("results/{site}/poles/cameras/{shard}.parquet", non_empty=True),
    resources:
        mem_mb=camera_memory,
    params:
        settings=told(
            dense_options,
            flags("alignment", "method", Reach, AlignmentLimits),
            corrections=corrections_file,
            curvature=decision_on("sight_curvature"),
            shard=wildcard("shard"),
            shards=setting("shards"),
        ),
        corrected=shard_corrections,
        images_sha256=dense_digest,


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
        out=ensure("results/{site}/poles/given_cameras/{shard}.parquet", non_empty=True),
    params:
        settings=told(
            flags("alignment", Reach),
            shard=wildcard("shard"),
            shards=setting("shards"),
        ),


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
