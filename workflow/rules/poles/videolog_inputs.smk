"""Helpers of the rules on images: where they are, what reads them, which views are looked at."""

import shlex

from roadsight.base.texts import read_yaml
from roadsight.io.records.companions import weight_files
from roadsight.io.images.videolog_files import files_by_shard


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
    return [f"{images_path(wildcards)}/{shard}.zip" for shard in image_shards(wildcards)]


@lru_cache(maxsize=None)
def videolog_shards(site, folders):
    resolved = SITES[site]
    table = resolved.beside(resolved.site.poles.videolog) or folders[0]
    shards, every = resolved.settings.shards, resolved.settings.videolog.every
    return clearly(files_by_shard, table, list(folders), shards, every)


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


# The project's own networks, for sites that name none.
OWN_CLASSES = "resources/manifests/road_classes.yaml"
OWN_DEPTH = "resources/manifests/road_depth.yaml"


def mask_sources(wildcards):
    """Sources of pixel classes as lists of files: the site's, or the project's own network."""
    resolved = SITES[wildcards.site]
    sources = [
        [resolved.beside(path) for path in source.files] for source in resolved.site.poles.masks
    ]
    return sources or [[OWN_CLASSES]]


def mask_options(wildcards):
    return " ".join(
        "--source " + " ".join(map(shlex.quote, source)) for source in mask_sources(wildcards)
    )


def depth_source(wildcards):
    resolved = SITES[wildcards.site]
    depth = resolved.site.poles.depth
    return OWN_DEPTH if depth is None else resolved.beside(depth.model or depth.images)


def depth_kind(wildcards):
    depth = SITES[wildcards.site].site.poles.depth
    return "inverse_depth" if depth is None else depth.kind


def own_networks(wildcards):
    """Option that names the project's own networks where they read images that are not its own.

    What a network holds tells whose it is, wherever the site keeps it.
    """
    if is_rendered(wildcards):
        return ""
    files = [file for source in mask_sources(wildcards) for file in source]
    used = network_checksums([*files, depth_source(wildcards)])
    named = {"classes": OWN_CLASSES, "depth": OWN_DEPTH}
    own = [kind for kind, file in named.items() if used & network_checksums([file])]
    return f"--own-networks {' '.join(own)}" if own else ""


def network_checksums(manifests):
    """Checksums of the networks that manifests name."""
    networks = set(model_files(manifests)) - set(manifests)
    return {CHECKSUMS.of(file) for file in networks}


def model_files(manifests):
    """Manifests and label maps with the networks that lie beside them."""
    files = [file for file in manifests if file.endswith((".yaml", ".yml"))]
    return [path for file in files for path in (file, *clearly(networks_of, file))]


def networks_of(manifest):
    """The network that a manifest names, and its weights; label maps name none."""
    name = os.path.expandvars(str((read_yaml(manifest) or {}).get("file", "")))
    network = Path(manifest).parent / name
    if not network.is_file():
        return []
    return [str(file) for file in (network, *weight_files(network))]


def models_digest(models):
    """Checksum of manifests, networks and the weights beside them."""
    return lambda wildcards: CHECKSUMS.of_all(models(wildcards))


def mask_models(wildcards):
    return model_files([file for source in mask_sources(wildcards) for file in source])


def depth_models(wildcards):
    return model_files([depth_source(wildcards)])


def used_views(wildcards):
    """Views that are looked at; its rule takes `after_profile` among its inputs."""
    skipped = decision_on("side_views")(wildcards) == "skip"
    return ["front"] if skipped else ["front", "left", "right"]


def given_lenses(wildcards):
    """Lenses of the site file as JSON."""
    return json.dumps(lenses_of(SITES[wildcards.site].site.poles))


def lenses_of(poles):
    """Distortion that a site states: a known lens without any has none, and none is sought."""
    stated = [lens.model_dump() for lens in poles.lenses]
    if poles.intrinsics is not None and not poles.cameras:
        stated.append({"route": None, "k1": 0.0, "k2": 0.0, "focal_px": 1000.0})
    return stated
