"""The cloud as surfels, without passing vehicles.

REQUIRED INPUTS  results/{site}/scene/: cloud, pavement, DEM
OUTPUTS          results/{site}/scene/: traffic, surfels
"""

from roadsight.base.sections.sensing import SurfelMaking


use rule step as mark_traffic with:
    input:
        cloud=rules.ingest_cloud.output.cloud,
        frame=rules.ingest_cloud.output.frame,
        dem=rules.build_dem.output.dem,
        pavement=rules.extract_pavement.output.pavement,
    output:
        out="results/{site}/scene/traffic.parquet",
    resources:
        mem_mb=megabytes(100),
        runtime=minutes(),
    params:
        settings=told(clear_below_m=setting("lidar.clear_below_m")),


use rule step as build_surfels with:
    input:
        cloud=rules.ingest_cloud.output.cloud,
        traffic=traffic_mask,
        code=sources_with("build_surfels", setting("lidar.outlier_engine")),
    output:
        out="results/{site}/scene/surfels.parquet",
    resources:
        mem_mb=megabytes(200),
        runtime=minutes(),
    params:
        settings=told(flags("lidar", SurfelMaking)),
