"""What each component of the pole job is worth.

REQUIRED INPUTS  results/{site}/poles/
OUTPUTS          results/{site}/poles/components.json
"""


rule compare_components:
    input:
        frames=rules.read_videolog.output.frames,
        image_edges=all_image_edges,
        pole_axes=landmark_axes,
        matches=tied_points,
        baseline=registered_cameras,
        masks=all_masks,
        depth=all_depths,
        road_edges=rules.extract_road_edges.output.edges,
        columns=rules.find_pole_columns.output.columns,
        terrain=only_if("terrain_occlusion", rules.build_terrain.output.terrain),
        decided=after_profile("sight_curvature", "side_views", "grid_convergence"),
        voxels=rules.rasterise_lidar.output.voxels,
        dem=rules.build_dem.output.dem,
        frame=rules.ingest_cloud.output.frame,
        truth=known_poles,
        code=sources("compare_components"),
    output:
        components="results/{site}/poles/components.json",
    log:
        log_of("compare_components"),
    benchmark:
        benchmark_of("compare_components")
    conda:
        ENVIRONMENT
    params:
        truth=layered_site("truth.poles", known_poles),
        truth_crs=site_field("truth.poles_crs"),
        truth_kind=known_pole_kind,
        settings=settings_of(
            "calibration", "alignment", "sightings", "triangulation", "validation"
        ),
        views=used_views,
        curvature=decision_on("sight_curvature"),
        grid_convergence=decision_on("grid_convergence"),
    shell:
        "python -m roadsight.stages.evidence.compare_components --frames {input.frames}"
        " --matches {input.matches} --baseline {input.baseline:q}"
        " --settings {params.settings:q} --views {params.views}"
        " --curvature {params.curvature} --grid-convergence {params.grid_convergence}"
        " --image-edges {input.image_edges} --pole-axes {input.pole_axes} --masks {input.masks}"
        " --depth {input.depth} --road-edges {input.road_edges} --columns {input.columns}"
        " --terrain {input.terrain} --voxels {input.voxels} --dem {input.dem}"
        " --frame {input.frame} --truth {params.truth:q} --truth-crs={params.truth_crs:q}"
        " --truth-kind={params.truth_kind:q} --out {output.components} > {log} 2>&1"
