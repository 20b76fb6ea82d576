"""Helpers of the evidence rules: studies, audits, and the sites that they start from."""

from roadsight.evidence import paper
from roadsight.evidence.metrics import METRICS
from roadsight.evidence.studies import load_overrides

STUDIES = TRADEOFFS.studies


wildcard_constraints:
    study="|".join(map(re.escape, STUDIES)),
    level=r"\d+",
    job="placement|poles",
    size="short|long",
    run=r"[a-z0-9_]+-[a-z0-9_]+",


def told_doubts(wildcards):
    """Files in which stages tell what their answers rest on; a stage that tells adds its own."""
    given = given_lists(wildcards)
    matched = [f"results/{wildcards.site}/doubts/match_inputs.json"] if given else []
    told = [rules.build_dem.output.doubts]
    pavement_for_poles = wants(wildcards.site, "poles") and not has_classes(wildcards)
    if has_scene_page(wildcards.site) or pavement_for_poles:
        told.append(rules.extract_pavement.output.doubts)
    if wants(wildcards.site, "poles"):
        told += [rules.profile_drive.output.doubts]
        told += [rules.triangulate_poles.output.doubts, rules.rate_hazard.output.doubts]
        told += [rules.calibrate_drive.output.doubts] if aligns(wildcards) else []
    scene = [file.format(site=wildcards.site) for file in told]
    return [*scene, *matched, *placement_only(placement_doubts)(wildcards)]


def given_lists(wildcards):
    """Lists that the user gave, of places, of images and folders, as `match_inputs` takes them."""
    resolved = SITES[wildcards.site]
    site, poles, found = resolved.site, resolved.site.poles, []

    def add(kind, what, path, crs=None):
        found.append(dict(kind=kind, what=what, path=path, crs=crs))

    def add_named(kind, what, path, crs=None):
        if path is not None and path != "sample":
            add(kind, what, resolved.layered(path), crs)

    if has_scene_page(wildcards.site):
        add_named("picture", "orthophoto", site.orthophoto)
        own = site.placement
        for what, path, crs in (
            ("edges", own.edges, own.edges_crs),
            ("polygons of the monitored area", own.tma, None),
            ("zones", own.zones, None),
            ("existing poles", own.mounts, None),
            ("cabinets", own.cabinets, None),
            ("known polygons", site.truth.pavement, site.truth.pavement_crs),
        ):
            add_named("places", what, path, crs)
    if wants(wildcards.site, "placement"):
        for plan in plans_of(wildcards.site).values():
            for option, what in (
                ("areas", "areas"),
                ("forbidden", "forbidden places"),
                ("mandatory", "mandatory places"),
                ("poles", "poles of the plan"),
            ):
                features = getattr(plan, option)
                if features is not None:
                    add("places", what, features.file, features.crs)
    if wants(wildcards.site, "poles") and not site.sample:
        truth = site.truth
        add_named("places", "known poles", truth.poles, truth.poles_crs)
        add_named("places", "barriers", site.roads.barriers, site.roads.barriers_crs)
        for what, path in (
            ("corrections", poles.corrections),
            ("given cameras", poles.cameras),
            ("known cameras", truth.cameras),
        ):
            add_named("images", what, path)
        for path in named_folders(resolved, "masks"):
            add("folder", "label images", path)
        for path in named_folders(resolved, "depth"):
            add("folder", "depth images", path)
    return list({(one["kind"], one["path"]): one for one in found}.values())


def listed_files(wildcards):
    """Files among the lists, without the layers that they name."""
    lists = given_lists(wildcards)
    named = [one["path"] for one in lists if one["kind"] != "folder"]
    return [file for path in named for file in with_companions(path)]


def listed_images(wildcards):
    """Checksum of the images and the folders among the lists, empty where there are none."""
    lists = given_lists(wildcards)
    if all(one["kind"] != "folder" for one in lists):
        return ""
    return image_digest("masks", "depth")(wildcards)


def frames_of_lists(wildcards):
    """Frames of the videolog, where a list is about its images."""
    lists = given_lists(wildcards)
    if all(one["kind"] in ("places", "picture") for one in lists):
        return []
    await_profile("side_views", wildcards)
    return [f"results/{wildcards.site}/poles/frames.parquet"]


def study_of(wildcards):
    return STUDIES[wildcards.study]


def level_name(wildcards):
    return list(study_of(wildcards).levels)[int(wildcards.level)]


@lru_cache(maxsize=None)
def site_named(file):
    """Name of the site of a site file."""
    return clearly(load_site, file, OWN_PLANS).site.site


def site_of_job(job):
    """Name of the site on which a job's studies are measured, if they name none."""
    return site_named(TRADEOFFS.sites[job])


def at_base(function):
    """A function of a site file for a rule: of the one that a study, or a job's, starts from."""
    return lambda wildcards: function(
        TRADEOFFS.site_of(study_of(wildcards))
        if "study" in wildcards.keys()
        else TRADEOFFS.sites[wildcards.job]
    )


def config_of_site(site):
    """The configuration with one site and its own plans alone.

    Neither the file that names the studies nor plans that this run asks for make a level stale.
    """
    file = type(CONFIG).model_fields["tradeoffs_file"].default
    changes = {"sites": [site], "tradeoffs_file": file}
    return OWN_PLANS.model_copy(update=changes).model_dump_json()


@lru_cache(maxsize=None)
def targets_at(file):
    """Everything that any study at a site reads, below the site's results."""
    plan = next(iter(plans_of(site_named(file))), "")
    studies = [study for study in STUDIES.values() if TRADEOFFS.site_of(study) == file]
    metrics = [METRICS[metric] for study in studies for metric in study.metrics]
    targets = dict.fromkeys(target for metric in metrics for target in metric.targets)
    return [target.format(plan=plan) for target in targets]


def base_at(file):
    """The same at the site's own settings."""
    return [f"results/{site_named(file)}/{target}" for target in targets_at(file)]


def audited_sites(job):
    """Sites that ask for an audit of a job."""
    return [
        site
        for site, resolved in SITES.items()
        if resolved.settings.effects == "audit" and wants(site, job)
    ]


def config_of_audit(wildcards):
    """The configuration with the audited site and plan alone."""
    plans = list(plans_of(wildcards.site))[:1]
    changes = {"sites": [str(SITES[wildcards.site].file)], "plans": plans}
    return CONFIG.model_copy(update=changes).model_dump_json()


def effects_of_one_way(wildcards):
    """Effects of the pole job that a site has no choice about: poses that nobody gives."""
    given = SITES[wildcards.site].site.poles.cameras
    return "" if given else "--leave-out road_alignment"


def audited_plan(wildcards):
    return next(iter(plans_of(wildcards.site)))


def run_of_paper(wildcards):
    return paper.runs(wildcards.size)[wildcards.run]


def site_of_paper(wildcards):
    return paper.site_name(run_of_paper(wildcards).site, wildcards.size)


def base_of_paper(wildcards):
    """What the default run of a site makes; the other runs share it."""
    runs = paper.runs(wildcards.size)
    default = runs[f"{runs[wildcards.run].site}-default"]
    return [f"results/{site_of_paper(wildcards)}/{target}" for target in default.targets]


def config_of_paper(wildcards):
    """The configuration with this site alone, whatever this run asks for."""
    file = paper.site_file(run_of_paper(wildcards).site, wildcards.size)
    return OWN_PLANS.model_copy(update={"sites": [file]}).model_dump_json()


def changes_of_paper(wildcards):
    """Settings of the published studies where the run has them, then the run's own."""
    run = run_of_paper(wildcards)
    named = clearly(load_overrides, paper.PUBLISHED_FILE) if run.published else {}
    return merged(named, run.changes)


def runs_of_paper(wildcards):
    return [f"results/paper/runs/{wildcards.size}/{run}.json" for run in paper.runs(wildcards.size)]
