"""From a road to which sensor position sees which target."""

from roadsight.base.sections.sensing import CellFilling, TargetGrid
from roadsight.base.sections.placement import Traffic


use rule step as place_candidates with:
    input:
        edges=rules.build_edges.output.out,
        pavement=rules.extract_pavement.output.pavement,
        dem=rules.build_dem.output.dem,
        cloud=rules.ingest_cloud.output.cloud,
        frame=rules.ingest_cloud.output.frame,
        ground=rules.build_dem.output.ground,
        mounts_files=beside_site("placement.mounts"),
        decided=after_profile("overhead_cover"),
    output:
        out="results/{site}/placement/round-0/candidates.parquet",
        doubts="results/{site}/doubts/place_candidates.json",
    resources:
        **holding_cloud(60),
    params:
        settings=told(
            "candidates",
            site=wildcard("site"),
            mounts=layered_site("placement.mounts"),
            overhead_cover=decision_on("overhead_cover"),
        ),


use rule step as place_targets with:
    input:
        pavement=rules.extract_pavement.output.points,
        outline=rules.extract_pavement.output.pavement,
        frame=rules.ingest_cloud.output.frame,
        edges=edges_of_targets,
    output:
        out="results/{site}/placement/targets.parquet",
        unexamined="results/{site}/placement/unexamined.gpkg",
        doubts="results/{site}/doubts/place_targets.json",
    params:
        settings=told(flags("targets", TargetGrid), target_box, width_m=target_width),


use rule step_on_surfels as gather_objects with:
    input:
        surfels=rules.build_surfels.output.out,
        dem=rules.build_dem.output.dem,
        frame=rules.ingest_cloud.output.frame,
    output:
        objects="results/{site}/placement/objects.gpkg",
        members="results/{site}/placement/objects.parquet",
        left="results/{site}/placement/surfels_left.parquet",
    params:
        settings=told(site=wildcard("site"), remove=site_field("placement.remove")),


use rule step_on_surfels as render_depth_maps with:
    input:
        candidates="results/{site}/placement/round-{round}/candidates.parquet",
        surfels=seen_surfels,
        cloud=rules.ingest_cloud.output.cloud,
        targets=rules.place_targets.output.out,
        traffic=traffic_mask,
        network=depth_network,
        tilts=only_if("mount_tilt", of_map(TILTS_OF_ROUND, [])),
        decided=after_profile("hole_filling", "curvature_refraction"),
        code=sources_with("render_depth_maps", setting("lidar.engine")),
    output:
        out=non_empty("results/{site}/placement/round-{round}/depth/{sensor}/{shard}.parquet"),
    params:
        settings=told(
            flags("lidar", CellFilling),
            of_map("", "--panorama"),
            shard=wildcard("shard"),
            shards=lambda wildcards: shards_in(wildcards.site, int(wildcards.round)),
            sensor=wildcard("sensor"),
            sensors=CONFIG.sensors_file,
            model=lidar_model,
            engine=setting("lidar.engine"),
            azimuth_stride=of_map(setting("lidar.azimuth_stride"), 1),
            room_m=target_room,
            kept="results/{site}/placement/kept/round-{round}/depth/{sensor}/{shard}.parquet",
            curvature=decision_on("curvature_refraction"),
        ),
        sensor=of_map(sensor_definition, wildcard("sensor")),


use rule step as build_detection_shard with:
    input:
        depth=rules.render_depth_maps.output.out,
        candidates="results/{site}/placement/round-{round}/candidates.parquet",
        targets=rules.place_targets.output.out,
        tilts=only_if("mount_tilt", TILTS_OF_ROUND),
        air=air_of_site,
        reflectivity=placement_effect("reflectivity", "reflectivity.json"),
        lanes=placement_effect("moving_vehicles", "lanes.parquet"),
        decided=after_profile("partial_hits", "curvature_refraction"),
    output:
        out=non_empty("results/{site}/placement/round-{round}/detection/{sensor}/{shard}.parquet"),
    params:
        settings=told(
            target_box,
            sensor=wildcard("sensor"),
            sensors=CONFIG.sensors_file,
            radius_m=setting("targets.radius_m"),
            height_m=target_height,
            min_beams=of_site(min_beams_of),
            azimuth_stride=setting("lidar.azimuth_stride"),
            partial_hits=decision_on("partial_hits"),
            curvature=decision_on("curvature_refraction"),
            kept="results/{site}/placement/kept/round-{round}/detection/{sensor}/{shard}.parquet",
        ),
        sensor=sensor_definition,


use rule step as check_coverage with:
    input:
        targets=rules.place_targets.output.out,
        candidates=lambda wildcards: candidates_in(wildcards.site, range(int(wildcards.round) + 1)),
        detections=lambda wildcards: detections_in(
            wildcards.site, range(int(wildcards.round) + 1), sensors_of(wildcards.site)
        ),
        frame=rules.ingest_cloud.output.frame,
        zones_files=in_last_round(beside_site("placement.zones")),
        cabinets_files=in_last_round(beside_site("placement.cabinets")),
    output:
        out="results/{site}/placement/round-{round}/coverage.json",
    params:
        settings=told(
            zones=in_last_round(layered_site("placement.zones")),
            cabinets=in_last_round(layered_site("placement.cabinets")),
            mounting=in_last_round(mounting_rules, lambda wildcards: "{}"),
            plans=plan_sensors,
        ),


use rule step as densify_candidates with:
    input:
        coverage=lambda wildcards: (
            f"results/{wildcards.site}/placement/round-{int(wildcards.round) - 1}/coverage.json"
        ),
        targets=rules.place_targets.output.out,
        candidates=lambda wildcards: candidates_in(wildcards.site, range(int(wildcards.round))),
        edges=rules.build_edges.output.out,
        pavement=rules.extract_pavement.output.pavement,
        dem=rules.build_dem.output.dem,
        cloud=rules.ingest_cloud.output.cloud,
        frame=rules.ingest_cloud.output.frame,
        ground=rules.build_dem.output.ground,
        mounts_files=beside_site("placement.mounts"),
        decided=after_profile("overhead_cover"),
    output:
        out="results/{site}/placement/round-{round}/candidates.parquet",
    wildcard_constraints:
        round=r"[1-9]\d*",
    params:
        settings=told(
            "candidates",
            round=wildcard("round"),
            plans=plan_sensors,
            radius_m=setting("coverage.radius_m"),
            closest_m=setting("coverage.closest_m"),
            mounts=layered_site("placement.mounts"),
            overhead_cover=decision_on("overhead_cover"),
        ),


# Physical effects of the placement job; a rule runs only where its effect is simulated.
use rule step as tilt_mounts with:
    input:
        candidates="results/{site}/placement/round-{round}/candidates.parquet",
        dem=rules.build_dem.output.dem,
        frame=rules.ingest_cloud.output.frame,
    output:
        out=TILTS_OF_ROUND,
    params:
        settings=told(mounting=setting("lidar.mounting")),


use rule step as model_rain with:
    output:
        out="results/{site}/placement/effects/rain.json",
    params:
        settings=told(rain_mm_h=setting("conditions.rain_mm_h"), sensors=optical_names),


use rule step as model_fog with:
    output:
        out="results/{site}/placement/effects/fog.json",
    params:
        settings=told(
            visibility_m=setting("conditions.visibility_m"),
            wavelengths_nm=sensor_wavelengths,
        ),


use rule step as measure_reflectivity with:
    input:
        cloud=rules.ingest_cloud.output.cloud,
        frame=rules.ingest_cloud.output.frame,
        pavement=rules.extract_pavement.output.pavement,
    output:
        out="results/{site}/placement/effects/reflectivity.json",
        surfaces="results/{site}/placement/effects/surfaces.parquet",
    resources:
        mem_mb=megabytes(60),
    params:
        settings=told(
            sensors=CONFIG.sensors_file,
            names=of_site(sensors_of),
            target_reflectivity=setting("conditions.target_reflectivity"),
        ),
        definitions=site_sensors_seeing,


use rule step as trace_lanes with:
    input:
        edges=rules.build_edges.output.out,
        pavement=rules.extract_pavement.output.pavement,
        dem=rules.build_dem.output.dem,
        frame=rules.ingest_cloud.output.frame,
    output:
        out="results/{site}/placement/effects/lanes.parquet",
    params:
        settings=told(flags("conditions", Traffic), site=wildcard("site")),


# Sensors in poses: those with a limited field of view, and spinning ones that a site turns.
use rule step as detect_poses with:
    input:
        depth=panorama_of_shard,
        candidates="results/{site}/placement/round-{round}/candidates.parquet",
        targets=rules.place_targets.output.out,
        tilts=only_if("mount_tilt", TILTS_OF_ROUND),
        air=air_of_site,
        reflectivity=placement_effect("reflectivity", "reflectivity.json"),
        lanes=placement_effect("moving_vehicles", "lanes.parquet"),
        decided=after_profile("partial_hits", "curvature_refraction"),
    output:
        out=non_empty("results/{site}/placement/round-{round}/poses/{sensor}/{shard}.parquet"),
    params:
        settings=told(
            target_box,
            criteria_of_sensor,
            sensor=wildcard("sensor"),
            sensors=CONFIG.sensors_file,
            yaw_deg=pose_angles("yaw_deg"),
            pitch_deg=pose_angles("pitch_deg"),
            roll_deg=pose_angles("roll_deg"),
            radius_m=setting("targets.radius_m"),
            height_m=target_height,
            partial_hits=decision_on("partial_hits"),
            curvature=decision_on("curvature_refraction"),
        ),
        sensor=sensor_definition,


# Depth maps in pairs, to train a network on a site's own cloud; only where they are asked for.
use rule step_on_surfels as render_depth_pairs with:
    input:
        candidates="results/{site}/placement/round-0/candidates.parquet",
        cloud=rules.ingest_cloud.output.cloud,
        traffic=traffic_mask,
    output:
        out=non_empty("results/{site}/placement/pairs/{site}.hybrid.npz"),
    params:
        settings=told(seed=setting("seed")),
