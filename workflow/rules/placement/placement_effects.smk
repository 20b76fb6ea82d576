"""Physical effects of the placement job; a rule runs only where its effect is simulated.

REQUIRED INPUTS  candidates, DEM, edges, pavement, cloud; conditions in the settings
OUTPUTS          results/{site}/placement/effects/: rain, fog, reflectivity, lanes
                 results/{site}/placement/round-*/tilts.parquet
"""

from roadsight.base.sections.placement import Traffic


use rule step as tilt_mounts with:
    input:
        candidates="results/{site}/placement/round-{round}/candidates.parquet",
        dem=rules.build_dem.output.dem,
        frame=rules.ingest_cloud.output.frame,
        code=sources("tilt_mounts"),
    output:
        out="results/{site}/placement/round-{round}/tilts.parquet",
    log:
        log_of("tilt_mounts", "round-{round}"),
    benchmark:
        benchmark_of("tilt_mounts", "round-{round}")
    params:
        settings=told(mounting=setting("lidar.mounting")),


use rule step as model_rain with:
    input:
        code=sources("model_rain"),
    output:
        out="results/{site}/placement/effects/rain.json",
    log:
        log_of("model_rain"),
    benchmark:
        benchmark_of("model_rain")
    params:
        settings=told(rain_mm_h=setting("conditions.rain_mm_h"), sensors=optical_names),


use rule step as model_fog with:
    input:
        code=sources("model_fog"),
    output:
        out="results/{site}/placement/effects/fog.json",
    log:
        log_of("model_fog"),
    benchmark:
        benchmark_of("model_fog")
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
        code=sources("measure_reflectivity"),
    output:
        out="results/{site}/placement/effects/reflectivity.json",
        surfaces="results/{site}/placement/effects/surfaces.parquet",
    log:
        log_of("measure_reflectivity"),
    benchmark:
        benchmark_of("measure_reflectivity")
    resources:
        mem_mb=megabytes(60),
    params:
        settings=told(
            sensors=CONFIG.sensors_file,
            names=sensor_names,
            target_reflectivity=setting("conditions.target_reflectivity"),
        ),
        definitions=site_sensors_seeing,


use rule step as trace_lanes with:
    input:
        edges=rules.build_edges.output.out,
        pavement=rules.extract_pavement.output.pavement,
        dem=rules.build_dem.output.dem,
        frame=rules.ingest_cloud.output.frame,
        code=sources("trace_lanes"),
    output:
        out="results/{site}/placement/effects/lanes.parquet",
    log:
        log_of("trace_lanes"),
    benchmark:
        benchmark_of("trace_lanes")
    params:
        settings=told(flags("conditions", Traffic), site=wildcard("site")),
