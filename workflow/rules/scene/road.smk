"""The road as the cloud shows it from above, for the pole job.

REQUIRED INPUTS  results/{site}/scene/*
OUTPUTS          results/{site}/poles/: voxels, top view, road edges, terrain
"""

from roadsight.base.sections.poles import RoadClasses


rule rasterise_lidar:
    input:
        cloud=rules.ingest_cloud.output.cloud,
        frame=rules.ingest_cloud.output.frame,
        dem=rules.build_dem.output.dem,
        pavement=pavement_for_roads,
        code=sources("rasterise_lidar"),
    output:
        voxels="results/{site}/poles/voxels.parquet",
        top="results/{site}/poles/top.tif",
    log:
        log_of("rasterise_lidar"),
    benchmark:
        benchmark_of("rasterise_lidar")
    conda:
        ENVIRONMENT
    threads: 2
    resources:
        mem_mb=megabytes(10),
        runtime=minutes(),
    params:
        road_source=road_source,
        options=flags("voxels"),
    shell:
        "python -m roadsight.stages.scene.rasterise_lidar --cloud {input.cloud}"
        " --frame {input.frame} --dem {input.dem} --pavement {input.pavement}"
        " --road-source {params.road_source} {params.options} --voxels {output.voxels}"
        " --top {output.top} --threads {threads} > {log} 2>&1"


rule extract_road_edges:
    input:
        top=rules.rasterise_lidar.output.top,
        frame=rules.ingest_cloud.output.frame,
        cloud=cloud_for_curbs,
        frames=track_for_curbs,
        code=sources("extract_road_edges"),
    output:
        edges="results/{site}/poles/road_edges.parquet",
        lines="results/{site}/poles/road_edges.gpkg",
    log:
        log_of("extract_road_edges"),
    benchmark:
        benchmark_of("extract_road_edges")
    conda:
        ENVIRONMENT
    params:
        options=flags("road_edges"),
    shell:
        "python -m roadsight.stages.scene.extract_road_edges --top {input.top}"
        " --frame {input.frame} --cloud {input.cloud} --frames {input.frames}"
        " {params.options} --edges {output.edges}"
        " --lines {output.lines} > {log} 2>&1"


rule build_terrain:
    input:
        cloud=rules.ingest_cloud.output.cloud,
        ground=ground_for_terrain,
        code=sources("build_terrain"),
    output:
        terrain="results/{site}/poles/terrain.npz",
    log:
        log_of("build_terrain"),
    benchmark:
        benchmark_of("build_terrain")
    conda:
        ENVIRONMENT
    resources:
        mem_mb=megabytes(60),
        runtime=minutes(),
    params:
        classes=some_flags("voxels", RoadClasses),
        mesh=flags("terrain_mesh"),
    shell:
        "python -m roadsight.stages.scene.build_terrain --cloud {input.cloud}"
        " --ground {input.ground} {params.classes} {params.mesh}"
        " --out {output.terrain} > {log} 2>&1"
