"""From a cloud to its road: ingest, ground and DEM, pavement, edges.

REQUIRED INPUTS  the site's LAS/LAZ files, or nothing where the site generates its sample
OUTPUTS          results/{site}/scene/: cloud, frame, profile, DEM, ground, pavement
                 results/{site}/placement/edges.gpkg
"""

from roadsight.base.sections.scene import GroundClasses, PavementOutline


rule ingest_cloud:
    input:
        clouds=cloud_files,
        extent=extent_files,
        code=sources("ingest_cloud"),
    output:
        cloud="results/{site}/scene/cloud.parquet",
        frame="results/{site}/scene/frame.json",
    log:
        log_of("ingest_cloud"),
    benchmark:
        benchmark_of("ingest_cloud")
    conda:
        ENVIRONMENT
    threads: 2
    resources:
        mem_mb=each_attempt(1000),
    params:
        sha256=cloud_checksums,
        crs=lambda wildcards: SITES[wildcards.site].site.crs or "auto",
        units=site_field("units"),
        vertical_units=site_field("vertical_units"),
        target_crs=site_field("target_crs"),
        extent=site_extent,
        extent_files=layered_extent_files,
        extent_crs=extent_crs,
        options=flags("scene"),
    shell:
        "RAYON_NUM_THREADS={threads} python -m roadsight.stages.scene.ingest_cloud --site {wildcards.site}"
        " --crs={params.crs:q} --units {params.units} --vertical-units {params.vertical_units}"
        " --target-crs={params.target_crs:q} --extent={params.extent:q} --extent-files {params.extent_files:q}"
        " --extent-crs={params.extent_crs:q} {params.options} --cloud {output.cloud} --frame {output.frame} {input.clouds:q} > {log} 2>&1"


checkpoint profile_scene:
    input:
        cloud=rules.ingest_cloud.output.cloud,
        frame=rules.ingest_cloud.output.frame,
        code=sources("profile_scene"),
    output:
        profile="results/{site}/scene/profile.json",
    log:
        log_of("profile_scene"),
    benchmark:
        benchmark_of("profile_scene")
    conda:
        ENVIRONMENT
    resources:
        mem_mb=megabytes(100),
        runtime=minutes(),
    shell:
        "python -m roadsight.stages.scene.profile_scene --cloud {input.cloud} --frame {input.frame}"
        " --out {output.profile} > {log} 2>&1"


rule build_dem:
    input:
        cloud=rules.ingest_cloud.output.cloud,
        frame=rules.ingest_cloud.output.frame,
        profile=rules.profile_scene.output.profile,
        code=sources("build_dem"),
    output:
        dem="results/{site}/scene/dem.tif",
        ground="results/{site}/scene/ground.parquet",
        doubts="results/{site}/doubts/build_dem.json",
    log:
        log_of("build_dem"),
    benchmark:
        benchmark_of("build_dem")
    conda:
        ENVIRONMENT
    resources:
        mem_mb=megabytes(60),
        runtime=minutes(),
    params:
        options=flags("ground"),
    shell:
        "python -m roadsight.stages.scene.build_dem --site {wildcards.site}"
        " --cloud {input.cloud} --frame {input.frame} --profile {input.profile}"
        " {params.options}"
        " --dem {output.dem} --ground {output.ground} --doubts {output.doubts} > {log} 2>&1"


rule cluster_fpfh:
    input:
        cloud=rules.ingest_cloud.output.cloud,
        ground=rules.build_dem.output.ground,
        profile=rules.profile_scene.output.profile,
        code=sources_with("cluster_fpfh", setting("pavement.fpfh_engine")),
    output:
        clusters="results/{site}/scene/fpfh_clusters.parquet",
    log:
        log_of("cluster_fpfh"),
    benchmark:
        benchmark_of("cluster_fpfh")
    conda:
        ENVIRONMENT
    resources:
        mem_mb=megabytes(150),
        runtime=minutes(),
    params:
        options=some_flags("pavement", GroundClasses),
        seed=setting("seed"),
    shell:
        "python -m roadsight.stages.scene.cluster_fpfh"
        " --cloud {input.cloud} --ground {input.ground} --profile {input.profile}"
        " {params.options} --seed {params.seed} --out {output.clusters} > {log} 2>&1"


rule extract_pavement:
    input:
        cloud=rules.ingest_cloud.output.cloud,
        frame=rules.ingest_cloud.output.frame,
        ground=rules.build_dem.output.ground,
        profile=profile_for_pavement,
        clusters=of_pavement("published", rules.cluster_fpfh.output.clusters),
        edges=of_pavement("surface", edges_file),
        track=of_pavement("surface", beside_site("placement.track")),
        tma=beside_site("placement.tma"),
        code=sources_with("extract_pavement", setting("pavement.cluster_engine")),
    output:
        pavement="results/{site}/scene/pavement.gpkg",
        points="results/{site}/scene/pavement.parquet",
        doubts="results/{site}/doubts/extract_pavement.json",
    log:
        log_of("extract_pavement"),
    benchmark:
        benchmark_of("extract_pavement")
    conda:
        ENVIRONMENT
    resources:
        mem_mb=memory_of_pavement,
        runtime=minutes(),
    params:
        tma=layered_site("placement.tma"),
        options=some_flags("pavement", "method", "intensity"),
        seeds=setting_of_pavement("surface", pavement_seeds),
        edges=setting_of_pavement(
            "surface", layered_site("placement.edges", edges_file)
        ),
        edges_crs=setting_of_pavement("surface", site_field("placement.edges_crs")),
        track=setting_of_pavement("surface", layered_site("placement.track")),
        track_crs=setting_of_pavement("surface", site_field("placement.track_crs")),
        outline=setting_of_pavement(
            "published", some_flags("pavement", "cluster_engine", PavementOutline)
        ),
    shell:
        "python -m roadsight.stages.scene.extract_pavement --site {wildcards.site}"
        " --cloud {input.cloud} --frame {input.frame} --ground {input.ground}"
        " --profile {input.profile} --clusters {input.clusters} --tma {params.tma:q}"
        " {params.options} --seeds={params.seeds:q}"
        " --edges {params.edges:q} --edges-crs={params.edges_crs:q}"
        " --track {params.track:q} --track-crs={params.track_crs:q}"
        " {params.outline} --pavement {output.pavement} --points {output.points}"
        " --doubts {output.doubts} > {log} 2>&1"


rule build_edges:
    input:
        frame=rules.ingest_cloud.output.frame,
        pavement=rules.extract_pavement.output.pavement,
        dem=rules.build_dem.output.dem,
        edges=edges_file,
        code=sources("build_edges"),
    output:
        edges="results/{site}/placement/edges.gpkg",
    log:
        log_of("build_edges"),
    benchmark:
        benchmark_of("build_edges")
    conda:
        ENVIRONMENT
    params:
        edges=layered_site("placement.edges", edges_file),
        edges_crs=site_field("placement.edges_crs"),
        options=flags("edges"),
    shell:
        "python -m roadsight.stages.scene.build_edges --site {wildcards.site} --frame {input.frame}"
        " --pavement {input.pavement} --dem {input.dem}"
        " --digitised {params.edges:q} --digitised-crs={params.edges_crs:q}"
        " {params.options} --out {output.edges} > {log} 2>&1"


rule score_pavement:
    input:
        cloud=rules.ingest_cloud.output.cloud,
        frame=rules.ingest_cloud.output.frame,
        ground=rules.build_dem.output.ground,
        pavement=rules.extract_pavement.output.pavement,
        truth=pavement_truth,
        code=sources("score_pavement"),
    output:
        scores="results/{site}/scene/pavement_scores.json",
    log:
        log_of("score_pavement"),
    benchmark:
        benchmark_of("score_pavement")
    conda:
        ENVIRONMENT
    params:
        truth=layered_site("truth.pavement", pavement_truth),
        truth_crs=site_field("truth.pavement_crs"),
        reach_m=site_field("truth.reach_m"),
        truth_layer=lambda wildcards: (
            "pavement" if SITES[wildcards.site].site.sample else ""
        ),
    shell:
        "python -m roadsight.stages.scene.score_pavement --cloud {input.cloud} --frame {input.frame}"
        " --ground {input.ground} --pavement {input.pavement}"
        " --truth {params.truth:q} --truth-crs={params.truth_crs:q}"
        " --truth-layer {params.truth_layer} --reach-m {params.reach_m}"
        " --out {output.scores} > {log} 2>&1"
