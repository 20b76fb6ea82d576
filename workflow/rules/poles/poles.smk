"""From cameras and what their images show to poles on the map.

REQUIRED INPUTS  results/{site}/poles/: frames, cameras, masks, depth, columns, voxels
OUTPUTS          results/{site}/poles/: sightings, poles, hazard, validation, page
USUAL STEPS      sightings, triangulation, hazard
"""


rule turn_side_views:
    input:
        frames=rules.read_videolog.output.frames,
        calibration=rules.calibrate_drive.output.calibration,
        cameras=all_cameras,
        images=rendered_images,
        drive=distorting_drive,
        code=sources("turn_side_views"),
    output:
        turns="results/{site}/poles/side_turns.json",
    log:
        log_of("turn_side_views"),
    benchmark:
        benchmark_of("turn_side_views")
    conda:
        ENVIRONMENT
    params:
        images=images_path,
        images_sha256=image_digest(),
        lenses=given_lenses,
    shell:
        "python -m roadsight.stages.poles.turn_side_views --frames {input.frames}"
        " --calibration {input.calibration} --cameras {input.cameras} --images {params.images:q}"
        " --drive {input.drive} --lenses {params.lenses:q} --out {output.turns} > {log} 2>&1"


rule measure_poles:
    input:
        frames=rules.read_videolog.output.frames,
        calibration=calibration_if_aligned,
        turns=side_turns_if_used,
        cameras=cameras_of_shard,
        masks=without_distortion("masks"),
        depth=without_distortion("depth"),
        dem=rules.build_dem.output.dem,
        columns=rules.find_pole_columns.output.columns,
        voxels=voxels_for_bearings,
        objects=objects_of_cloud,
        frame=rules.ingest_cloud.output.frame,
        decided=after_profile("side_views", "grid_convergence"),
        code=sources("measure_poles"),
    output:
        sightings=ensure(
            "results/{site}/poles/sightings/{shard}.parquet", non_empty=True
        ),
        seen="results/{site}/poles/seen/{shard}.parquet",
        markings="results/{site}/poles/markings/{shard}.parquet",
    log:
        log_of("measure_poles", "{shard}"),
    benchmark:
        benchmark_of("measure_poles", "{shard}")
    conda:
        ENVIRONMENT
    params:
        shards=setting("shards"),
        options=flags("sightings"),
        markings=some_flags("image_edges", "min_marking_px"),
        views=used_views,
        grid_convergence=decision_on("grid_convergence"),
    shell:
        "python -m roadsight.stages.poles.measure_poles --frames {input.frames}"
        " --calibration {input.calibration} --turns {input.turns} --cameras {input.cameras} --masks {input.masks} --depth {input.depth}"
        " --dem {input.dem} --columns {input.columns} --voxels {input.voxels} --objects {input.objects} --frame {input.frame} {params.options} {params.markings}"
        " --views {params.views} --grid-convergence {params.grid_convergence}"
        " --shard {wildcards.shard} --shards {params.shards} --out {output.sightings}"
        " --seen {output.seen} --markings {output.markings} > {log} 2>&1"


rule triangulate_poles:
    input:
        sightings=all_sightings,
        frame=rules.ingest_cloud.output.frame,
        dem=rules.build_dem.output.dem,
        voxels=rules.rasterise_lidar.output.voxels,
        objects=objects_of_cloud,
        seen=all_seen,
        frames=rules.read_videolog.output.frames,
        columns=rules.find_pole_columns.output.columns,
        decisions=beside_site("poles.decisions"),
        code=sources("triangulate_poles"),
    output:
        poles="results/{site}/poles/poles.parquet",
        layers="results/{site}/poles/placed.gpkg",
        csv="results/{site}/poles/poles.csv",
        geojson="results/{site}/poles/poles.geojson",
        doubts="results/{site}/doubts/triangulate_poles.json",
    log:
        log_of("triangulate_poles"),
    benchmark:
        benchmark_of("triangulate_poles")
    conda:
        ENVIRONMENT
    params:
        options=flags("triangulation"),
        networks=own_networks,
    shell:
        "python -m roadsight.stages.poles.triangulate_poles --sightings {input.sightings}"
        " --frame {input.frame} --dem {input.dem} --voxels {input.voxels} {params.options} {params.networks}"
        " --objects {input.objects} --seen {input.seen} --frames {input.frames} --columns {input.columns} --decisions {input.decisions:q} --poles {output.poles} --layers {output.layers} --csv {output.csv}"
        " --geojson {output.geojson} --doubts {output.doubts} > {log} 2>&1"


rule rate_hazard:
    input:
        poles=rules.triangulate_poles.output.poles,
        frame=rules.ingest_cloud.output.frame,
        frames=rules.read_videolog.output.frames,
        edges=rules.extract_road_edges.output.edges,
        dem=rules.build_dem.output.dem,
        cloud=rules.ingest_cloud.output.cloud,
        ground=rules.build_dem.output.ground,
        placed=rules.triangulate_poles.output.layers,
        markings=all_markings,
        inventory=beside_site("roads.inventory"),
        routes=beside_site("roads.routes"),
        barriers=beside_site("roads.barriers"),
        decided=after_profile("scale_factor"),
        code=sources("rate_hazard"),
    output:
        hazard="results/{site}/poles/hazard.parquet",
        csv="results/{site}/poles/hazard.csv",
        sections="results/{site}/poles/cross_sections.parquet",
        geometry="results/{site}/poles/road_geometry.csv",
        layers="results/{site}/poles/poles.gpkg",
        doubts="results/{site}/doubts/rate_hazard.json",
    log:
        log_of("rate_hazard"),
    benchmark:
        benchmark_of("rate_hazard")
    conda:
        ENVIRONMENT
    params:
        options=flags("hazard"),
        scale_factor=decision_on("scale_factor"),
        inventory=layered_site("roads.inventory"),
        inventory_crs=site_field("roads.inventory_crs"),
        routes=layered_site("roads.routes"),
        routes_crs=site_field("roads.routes_crs"),
        barriers=layered_site("roads.barriers"),
        barriers_crs=site_field("roads.barriers_crs"),
        measure_unit=site_field("roads.measure_unit"),
        traffic=site_field("roads.traffic"),
        carriageway=site_field("roads.carriageway"),
    shell:
        "python -m roadsight.stages.poles.rate_hazard --poles {input.poles} --frame {input.frame}"
        " --frames {input.frames} --edges {input.edges} --dem {input.dem}"
        " --cloud {input.cloud} --ground {input.ground} --placed {input.placed}"
        " --markings {input.markings} --inventory {params.inventory:q} --inventory-crs={params.inventory_crs:q}"
        " --routes {params.routes:q} --routes-crs={params.routes_crs:q}"
        " --barriers {params.barriers:q} --barriers-crs={params.barriers_crs:q}"
        " --measure-unit {params.measure_unit} --traffic {params.traffic}"
        " --carriageway {params.carriageway}"
        " --scale-factor {params.scale_factor} {params.options}"
        " --out {output.hazard} --csv {output.csv} --sections {output.sections}"
        " --geometry-csv {output.geometry} --layers {output.layers} --doubts {output.doubts} > {log} 2>&1"


rule validate_poles:
    input:
        poles=rules.triangulate_poles.output.poles,
        placed=rules.triangulate_poles.output.layers,
        truth=known_poles,
        roadside=known_roadside,
        frame=rules.ingest_cloud.output.frame,
        frames=rules.read_videolog.output.frames,
        edges=rules.extract_road_edges.output.edges,
        voxels=rules.rasterise_lidar.output.voxels,
        code=sources("validate_poles"),
    output:
        validation="results/{site}/poles/validation.json",
    log:
        log_of("validate_poles"),
    benchmark:
        benchmark_of("validate_poles")
    conda:
        ENVIRONMENT
    params:
        truth=layered_site("truth.poles", known_poles),
        truth_crs=site_field("truth.poles_crs"),
        truth_kind=known_pole_kind,
        options=some_flags("validation", "reach_m", "match_m"),
        kinds=some_flags("sightings", "kinds"),
    shell:
        "python -m roadsight.stages.poles.validate_poles --poles {input.poles}"
        " --truth {params.truth:q} --truth-crs={params.truth_crs:q} --truth-kind={params.truth_kind:q} --frame {input.frame}"
        " --frames {input.frames} --edges {input.edges} --voxels {input.voxels} --placed {input.placed} --roadside {input.roadside} {params.options} {params.kinds}"
        " --out {output.validation} > {log} 2>&1"
