"""Helpers of the evidence rules: studies, their levels and the sites that they start from."""

from roadsight.evidence.metrics import METRICS

STUDIES = TRADEOFFS.studies


wildcard_constraints:
    study="|".join(map(re.escape, STUDIES)),
    level=r"\d+",


def level_name(wildcards):
    return list(STUDIES[wildcards.study].levels)[int(wildcards.level)]


def changes_of_level(wildcards):
    study = STUDIES[wildcards.study]
    return clearly(study.changes, level_name(wildcards))


def site_of_job(job):
    """Name of the site on which a job's studies are measured."""
    one = TRADEOFFS.model_copy(update={"sites": {job: TRADEOFFS.sites[job]}})
    return next(iter(clearly(load_evidence_sites, CONFIG, one)))


def config_of_study(wildcards):
    """The configuration with the study's site alone."""
    site = TRADEOFFS.sites[STUDIES[wildcards.study].job]
    return CONFIG.model_copy(update={"sites": [site]}).model_dump_json()


def base_of_study(wildcards):
    """Everything that any study of the same job reads, at the site's own settings."""
    job = STUDIES[wildcards.study].job
    site = site_of_job(job)
    plan = next(iter(plans_of(site)))
    metrics = [METRICS[m] for s in STUDIES.values() if s.job == job for m in s.metrics]
    targets = dict.fromkeys(target for metric in metrics for target in metric.targets)
    return [f"results/{site}/{target.format(plan=plan)}" for target in targets]


def measured_levels():
    return [
        f"results/tradeoffs/levels/{name}-{level}.json"
        for name, study in STUDIES.items()
        for level in range(len(study.levels))
    ]


def measured_length_km():
    """Length of the road of the pole job's site."""
    return SITES[site_of_job("poles")].site.sample.length_m / 1000


def config_of_site(wildcards):
    """The configuration with one site alone."""
    file = str(SITES[wildcards.site].file)
    return CONFIG.model_copy(update={"sites": [file]}).model_dump_json()


def audited_pole_effects(wildcards):
    """Effects of the pole job that can be both ways at a site: given poses, or what needs none."""
    given = SITES[wildcards.site].site.poles.cameras
    effects = [name for name, effect in EFFECTS.items() if effect.job == "poles"]
    return " ".join(e for e in effects if given or e != "road_alignment")
