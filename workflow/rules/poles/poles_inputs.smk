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


def has_classes(wildcards):
    """Whether the cloud has classes of road and ground; without, the pavement stands for them."""
    return SITES[wildcards.site].site.poles.road == "classes"


if_unclassed = where(lambda wildcards: not has_classes(wildcards))
if_curbs = where(lambda wildcards: setting("road_edges.method")(wildcards) == "curbs")


def road_source(wildcards):
    return "class" if has_classes(wildcards) else "pavement"


@where
def if_bearings(wildcards):
    """Bearings are those to the nearest voxel, or depths are fitted to voxels."""
    sightings = SITES[wildcards.site].settings.sightings
    return sightings.bearing == "lidar" or sightings.distance == "published"


@where
def if_objects(wildcards):
    """Objects that the cloud shows are asked for."""
    kinds = SITES[wildcards.site].setting("sightings.kinds")
    return not {"tree", "guardrail", "building", "headwall"}.isdisjoint(kinds)


def pole_frames(wildcards):
    return f"results/{wildcards.site}/poles/frames.parquet"


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
