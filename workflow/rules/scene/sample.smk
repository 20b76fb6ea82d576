"""Sites that the workflow generates itself, with their exact truth.

OUTPUTS          results/{site}/sample/: cloud, truth, edges; or cloud, truth, videolog with images
"""

from roadsight.base.sections.run import (
    HighwayScene,
    RuralLenses,
    RuralScene,
    RuralSurvey,
)


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
        settings=told(
            sample_flags(HighwayScene, "length_m", "class_scheme"),
            seed=setting("seed"),
        ),


use rule step as generate_rural with:
    output:
        cloud="results/{site}/sample/cloud.laz",
        truth="results/{site}/sample/truth.gpkg",
        poles="results/{site}/sample/truth_poles.csv",
        cameras="results/{site}/sample/truth_cameras.csv",
        videolog="results/{site}/sample/videolog.csv",
        baseline="results/{site}/sample/baseline.json",
    wildcard_constraints:
        site=sites_with_scene("rural"),
    resources:
        mem_mb=each_attempt(2000),
    params:
        settings=told(
            sample_flags(RuralScene, RuralSurvey, "length_m", "class_scheme"),
            seed=setting("seed"),
        ),


use rule step as render_videolog with:
    output:
        images=ensure("results/{site}/sample/images/{shard}.zip", non_empty=True),
    wildcard_constraints:
        site=sites_with_scene("rural"),
    resources:
        mem_mb=each_attempt(2000),
    params:
        settings=told(
            sample_flags(RuralScene, RuralLenses, "length_m"),
            seed=setting("seed"),
            shard=wildcard("shard"),
            shards=setting("shards"),
        ),
