"""Physical effects of the placement job; a rule runs only where its effect is simulated.

REQUIRED INPUTS  candidates, DEM, edges, pavement, cloud; conditions in the settings
OUTPUTS          results/{site}/placement/effects/: rain, fog, reflectivity, lanes
                 results/{site}/placement/round-*/tilts.parquet
"""

from roadsight.base.sections.placement import Traffic


rule tilt_mounts:
    input:
        candidates="results/{site}/placement/round-{round}/candidates.parquet",
        dem=rules.build_dem.output.dem,
        frame=rules.ingest_cloud.output.frame,
        code=sources("tilt_mounts"),
    output:
        tilts="results/{site}/placement/round-{round}/tilts.parquet",
    log:
        log_of("tilt_mounts", "round-{round}"),
    benchmark:
        benchmark_of("tilt_mounts", "round-{round}")
    conda:
        ENVIRONMENT
    params:
        mounting=setting("lidar.mounting"),
    shell:
        "python -m roadsight.stages.placement.tilt_mounts --candidates {input.candidates}"
        " --dem {input.dem} --frame {input.frame} --mounting {params.mounting}"
        " --out {output.tilts} > {log} 2>&1"


rule model_rain:
    input:
        code=sources("model_rain"),
    output:
        rain="results/{site}/placement/effects/rain.json",
    log:
        log_of("model_rain"),
    benchmark:
        benchmark_of("model_rain")
    conda:
        ENVIRONMENT
    params:
        rain_mm_h=setting("conditions.rain_mm_h"),
        sensors=optical_names,
    shell:
        "python -m roadsight.stages.placement.model_rain --rain-mm-h {params.rain_mm_h}"
        " --sensors {params.sensors} --out {output.rain} > {log} 2>&1"


rule model_fog:
    input:
        code=sources("model_fog"),
    output:
        fog="results/{site}/placement/effects/fog.json",
    log:
        log_of("model_fog"),
    benchmark:
        benchmark_of("model_fog")
    conda:
        ENVIRONMENT
    params:
        visibility_m=setting("conditions.visibility_m"),
        wavelengths_nm=sensor_wavelengths,
    shell:
        "python -m roadsight.stages.placement.model_fog --visibility-m {params.visibility_m}"
        " --wavelengths-nm {params.wavelengths_nm:q} --out {output.fog} > {log} 2>&1"


rule measure_reflectivity:
    input:
        cloud=rules.ingest_cloud.output.cloud,
        frame=rules.ingest_cloud.output.frame,
        pavement=rules.extract_pavement.output.pavement,
        code=sources("measure_reflectivity"),
    output:
        ranges="results/{site}/placement/effects/reflectivity.json",
        surfaces="results/{site}/placement/effects/surfaces.parquet",
    log:
        log_of("measure_reflectivity"),
    benchmark:
        benchmark_of("measure_reflectivity")
    conda:
        ENVIRONMENT
    resources:
        mem_mb=megabytes(60),
    params:
        sensors_file=CONFIG.sensors_file,
        definitions=site_sensors_seeing,
        sensors=sensor_names,
        target_reflectivity=setting("conditions.target_reflectivity"),
    shell:
        "python -m roadsight.stages.placement.measure_reflectivity --cloud {input.cloud}"
        " --frame {input.frame} --pavement {input.pavement} --sensors {params.sensors_file:q}"
        " --names {params.sensors} --target-reflectivity {params.target_reflectivity}"
        " --surfaces {output.surfaces} --out {output.ranges} > {log} 2>&1"


rule trace_lanes:
    input:
        edges=rules.build_edges.output.edges,
        pavement=rules.extract_pavement.output.pavement,
        dem=rules.build_dem.output.dem,
        frame=rules.ingest_cloud.output.frame,
        code=sources("trace_lanes"),
    output:
        lanes="results/{site}/placement/effects/lanes.parquet",
    log:
        log_of("trace_lanes"),
    benchmark:
        benchmark_of("trace_lanes")
    conda:
        ENVIRONMENT
    params:
        traffic=some_flags("conditions", Traffic),
    shell:
        "python -m roadsight.stages.placement.trace_lanes --site {wildcards.site} --edges {input.edges}"
        " --pavement {input.pavement} --dem {input.dem} --frame {input.frame}"
        " {params.traffic} --out {output.lanes} > {log} 2>&1"
