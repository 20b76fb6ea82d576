"""What each component of the pole job is worth.

REQUIRED INPUTS  results/{site}/poles/
OUTPUTS          results/{site}/poles/components.json
"""


use rule step as compare_components with:
    input:
        frames=rules.read_videolog.output.out,
        image_edges=all_image_edges,
        pole_axes=if_landmarks(all_pole_axes),
        matches=if_ties(all_matches),
        baseline=registered_cameras,
        masks=all_masks,
        depth=all_depths,
        road_edges=rules.extract_road_edges.output.edges,
        columns=rules.find_pole_columns.output.out,
        terrain=only_if("terrain_occlusion", rules.build_terrain.output.out),
        decided=after_profile("sight_curvature", "side_views", "grid_convergence"),
        voxels=rules.rasterise_lidar.output.voxels,
        dem=rules.build_dem.output.dem,
        frame=rules.ingest_cloud.output.frame,
        truth_files=known_poles,
    output:
        out="results/{site}/poles/components.json",
    params:
        settings=told(
            settings=settings_of(
                "calibration", "alignment", "sightings", "triangulation", "validation"
            ),
            views=used_views,
            curvature=decision_on("sight_curvature"),
            grid_convergence=decision_on("grid_convergence"),
            truth=layered_site("truth.poles", known_poles),
            truth_crs=site_field("truth.poles_crs"),
            truth_kind=known_pole_kind,
        ),
