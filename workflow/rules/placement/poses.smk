"""Sensors in poses: those with a limited field of view, and spinning ones that a site turns.

REQUIRED INPUTS  candidates, targets and panoramas (depth maps that look everywhere) of a round
OUTPUTS          results/{site}/placement/round-*/poses/: detections of each pose worth keeping
"""


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
        out=ensure(
            "results/{site}/placement/round-{round}/poses/{sensor}/{shard}.parquet",
            non_empty=True,
        ),
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
