"""Helpers of the pole rules: images and what is made of them, by shard."""

import shlex

from roadsight.io.texts import read_yaml
from roadsight.io.videolog_files import files_by_shard


def flags(section, *left_out):
    """Settings of a section as command-line options, for a rule that takes them all."""

    def options(wildcards):
        values = (
            SITES[wildcards.site].setting(section).model_dump(exclude=set(left_out))
        )
        return " ".join(
            f"--{name.replace('_', '-')} {option(value)}"
            for name, value in values.items()
        )

    return options


def some_flags(section, *names):
    """The same of some settings of a section, for a rule that shares them with another."""

    def options(wildcards):
        values = SITES[wildcards.site].setting(section).model_dump(include=set(names))
        return " ".join(
            f"--{name.replace('_', '-')} {option(values[name])}" for name in names
        )

    return options


def option(value):
    return " ".join(map(str, value)) if isinstance(value, list) else str(value)


def image_shards(wildcards):
    return range(SITES[wildcards.site].settings.shards)


def pole_shards(kind, suffix):
    """All shards of one kind of result."""
    return lambda wildcards: [
        f"results/{wildcards.site}/poles/{kind}/{shard}.{suffix}"
        for shard in image_shards(wildcards)
    ]


all_image_edges = pole_shards("image_edges", "parquet")
all_pole_axes = pole_shards("pole_axes", "parquet")
all_sightings = pole_shards("sightings", "parquet")


def is_rendered(wildcards):
    return SITES[wildcards.site].site.sample is not None


def videolog_file(wildcards):
    """The table of the videolog: the site's, the generated one, or none where images are tagged."""
    if is_rendered(wildcards):
        return [f"results/{wildcards.site}/sample/videolog.csv"]
    return beside_site("poles.videolog")(wildcards)


def images_path(wildcards):
    """Folder or archive of the images."""
    if is_rendered(wildcards):
        return f"results/{wildcards.site}/sample/images"
    resolved = SITES[wildcards.site]
    return resolved.beside(resolved.site.poles.images)


def videolog_path(wildcards):
    """The table, or the images themselves where they are tagged."""
    return (videolog_file(wildcards) or [images_path(wildcards)])[0]


def rendered_images(wildcards):
    """Archives of rendered images, where the site has them."""
    if not is_rendered(wildcards):
        return []
    return [
        f"{images_path(wildcards)}/{shard}.zip" for shard in image_shards(wildcards)
    ]


def rendered_shard(wildcards):
    files = rendered_images(wildcards)
    return files[int(wildcards.shard)] if files else []


def shard_images_path(wildcards):
    return rendered_shard(wildcards) or images_path(wildcards)


@lru_cache(maxsize=None)
def videolog_shards(site, folders):
    resolved = SITES[site]
    table = resolved.beside(resolved.site.poles.videolog) or folders[0]
    return clearly(files_by_shard, table, list(folders), resolved.settings.shards)


def image_digest(*fields):
    """Checksum of the images of a shard (of all, without one) and of what comes with them."""

    def digest(wildcards):
        resolved = SITES[wildcards.site]
        if resolved.site.sample:
            return ""
        named = [images_path(wildcards)]
        named += [path for field in fields for path in named_folders(resolved, field)]
        shards = videolog_shards(wildcards.site, tuple(named))
        if "shard" in wildcards.keys():
            return CHECKSUMS.of_all(shards[int(wildcards.shard)])
        return CHECKSUMS.of_all({file for files in shards for file in files})

    return digest


def named_folders(resolved, field):
    """Folders of label or depth images that the site names."""
    poles = resolved.site.poles
    if field == "depth":
        named = [poles.depth.images] if poles.depth else []
    else:
        named = [source.labels for source in poles.masks]
    return [resolved.beside(path) for path in named if path]


OWN_CLASSES = "resources/manifests/road_classes.yaml"
OWN_DEPTH = "resources/manifests/road_depth.yaml"


def mask_sources(wildcards):
    """Sources of pixel classes as lists of files: the site's, or the project's own network."""
    resolved = SITES[wildcards.site]
    sources = [
        [resolved.beside(path) for path in source.files]
        for source in resolved.site.poles.masks
    ]
    return sources or [[OWN_CLASSES]]


def mask_options(wildcards):
    return " ".join(
        "--source " + " ".join(map(shlex.quote, source))
        for source in mask_sources(wildcards)
    )


def depth_source(wildcards):
    resolved = SITES[wildcards.site]
    depth = resolved.site.poles.depth
    return OWN_DEPTH if depth is None else resolved.beside(depth.model or depth.images)


def depth_kind(wildcards):
    depth = SITES[wildcards.site].site.poles.depth
    return "inverse_depth" if depth is None else depth.kind


def model_files(manifests):
    """Manifests and label maps with the networks that lie beside them."""
    files = [file for file in manifests if file.endswith((".yaml", ".yml"))]
    return [path for file in files for path in (file, *clearly(networks_of, file))]


def networks_of(manifest):
    """The network that a manifest names; label maps name none."""
    name = os.path.expandvars(str((read_yaml(manifest) or {}).get("file", "")))
    network = Path(manifest).parent / name
    return [str(network)] if network.is_file() else []


def mask_models(wildcards):
    return model_files([file for source in mask_sources(wildcards) for file in source])


def depth_models(wildcards):
    return model_files([depth_source(wildcards)])


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


def drive_profile(wildcards):
    return f"results/{wildcards.site}/poles/drive.json"


def used_views(wildcards):
    """Views that are looked at; its rule takes `after_profile` among its inputs."""
    skipped = decision_on("side_views")(wildcards) == "skip"
    return "front" if skipped else "front left right"


def without_distortion(kind):
    """Masks or depth of a shard: straightened ones where the lenses distort."""

    def path(wildcards):
        after_profile("lens_distortion")(wildcards)
        distorted = decided("lens_distortion", wildcards) == "simulate"
        folder = f"straight/{kind}" if distorted else kind
        return f"results/{wildcards.site}/poles/{folder}/{wildcards.shard}.zip"

    return path


def all_without_distortion(kind):
    """The same of all shards."""

    def paths(wildcards):
        after_profile("lens_distortion")(wildcards)
        distorted = decided("lens_distortion", wildcards) == "simulate"
        folder = f"straight/{kind}" if distorted else kind
        return pole_shards(folder, "zip")(wildcards)

    return paths


all_masks = all_without_distortion("masks")
all_depths = all_without_distortion("depth")


def given_lenses(wildcards):
    """Lenses of the site file as JSON."""
    lenses = SITES[wildcards.site].site.poles.lenses
    return json.dumps([lens.model_dump() for lens in lenses])


def aligns(wildcards):
    """Whether cameras are found by aligning them with the road."""
    after_profile("road_alignment")(wildcards)
    aligned = decided("road_alignment", wildcards) == "simulate"
    resolved = SITES[wildcards.site]
    if not aligned and not resolved.site.poles.cameras:
        clearly(refuse_without_cameras, resolved)
    return aligned


def refuse_without_cameras(resolved):
    raise InputError(
        "road_alignment is skipped, but no cameras are given",
        where=f"{resolved.file}: settings.effects",
        hint="give poles.cameras, or leave the decision to the share of given cameras",
    )


def camera_folder(wildcards):
    return "cameras" if aligns(wildcards) else "given_cameras"


def all_cameras(wildcards):
    return pole_shards(camera_folder(wildcards), "parquet")(wildcards)


def cameras_of_shard(wildcards):
    folder = camera_folder(wildcards)
    return f"results/{wildcards.site}/poles/{folder}/{wildcards.shard}.parquet"


def calibration_if_aligned(wildcards):
    """The drives' calibration, which given cameras do not need."""
    found = f"results/{wildcards.site}/poles/calibration.json"
    return [found] if aligns(wildcards) else []


def cameras_of_videolog(wildcards):
    """Cameras that come with the videolog: the site's file, or those of the generated site."""
    if SITES[wildcards.site].site.poles.cameras == "sample":
        return [f"results/{wildcards.site}/sample/truth_cameras.csv"]
    return beside_site("poles.cameras")(wildcards)


def uses_landmarks(wildcards):
    return SITES[wildcards.site].setting("alignment.landmarks") == "use"


def landmark_axes(wildcards):
    """Pole axes in the images, where poles help to align the cameras."""
    return all_pole_axes(wildcards) if uses_landmarks(wildcards) else []


def landmark_columns(wildcards):
    """Pole-like columns of the cloud, where they help to align the cameras."""
    found = f"results/{wildcards.site}/poles/columns.parquet"
    return [found] if uses_landmarks(wildcards) else []


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
    """Voxels, where bearings are those to the nearest of them, as published."""
    lidar = SITES[wildcards.site].setting("sightings.bearing") == "lidar"
    return [f"results/{wildcards.site}/poles/voxels.parquet"] if lidar else []


def pole_frames(wildcards):
    return f"results/{wildcards.site}/poles/frames.parquet"


def found_poles(wildcards):
    return f"results/{wildcards.site}/poles/poles.parquet"


def known_poles(wildcards):
    """Known poles: the site's file, or those of the generated site."""
    if is_rendered(wildcards):
        return [f"results/{wildcards.site}/sample/truth_poles.csv"]
    return beside_site("truth.poles")(wildcards)


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
    return [
        f"results/{site}/poles/page.json"
        for site in ASKED_SITES
        if wants(site, "poles")
    ]


def poles_only(inputs):
    """An input function that gives nothing where a site does not ask for poles."""
    return lambda wildcards: inputs(wildcards) if wants(wildcards.site, "poles") else []


# Settings of the alignment that the calibration of the drive does not know.
ALIGNMENT_ONLY = ("landmarks", "method", "max_residual_px", "max_sigma_heading_deg")
