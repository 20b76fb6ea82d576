"""What the images of a videolog show, shard by shard."""

from roadsight.base.sections.poles import PoleMasks


use rule step as read_videolog with:
    input:
        videolog_files=videolog_file,
        images_files=rendered_images,
        cloud=rules.ingest_cloud.output.cloud,
        frame=rules.ingest_cloud.output.frame,
        dem=rules.build_dem.output.dem,
        top=rules.rasterise_lidar.output.top,
    output:
        out="results/{site}/poles/frames.parquet",
    params:
        settings=told("videolog", videolog=videolog_path, images=images_path),
        images_sha256=image_digest(),


checkpoint profile_drive:
    input:
        frames=rules.read_videolog.output.out,
        images_files=rendered_images,
        dem=rules.build_dem.output.dem,
        frame=rules.ingest_cloud.output.frame,
    output:
        out="results/{site}/poles/drive.json",
        doubts="results/{site}/doubts/profile_drive.json",
    conda:
        ENVIRONMENT
    params:
        command=command,
        settings=told(images=images_path),
        images_sha256=image_digest(),
    shell:
        STEP


use rule step as segment_images with:
    input:
        frames=rules.read_videolog.output.out,
        images_files=rendered_images,
        models_files=mask_models,
        decided=after_profile("side_views"),
    output:
        out=non_empty("results/{site}/poles/masks/{shard}.zip"),
    resources:
        mem_mb=each_attempt(2000),
    params:
        settings=told(mask_options, "networks", images=images_path, views=used_views, **ONE_SHARD),
        images_sha256=image_digest("masks"),
        models_sha256=models_digest(mask_models),


use rule segment_images as estimate_depth with:
    input:
        frames=rules.read_videolog.output.out,
        images_files=rendered_images,
        models_files=depth_models,
        decided=after_profile("side_views"),
    output:
        out=non_empty("results/{site}/poles/depth/{shard}.zip"),
    params:
        settings=told(
            "networks",
            images=images_path,
            source=depth_source,
            folder_kind=depth_kind,
            views=used_views,
            **ONE_SHARD,
        ),
        images_sha256=image_digest("depth"),
        models_sha256=models_digest(depth_models),


use rule step as undistort_views with:
    input:
        frames=rules.read_videolog.output.out,
        images_files=rendered_images,
        drive=rules.profile_drive.output.out,
        maps="results/{site}/poles/{kind}/{shard}.zip",
        decided=after_profile("side_views"),
    output:
        out=non_empty("results/{site}/poles/straight/{kind}/{shard}.zip"),
    wildcard_constraints:
        kind="masks|depth",
    params:
        settings=told(images=images_path, lenses=given_lenses, views=used_views, **ONE_SHARD),


use rule step as trace_image_edges with:
    input:
        frames=rules.read_videolog.output.out,
        masks=pole_shard(straight("masks"), "zip"),
    output:
        out=non_empty("results/{site}/poles/image_edges/{shard}.parquet"),
    params:
        settings=told("image_edges", **ONE_SHARD),


use rule step as trace_pole_axes with:
    input:
        frames=rules.read_videolog.output.out,
        masks=pole_shard(straight("masks"), "zip"),
        decided=after_profile("side_views"),
    output:
        out=non_empty("results/{site}/poles/pole_axes/{shard}.parquet"),
    params:
        settings=told(flags("sightings", PoleMasks), views=used_views, **ONE_SHARD),


use rule step as match_images with:
    input:
        frames=rules.read_videolog.output.out,
        images_files=rendered_images,
        drive=distorting_drive,
    output:
        out=non_empty("results/{site}/poles/matches/{shard}.parquet"),
    params:
        settings=told(images=images_path, lenses=given_lenses, **ONE_SHARD),
        images_sha256=image_digest(),
