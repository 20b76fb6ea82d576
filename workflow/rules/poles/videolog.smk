"""What the images of a videolog show, shard by shard.

REQUIRED INPUTS  the site's videolog, images and networks (or masks and depth), results/{site}/scene/*
OUTPUTS          results/{site}/poles/: frames, profile of the drive, masks, depth, image edges, pole axes,
                 matches
"""

from roadsight.base.sections.poles import PoleMasks


rule read_videolog:
    input:
        videolog=videolog_file,
        images=rendered_images,
        cloud=rules.ingest_cloud.output.cloud,
        frame=rules.ingest_cloud.output.frame,
        dem=rules.build_dem.output.dem,
        top=rules.rasterise_lidar.output.top,
        code=sources("read_videolog"),
    output:
        frames="results/{site}/poles/frames.parquet",
    log:
        log_of("read_videolog"),
    benchmark:
        benchmark_of("read_videolog")
    conda:
        ENVIRONMENT
    params:
        videolog=videolog_path,
        images=images_path,
        images_sha256=image_digest(),
        options=flags("videolog"),
    shell:
        "python -m roadsight.stages.poles.read_videolog --videolog {params.videolog:q}"
        " --images {params.images:q} --cloud {input.cloud} --frame {input.frame}"
        " --dem {input.dem} --top {input.top} {params.options} --out {output.frames} > {log} 2>&1"


checkpoint profile_drive:
    input:
        frames=rules.read_videolog.output.frames,
        images=rendered_images,
        dem=rules.build_dem.output.dem,
        frame=rules.ingest_cloud.output.frame,
        code=sources("profile_drive"),
    output:
        drive="results/{site}/poles/drive.json",
        doubts="results/{site}/doubts/profile_drive.json",
    log:
        log_of("profile_drive"),
    benchmark:
        benchmark_of("profile_drive")
    conda:
        ENVIRONMENT
    params:
        images=images_path,
        images_sha256=image_digest(),
    shell:
        "python -m roadsight.stages.poles.profile_drive --frames {input.frames} --dem {input.dem}"
        " --frame {input.frame} --images {params.images:q} --doubts {output.doubts}"
        " --out {output.drive} > {log} 2>&1"


rule segment_images:
    input:
        frames=rules.read_videolog.output.frames,
        images=rendered_images,
        models=mask_models,
        decided=after_profile("side_views"),
        code=sources("segment_images"),
    output:
        masks=ensure("results/{site}/poles/masks/{shard}.zip", non_empty=True),
    log:
        log_of("segment_images", "{shard}"),
    benchmark:
        benchmark_of("segment_images", "{shard}")
    conda:
        ENVIRONMENT
    resources:
        mem_mb=each_attempt(2000),
    params:
        images=images_path,
        images_sha256=image_digest("masks"),
        models_sha256=models_digest(mask_models),
        masks=mask_options,
        views=used_views,
        shards=setting("shards"),
        options=flags("networks"),
    shell:
        "python -m roadsight.stages.poles.segment_images --frames {input.frames}"
        " --images {params.images:q} {params.masks} --views {params.views} {params.options}"
        " --shard {wildcards.shard} --shards {params.shards} --out {output.masks} > {log} 2>&1"


rule estimate_depth:
    input:
        frames=rules.read_videolog.output.frames,
        images=rendered_images,
        models=depth_models,
        decided=after_profile("side_views"),
        code=sources("estimate_depth"),
    output:
        depth=ensure("results/{site}/poles/depth/{shard}.zip", non_empty=True),
    log:
        log_of("estimate_depth", "{shard}"),
    benchmark:
        benchmark_of("estimate_depth", "{shard}")
    conda:
        ENVIRONMENT
    resources:
        mem_mb=each_attempt(2000),
    params:
        images=images_path,
        images_sha256=image_digest("depth"),
        models_sha256=models_digest(depth_models),
        source=depth_source,
        kind=depth_kind,
        views=used_views,
        shards=setting("shards"),
        options=flags("networks"),
    shell:
        "python -m roadsight.stages.poles.estimate_depth --frames {input.frames}"
        " --images {params.images:q} --source {params.source:q} --folder-kind {params.kind}"
        " --views {params.views} {params.options} --shard {wildcards.shard}"
        " --shards {params.shards} --out {output.depth} > {log} 2>&1"


rule undistort_views:
    input:
        frames=rules.read_videolog.output.frames,
        images=rendered_images,
        drive=rules.profile_drive.output.drive,
        maps="results/{site}/poles/{kind}/{shard}.zip",
        decided=after_profile("side_views"),
        code=sources("undistort_views"),
    output:
        maps=ensure("results/{site}/poles/straight/{kind}/{shard}.zip", non_empty=True),
    log:
        log_of("undistort_views", "{kind}", "{shard}"),
    benchmark:
        benchmark_of("undistort_views", "{kind}", "{shard}")
    wildcard_constraints:
        kind="masks|depth",
    conda:
        ENVIRONMENT
    params:
        images=images_path,
        lenses=given_lenses,
        views=used_views,
        shards=setting("shards"),
    shell:
        "python -m roadsight.stages.poles.undistort_views --frames {input.frames}"
        " --images {params.images:q} --drive {input.drive} --lenses {params.lenses:q}"
        " --maps {input.maps} --views {params.views} --shard {wildcards.shard}"
        " --shards {params.shards} --out {output.maps} > {log} 2>&1"


rule trace_image_edges:
    input:
        frames=rules.read_videolog.output.frames,
        masks=without_distortion("masks"),
        code=sources("trace_image_edges"),
    output:
        edges=ensure("results/{site}/poles/image_edges/{shard}.parquet", non_empty=True),
    log:
        log_of("trace_image_edges", "{shard}"),
    benchmark:
        benchmark_of("trace_image_edges", "{shard}")
    conda:
        ENVIRONMENT
    params:
        shards=setting("shards"),
        options=flags("image_edges"),
    shell:
        "python -m roadsight.stages.poles.trace_image_edges --frames {input.frames}"
        " --masks {input.masks} {params.options} --shard {wildcards.shard}"
        " --shards {params.shards} --out {output.edges} > {log} 2>&1"


rule trace_pole_axes:
    input:
        frames=rules.read_videolog.output.frames,
        masks=without_distortion("masks"),
        decided=after_profile("side_views"),
        code=sources("trace_pole_axes"),
    output:
        axes=ensure("results/{site}/poles/pole_axes/{shard}.parquet", non_empty=True),
    log:
        log_of("trace_pole_axes", "{shard}"),
    benchmark:
        benchmark_of("trace_pole_axes", "{shard}")
    conda:
        ENVIRONMENT
    params:
        shards=setting("shards"),
        views=used_views,
        options=some_flags("sightings", PoleMasks),
    shell:
        "python -m roadsight.stages.poles.trace_pole_axes --frames {input.frames} --masks {input.masks}"
        " --views {params.views} {params.options} --shard {wildcards.shard}"
        " --shards {params.shards}"
        " --out {output.axes} > {log} 2>&1"


rule match_images:
    input:
        frames=rules.read_videolog.output.frames,
        images=rendered_images,
        drive=distorting_drive,
        code=sources("match_images"),
    output:
        matches=ensure("results/{site}/poles/matches/{shard}.parquet", non_empty=True),
    log:
        log_of("match_images", "{shard}"),
    benchmark:
        benchmark_of("match_images", "{shard}")
    conda:
        ENVIRONMENT
    params:
        images=images_path,
        images_sha256=image_digest(),
        lenses=given_lenses,
        shards=setting("shards"),
    shell:
        "python -m roadsight.stages.poles.match_images --frames {input.frames}"
        " --images {params.images:q} --drive {input.drive} --lenses {params.lenses:q}"
        " --shard {wildcards.shard} --shards {params.shards} --out {output.matches} > {log} 2>&1"
