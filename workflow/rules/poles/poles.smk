"""From cameras and what their images show to poles on the map.

REQUIRED INPUTS  results/{site}/poles/: frames, cameras, masks, depth, columns, voxels
OUTPUTS          results/{site}/poles/: sightings, poles, hazard, validation, page
USUAL STEPS      sightings, triangulation, hazard
"""


use rule step as turn_side_views with:
    input:
        frames=rules.read_videolog.output.out,
        calibration=rules.calibrate_drive.output.out,
        cameras=all_cameras,
        images_files=rendered_images,
        drive=distorting_drive,
    output:
        out="results/{site}/poles/side_turns.json",
    params:
        settings=told(images=images_path, lenses=given_lenses),
        images_sha256=image_digest(),


use rule step as measure_poles with:
    input:
        frames=rules.read_videolog.output.out,
        calibration=calibration_if_aligned,
        turns=side_turns_if_used,
        cameras=cameras_of_shard,
        masks=without_distortion("masks"),
        depth=without_distortion("depth"),
        dem=rules.build_dem.output.dem,
        columns=rules.find_pole_columns.output.out,
        voxels=if_bearings([rules.rasterise_lidar.output.voxels]),
        objects=if_objects([rules.find_roadside_objects.output.out]),
        frame=rules.ingest_cloud.output.frame,
        decided=after_profile("side_views", "grid_convergence"),
    output:
        out=ensure("results/{site}/poles/sightings/{shard}.parquet", non_empty=True),
        seen="results/{site}/poles/seen/{shard}.parquet",
        markings="results/{site}/poles/markings/{shard}.parquet",
    params:
        settings=told(
            "sightings",
            flags("image_edges", "min_marking_px"),
            views=used_views,
            grid_convergence=decision_on("grid_convergence"),
            shard=wildcard("shard"),
            shards=setting("shards"),
        ),


use rule step as triangulate_poles with:
    input:
        sightings=all_sightings,
        frame=rules.ingest_cloud.output.frame,
        dem=rules.build_dem.output.dem,
        voxels=rules.rasterise_lidar.output.voxels,
        objects=if_objects([rules.find_roadside_objects.output.out]),
        seen=all_seen,
        frames=rules.read_videolog.output.out,
        columns=rules.find_pole_columns.output.out,
        decisions=beside_site("poles.decisions"),
    output:
        poles="results/{site}/poles/poles.parquet",
        layers="results/{site}/poles/placed.gpkg",
        csv="results/{site}/poles/poles.csv",
        geojson="results/{site}/poles/poles.geojson",
        doubts="results/{site}/doubts/triangulate_poles.json",
    params:
        settings=told("triangulation", own_networks),


use rule step as rate_hazard with:
    input:
        poles=rules.triangulate_poles.output.poles,
        frame=rules.ingest_cloud.output.frame,
        frames=rules.read_videolog.output.out,
        edges=rules.extract_road_edges.output.edges,
        dem=rules.build_dem.output.dem,
        cloud=rules.ingest_cloud.output.cloud,
        ground=rules.build_dem.output.ground,
        placed=rules.triangulate_poles.output.layers,
        markings=all_markings,
        inventory_files=beside_site("roads.inventory"),
        routes_files=beside_site("roads.routes"),
        barriers_files=beside_site("roads.barriers"),
        decided=after_profile("scale_factor"),
    output:
        out="results/{site}/poles/hazard.parquet",
        csv="results/{site}/poles/hazard.csv",
        sections="results/{site}/poles/cross_sections.parquet",
        geometry_csv="results/{site}/poles/road_geometry.csv",
        layers="results/{site}/poles/poles.gpkg",
        doubts="results/{site}/doubts/rate_hazard.json",
    params:
        settings=told(
            "hazard",
            inventory=layered_site("roads.inventory"),
            inventory_crs=site_field("roads.inventory_crs"),
            routes=layered_site("roads.routes"),
            routes_crs=site_field("roads.routes_crs"),
            barriers=layered_site("roads.barriers"),
            barriers_crs=site_field("roads.barriers_crs"),
            measure_unit=site_field("roads.measure_unit"),
            traffic=site_field("roads.traffic"),
            carriageway=site_field("roads.carriageway"),
            scale_factor=decision_on("scale_factor"),
        ),


use rule step as validate_poles with:
    input:
        poles=rules.triangulate_poles.output.poles,
        placed=rules.triangulate_poles.output.layers,
        truth_files=known_poles,
        roadside=known_roadside,
        frame=rules.ingest_cloud.output.frame,
        frames=rules.read_videolog.output.out,
        edges=rules.extract_road_edges.output.edges,
        voxels=rules.rasterise_lidar.output.voxels,
    output:
        out="results/{site}/poles/validation.json",
    params:
        settings=told(
            flags("validation", "reach_m", "match_m"),
            flags("sightings", "kinds"),
            truth=layered_site("truth.poles", known_poles),
            truth_crs=site_field("truth.poles_crs"),
            truth_kind=known_pole_kind,
        ),
