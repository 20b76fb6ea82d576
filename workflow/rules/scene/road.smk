"""The road as the cloud shows it from above, for the pole job.

REQUIRED INPUTS  results/{site}/scene/*
OUTPUTS          results/{site}/poles/: voxels, top view, road edges, terrain
"""

from roadsight.base.sections.poles import RoadClasses


use rule step as rasterise_lidar with:
    input:
        cloud=rules.ingest_cloud.output.cloud,
        frame=rules.ingest_cloud.output.frame,
        dem=rules.build_dem.output.dem,
        pavement=if_unclassed(rules.extract_pavement.output.pavement),
    output:
        voxels="results/{site}/poles/voxels.parquet",
        top="results/{site}/poles/top.tif",
    threads: 2
    resources:
        mem_mb=megabytes(10),
        runtime=minutes(),
    params:
        command=command_with("threads"),
        settings=told("voxels", road_source=road_source),


use rule step as extract_road_edges with:
    input:
        top=rules.rasterise_lidar.output.top,
        frame=rules.ingest_cloud.output.frame,
        cloud=if_curbs([rules.ingest_cloud.output.cloud]),
        frames=if_curbs(["results/{site}/poles/frames.parquet"]),
    output:
        edges="results/{site}/poles/road_edges.parquet",
        lines="results/{site}/poles/road_edges.gpkg",
    params:
        settings=told("road_edges"),


use rule step as build_terrain with:
    input:
        cloud=rules.ingest_cloud.output.cloud,
        ground=if_unclassed(rules.build_dem.output.ground),
    output:
        out="results/{site}/poles/terrain.npz",
    resources:
        mem_mb=megabytes(60),
        runtime=minutes(),
    params:
        settings=told(flags("voxels", RoadClasses), "terrain_mesh"),
