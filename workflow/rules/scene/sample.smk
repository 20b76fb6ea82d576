"""Sites that the workflow generates itself, with their exact truth.

OUTPUTS          results/{site}/sample/: cloud, truth, edges; or cloud, truth, videolog with images
"""


rule generate_sample:
    input:
        code=sources("generate_sample"),
    output:
        cloud="results/{site}/sample/cloud.laz",
        truth="results/{site}/sample/truth.gpkg",
        edges="results/{site}/sample/edges.geojson",
    log:
        log_of("generate_sample"),
    benchmark:
        benchmark_of("generate_sample")
    wildcard_constraints:
        site=sites_with_scene("highway"),
    conda:
        ENVIRONMENT
    resources:
        mem_mb=each_attempt(2000),
    params:
        scene=site_field("sample.scene"),
        points=site_field("sample.points"),
        length_m=site_field("sample.length_m"),
        radius_m=site_field("sample.radius_m"),
        grade=site_field("sample.grade"),
        tunnel=lambda wildcards: (
            "yes" if SITES[wildcards.site].site.sample.tunnel else "no"
        ),
        overhead=lambda wildcards: NamedValue(
            "sample.overhead",
            "yes" if SITES[wildcards.site].site.sample.overhead else "no",
        ),
        class_scheme=site_field("sample.class_scheme"),
        seed=setting("seed"),
    shell:
        "python -m roadsight.stages.scene.generate_sample --scene {params.scene} --seed {params.seed}"
        " --points {params.points} --length-m {params.length_m} --radius-m {params.radius_m}"
        " --grade {params.grade} --tunnel {params.tunnel} --overhead {params.overhead}"
        " --class-scheme {params.class_scheme}"
        " --cloud {output.cloud} --truth {output.truth} --edges {output.edges} > {log} 2>&1"


rule generate_rural:
    input:
        code=sources("generate_rural"),
    output:
        cloud="results/{site}/sample/cloud.laz",
        truth="results/{site}/sample/truth.gpkg",
        poles="results/{site}/sample/truth_poles.csv",
        cameras="results/{site}/sample/truth_cameras.csv",
        videolog="results/{site}/sample/videolog.csv",
    log:
        log_of("generate_rural"),
    benchmark:
        benchmark_of("generate_rural")
    wildcard_constraints:
        site=sites_with_scene("rural"),
    conda:
        ENVIRONMENT
    resources:
        mem_mb=each_attempt(2000),
    params:
        pulses_per_m2=site_field("sample.pulses_per_m2"),
        length_m=site_field("sample.length_m"),
        scene=rural_options,
        survey=rural_survey,
        seed=setting("seed"),
    shell:
        "python -m roadsight.stages.scene.generate_rural --seed {params.seed}"
        " --length-m {params.length_m} --pulses-per-m2 {params.pulses_per_m2} {params.scene} {params.survey}"
        " --cloud {output.cloud} --truth {output.truth} --poles {output.poles}"
        " --cameras {output.cameras} --videolog {output.videolog} > {log} 2>&1"


rule render_videolog:
    input:
        code=sources("render_videolog"),
    output:
        images=ensure("results/{site}/sample/images/{shard}.zip", non_empty=True),
    log:
        log_of("render_videolog", "{shard}"),
    benchmark:
        benchmark_of("render_videolog", "{shard}")
    wildcard_constraints:
        site=sites_with_scene("rural"),
    conda:
        ENVIRONMENT
    resources:
        mem_mb=each_attempt(2000),
    params:
        length_m=site_field("sample.length_m"),
        scene=rural_options,
        lens=rural_lens,
        seed=setting("seed"),
        shards=setting("shards"),
    shell:
        "python -m roadsight.stages.scene.render_videolog --seed {params.seed}"
        " --length-m {params.length_m} {params.scene} {params.lens} --shard {wildcards.shard} --shards {params.shards}"
        " --images {output.images} > {log} 2>&1"
