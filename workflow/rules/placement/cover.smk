"""The optimal set of each plan, and what stands in its way."""


use rule step as solve_cover with:
    input:
        coverage=last_coverage,
        targets=rules.place_targets.output.out,
        candidates=all_candidates,
        detections=plan_detections,
        frame=rules.ingest_cloud.output.frame,
        lanes=past_traffic(placement_effect("moving_vehicles", "lanes.parquet")),
        areas_files=plan_file("areas"),
        forbidden_files=plan_file("forbidden"),
        mandatory_files=plan_file("mandatory"),
        poles_files=plan_file("poles"),
        zones_files=beside_site("placement.zones"),
        cabinets_files=beside_site("placement.cabinets"),
        edges=rules.build_edges.output.out,
        surfels=if_robust(lambda wildcards: [seen_surfels(wildcards)]),
        tilts=if_robust(only_if("mount_tilt", tilts_of_all_rounds)),
        air=if_robust(air_of_site),
        reflectivity=if_robust(placement_effect("reflectivity", "reflectivity.json")),
        code=sources_with("solve_cover", if_robust(setting("lidar.engine"))),
    output:
        solution="results/{site}/placement/{plan}/solution.json",
        layers="results/{site}/placement/{plan}/solution.gpkg",
        timing="results/{site}/placement/{plan}/timing.json",
        doubts="results/{site}/doubts/solve_cover/{plan}.json",
    params:
        settings=told(
            "cover",
            past_traffic(
                lambda wildcards: f"--availability {plan_of(wildcards).availability!r}", ""
            ),
            if_robust(robust_arguments, ""),
            site=wildcard("site"),
            plan=wildcard("plan"),
            sensors=plan_costs,
            target_height_m=target_height,
            uncoverable=setting("coverage.uncoverable"),
            seed=setting("seed"),
            options=lambda wildcards: plan_of(wildcards).options(),
            areas=layered_plan_file("areas"),
            forbidden=layered_plan_file("forbidden"),
            mandatory=layered_plan_file("mandatory"),
            poles=layered_plan_file("poles"),
            zones=layered_site("placement.zones"),
            cabinets=layered_site("placement.cabinets"),
            mounting=mounting_rules,
        ),


use rule step_on_surfels as find_obstacles with:
    input:
        solution=rules.solve_cover.output.solution,
        coverage=last_coverage,
        targets=rules.place_targets.output.out,
        candidates=all_candidates,
        detections=plan_detections,
        surfels=seen_surfels,
        dem=rules.build_dem.output.dem,
        frame=rules.ingest_cloud.output.frame,
        air=air_of_site,
        reflectivity=placement_effect("reflectivity", "reflectivity.json"),
        lanes=placement_effect("moving_vehicles", "lanes.parquet"),
        objects=rules.gather_objects.output.members,
        zones_files=beside_site("placement.zones"),
        cabinets_files=beside_site("placement.cabinets"),
        depth=if_cells(plan_depth_maps),
        cloud=if_cells([rules.ingest_cloud.output.cloud]),
        traffic=if_cells(traffic_mask),
        tilts=if_cells(only_if("mount_tilt", tilts_of_all_rounds)),
        decided=if_cells(after_profile("curvature_refraction")),
        code=sources_with("find_obstacles", setting("lidar.engine")),
    output:
        out="results/{site}/placement/{plan}/obstacles.gpkg",
    params:
        settings=told(
            if_cells(cell_arguments, ""),
            plan=wildcard("plan"),
            sensors=CONFIG.sensors_file,
            zones=layered_site("placement.zones"),
            cabinets=layered_site("placement.cabinets"),
            mounting=mounting_rules,
            target_height_m=target_height,
            engine=setting("lidar.engine"),
        ),
        sensors=plan_costs,


use rule step_on_surfels as render_scans with:
    input:
        solution=rules.solve_cover.output.solution,
        surfels=seen_surfels,
        frame=rules.ingest_cloud.output.frame,
        tilts=only_if("mount_tilt", tilts_of_all_rounds),
        air=air_of_site,
        surfaces=placement_effect("reflectivity", "surfaces.parquet"),
        code=sources_with("render_scans", setting("lidar.engine")),
    output:
        out="results/{site}/placement/{plan}/scans.laz",
    params:
        settings=told(sensors=CONFIG.sensors_file, engine=setting("lidar.engine")),
        sensors=plan_costs,


use rule step_on_surfels as measure_data with:
    input:
        solution=rules.solve_cover.output.solution,
        targets=rules.place_targets.output.out,
        detections=plan_detections,
        edges=rules.build_edges.output.out,
        pavement=rules.extract_pavement.output.pavement,
        frame=rules.ingest_cloud.output.frame,
        scans=rules.render_scans.output.out,
        depth=plan_depth_maps,
        candidates=all_candidates,
        tilts=only_if("mount_tilt", tilts_of_all_rounds),
        air=air_of_site,
        reflectivity=placement_effect("reflectivity", "reflectivity.json"),
        decided=after_profile("partial_hits", "curvature_refraction"),
    output:
        out="results/{site}/placement/{plan}/data.json",
        layers="results/{site}/placement/{plan}/data.gpkg",
    params:
        settings=told(
            target_box,
            sensors=CONFIG.sensors_file,
            frames_hz=setting("lidar.frames_hz"),
            lidar_curve=setting("targets.lidar_curve"),
            camera_curve=setting("targets.camera_curve"),
            radius_m=setting("targets.radius_m"),
            height_m=target_height,
            azimuth_stride=setting("lidar.azimuth_stride"),
            partial_hits=decision_on("partial_hits"),
            curvature=decision_on("curvature_refraction"),
        ),
        sensors=plan_costs,


use rule step_on_surfels as measure_tolerance with:
    input:
        solution=rules.solve_cover.output.solution,
        targets=rules.place_targets.output.out,
        detections=plan_detections,
        surfels=seen_surfels,
        frame=rules.ingest_cloud.output.frame,
        tilts=only_if("mount_tilt", tilts_of_all_rounds),
        air=air_of_site,
        reflectivity=placement_effect("reflectivity", "reflectivity.json"),
        decided=after_profile("partial_hits", "curvature_refraction"),
        code=sources_with("measure_tolerance", setting("lidar.engine")),
    output:
        out="results/{site}/placement/{plan}/tolerance.json",
        layers="results/{site}/placement/{plan}/tolerance.gpkg",
    params:
        settings=told(
            change_arguments,
            sensors_file=CONFIG.sensors_file,
            partial_hits=decision_on("partial_hits"),
            curvature=decision_on("curvature_refraction"),
        ),
        sensors=site_sensors_seeing,


use rule step_on_surfels as try_removals with:
    input:
        solution=rules.solve_cover.output.solution,
        obstacles=rules.find_obstacles.output.out,
        objects=rules.gather_objects.output.members,
        targets=rules.place_targets.output.out,
        candidates=all_candidates,
        detections=plan_detections,
        surfels=seen_surfels,
        frame=rules.ingest_cloud.output.frame,
        tilts=only_if("mount_tilt", tilts_of_all_rounds),
        air=air_of_site,
        reflectivity=placement_effect("reflectivity", "reflectivity.json"),
        zones_files=beside_site("placement.zones"),
        cabinets_files=beside_site("placement.cabinets"),
        decided=after_profile("partial_hits", "curvature_refraction"),
        code=sources_with("try_removals", setting("lidar.engine")),
    output:
        out="results/{site}/placement/{plan}/removals.json",
    params:
        settings=told(
            change_arguments,
            costs=plan_costs,
            sensors_file=CONFIG.sensors_file,
            felled=setting("coverage.felled"),
            time_limit_s=setting("cover.time_limit_s"),
            zones=layered_site("placement.zones"),
            cabinets=layered_site("placement.cabinets"),
            mounting=mounting_rules,
            partial_hits=decision_on("partial_hits"),
            curvature=decision_on("curvature_refraction"),
        ),
