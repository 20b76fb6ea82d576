"""What people and checks read: a summary of each site and one report page."""


use rule step as match_inputs with:
    input:
        frame=rules.ingest_cloud.output.frame,
        frames=frames_of_lists,
        listed_files=listed_files,
    output:
        doubts="results/{site}/doubts/match_inputs.json",
    params:
        settings=told(
            views=where(frames_of_lists)(used_views, ["front"]),
            lists=lambda wildcards: json.dumps(given_lists(wildcards)),
        ),
        images_sha256=listed_images,


use rule step as summarise_site with:
    input:
        frame=rules.ingest_cloud.output.frame,
        profile=rules.profile_scene.output.out,
        effects=rules.plan_effects.output.out,
        given=given_files,
        scores=pavement_scores,
        traffic=placement_only(traffic_mask),
        frames=poles_only(rules.read_videolog.output.out),
        cameras=poles_only(all_cameras),
        sightings=poles_only(all_sightings),
        poles=poles_only(rules.triangulate_poles.output.poles),
        validation=pole_validation,
        camera_scores=camera_scores,
        coverage=placement_only(last_coverage),
        pavement=scene_page_only([rules.extract_pavement.output.points]),
        solutions=placement_only(per_plan("solution.json")),
        timings=placement_only(per_plan("timing.json")),
        data=placement_only(per_plan("data.json")),
        tolerances=placement_only(per_plan("tolerance.json")),
        removals=placement_only(per_plan("removals.json")),
        doubts=told_doubts,
    output:
        out="results/{site}/summary.json",
        run="results/{site}/run.json",
    params:
        settings=told(
            benchmarks="results/{site}/benchmarks",
            site=wildcard("site"),
            seed=setting("seed"),
            settings=lambda wildcards: SITES[wildcards.site].settings.model_dump_json(),
            sensors=lambda wildcards: json.dumps(site_sensors(wildcards), sort_keys=True),
        ),


use rule step as write_site_page with:
    input:
        summary=rules.summarise_site.output.out,
        frame=rules.ingest_cloud.output.frame,
        cloud=rules.ingest_cloud.output.cloud,
        dem=rules.build_dem.output.dem,
        pavement=rules.extract_pavement.output.pavement,
        edges=rules.build_edges.output.out,
        orthophoto=beside_site("orthophoto"),
        targets=placement_only(rules.place_targets.output.out),
        unexamined=placement_only(rules.place_targets.output.unexamined),
        candidates=placement_only(all_candidates),
        detections=placement_only(all_detections),
        coverage=placement_only(last_coverage),
        solutions=placement_only(per_plan("solution.json")),
        layers=placement_only(per_plan("solution.gpkg")),
        tolerances=placement_only(per_plan("tolerance.gpkg")),
        obstacles=placement_only(per_plan("obstacles.gpkg")),
        scans=placement_only(per_plan("scans.laz")),
    output:
        out="results/{site}/page.json",
    resources:
        **holding_cloud(100),
    params:
        settings=told(
            site=wildcard("site"),
            title=site_field("title"),
            plans=lambda wildcards: [
                f"{n}={p.title}" for n, p in plans_of(wildcards.site).items()
            ],
            sensors=CONFIG.sensors_file,
        ),
        sensors=site_sensors,


use rule step as write_report with:
    input:
        pages=asked(["results/{site}/page.json"], "scene", "placement"),
        poles_pages=asked(["results/{site}/poles/page.json"], "poles"),
        runs=asked(["results/{site}/run.json"]),
        handed_over_files=[*printed_reports(), *handovers()],
        assets=REPORT_ASSETS,
    output:
        out="results/report.html",
    log:
        "logs/write_report.log",
    params:
        settings=told(evidence=evidence_pages()),


use rule step as write_pdf with:
    input:
        page=scene_page_only([rules.write_site_page.output.out]),
        poles_page=poles_only(["results/{site}/poles/page.json"]),
        run=rules.summarise_site.output.run,
        template_files=PAPER_ASSETS,
    output:
        out="results/{site}/report.pdf",
    resources:
        mem_mb=megabytes(100),


use rule step as write_handover with:
    input:
        frame=rules.ingest_cloud.output.frame,
        dem=rules.build_dem.output.dem,
        pavement=scene_page_only([rules.extract_pavement.output.pavement]),
        edges=scene_page_only([rules.build_edges.output.out]),
        unexamined=placement_only(rules.place_targets.output.unexamined),
        solutions=placement_only(per_plan("solution.json")),
        plan_layers=placement_only(per_plan("solution.gpkg")),
        obstacles=placement_only(per_plan("obstacles.gpkg")),
        poles=poles_only([rules.rate_hazard.output.layers]),
        road_edges=poles_only([rules.extract_road_edges.output.lines]),
    output:
        layers="results/{site}/gis/{site}.gpkg",
        project="results/{site}/gis/{site}.qgs",
        kml="results/{site}/gis/{site}.kml",
        drawing="results/{site}/gis/{site}.dxf",
    params:
        settings=told(
            site=wildcard("site"),
            title=site_field("title"),
            orthophoto=beside_site("orthophoto"),
        ),


use rule step as write_stakeout with:
    input:
        frame=rules.ingest_cloud.output.frame,
        edges=rules.build_edges.output.out,
        solutions=per_plan("solution.json"),
    output:
        out="results/{site}/stakeout.csv",


use rule step as write_poles_page with:
    input:
        summary=rules.summarise_site.output.out,
        frame=rules.ingest_cloud.output.frame,
        dem=rules.build_dem.output.dem,
        top=rules.rasterise_lidar.output.top,
        road_edges=rules.extract_road_edges.output.edges,
        frames=rules.read_videolog.output.out,
        images_files=rendered_images,
        cameras=all_cameras,
        image_edges=all_image_edges,
        sightings=all_sightings,
        masks=all_masks,
        depth=all_depths,
        poles=rules.triangulate_poles.output.poles,
        hazard=rules.rate_hazard.output.out,
        sections=rules.rate_hazard.output.sections,
        files=[
            *expand(
                "results/{{site}}/poles/poles.{kind}", kind=["parquet", "gpkg", "csv", "geojson"]
            ),
            "results/{site}/poles/hazard.csv",
            "results/{site}/poles/road_geometry.csv",
        ],
        validation=pole_validation,
        components=compared_components,
        drive=only_if("lens_distortion", rules.profile_drive.output.out),
    output:
        out="results/{site}/poles/page.json",
        pictures="results/{site}/poles/pictures.zip",
    params:
        settings=told(
            "pictures",
            site=wildcard("site"),
            title=site_field("title"),
            images=images_path,
            lenses=given_lenses,
        ),


# What each component of the pole job is worth.
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
