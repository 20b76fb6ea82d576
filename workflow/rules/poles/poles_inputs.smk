"""Helpers of the pole rules: shards, the road, known and found poles, cameras."""

from roadsight.base.shards import deal
from roadsight.io.images.camera_tables import corrections_of
from roadsight.io.images.videolog_files import check_corrections, dealt_images, videolog_images
from roadsight_worlds.rural.image_names import image_names


def image_shards(wildcards):
    return range(SITES[wildcards.site].settings.shards)


def pole_shards(kind, suffix):
    """All shards of one kind of result, which may hang on the wildcards."""
    return lambda wildcards: [
        f"results/{wildcards.site}/poles/{value_at(wildcards, kind)}/{shard}.{suffix}"
        for shard in image_shards(wildcards)
    ]


def pole_shard(kind, suffix):
    """The shard that a rule is about."""
    return lambda wildcards: (
        f"results/{wildcards.site}/poles/{kind(wildcards)}/{wildcards.shard}.{suffix}"
    )


all_image_edges = pole_shards("image_edges", "parquet")
all_matches = pole_shards("matches", "parquet")
all_pole_axes = pole_shards("pole_axes", "parquet")
all_sightings = pole_shards("sightings", "parquet")


def distorts(wildcards):
    """Whether the lenses of a site distort its views."""
    await_profile("lens_distortion", wildcards)
    return decided("lens_distortion", wildcards) == "simulate"


def straight(kind):
    """Folder of masks or depth: of straightened ones where the lenses distort."""
    return lambda wildcards: f"straight/{kind}" if distorts(wildcards) else kind


all_masks = pole_shards(straight("masks"), "zip")
all_depths = pole_shards(straight("depth"), "zip")
# Profile of the drive with its lenses, where they distort.
distorting_drive = where(distorts)("results/{site}/poles/drive.json")


def has_classes(wildcards):
    """Whether the cloud has classes of road and ground; without, the pavement stands for them."""
    return SITES[wildcards.site].site.poles.road == "classes"


if_unclassed = where(lambda wildcards: not has_classes(wildcards))
if_curbs = where(lambda wildcards: setting("road_edges.method")(wildcards) == "curbs")


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


known_poles = sample_or_beside("truth.poles", "truth_poles.csv")
known_cameras = sample_or_beside("truth.cameras", "truth_cameras.csv")
cameras_of_videolog = sample_or_beside("poles.cameras", "truth_cameras.csv", where_stated=True)


# Which of the known posts are poles.
known_pole_kind = if_rendered("utility", site_field("truth.poles_kind"))
camera_scores = poles_only(where(known_cameras)(["results/{site}/poles/camera_scores.json"]))
pole_validation = poles_only(where(known_poles)(["results/{site}/poles/validation.json"]))
compared_components = where(
    lambda wildcards: (
        setting("validation.components")(wildcards) == "compare" and pole_validation(wildcards)
    )
)(["results/{site}/poles/components.json"])


def aligns(wildcards):
    """Whether cameras are found by aligning them with the road."""
    await_profile("road_alignment", wildcards)
    aligned = decided("road_alignment", wildcards) == "simulate"
    resolved = SITES[wildcards.site]
    if not aligned and not resolved.site.poles.cameras:
        refuse(
            "road_alignment is skipped, but no cameras are given",
            where=f"{resolved.file}: settings.effects",
            hint="give poles.cameras, or leave the decision to the share of given cameras",
        )
    return aligned


def registered_cameras(wildcards):
    """Registered cameras: the site's file; where the published alignment needs one, the sample's."""
    resolved = SITES[wildcards.site]
    given = beside_site("poles.baseline")(wildcards)
    if given or resolved.setting("alignment.method") != "published":
        return given
    if is_rendered(wildcards):
        return [f"results/{wildcards.site}/sample/baseline.json"]
    return refuse(
        "the published alignment starts from a registered camera of each image size",
        where=f"{resolved.file}: poles.baseline",
        found="none",
        hint="register one image of each size with `roadsight register` or in the studio",
    )


# Given cameras need no calibration of the drives.
if_aligned = where(aligns)
camera_folder = if_aligned("cameras", "given_cameras")
all_cameras = pole_shards(camera_folder, "parquet")


def side_turns_if_used(wildcards):
    """Yaw of the side views from what images share, where cameras are aligned and views are used."""
    await_profile("side_views", wildcards)
    stitched = SITES[wildcards.site].setting("sightings.side_views") == "stitched"
    used = used_views(wildcards) != ["front"] and aligns(wildcards) and not stitched
    return [f"results/{wildcards.site}/poles/side_turns.json"] if used else []


def intrinsics_file(wildcards):
    """Table of known lenses, where the site names one instead of its numbers."""
    lens = stated("poles.intrinsics", wildcards)
    return [SITES[wildcards.site].beside(lens)] if isinstance(lens, str) else []


def is_dense(wildcards):
    """Whether cameras are aligned with all that photographs and cloud share."""
    method = SITES[wildcards.site].setting("alignment.method")
    known_lens = stated("poles.intrinsics", wildcards) is not None
    return method == "dense" or (method == "auto" and known_lens)


if_dense = where(is_dense)


def camera_memory(wildcards, attempt):
    """Fields of a dozen photographs and the cloud around them took 1.5 GB."""
    return attempt * (2500 if is_dense(wildcards) else 1000)


def dense_options(wildcards):
    """Options of the dense alignment that are no files of the workflow.

    Known lenses are told as a path, or as a row in JSON.
    """
    lens = stated("poles.intrinsics", wildcards)
    told = intrinsics_file(wildcards) or ([lens.model_dump_json(exclude_none=True)] if lens else [])
    parts = ["--intrinsics", shlex.quote(told[0])] if told else []
    if is_dense(wildcards):
        parts += ["--photographs", shlex.quote(str(images_path(wildcards)))]
        parts += ["--lenses", shlex.quote(given_lenses(wildcards))]
    return " ".join(parts)


if_landmarks = where(lambda wildcards: setting("alignment.landmarks")(wildcards) == "use")
if_ties = where(lambda wildcards: setting("alignment.ties")(wildcards) == "use")


def shard_corrections(wildcards):
    """What a person set for images of this shard, so that only their shard becomes stale."""
    resolved = SITES[wildcards.site]
    path = resolved.beside(resolved.site.poles.corrections)
    if path is None:
        return []
    dealt = clearly(images_by_shard, wildcards.site, path)
    return clearly(corrections_of, path, dealt[int(wildcards.shard)])


@lru_cache(maxsize=None)
def images_by_shard(site, path):
    """Names of each shard's images; refuse corrections of which none is about an image."""
    resolved = SITES[site]
    shards, every = resolved.settings.shards, resolved.settings.videolog.every
    if sample := resolved.site.sample:
        known = image_names(sample.length_m, 1)
        dealt = deal(image_names(sample.length_m, every), shards)
    else:
        images = resolved.beside(resolved.site.poles.images)
        table = resolved.beside(resolved.site.poles.videolog) or images
        known = videolog_images(table, images)
        dealt = dealt_images(table, images, shards, every)
    check_corrections(known, path)
    return [{name for name, own in dealt.items() if own == shard} for shard in range(shards)]


# The table of corrections, for shards that it is about.
corrections_file = where(shard_corrections)(beside_site("poles.corrections"))
