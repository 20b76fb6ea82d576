"""What people and checks read: a summary of each site and one report page.

REQUIRED INPUTS  everything a site's jobs produced
OUTPUTS          results/{site}/summary.json, results/{site}/run.json (date, code and times),
                 results/{site}/report.pdf, results/report.html,
                 results/{site}/gis/: {site}.gpkg, .qgs, .kml, .dxf; results/{site}/stakeout.csv
"""


rule match_inputs:
    input:
        frame=rules.ingest_cloud.output.frame,
        frames=frames_of_lists,
        files=listed_files,
        code=sources("match_inputs"),
    output:
        doubts="results/{site}/doubts/match_inputs.json",
    log:
        log_of("match_inputs"),
    benchmark:
        benchmark_of("match_inputs")
    conda:
        ENVIRONMENT
    params:
        lists=lists_json,
        images_sha256=listed_images,
        views=lambda wildcards: (
            used_views(wildcards) if frames_of_lists(wildcards) else "front"
        ),
    shell:
        "python -m roadsight.stages.evidence.match_inputs --frame {input.frame}"
        " --frames {input.frames} --views {params.views} --lists={params.lists:q}"
        " --doubts {output.doubts} > {log} 2>&1"


rule summarise_site:
    input:
        frame=rules.ingest_cloud.output.frame,
        profile=rules.profile_scene.output.profile,
        effects=rules.plan_effects.output.effects,
        given=given_files,
        scores=pavement_scores,
        traffic=placement_only(traffic_mask),
        frames=poles_only(pole_frames),
        cameras=poles_only(all_cameras),
        sightings=poles_only(all_sightings),
        poles=poles_only(found_poles),
        validation=pole_validation,
        camera_scores=camera_scores,
        coverage=placement_only(last_coverage),
        pavement=pavement_points,
        solutions=placement_only(plan_solutions),
        timings=placement_only(plan_timings),
        data=placement_only(plan_data),
        tolerances=placement_only(plan_tolerances),
        removals=placement_only(plan_removals),
        doubts=told_doubts,
        code=sources("summarise_site"),
    output:
        summary="results/{site}/summary.json",
        run="results/{site}/run.json",
    log:
        log_of("summarise_site"),
    benchmark:
        benchmark_of("summarise_site")
    conda:
        ENVIRONMENT
    params:
        seed=setting("seed"),
        settings=all_settings,
        sensors=site_sensors_json,
    shell:
        "python -m roadsight.stages.evidence.summarise_site --site {wildcards.site} --seed {params.seed}"
        " --settings {params.settings:q} --sensors {params.sensors:q} --given {input.given:q}"
        " --frame {input.frame} --profile {input.profile}"
        " --effects {input.effects}"
        " --scores {input.scores} --traffic {input.traffic} --coverage {input.coverage} --solutions {input.solutions}"
        " --pavement {input.pavement} --timings {input.timings} --data {input.data} --tolerances {input.tolerances} --removals {input.removals} --frames {input.frames} --cameras {input.cameras}"
        " --sightings {input.sightings} --poles {input.poles} --validation {input.validation}"
        " --camera-scores {input.camera_scores} --doubts {input.doubts}"
        " --benchmarks results/{wildcards.site}/benchmarks"
        " --out {output.summary} --run {output.run} > {log} 2>&1"


rule write_site_page:
    input:
        summary=rules.summarise_site.output.summary,
        frame=rules.ingest_cloud.output.frame,
        cloud=rules.ingest_cloud.output.cloud,
        dem=rules.build_dem.output.dem,
        pavement=rules.extract_pavement.output.pavement,
        edges=rules.build_edges.output.edges,
        orthophoto=beside_site("orthophoto"),
        targets=placement_only(site_targets),
        unexamined=placement_only(unexamined_pavement),
        candidates=placement_only(all_candidates),
        detections=placement_only(all_detections),
        coverage=placement_only(last_coverage),
        solutions=placement_only(plan_solutions),
        layers=placement_only(plan_layers),
        tolerances=placement_only(plan_tolerance_layers),
        obstacles=placement_only(plan_obstacles),
        scans=placement_only(plan_scans),
        code=sources("write_site_page"),
    output:
        page="results/{site}/page.json",
    log:
        log_of("write_site_page"),
    benchmark:
        benchmark_of("write_site_page")
    conda:
        ENVIRONMENT
    resources:
        mem_mb=megabytes(100),
        runtime=minutes(),
    params:
        title=site_field("title"),
        plans=plan_titles,
        sensors=site_sensors,
        sensors_file=CONFIG.sensors_file,
    shell:
        "python -m roadsight.stages.evidence.write_site_page --site {wildcards.site}"
        " --title={params.title:q} --plans {params.plans:q} --sensors {params.sensors_file:q}"
        " --summary {input.summary} --frame {input.frame} --cloud {input.cloud}"
        " --dem {input.dem} --pavement {input.pavement} --edges {input.edges}"
        " --orthophoto {input.orthophoto}"
        " --targets {input.targets} --unexamined {input.unexamined} --candidates {input.candidates}"
        " --detections {input.detections} --coverage {input.coverage}"
        " --solutions {input.solutions} --layers {input.layers}"
        " --tolerances {input.tolerances}"
        " --obstacles {input.obstacles} --scans {input.scans}"
        " --out {output.page} > {log} 2>&1"


rule write_report:
    input:
        pages=site_pages(),
        poles_pages=pole_pages(),
        runs=site_runs(),
        handed_over=[*printed_reports(), *handovers()],
        assets=REPORT_ASSETS,
        code=sources("write_report"),
    output:
        report="results/report.html",
    log:
        "logs/write_report.log",
    benchmark:
        "results/benchmarks/write_report.tsv"
    conda:
        ENVIRONMENT
    params:
        evidence=evidence_pages(),
    shell:
        "python -m roadsight.stages.evidence.write_report --pages {input.pages}"
        " --poles-pages {input.poles_pages} --runs {input.runs} --evidence {params.evidence:q}"
        " --out {output.report} > {log} 2>&1"


rule write_pdf:
    input:
        page=own_site_page,
        poles_page=own_poles_page,
        run=rules.summarise_site.output.run,
        template=PAPER_ASSETS,
        code=sources("write_pdf"),
    output:
        pdf="results/{site}/report.pdf",
    log:
        log_of("write_pdf"),
    benchmark:
        benchmark_of("write_pdf")
    conda:
        ENVIRONMENT
    resources:
        mem_mb=megabytes(100),
    shell:
        "python -m roadsight.stages.evidence.write_pdf --page {input.page} --poles-page {input.poles_page}"
        " --run {input.run} --out {output.pdf} > {log} 2>&1"


rule write_handover:
    input:
        frame=rules.ingest_cloud.output.frame,
        dem=rules.build_dem.output.dem,
        pavement=scene_page_only(rules.extract_pavement.output.pavement),
        edges=scene_page_only(rules.build_edges.output.edges),
        unexamined=placement_only(unexamined_pavement),
        solutions=placement_only(plan_solutions),
        layers=placement_only(plan_layers),
        obstacles=placement_only(plan_obstacles),
        poles=poles_only(pole_layers),
        road_edges=poles_only(road_edge_layers),
        code=sources("write_handover"),
    output:
        layers="results/{site}/gis/{site}.gpkg",
        project="results/{site}/gis/{site}.qgs",
        kml="results/{site}/gis/{site}.kml",
        drawing="results/{site}/gis/{site}.dxf",
    log:
        log_of("write_handover"),
    benchmark:
        benchmark_of("write_handover")
    conda:
        ENVIRONMENT
    params:
        title=site_field("title"),
        orthophoto=beside_site("orthophoto"),
    shell:
        "python -m roadsight.stages.evidence.write_handover --site {wildcards.site}"
        " --title={params.title:q} --frame {input.frame} --dem {input.dem}"
        " --pavement {input.pavement} --edges {input.edges}"
        " --unexamined {input.unexamined} --solutions {input.solutions}"
        " --plan-layers {input.layers} --obstacles {input.obstacles} --poles {input.poles}"
        " --road-edges {input.road_edges} --orthophoto {params.orthophoto:q} --layers {output.layers}"
        " --project {output.project} --kml {output.kml} --drawing {output.drawing} > {log} 2>&1"


rule write_stakeout:
    input:
        frame=rules.ingest_cloud.output.frame,
        edges=rules.build_edges.output.edges,
        solutions=plan_solutions,
        code=sources("write_stakeout"),
    output:
        table="results/{site}/stakeout.csv",
    log:
        log_of("write_stakeout"),
    benchmark:
        benchmark_of("write_stakeout")
    conda:
        ENVIRONMENT
    shell:
        "python -m roadsight.stages.evidence.write_stakeout --frame {input.frame}"
        " --edges {input.edges} --solutions {input.solutions} --out {output.table} > {log} 2>&1"


rule write_poles_page:
    input:
        summary=rules.summarise_site.output.summary,
        frame=rules.ingest_cloud.output.frame,
        dem=rules.build_dem.output.dem,
        top=rules.rasterise_lidar.output.top,
        road_edges=rules.extract_road_edges.output.edges,
        frames=rules.read_videolog.output.frames,
        images=rendered_images,
        cameras=all_cameras,
        image_edges=all_image_edges,
        sightings=all_sightings,
        masks=all_masks,
        depth=all_depths,
        poles=rules.triangulate_poles.output.poles,
        hazard=rules.rate_hazard.output.hazard,
        sections=rules.rate_hazard.output.sections,
        pole_files=pole_files,
        validation=pole_validation,
        components=compared_components,
        drive=only_if("lens_distortion", rules.profile_drive.output.drive),
        code=sources("write_poles_page"),
    output:
        page="results/{site}/poles/page.json",
        pictures="results/{site}/poles/pictures.zip",
    log:
        log_of("write_poles_page"),
    benchmark:
        benchmark_of("write_poles_page")
    conda:
        ENVIRONMENT
    params:
        title=site_field("title"),
        images=images_path,
        lenses=given_lenses,
        options=flags("pictures"),
    shell:
        "python -m roadsight.stages.evidence.write_poles_page --site {wildcards.site}"
        " --title={params.title:q} --summary {input.summary} --frame {input.frame}"
        " --dem {input.dem} --top {input.top} --road-edges {input.road_edges}"
        " --frames {input.frames} --images {params.images:q} --cameras {input.cameras}"
        " --image-edges {input.image_edges} --sightings {input.sightings} --masks {input.masks}"
        " --depth {input.depth} --poles {input.poles} --hazard {input.hazard}"
        " --sections {input.sections}"
        " --validation {input.validation} --components {input.components}"
        " --drive {input.drive} --lenses {params.lenses:q}"
        " --files {input.pole_files} {params.options}"
        " --out {output.page} --pictures {output.pictures} > {log} 2>&1"
