"""The cloud as surfels, without passing vehicles.

REQUIRED INPUTS  results/{site}/scene/: cloud, pavement, DEM
OUTPUTS          results/{site}/scene/: traffic, surfels
"""

from roadsight.base.sections.sensing import SurfelMaking


rule mark_traffic:
    input:
        cloud=rules.ingest_cloud.output.cloud,
        frame=rules.ingest_cloud.output.frame,
        dem=rules.build_dem.output.dem,
        pavement=rules.extract_pavement.output.pavement,
        code=sources("mark_traffic"),
    output:
        traffic="results/{site}/scene/traffic.parquet",
    log:
        log_of("mark_traffic"),
    benchmark:
        benchmark_of("mark_traffic")
    conda:
        ENVIRONMENT
    resources:
        mem_mb=megabytes(100),
        runtime=minutes(),
    params:
        clear_below_m=setting("lidar.clear_below_m"),
    shell:
        "python -m roadsight.stages.scene.mark_traffic --cloud {input.cloud} --frame {input.frame}"
        " --dem {input.dem} --pavement {input.pavement} --clear-below-m {params.clear_below_m}"
        " --out {output.traffic} > {log} 2>&1"


rule build_surfels:
    input:
        cloud=rules.ingest_cloud.output.cloud,
        traffic=traffic_mask,
        code=sources_with("build_surfels", setting("lidar.outlier_engine")),
    output:
        surfels="results/{site}/scene/surfels.parquet",
    log:
        log_of("build_surfels"),
    benchmark:
        benchmark_of("build_surfels")
    conda:
        ENVIRONMENT
    resources:
        mem_mb=megabytes(200),
        runtime=minutes(),
    params:
        options=some_flags("lidar", SurfelMaking),
    shell:
        "python -m roadsight.stages.scene.build_surfels --cloud {input.cloud}"
        " --traffic {input.traffic} {params.options} --out {output.surfels} > {log} 2>&1"
