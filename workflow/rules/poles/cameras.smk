"""Where the camera of every image stood: aligned with the road, or given.

REQUIRED INPUTS  results/{site}/poles/: frames, image edges, pole axes, road edges, columns, terrain
OUTPUTS          results/{site}/poles/: calibration, cameras or given_cameras, camera scores
"""

from roadsight.base.sections.poles import AlignmentLimits, Reach


rule calibrate_drive:
    input:
        frames=rules.read_videolog.output.frames,
        image_edges=all_image_edges,
        road_edges=rules.extract_road_edges.output.edges,
        frame=rules.ingest_cloud.output.frame,
        dem=rules.build_dem.output.dem,
        terrain=only_if("terrain_occlusion", rules.build_terrain.output.terrain),
        decided=after_profile("sight_curvature"),
        pole_axes=landmark_axes,
        columns=landmark_columns,
        matches=tied_points,
        baseline=registered_cameras,
        cloud=dense_only(rules.ingest_cloud.output.cloud),
        photographs=dense_photographs,
        masks=dense_masks,
        drive=dense_drive,
        intrinsics=intrinsics_file,
        code=sources("calibrate_drive"),
    output:
        calibration="results/{site}/poles/calibration.json",
        doubts="results/{site}/doubts/calibrate_drive.json",
    log:
        log_of("calibrate_drive"),
    benchmark:
        benchmark_of("calibrate_drive")
    conda:
        ENVIRONMENT
    resources:
        mem_mb=camera_memory,
    params:
        options=flags("calibration"),
        sides=some_flags("sightings", "left_yaw_deg", "right_yaw_deg"),
        shared=some_flags("alignment", Reach),
        method=some_flags("alignment", "method"),
        dense=dense_options,
        images_sha256=dense_digest,
        curvature=decision_on("sight_curvature"),
    shell:
        "python -m roadsight.stages.poles.calibrate_drive --frames {input.frames}"
        " --image-edges {input.image_edges} --road-edges {input.road_edges}"
        " --frame {input.frame} --dem {input.dem} --terrain {input.terrain}"
        " --pole-axes {input.pole_axes} --columns {input.columns}"
        " --matches {input.matches} --baseline {input.baseline:q} {params.options} {params.sides} {params.shared}"
        " {params.method} {params.dense} --cloud {input.cloud} --masks {input.masks}"
        " --drive {input.drive} --curvature {params.curvature}"
        " --doubts {output.doubts} --out {output.calibration} > {log} 2>&1"


rule align_cameras:
    input:
        frames=rules.read_videolog.output.frames,
        image_edges=all_image_edges,
        road_edges=rules.extract_road_edges.output.edges,
        frame=rules.ingest_cloud.output.frame,
        dem=rules.build_dem.output.dem,
        terrain=only_if("terrain_occlusion", rules.build_terrain.output.terrain),
        decided=after_profile("sight_curvature"),
        pole_axes=landmark_axes,
        columns=landmark_columns,
        calibration=rules.calibrate_drive.output.calibration,
        cloud=dense_only(rules.ingest_cloud.output.cloud),
        photographs=dense_photographs,
        masks=dense_masks,
        drive=dense_drive,
        intrinsics=intrinsics_file,
        code=sources("align_cameras"),
    output:
        cameras=ensure("results/{site}/poles/cameras/{shard}.parquet", non_empty=True),
    log:
        log_of("align_cameras", "{shard}"),
    benchmark:
        benchmark_of("align_cameras", "{shard}")
    conda:
        ENVIRONMENT
    resources:
        mem_mb=camera_memory,
    params:
        shards=setting("shards"),
        options=some_flags("alignment", "method", Reach, AlignmentLimits),
        corrections=corrections_file,
        corrected=shard_corrections,
        dense=dense_options,
        images_sha256=dense_digest,
        curvature=decision_on("sight_curvature"),
    shell:
        "python -m roadsight.stages.poles.align_cameras --frames {input.frames}"
        " --image-edges {input.image_edges} --road-edges {input.road_edges}"
        " --frame {input.frame} --dem {input.dem} --terrain {input.terrain}"
        " --pole-axes {input.pole_axes} --columns {input.columns}"
        " --calibration {input.calibration} --corrections {params.corrections:q}"
        " {params.dense} --cloud {input.cloud} --masks {input.masks} --drive {input.drive}"
        " --curvature {params.curvature} {params.options} --shard {wildcards.shard}"
        " --shards {params.shards} --out {output.cameras} > {log} 2>&1"


rule use_given_cameras:
    input:
        frames=rules.read_videolog.output.frames,
        image_edges=rules.trace_image_edges.output.edges,
        road_edges=rules.extract_road_edges.output.edges,
        frame=rules.ingest_cloud.output.frame,
        dem=rules.build_dem.output.dem,
        cameras=cameras_of_videolog,
        intrinsics=intrinsics_file,
        code=sources("use_given_cameras"),
    output:
        cameras=ensure(
            "results/{site}/poles/given_cameras/{shard}.parquet", non_empty=True
        ),
    log:
        log_of("use_given_cameras", "{shard}"),
    benchmark:
        benchmark_of("use_given_cameras", "{shard}")
    conda:
        ENVIRONMENT
    params:
        shards=setting("shards"),
        shared=some_flags("alignment", Reach),
    shell:
        "python -m roadsight.stages.poles.use_given_cameras --frames {input.frames}"
        " --image-edges {input.image_edges} --road-edges {input.road_edges}"
        " --frame {input.frame} --dem {input.dem} --cameras {input.cameras:q}"
        " --intrinsics {input.intrinsics:q} {params.shared} --shard {wildcards.shard}"
        " --shards {params.shards} --out {output.cameras} > {log} 2>&1"


rule score_cameras:
    input:
        cameras=all_cameras,
        truth=known_cameras,
        intrinsics=beside_site("truth.intrinsics"),
        frame=rules.ingest_cloud.output.frame,
        road_edges=rules.extract_road_edges.output.edges,
        code=sources("score_cameras"),
    output:
        errors="results/{site}/poles/camera_errors.parquet",
        scores="results/{site}/poles/camera_scores.json",
    log:
        log_of("score_cameras"),
    benchmark:
        benchmark_of("score_cameras")
    conda:
        ENVIRONMENT
    shell:
        "python -m roadsight.stages.poles.score_cameras --cameras {input.cameras}"
        " --truth {input.truth:q} --intrinsics {input.intrinsics:q} --frame {input.frame}"
        " --road-edges {input.road_edges} --errors {output.errors} --out {output.scores}"
        " > {log} 2>&1"
