"""The optimal set of each plan, and what stands in its way.

REQUIRED INPUTS  results/{site}/placement/: targets, candidates, detections and coverage of all rounds
OUTPUTS          results/{site}/placement/{plan}/: solution, obstacles, scans of the chosen sensors
"""


rule solve_cover:
    input:
        coverage=last_coverage,
        targets=rules.place_targets.output.targets,
        candidates=all_candidates,
        detections=plan_detections,
        frame=rules.ingest_cloud.output.frame,
        lanes=lanes_of_plan,
        areas=plan_file("areas"),
        forbidden=plan_file("forbidden"),
        mandatory=plan_file("mandatory"),
        poles=plan_file("poles"),
        zones=beside_site("placement.zones"),
        cabinets=beside_site("placement.cabinets"),
        edges=rules.build_edges.output.edges,
        surfels=if_robust(lambda wildcards: [seen_surfels(wildcards)]),
        tilts=if_robust(only_if("mount_tilt", tilts_of_all_rounds)),
        air=if_robust(air_of_site),
        reflectivity=if_robust(placement_effect("reflectivity", "reflectivity.json")),
        code=sources_with("solve_cover", engine_of_cover),
    output:
        solution="results/{site}/placement/{plan}/solution.json",
        layers="results/{site}/placement/{plan}/solution.gpkg",
        timing="results/{site}/placement/{plan}/timing.json",
        doubts="results/{site}/doubts/solve_cover/{plan}.json",
    log:
        log_of("solve_cover", "{plan}"),
    benchmark:
        benchmark_of("solve_cover", "{plan}")
    conda:
        ENVIRONMENT
    params:
        zones=layered_site("placement.zones"),
        cabinets=layered_site("placement.cabinets"),
        areas=layered_plan_file("areas"),
        forbidden=layered_plan_file("forbidden"),
        mandatory=layered_plan_file("mandatory"),
        poles=layered_plan_file("poles"),
        sensors=plan_costs,
        options=plan_options,
        cover=flags("cover"),
        availability=plan_availability,
        height_m=target_height,
        uncoverable=setting("coverage.uncoverable"),
        mounting=mounting_rules,
        robust=robust_arguments,
        seed=setting("seed"),
    shell:
        "python -m roadsight.stages.placement.solve_cover --site {wildcards.site} --plan {wildcards.plan}"
        " --coverage {input.coverage} --targets {input.targets} --candidates {input.candidates}"
        " --detections {input.detections} --frame {input.frame} --sensors {params.sensors:q}"
        " {params.cover} {params.availability} --lanes {input.lanes}"
        " --target-height-m {params.height_m} --edges {input.edges}"
        " --uncoverable {params.uncoverable} --seed {params.seed} --options={params.options:q}"
        " --areas {params.areas:q} --forbidden {params.forbidden:q}"
        " --mandatory {params.mandatory:q} --poles {params.poles:q}"
        " --zones {params.zones:q} --cabinets {params.cabinets:q} --mounting {params.mounting:q}"
        " --surfels {input.surfels} --tilts {input.tilts} --air {input.air} --reflectivity {input.reflectivity} {params.robust}"
        " --solution {output.solution} --layers {output.layers}"
        " --timing {output.timing} --doubts {output.doubts} > {log} 2>&1"


rule find_obstacles:
    input:
        solution=rules.solve_cover.output.solution,
        coverage=last_coverage,
        targets=rules.place_targets.output.targets,
        candidates=all_candidates,
        detections=plan_detections,
        surfels=seen_surfels,
        dem=rules.build_dem.output.dem,
        frame=rules.ingest_cloud.output.frame,
        rain=placement_effect("rain", "rain.json"),
        fog=placement_effect("fog", "fog.json"),
        reflectivity=placement_effect("reflectivity", "reflectivity.json"),
        lanes=placement_effect("moving_vehicles", "lanes.parquet"),
        objects=rules.gather_objects.output.members,
        zones=beside_site("placement.zones"),
        cabinets=beside_site("placement.cabinets"),
        depth=if_cells(plan_depth_maps),
        points=if_cells(rules.ingest_cloud.output.cloud),
        traffic=if_cells(traffic_mask),
        tilts=if_cells(only_if("mount_tilt", tilts_of_all_rounds)),
        decided=if_cells(after_profile("curvature_refraction")),
        code=sources_with("find_obstacles", setting("lidar.engine")),
    output:
        obstacles="results/{site}/placement/{plan}/obstacles.gpkg",
    log:
        log_of("find_obstacles", "{plan}"),
    benchmark:
        benchmark_of("find_obstacles", "{plan}")
    conda:
        ENVIRONMENT
    resources:
        mem_mb=megabytes(250),
        runtime=minutes(),
    params:
        zones=layered_site("placement.zones"),
        cabinets=layered_site("placement.cabinets"),
        sensors_file=CONFIG.sensors_file,
        sensors=plan_costs,
        height_m=target_height,
        mounting=mounting_rules,
        engine=setting("lidar.engine"),
        cells=cell_arguments,
    shell:
        "python -m roadsight.stages.placement.find_obstacles --solution {input.solution}"
        " --coverage {input.coverage} --plan {wildcards.plan} --targets {input.targets}"
        " --candidates {input.candidates} --detections {input.detections}"
        " --surfels {input.surfels} --dem {input.dem} --frame {input.frame}"
        " --objects {input.objects} --sensors {params.sensors_file:q} --air {input.rain} {input.fog}"
        " --reflectivity {input.reflectivity} --lanes {input.lanes}"
        " --zones {params.zones:q} --cabinets {params.cabinets:q} --mounting {params.mounting:q}"
        " --target-height-m {params.height_m} --engine {params.engine}"
        " --depth {input.depth} --cloud {input.points} --traffic {input.traffic} --tilts {input.tilts}"
        " {params.cells} --out {output.obstacles} > {log} 2>&1"


rule render_scans:
    input:
        solution=rules.solve_cover.output.solution,
        surfels=seen_surfels,
        frame=rules.ingest_cloud.output.frame,
        tilts=only_if("mount_tilt", tilts_of_all_rounds),
        rain=placement_effect("rain", "rain.json"),
        fog=placement_effect("fog", "fog.json"),
        surfaces=placement_effect("reflectivity", "surfaces.parquet"),
        code=sources_with("render_scans", setting("lidar.engine")),
    output:
        scans="results/{site}/placement/{plan}/scans.laz",
    log:
        log_of("render_scans", "{plan}"),
    benchmark:
        benchmark_of("render_scans", "{plan}")
    conda:
        ENVIRONMENT
    resources:
        mem_mb=megabytes(250),
        runtime=minutes(),
    params:
        sensors_file=CONFIG.sensors_file,
        sensors=plan_costs,
        engine=setting("lidar.engine"),
    shell:
        "python -m roadsight.stages.placement.render_scans --solution {input.solution}"
        " --surfels {input.surfels} --frame {input.frame} --sensors {params.sensors_file:q}"
        " --tilts {input.tilts} --air {input.rain} {input.fog} --surfaces {input.surfaces}"
        " --engine {params.engine} --out {output.scans} > {log} 2>&1"


rule measure_data:
    input:
        solution=rules.solve_cover.output.solution,
        targets=rules.place_targets.output.targets,
        detections=plan_detections,
        edges=rules.build_edges.output.edges,
        pavement=rules.extract_pavement.output.pavement,
        frame=rules.ingest_cloud.output.frame,
        scans=rules.render_scans.output.scans,
        depth=plan_depth_maps,
        candidates=all_candidates,
        tilts=only_if("mount_tilt", tilts_of_all_rounds),
        rain=placement_effect("rain", "rain.json"),
        fog=placement_effect("fog", "fog.json"),
        reflectivity=placement_effect("reflectivity", "reflectivity.json"),
        decided=after_profile("partial_hits", "curvature_refraction"),
        code=sources("measure_data"),
    output:
        data="results/{site}/placement/{plan}/data.json",
        layers="results/{site}/placement/{plan}/data.gpkg",
    log:
        log_of("measure_data", "{plan}"),
    benchmark:
        benchmark_of("measure_data", "{plan}")
    conda:
        ENVIRONMENT
    resources:
        mem_mb=megabytes(250),
        runtime=minutes(),
    params:
        sensors_file=CONFIG.sensors_file,
        sensors=plan_costs,
        frames_hz=setting("lidar.frames_hz"),
        lidar_curve=setting("targets.lidar_curve"),
        camera_curve=setting("targets.camera_curve"),
        radius_m=setting("targets.radius_m"),
        height_m=target_height,
        box=target_box,
        azimuth_stride=setting("lidar.azimuth_stride"),
        partial_hits=decision_on("partial_hits"),
        curvature=decision_on("curvature_refraction"),
    shell:
        "python -m roadsight.stages.placement.measure_data --solution {input.solution}"
        " --targets {input.targets} --detections {input.detections} --edges {input.edges}"
        " --pavement {input.pavement} --frame {input.frame} --sensors {params.sensors_file:q}"
        " --scans {input.scans} --frames-hz {params.frames_hz}"
        " --lidar-curve {params.lidar_curve} --camera-curve {params.camera_curve}"
        " --depth {input.depth} --candidates {input.candidates} --tilts {input.tilts}"
        " --air {input.rain} {input.fog} --reflectivity {input.reflectivity}"
        " --radius-m {params.radius_m} --height-m {params.height_m} {params.box}"
        " --azimuth-stride {params.azimuth_stride}"
        " --partial-hits {params.partial_hits} --curvature {params.curvature}"
        " --out {output.data} --layers {output.layers} > {log} 2>&1"


rule measure_tolerance:
    input:
        solution=rules.solve_cover.output.solution,
        targets=rules.place_targets.output.targets,
        detections=plan_detections,
        surfels=seen_surfels,
        frame=rules.ingest_cloud.output.frame,
        tilts=only_if("mount_tilt", tilts_of_all_rounds),
        rain=placement_effect("rain", "rain.json"),
        fog=placement_effect("fog", "fog.json"),
        reflectivity=placement_effect("reflectivity", "reflectivity.json"),
        decided=after_profile("partial_hits", "curvature_refraction"),
        code=sources_with("measure_tolerance", setting("lidar.engine")),
    output:
        tolerance="results/{site}/placement/{plan}/tolerance.json",
        layers="results/{site}/placement/{plan}/tolerance.gpkg",
    log:
        log_of("measure_tolerance", "{plan}"),
    benchmark:
        benchmark_of("measure_tolerance", "{plan}")
    conda:
        ENVIRONMENT
    resources:
        mem_mb=megabytes(250),
        runtime=minutes(),
    params:
        sensors_file=CONFIG.sensors_file,
        sensors=site_sensors_seeing,
        settings=change_arguments,
        partial_hits=decision_on("partial_hits"),
        curvature=decision_on("curvature_refraction"),
    shell:
        "python -m roadsight.stages.placement.measure_tolerance --solution {input.solution}"
        " --targets {input.targets} --surfels {input.surfels} --frame {input.frame}"
        " --sensors-file {params.sensors_file:q} {params.settings}"
        " --tilts {input.tilts} --air {input.rain} {input.fog}"
        " --reflectivity {input.reflectivity} --detections {input.detections}"
        " --partial-hits {params.partial_hits} --curvature {params.curvature}"
        " --out {output.tolerance} --layers {output.layers} > {log} 2>&1"


rule try_removals:
    input:
        solution=rules.solve_cover.output.solution,
        obstacles=rules.find_obstacles.output.obstacles,
        objects=rules.gather_objects.output.members,
        targets=rules.place_targets.output.targets,
        candidates=all_candidates,
        detections=plan_detections,
        surfels=seen_surfels,
        frame=rules.ingest_cloud.output.frame,
        tilts=only_if("mount_tilt", tilts_of_all_rounds),
        rain=placement_effect("rain", "rain.json"),
        fog=placement_effect("fog", "fog.json"),
        reflectivity=placement_effect("reflectivity", "reflectivity.json"),
        zones=beside_site("placement.zones"),
        cabinets=beside_site("placement.cabinets"),
        decided=after_profile("partial_hits", "curvature_refraction"),
        code=sources_with("try_removals", setting("lidar.engine")),
    output:
        removals="results/{site}/placement/{plan}/removals.json",
    log:
        log_of("try_removals", "{plan}"),
    benchmark:
        benchmark_of("try_removals", "{plan}")
    conda:
        ENVIRONMENT
    resources:
        mem_mb=megabytes(250),
        runtime=minutes(),
    params:
        zones=layered_site("placement.zones"),
        cabinets=layered_site("placement.cabinets"),
        sensors_file=CONFIG.sensors_file,
        sensors=plan_costs,
        felled=setting("coverage.felled"),
        time_limit_s=setting("cover.time_limit_s"),
        mounting=mounting_rules,
        settings=change_arguments,
        partial_hits=decision_on("partial_hits"),
        curvature=decision_on("curvature_refraction"),
    shell:
        "python -m roadsight.stages.placement.try_removals --solution {input.solution}"
        " --obstacles {input.obstacles} --objects {input.objects} --targets {input.targets}"
        " --candidates {input.candidates} --detections {input.detections}"
        " --surfels {input.surfels} --frame {input.frame} --costs {params.sensors:q}"
        " --sensors-file {params.sensors_file:q} --felled {params.felled} {params.settings}"
        " --time-limit-s {params.time_limit_s} --tilts {input.tilts} --air {input.rain} {input.fog}"
        " --reflectivity {input.reflectivity} --zones {params.zones:q}"
        " --cabinets {params.cabinets:q} --mounting {params.mounting:q}"
        " --partial-hits {params.partial_hits} --curvature {params.curvature}"
        " --out {output.removals} > {log} 2>&1"
