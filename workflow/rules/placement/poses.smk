"""Sensors in poses: those with a limited field of view, and spinning ones that a site turns.

REQUIRED INPUTS  candidates, targets and panoramas (depth maps that look everywhere) of a round
OUTPUTS          results/{site}/placement/round-*/poses/: detections of each pose worth keeping
"""


rule detect_poses:
    input:
        depth=panorama_of_shard,
        candidates="results/{site}/placement/round-{round}/candidates.parquet",
        targets=rules.place_targets.output.targets,
        tilts=only_if("mount_tilt", tilts_of_round),
        rain=placement_effect("rain", "rain.json"),
        fog=placement_effect("fog", "fog.json"),
        reflectivity=placement_effect("reflectivity", "reflectivity.json"),
        lanes=placement_effect("moving_vehicles", "lanes.parquet"),
        decided=after_profile("partial_hits", "curvature_refraction"),
        code=sources("detect_poses"),
    output:
        detection=ensure(
            "results/{site}/placement/round-{round}/poses/{sensor}/{shard}.parquet",
            non_empty=True,
        ),
    log:
        log_of("detect_poses", "round-{round}", "{sensor}", "{shard}"),
    benchmark:
        benchmark_of("detect_poses", "round-{round}", "{sensor}", "{shard}")
    conda:
        ENVIRONMENT
    params:
        sensor=sensor_definition,
        sensors_file=CONFIG.sensors_file,
        yaw_deg=pose_angles("yaw_deg"),
        pitch_deg=pose_angles("pitch_deg"),
        roll_deg=pose_angles("roll_deg"),
        radius_m=setting("targets.radius_m"),
        height_m=target_height,
        box=target_box,
        criteria=criteria_of_sensor,
        partial_hits=decision_on("partial_hits"),
        curvature=decision_on("curvature_refraction"),
    shell:
        "python -m roadsight.stages.placement.detect_poses --depth {input.depth}"
        " --candidates {input.candidates} --targets {input.targets}"
        " --sensor {wildcards.sensor} --sensors {params.sensors_file:q}"
        " --yaw-deg {params.yaw_deg} --pitch-deg {params.pitch_deg}"
        " --roll-deg {params.roll_deg} --radius-m {params.radius_m}"
        " --height-m {params.height_m} {params.box} {params.criteria}"
        " --tilts {input.tilts} --air {input.rain} {input.fog}"
        " --reflectivity {input.reflectivity} --lanes {input.lanes}"
        " --partial-hits {params.partial_hits} --curvature {params.curvature}"
        " --out {output.detection} > {log} 2>&1"
