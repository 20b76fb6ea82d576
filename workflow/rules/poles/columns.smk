"""What the cloud shows beside the road: pole-like columns; trees and guardrails, where asked for.

REQUIRED INPUTS  results/{site}/scene/: cloud, frame, DEM
OUTPUTS          results/{site}/poles/: columns.parquet, objects.parquet
"""


rule find_pole_columns:
    input:
        cloud=rules.ingest_cloud.output.cloud,
        frame=rules.ingest_cloud.output.frame,
        dem=rules.build_dem.output.dem,
        code=sources("find_pole_columns"),
    output:
        columns="results/{site}/poles/columns.parquet",
    log:
        log_of("find_pole_columns"),
    benchmark:
        benchmark_of("find_pole_columns")
    conda:
        ENVIRONMENT
    resources:
        mem_mb=megabytes(60),
        runtime=minutes(),
    params:
        options=flags("columns"),
    shell:
        "python -m roadsight.stages.poles.find_pole_columns --cloud {input.cloud} --frame {input.frame}"
        " --dem {input.dem} {params.options} --out {output.columns} > {log} 2>&1"


rule find_roadside_objects:
    input:
        cloud=rules.ingest_cloud.output.cloud,
        frame=rules.ingest_cloud.output.frame,
        dem=rules.build_dem.output.dem,
        code=sources("find_roadside_objects"),
    output:
        objects="results/{site}/poles/objects.parquet",
    log:
        log_of("find_roadside_objects"),
    benchmark:
        benchmark_of("find_roadside_objects")
    conda:
        ENVIRONMENT
    resources:
        mem_mb=megabytes(60),
        runtime=minutes(),
    params:
        options=some_flags("sightings", "kinds", "building_classes", "headwall_classes"),
    shell:
        "python -m roadsight.stages.poles.find_roadside_objects --cloud {input.cloud} --frame {input.frame}"
        " --dem {input.dem} {params.options} --out {output.objects} > {log} 2>&1"
