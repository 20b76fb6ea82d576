"""From files, or a generated sample, to a road: ground, pavement, edges, surfels, voxels."""

from roadsight.base.sections.poles import RoadClasses
from roadsight.base.sections.run import HighwayScene, RuralLenses, RuralScene, RuralSurvey
from roadsight.base.sections.scene import GroundClasses, PavementOutline
from roadsight.base.sections.sensing import SurfelMaking


# Sites that the workflow generates itself, with their exact truth.
use rule step as generate_sample with:
    output:
        cloud="results/{site}/sample/cloud.laz",
        truth="results/{site}/sample/truth.gpkg",
        edges="results/{site}/sample/edges.geojson",
    wildcard_constraints:
        site=sites_with_scene("highway"),
    resources:
        mem_mb=each_attempt(2000),
    params:
        settings=told(sample_flags(HighwayScene, "length_m", "class_scheme"), seed=setting("seed")),


use rule generate_sample as generate_rural with:
    output:
        cloud="results/{site}/sample/cloud.laz",
        truth="results/{site}/sample/truth.gpkg",
        poles="results/{site}/sample/truth_poles.csv",
        cameras="results/{site}/sample/truth_cameras.csv",
        videolog="results/{site}/sample/videolog.csv",
        baseline="results/{site}/sample/baseline.json",
    wildcard_constraints:
        site=sites_with_scene("rural"),
    params:
        settings=told(
            sample_flags(RuralScene, RuralSurvey, "length_m", "class_scheme"),
            seed=setting("seed"),
        ),


use rule generate_rural as render_videolog with:
    output:
        images=non_empty("results/{site}/sample/images/{shard}.zip"),
    params:
        settings=told(
            sample_flags(RuralScene, RuralLenses, "length_m"),
            seed=setting("seed"),
            **ONE_SHARD,
        ),


# From a cloud to its road: ingest, ground and DEM, pavement, edges.
use rule step as ingest_cloud with:
    input:
        clouds=cloud_files,
        extent_files=extent_files,
    output:
        cloud="results/{site}/scene/cloud.parquet",
        frame="results/{site}/scene/frame.json",
    threads: 2
    resources:
        mem_mb=each_attempt(1000),
    params:
        settings=told(
            "scene",
            site=wildcard("site"),
            crs=lambda wildcards: SITES[wildcards.site].site.crs or "auto",
            units=site_field("units"),
            vertical_units=site_field("vertical_units"),
            target_crs=site_field("target_crs"),
            extent=site_extent,
            extent_files=layered_extent_files,
            extent_crs=extent_crs,
        ),
        sha256=if_rendered([], of_site(lambda site: list(map(CHECKSUMS.of, SITES[site].clouds)))),


checkpoint profile_scene:
    input:
        cloud=rules.ingest_cloud.output.cloud,
        frame=rules.ingest_cloud.output.frame,
    output:
        out="results/{site}/scene/profile.json",
    conda:
        ENVIRONMENT
    resources:
        **holding_cloud(100),
    params:
        command=command,
        settings="",
    shell:
        STEP


use rule step as build_dem with:
    input:
        cloud=rules.ingest_cloud.output.cloud,
        frame=rules.ingest_cloud.output.frame,
        profile=rules.profile_scene.output.out,
    output:
        dem="results/{site}/scene/dem.tif",
        ground="results/{site}/scene/ground.parquet",
        doubts="results/{site}/doubts/build_dem.json",
    resources:
        **holding_cloud(60),
    params:
        settings=told("ground", site=wildcard("site")),


use rule step as cluster_fpfh with:
    input:
        cloud=rules.ingest_cloud.output.cloud,
        ground=rules.build_dem.output.ground,
        profile=rules.profile_scene.output.out,
        code=sources_with("cluster_fpfh", setting("pavement.fpfh_engine")),
    output:
        out="results/{site}/scene/fpfh_clusters.parquet",
    resources:
        **holding_cloud(150),
    params:
        settings=told(flags("pavement", GroundClasses), seed=setting("seed")),


use rule step as extract_pavement with:
    input:
        cloud=rules.ingest_cloud.output.cloud,
        frame=rules.ingest_cloud.output.frame,
        ground=rules.build_dem.output.ground,
        profile=if_profiled([rules.profile_scene.output.out]),
        clusters=of_pavement("published", [rules.cluster_fpfh.output.out]),
        edges_files=of_pavement("surface", edges_file),
        track_files=of_pavement("surface", beside_site("placement.track")),
        tma_files=beside_site("placement.tma"),
        code=sources_with("extract_pavement", setting("pavement.cluster_engine")),
    output:
        pavement="results/{site}/scene/pavement.gpkg",
        points="results/{site}/scene/pavement.parquet",
        doubts="results/{site}/doubts/extract_pavement.json",
    resources:
        mem_mb=memory_of_pavement,
        runtime=MINUTES,
    params:
        settings=told(
            flags("pavement", "method", "intensity"),
            setting_of_pavement("published", flags("pavement", "cluster_engine", PavementOutline)),
            site=wildcard("site"),
            tma=layered_site("placement.tma"),
            seeds=setting_of_pavement("surface", pavement_seeds),
            edges=setting_of_pavement("surface", layered_site("placement.edges", edges_file)),
            edges_crs=setting_of_pavement("surface", site_field("placement.edges_crs")),
            track=setting_of_pavement("surface", layered_site("placement.track")),
            track_crs=setting_of_pavement("surface", site_field("placement.track_crs")),
        ),


use rule step as build_edges with:
    input:
        frame=rules.ingest_cloud.output.frame,
        pavement=rules.extract_pavement.output.pavement,
        dem=rules.build_dem.output.dem,
        edges_files=edges_file,
    output:
        out="results/{site}/placement/edges.gpkg",
    params:
        settings=told(
            "edges",
            site=wildcard("site"),
            digitised=layered_site("placement.edges", edges_file),
            digitised_crs=site_field("placement.edges_crs"),
        ),


use rule step as score_pavement with:
    input:
        cloud=rules.ingest_cloud.output.cloud,
        frame=rules.ingest_cloud.output.frame,
        ground=rules.build_dem.output.ground,
        pavement=rules.extract_pavement.output.pavement,
        truth_files=pavement_truth,
    output:
        out="results/{site}/scene/pavement_scores.json",
    params:
        settings=told(
            truth=layered_site("truth.pavement", pavement_truth),
            truth_crs=site_field("truth.pavement_crs"),
            truth_layer=if_rendered("pavement", ""),
            reach_m=site_field("truth.reach_m"),
        ),


# The cloud as surfels, without passing vehicles.
use rule step as mark_traffic with:
    input:
        cloud=rules.ingest_cloud.output.cloud,
        frame=rules.ingest_cloud.output.frame,
        dem=rules.build_dem.output.dem,
        pavement=rules.extract_pavement.output.pavement,
    output:
        out="results/{site}/scene/traffic.parquet",
    resources:
        **holding_cloud(100),
    params:
        settings=told(clear_below_m=setting("lidar.clear_below_m")),


use rule step as build_surfels with:
    input:
        cloud=rules.ingest_cloud.output.cloud,
        traffic=traffic_mask,
        code=sources_with("build_surfels", setting("lidar.outlier_engine")),
    output:
        out="results/{site}/scene/surfels.parquet",
    resources:
        **holding_cloud(200),
    params:
        settings=told(flags("lidar", SurfelMaking)),


# The road as the cloud shows it from above, for the pole job.
use rule step as rasterise_lidar with:
    input:
        cloud=rules.ingest_cloud.output.cloud,
        frame=rules.ingest_cloud.output.frame,
        dem=rules.build_dem.output.dem,
        pavement=if_unclassed(rules.extract_pavement.output.pavement),
    output:
        voxels="results/{site}/poles/voxels.parquet",
        top="results/{site}/poles/top.tif",
    threads: 2
    resources:
        **holding_cloud(10),
    params:
        command=command_with("threads"),
        settings=told("voxels", road_source=where(has_classes)("class", "pavement")),


use rule step as extract_road_edges with:
    input:
        top=rules.rasterise_lidar.output.top,
        frame=rules.ingest_cloud.output.frame,
        cloud=if_curbs([rules.ingest_cloud.output.cloud]),
        frames=if_curbs(["results/{site}/poles/frames.parquet"]),
    output:
        edges="results/{site}/poles/road_edges.parquet",
        lines="results/{site}/poles/road_edges.gpkg",
    params:
        settings=told("road_edges"),


use rule step as build_terrain with:
    input:
        cloud=rules.ingest_cloud.output.cloud,
        ground=if_unclassed(rules.build_dem.output.ground),
    output:
        out="results/{site}/poles/terrain.npz",
    resources:
        **holding_cloud(60),
    params:
        settings=told(flags("voxels", RoadClasses), "terrain_mesh"),


# Which physical effects each site simulates. Decisions hang on what was measured: `profile_scene`
# is the one checkpoint of the placement job, `profile_drive` that of the pole job. Before it has
# run, `snakemake -n` shows inputs that hang on a decision as <TBD>; after it, the whole DAG.
use rule step as plan_effects with:
    input:
        profile="results/{site}/scene/profile.json",
        frame="results/{site}/scene/frame.json",
        drive=poles_only("results/{site}/poles/drive.json"),
        catalogue=CONFIG.effects_file,
    output:
        out="results/{site}/effects.json",
    params:
        settings=told(
            circumstances=of_site(lambda site: json.dumps(circumstances(site), sort_keys=True))
        ),
