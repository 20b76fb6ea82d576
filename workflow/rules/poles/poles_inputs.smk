"""Helpers of the pole rules: shards, the road, known and found poles."""


def image_shards(wildcards):
    return range(SITES[wildcards.site].settings.shards)


def pole_shards(kind, suffix):
    """All shards of one kind of result."""
    return lambda wildcards: [
        f"results/{wildcards.site}/poles/{kind}/{shard}.{suffix}"
        for shard in image_shards(wildcards)
    ]


all_image_edges = pole_shards("image_edges", "parquet")
all_matches = pole_shards("matches", "parquet")
all_pole_axes = pole_shards("pole_axes", "parquet")
all_sightings = pole_shards("sightings", "parquet")
all_seen = pole_shards("seen", "parquet")
all_markings = pole_shards("markings", "parquet")


def pavement_for_roads(wildcards):
    """Pavement that stands for the road class of a cloud without one."""
    if SITES[wildcards.site].site.poles.road == "classes":
        return []
    return f"results/{wildcards.site}/scene/pavement.gpkg"


def road_source(wildcards):
    return "class" if SITES[wildcards.site].site.poles.road == "classes" else "pavement"


def ground_for_terrain(wildcards):
    """Ground labels for the terrain of a cloud without classes."""
    if SITES[wildcards.site].site.poles.road == "classes":
        return []
    return f"results/{wildcards.site}/scene/ground.parquet"


def _where_curbs(wildcards, path):
    curbs = SITES[wildcards.site].setting("road_edges.method") == "curbs"
    return [f"results/{wildcards.site}/{path}"] if curbs else []


def cloud_for_curbs(wildcards):
    """Cloud, where road edges are curbs."""
    return _where_curbs(wildcards, "scene/cloud.parquet")


def track_for_curbs(wildcards):
    """Track beside which curbs are looked for."""
    return _where_curbs(wildcards, "poles/frames.parquet")


def voxels_for_bearings(wildcards):
    """Voxels, where bearings are those to the nearest of them, or depths are fitted to them."""
    setting = SITES[wildcards.site].setting
    asked = setting("sightings.bearing") == "lidar" or setting("sightings.distance") == "published"
    return [f"results/{wildcards.site}/poles/voxels.parquet"] if asked else []


def objects_of_cloud(wildcards):
    """Objects that the cloud shows, where they are asked for."""
    asked = {"tree", "guardrail", "building", "headwall"} & set(
        SITES[wildcards.site].setting("sightings.kinds")
    )
    return [f"results/{wildcards.site}/poles/objects.parquet"] if asked else []


def pole_frames(wildcards):
    return f"results/{wildcards.site}/poles/frames.parquet"


def found_poles(wildcards):
    return f"results/{wildcards.site}/poles/poles.parquet"


def known_poles(wildcards):
    """Known poles: the site's file, or those of the generated site."""
    if is_rendered(wildcards):
        return [f"results/{wildcards.site}/sample/truth_poles.csv"]
    return beside_site("truth.poles")(wildcards)


def known_roadside(wildcards):
    """Known trees, guardrails and driveways of a generated site."""
    known = is_rendered(wildcards)
    return [f"results/{wildcards.site}/sample/truth.gpkg"] if known else []


def known_pole_kind(wildcards):
    """Which of the known posts are poles."""
    if is_rendered(wildcards):
        return "utility"
    return SITES[wildcards.site].site.truth.poles_kind or ""


def known_cameras(wildcards):
    """Known cameras: the site's file, or those of the generated site."""
    if is_rendered(wildcards):
        return [f"results/{wildcards.site}/sample/truth_cameras.csv"]
    return beside_site("truth.cameras")(wildcards)


def camera_scores(wildcards):
    scored = wants(wildcards.site, "poles") and known_cameras(wildcards)
    return [f"results/{wildcards.site}/poles/camera_scores.json"] if scored else []


def pole_validation(wildcards):
    scored = wants(wildcards.site, "poles") and known_poles(wildcards)
    return [f"results/{wildcards.site}/poles/validation.json"] if scored else []


def compared_components(wildcards):
    """What each component is worth, where a site asks for it and its poles are known."""
    asked = SITES[wildcards.site].setting("validation.components") == "compare"
    known = asked and pole_validation(wildcards)
    return [f"results/{wildcards.site}/poles/components.json"] if known else []


def pole_results():
    return [
        f"results/{site}/poles/{file}"
        for site in ASKED_SITES
        if wants(site, "poles")
        for file in ("poles.gpkg", "hazard.parquet", "page.json")
    ]


def pole_pages():
    return [f"results/{site}/poles/page.json" for site in ASKED_SITES if wants(site, "poles")]


def own_poles_page(wildcards):
    """Page of the poles, where the site asks for them."""
    asked = wants(wildcards.site, "poles")
    return [f"results/{wildcards.site}/poles/page.json"] if asked else []


def pole_layers(wildcards):
    return [f"results/{wildcards.site}/poles/poles.gpkg"]


def pole_files(wildcards):
    """Files of the poles that the report names."""
    names = (
        "poles.parquet",
        "poles.gpkg",
        "poles.csv",
        "poles.geojson",
        "hazard.csv",
        "road_geometry.csv",
    )
    return [f"results/{wildcards.site}/poles/{name}" for name in names]


def road_edge_layers(wildcards):
    return [f"results/{wildcards.site}/poles/road_edges.gpkg"]


def poles_only(inputs):
    """An input function that gives nothing where a site does not ask for poles."""
    return lambda wildcards: inputs(wildcards) if wants(wildcards.site, "poles") else []
