"""What the cloud shows beside the road: pole-like columns; trees and guardrails, where asked for.

REQUIRED INPUTS  results/{site}/scene/: cloud, frame, DEM
OUTPUTS          results/{site}/poles/: columns.parquet, objects.parquet
"""


use rule step as find_pole_columns with:
    input:
        cloud=rules.ingest_cloud.output.cloud,
        frame=rules.ingest_cloud.output.frame,
        dem=rules.build_dem.output.dem,
    output:
        out="results/{site}/poles/columns.parquet",
    resources:
        mem_mb=megabytes(60),
        runtime=minutes(),
    params:
        settings=told("columns"),


use rule step as find_roadside_objects with:
    input:
        cloud=rules.ingest_cloud.output.cloud,
        frame=rules.ingest_cloud.output.frame,
        dem=rules.build_dem.output.dem,
    output:
        out="results/{site}/poles/objects.parquet",
    resources:
        mem_mb=megabytes(60),
        runtime=minutes(),
    params:
        settings=told(flags("sightings", "kinds", "building_classes", "headwall_classes")),
