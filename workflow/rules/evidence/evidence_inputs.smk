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
    resolved, plans = SITES[wildcards.site], plans_of(wildcards.site).values()
    site, own, truth, poles = attrgetter("site", "site.placement", "site.truth", "site.poles")(
        resolved
    )

    def named(what, path, crs=None, kind="places"):
        return kind, what, None if path in (None, "sample") else resolved.layered(path), crs

    rows = []
    if has_scene_page(wildcards.site):
        rows += [
            named("orthophoto", site.orthophoto, kind="picture"),
            named("edges", own.edges, own.edges_crs),
            named("polygons of the monitored area", own.tma),
            named("zones", own.zones),
            named("existing poles", own.mounts),
            named("cabinets", own.cabinets),
            named("known polygons", truth.pavement, truth.pavement_crs),
        ]
    for plan in plans if wants(wildcards.site, "placement") else []:
        for what, features in (
            ("areas", plan.areas),
            ("forbidden places", plan.forbidden),
            ("mandatory places", plan.mandatory),
            ("poles of the plan", plan.poles),
        ):
            rows += [("places", what, features.file, features.crs)] if features is not None else []
    if wants(wildcards.site, "poles") and not site.sample:
        rows += [
            named("known poles", truth.poles, truth.poles_crs),
            named("barriers", site.roads.barriers, site.roads.barriers_crs),
            named("corrections", poles.corrections, kind="images"),
            named("given cameras", poles.cameras, kind="images"),
            named("known cameras", truth.cameras, kind="images"),
            *(("folder", "label images", file, None) for file in named_folders(resolved, "masks")),
            *(("folder", "depth images", file, None) for file in named_folders(resolved, "depth")),
        ]
    found = [dict(zip(("kind", "what", "path", "crs"), row)) for row in rows if row[2] is not None]
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


# A site has no choice about poses that nobody gives.
effects_of_one_way = where(site_field("poles.cameras"))("", "--leave-out road_alignment")


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
