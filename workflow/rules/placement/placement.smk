"""From a road to which sensor position sees which target.

REQUIRED INPUTS  results/{site}/scene/* and placement/edges.gpkg
OUTPUTS          results/{site}/placement/round-*/: candidates, depth maps, detections, coverage
USUAL STEPS      candidates and targets, depth maps and detections by shard, coverage check, rounds
                 of denser candidates near gaps
"""

from roadsight.base.sections.sensing import CellFilling, TargetGrid


rule place_candidates:
    input:
        edges=rules.build_edges.output.edges,
        pavement=rules.extract_pavement.output.pavement,
        dem=rules.build_dem.output.dem,
        cloud=rules.ingest_cloud.output.cloud,
        frame=rules.ingest_cloud.output.frame,
        ground=rules.build_dem.output.ground,
        mounts=beside_site("placement.mounts"),
        decided=after_profile("overhead_cover"),
        code=sources("place_candidates"),
    output:
        candidates="results/{site}/placement/round-0/candidates.parquet",
    log:
        log_of("place_candidates"),
    benchmark:
        benchmark_of("place_candidates")
    conda:
        ENVIRONMENT
    resources:
        mem_mb=megabytes(60),
        runtime=minutes(),
    params:
        mounts=layered_site("placement.mounts"),
        options=flags("candidates"),
        overhead_cover=decision_on("overhead_cover"),
    shell:
        "python -m roadsight.stages.placement.place_candidates --site {wildcards.site}"
        " --edges {input.edges} --pavement {input.pavement} --dem {input.dem}"
        " --cloud {input.cloud} --frame {input.frame} {params.options}"
        " --ground {input.ground} --mounts {params.mounts:q} --overhead-cover {params.overhead_cover}"
        " --out {output.candidates} > {log} 2>&1"


rule place_targets:
    input:
        pavement=rules.extract_pavement.output.points,
        outline=rules.extract_pavement.output.pavement,
        frame=rules.ingest_cloud.output.frame,
        edges=edges_of_targets,
        code=sources("place_targets"),
    output:
        targets="results/{site}/placement/targets.parquet",
        unexamined="results/{site}/placement/unexamined.gpkg",
        doubts="results/{site}/doubts/place_targets.json",
    log:
        log_of("place_targets"),
    benchmark:
        benchmark_of("place_targets")
    conda:
        ENVIRONMENT
    params:
        grid=some_flags("targets", TargetGrid),
        width_m=target_width,
        box=target_box,
    shell:
        "python -m roadsight.stages.placement.place_targets --pavement {input.pavement}"
        " --outline {input.outline} --frame {input.frame} --edges {input.edges} {params.grid}"
        " --width-m {params.width_m} {params.box}"
        " --unexamined {output.unexamined} --doubts {output.doubts} --out {output.targets} > {log} 2>&1"


rule gather_objects:
    input:
        surfels=rules.build_surfels.output.surfels,
        dem=rules.build_dem.output.dem,
        frame=rules.ingest_cloud.output.frame,
        code=sources("gather_objects"),
    output:
        objects="results/{site}/placement/objects.gpkg",
        members="results/{site}/placement/objects.parquet",
        left="results/{site}/placement/surfels_left.parquet",
    log:
        log_of("gather_objects"),
    benchmark:
        benchmark_of("gather_objects")
    conda:
        ENVIRONMENT
    resources:
        mem_mb=megabytes(250),
        runtime=minutes(),
    params:
        removed=site_field("placement.remove"),
    shell:
        "python -m roadsight.stages.placement.gather_objects --site {wildcards.site}"
        " --surfels {input.surfels} --dem {input.dem} --frame {input.frame}"
        " --remove {params.removed:q} --objects {output.objects} --members {output.members}"
        " --left {output.left} > {log} 2>&1"


rule render_depth_maps:
    input:
        candidates="results/{site}/placement/round-{round}/candidates.parquet",
        surfels=seen_surfels,
        cloud=rules.ingest_cloud.output.cloud,
        targets=rules.place_targets.output.targets,
        traffic=traffic_mask,
        network=depth_network,
        tilts=only_if("mount_tilt", tilts_of_map),
        decided=after_profile("hole_filling", "curvature_refraction"),
        code=sources_with("render_depth_maps", setting("lidar.engine")),
    output:
        depth=ensure(
            "results/{site}/placement/round-{round}/depth/{sensor}/{shard}.parquet",
            non_empty=True,
        ),
    log:
        log_of("render_depth_maps", "round-{round}", "{sensor}", "{shard}"),
    benchmark:
        benchmark_of("render_depth_maps", "round-{round}", "{sensor}", "{shard}")
    conda:
        ENVIRONMENT
    resources:
        mem_mb=megabytes(250),
        runtime=minutes(),
    params:
        sensor=sensor_of_map,
        sensors_file=CONFIG.sensors_file,
        shards=shard_count,
        model=lidar_model,
        engine=setting("lidar.engine"),
        azimuth_stride=stride_of_map,
        curvature=decision_on("curvature_refraction"),
        filling=some_flags("lidar", CellFilling),
        room_m=target_room,
        panorama=panorama_flag,
        kept="results/{site}/placement/kept/round-{round}/depth/{sensor}/{shard}.parquet",
    shell:
        "python -m roadsight.stages.placement.render_depth_maps --candidates {input.candidates}"
        " --shard {wildcards.shard} --shards {params.shards}"
        " --sensor {wildcards.sensor} --sensors {params.sensors_file:q} --model {params.model}"
        " --engine {params.engine} --azimuth-stride {params.azimuth_stride}"
        " --surfels {input.surfels} --cloud {input.cloud} --traffic {input.traffic}"
        " --network {input.network:q} --targets {input.targets} --room-m {params.room_m}"
        " {params.filling} {params.panorama} --kept {params.kept}"
        " --tilts {input.tilts} --curvature {params.curvature} --out {output.depth} > {log} 2>&1"


rule build_detection_shard:
    input:
        depth=rules.render_depth_maps.output.depth,
        candidates="results/{site}/placement/round-{round}/candidates.parquet",
        targets=rules.place_targets.output.targets,
        tilts=only_if("mount_tilt", tilts_of_round),
        rain=placement_effect("rain", "rain.json"),
        fog=placement_effect("fog", "fog.json"),
        reflectivity=placement_effect("reflectivity", "reflectivity.json"),
        lanes=placement_effect("moving_vehicles", "lanes.parquet"),
        decided=after_profile("partial_hits", "curvature_refraction"),
        code=sources("build_detection_shard"),
    output:
        detection=ensure(
            "results/{site}/placement/round-{round}/detection/{sensor}/{shard}.parquet",
            non_empty=True,
        ),
    log:
        log_of("build_detection_shard", "round-{round}", "{sensor}", "{shard}"),
    benchmark:
        benchmark_of("build_detection_shard", "round-{round}", "{sensor}", "{shard}")
    conda:
        ENVIRONMENT
    params:
        sensor=sensor_definition,
        sensors_file=CONFIG.sensors_file,
        radius_m=setting("targets.radius_m"),
        height_m=target_height,
        box=target_box,
        min_beams=least_beams,
        azimuth_stride=setting("lidar.azimuth_stride"),
        partial_hits=decision_on("partial_hits"),
        curvature=decision_on("curvature_refraction"),
        kept="results/{site}/placement/kept/round-{round}/detection/{sensor}/{shard}.parquet",
    shell:
        "python -m roadsight.stages.placement.build_detection_shard --depth {input.depth}"
        " --candidates {input.candidates} --targets {input.targets}"
        " --sensor {wildcards.sensor} --sensors {params.sensors_file:q}"
        " --radius-m {params.radius_m} --height-m {params.height_m} {params.box}"
        " --min-beams {params.min_beams} --azimuth-stride {params.azimuth_stride}"
        " --tilts {input.tilts} --air {input.rain} {input.fog}"
        " --reflectivity {input.reflectivity} --lanes {input.lanes}"
        " --partial-hits {params.partial_hits} --curvature {params.curvature}"
        " --kept {params.kept} --out {output.detection} > {log} 2>&1"


rule check_coverage:
    input:
        targets=rules.place_targets.output.targets,
        candidates=candidates_up_to_round,
        detections=detections_up_to_round,
        frame=rules.ingest_cloud.output.frame,
        zones=in_last_round(beside_site("placement.zones")),
        cabinets=in_last_round(beside_site("placement.cabinets")),
        code=sources("check_coverage"),
    output:
        coverage="results/{site}/placement/round-{round}/coverage.json",
    log:
        log_of("check_coverage", "round-{round}"),
    benchmark:
        benchmark_of("check_coverage", "round-{round}")
    conda:
        ENVIRONMENT
    params:
        plans=plan_sensors,
        zones=in_last_round(layered_site("placement.zones")),
        cabinets=in_last_round(layered_site("placement.cabinets")),
        mounting=in_last_round(mounting_rules, otherwise="{}"),
    shell:
        "python -m roadsight.stages.placement.check_coverage --targets {input.targets}"
        " --candidates {input.candidates} --detections {input.detections} --frame {input.frame}"
        " --zones {params.zones:q} --cabinets {params.cabinets:q} --mounting {params.mounting:q}"
        " --plans {params.plans:q} --out {output.coverage} > {log} 2>&1"


rule densify_candidates:
    input:
        coverage=coverage_of_previous_round,
        targets=rules.place_targets.output.targets,
        candidates=candidates_of_previous_rounds,
        edges=rules.build_edges.output.edges,
        pavement=rules.extract_pavement.output.pavement,
        dem=rules.build_dem.output.dem,
        cloud=rules.ingest_cloud.output.cloud,
        frame=rules.ingest_cloud.output.frame,
        ground=rules.build_dem.output.ground,
        mounts=beside_site("placement.mounts"),
        decided=after_profile("overhead_cover"),
        code=sources("densify_candidates"),
    output:
        candidates="results/{site}/placement/round-{round}/candidates.parquet",
    log:
        log_of("densify_candidates", "round-{round}"),
    benchmark:
        benchmark_of("densify_candidates", "round-{round}")
    wildcard_constraints:
        round=r"[1-9]\d*",
    conda:
        ENVIRONMENT
    params:
        mounts=layered_site("placement.mounts"),
        plans=plan_sensors,
        radius_m=setting("coverage.radius_m"),
        closest_m=setting("coverage.closest_m"),
        options=flags("candidates"),
        overhead_cover=decision_on("overhead_cover"),
    shell:
        "python -m roadsight.stages.placement.densify_candidates"
        " --round {wildcards.round} --coverage {input.coverage} --targets {input.targets}"
        " --candidates {input.candidates} --edges {input.edges} --pavement {input.pavement}"
        " --dem {input.dem} --cloud {input.cloud} --frame {input.frame}"
        " --plans {params.plans:q} --radius-m {params.radius_m} --closest-m {params.closest_m}"
        " {params.options}"
        " --ground {input.ground} --mounts {params.mounts:q} --overhead-cover {params.overhead_cover}"
        " --out {output.candidates} > {log} 2>&1"
